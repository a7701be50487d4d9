"""What the report says of results that were handed in: their main numbers, and how they were moved."""

from __future__ import annotations

from collections.abc import Sequence

from eval.page.numbers import number
from eval.page.tables import is_blank
from eval.referee.paths.align import ABOUT, NONE
from eval.referee.paths.given import GivenRun
from eval.referee.score import Trial
from eval.report.rows import Row, value_of


def results_statement(trial: Trial, rows: Sequence[Row]) -> str:
    """A sentence on each result of a trial, from its rows of metrics.csv; empty where none was handed in."""
    names = {r.estimator for r in trial.runs if isinstance(r, GivenRun)}
    return " ".join(_sentence(row) for row in rows if row["estimator"] in names)


def _sentence(row: Row) -> str:
    """Errors and NEES of one phase."""
    said = []
    for column, what, unit in (
        ("rmse_position_m", "position RMSE", " m"), ("rpe_10m_m", "relative error over 10 m", " m"),
        ("nees_pose", "mean pose NEES", " (3 expected)"), ("rms_from_batch_m", "RMS distance from batch", " m"),
    ):  # fmt: skip
        if not is_blank(row[column]):
            said.append(f"{what} {number(value_of(row, column))}{unit}")
    of = "" if is_blank(row["matched"]) else f", {row['matched']} of {row['frames']} poses matched with the truth"
    return f"`{row['estimator']}` ({row['phase']}): {', '.join(said) or 'nothing to compare with'}{of}."


def aligned_statement(trial: Trial) -> str:
    """Which results were moved onto the truth, for captions; empty where none was."""
    moved = [r for r in trial.runs if isinstance(r, GivenRun) and r.aligned != NONE]
    if not moved:
        return ""
    names = ", ".join(dict.fromkeys(r.estimator for r in moved))
    return f" But aligned: {names}, {ABOUT[moved[0].aligned]} (`--align {moved[0].aligned}`)."

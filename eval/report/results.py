"""The lines of `eval.score`: one estimate with a name and a value a line, or many runs with their verdicts.

What the report says of results that were handed in: their main numbers, and how they were moved.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from data.formats.results.reading import is_bag, read_path
from data.formats.results.space import projection
from data.formats.results.tables import Beside
from data.log import Log
from data.notice import Code, notice
from data.se2 import Array
from data.words import sentence
from eval.plan.flags.table import Reading
from eval.plan.results import Result, manner_of, phase_of, runs_of, true_path, truth_of
from eval.referee import consistency, errors
from eval.referee.consistency import QUANTITIES
from eval.referee.given_runs import NONE, GivenRun, TruePath, truth_log
from eval.referee.metrics import OF_ESTIMATES
from eval.referee.score import Trial, metrics_row
from eval.report.page.tables import is_blank, number
from eval.report.rows import Row, value_of
from eval.studies.montecarlo import Sample, verdicts

ESTIMATE = "estimate"
FIRST = tuple(f"{name}_position_m" for name in ("rmse", "mean", "median", "std", "min", "max"))
"""Absolute errors of the position stand in front."""
LEFT_OUT = ("observations", "accepted", "rejected", "landmarks", "frames", "lost_frame", "iterations", "block_frames")


@dataclass(frozen=True, eq=False)
class Scored:
    """An estimate with its truth: the run, and notes for the person."""

    run: GivenRun
    log: Log
    phase: str
    notes: tuple[str, ...]


def one(file: str, truth: str, reading: Reading) -> tuple[list[str], list[str]]:
    """Lines of the scores, a name and a value each, and what has to be said besides."""
    s = _scored(file, truth, reading)
    row = scores(s)
    return [f"{name} {_six(value)}" for name, value in row.items()], list(s.notes)


def several(files: Sequence[str], truths: Sequence[str], reading: Reading) -> tuple[list[str], list[str]]:
    """Lines of verdicts on many runs: errors pooled over all poses of equal weight a run, and the mean NEES."""
    found = [_scored(file, truth, reading) for file, truth in zip(files, truths, strict=True)]
    samples = [_sample(s) for s in found]
    lines = [f"runs {len(found)}"]
    for name, quantity, scale in (
        ("rmse_position_m", "position", 1.0), ("rmse_heading_deg", "heading", math.degrees(1.0)),
    ):  # fmt: skip
        lines.append(f"{name} {_six(scale * math.sqrt(float(np.mean([s.squares[quantity] for s in samples]))))}")
    bare = [f for f, s in zip(files, samples, strict=True) if not math.isfinite(s.means["pose"])]
    matched = sum(s.run.match.matched for s in found if s.run.match is not None)
    unmatched = sum(s.run.match.unmatched for s in found if s.run.match is not None)
    lines += [f"matched {matched}", f"unmatched {unmatched}"]
    notes = []
    if bare:
        notes.append(f"no NEES, as {len(bare)} of {len(files)} estimates have no usable covariance, {bare[0]} first")
    for quantity, v in verdicts(samples):
        name = quantity if quantity.startswith("coverage") else f"nees_{quantity}"
        expected = f"{v.expected:g} expected"
        interval = f"95 % interval {number(v.lower)} to {number(v.upper)}" if math.isfinite(v.lower) else "no interval"
        power = f", power {v.power:.2f} against 0.8 P" if math.isfinite(v.power) else ""
        lines.append(f"{name} {_six(v.mean)} {v.word} ({interval}, {expected}{power})")
    if len(found) < consistency.MIN_RUNS:
        notes.append(f"a verdict needs at least {consistency.MIN_RUNS} runs; these are {len(found)}")
    first = next((s.notes for s in found if s.notes), ())
    return lines, [*notes, *(f"{files[0]}: {n}" for n in first)]


def _scored(file: str, truth: str, reading: Reading) -> Scored:
    """An estimate, read and matched; of a truth that is a log, the run has its frames if they are the same."""
    notes = []
    path = Path(truth)
    if (path.is_dir() and not is_bag(path)) or not (path.exists() or is_bag(Path(truth.partition(":/")[0]))):
        from data.logs import open_log

        log = open_log(truth)
        asked = truth_of(log, None)
        given = None
    else:
        given = true_path(truth, [ESTIMATE], reading)
        log, asked = truth_log(path.stem, given), TruePath(given.time, given.pose)
        notes += [f"truth {truth}: {n}" for n in (projection(given), *given.notes) if n]
    if asked is None:
        from data.errors import DataError

        raise DataError.at(truth, "has no true poses (truth.csv)")
    phase = phase_of(Path(file))
    result = Result(ESTIMATE, {phase: read_path(file, manner_of(ESTIMATE, [ESTIMATE], reading))}, Beside())
    (run,) = runs_of(result, log, "slam", asked, reading)
    return Scored(run, log, phase, (*notes, *map(sentence, run.notes)))


def scores(s: Scored) -> dict[str, float]:
    """Every number by its name: those of metrics.csv, and what else is said of the position's errors."""
    row = metrics_row(s.run, s.phase, s.log, None)
    assert s.run.match is not None  # `runs_of` matched it
    pose, truth = s.run.trajectory(s.phase).pose, s.run.match.truth
    d = errors.position_distance(pose, truth)
    d = d[np.isfinite(d)]
    row |= {
        "mean_position_m": float(d.mean()), "median_position_m": float(np.median(d)),
        "std_position_m": float(d.std()), "min_position_m": float(d.min()),
    }  # fmt: skip
    row["rmse_heading_rad"] = math.radians(errors.heading_rmse_deg(pose, truth))
    rest = [m.column for m in OF_ESTIMATES if m.column not in (*FIRST, *LEFT_OUT)]
    rest.insert(rest.index("rmse_heading_deg") + 1, "rmse_heading_rad")
    names = [*FIRST, *rest]
    values = {name: row.get(name) for name in names}
    return {name: float(v) for name, v in values.items() if isinstance(v, (int, float)) and math.isfinite(v)}


def _sample(s: Scored) -> Sample:
    """What one run gives to the verdicts."""
    assert s.run.match is not None  # as above
    t, truth = s.run.trajectory(s.phase), s.run.match.truth
    each: dict[str, Array] = {q: consistency.nees(t.pose, t.covariance, truth, q) for q in QUANTITIES}
    ends = {q: v[np.isfinite(v)] for q, v in each.items()}
    return Sample(
        {q: consistency.mean_or_nan(v) for q, v in each.items()},
        {q: float(v[-1]) if len(v) else math.nan for q, v in ends.items()},
        {
            "position": errors.rms(errors.position_distance(t.pose, truth)) ** 2,
            "heading": math.radians(errors.heading_rmse_deg(t.pose, truth)) ** 2,
        },
    )


def _six(value: float) -> str:
    """Six significant digits; counts as they are."""
    return str(int(value)) if float(value).is_integer() and abs(value) < 1e6 else f"{value:.6g}"


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
    how = sentence(notice(Code.ALIGNED, how=moved[0].aligned))
    return f" But aligned: {names}, {how} (`--align {moved[0].aligned}`)."

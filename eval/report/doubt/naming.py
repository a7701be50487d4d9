"""Where the name of a landmark, which is that of the observation that initialized it, changes what the counts say."""

from __future__ import annotations

from collections.abc import Sequence

from eval.page.numbers import number
from eval.referee.score import Trial
from eval.report.rows import Row, value_of

WRONG, AGREE = 0.05, 0.99
"""More than this share of the pairings is FP, and yet more than that share shows what most of its landmark's do."""
OTHER = 0.05
"""Landmark RMSE differs by more than this share when landmarks are named by majority."""
REASON = "a landmark is named by the observation that initialized it; where that showed a neighbour, all others are FP"


def naming_statements(trial: Trial, metrics: Sequence[Row], association: Sequence[Row]) -> list[str]:
    """A sentence for each run of a trial where it matters, one for runs with the same numbers; rows of its log."""
    told: dict[str, list[str]] = {}
    for run in trial.runs:
        phase = run.phases[-1] if run.phases else ""
        scored = _row(association, run.estimator, run.association, phase)
        parts = (_pairings(scored), _places(_row(metrics, run.estimator, run.association, phase)))
        text = "; ".join(p for p in parts if p)
        if text:
            told.setdefault(f"{run.association}: {text}", []).append(run.estimator)
    return [f"{', '.join(names)} with {text}: {REASON}." for text, names in told.items()]


def _row(rows: Sequence[Row], estimator: str, association: str, phase: str) -> Row:
    key = (estimator, association, phase)
    return next((r for r in rows if (r["estimator"], r["association"], r["phase"]) == key), {})


def _pairings(row: Row) -> str:
    tp, fp, agree = (value_of(row, c) for c in ("tp", "fp", "majority_agreement"))
    if not (agree > AGREE and fp > WRONG * (tp + fp)):
        return ""
    return (
        f"{100.0 * fp / (tp + fp):.1f} % of the pairings are FP, yet {100.0 * agree:.1f} % of them show what most"
        " observations of their landmark do"
    )


def _places(row: Row) -> str:
    stated, by_majority = value_of(row, "rmse_landmark_m"), value_of(row, "rmse_landmark_majority_m")
    if not abs(stated - by_majority) > OTHER * stated:
        return ""
    return f"landmark RMSE is {number(stated)} m, by majority {number(by_majority)} m"

"""Rows of metrics.csv and association.csv, typed as far as the report uses them, and a trial's file names."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from data.log import folder_name
from data.se2 import Array
from eval.referee import battery
from eval.referee.consistency import CORRELATED, OVERCONFIDENT, innovations_word
from eval.referee.headline import overconfident
from eval.referee.score import Trial
from eval.replay.settings import BATCH, ESTIMATORS, FILTERS, INCREMENTAL
from eval.report.page.tables import is_blank
from eval.studies.trusted import Trust

Row = dict[str, object]
SYSTEMATIC = "systematic"  # picture and table of the systematic errors that were estimated along


def stem(trial: Trial, what: str = "") -> str:
    """Name of a trial's file, without suffix; without `what` that of its page in `details/`."""
    return "-".join(filter(None, (folder_name(trial.log.name), trial.task, what)))


def variants(trial: Trial, trials: Sequence[Trial]) -> tuple[Trial, ...]:
    """The variants of a trial: the same log with another setup or other knowledge."""
    if trial.variant_of is not None:
        return ()
    return tuple(t for t in trials if t.variant_of == trial.log.name and t.task == trial.task)


def value_of(row: Row, column: str) -> float:
    """A number of a row, NaN where it is blank."""
    value = row.get(column)
    return math.nan if is_blank(value) else float(value)  # type: ignore[arg-type]


def rows_of(frame: pd.DataFrame) -> list[Row]:
    """The rows of a table."""
    return [{str(k): v for k, v in r.items()} for r in frame.to_dict("records")]


@dataclass(frozen=True)
class Scored:
    """A row of metrics.csv: one run in one phase. Unknown: NaN, no `lost_why`."""

    estimator: str
    association: str
    phase: str
    status: str
    # rmse, aligned, from_batch: position RMSE [m] against the truth, after alignment, and against the batch solution
    rmse: float
    aligned: float
    from_batch: float
    # nees, nees_median: of the pose, over the frames but `nees_left_out` of nearly singular covariance. nis with its
    # bounds and expectation: per degree of freedom. lag1: of innovations; of a smoother that forms none the filter's
    nees: float
    nees_median: float
    nees_left_out: float
    nees_lower: float
    nis: float
    nis_lower: float
    nis_upper: float
    nis_expected: float
    lag1: float
    lag1_se: float
    rejected: float  # observations left out
    lost_frame: float
    lost_why: str
    twins: int = 0  # bootstrap replicates that bounds and expectation are of; 0: of the gated chi-square law

    @property
    def ok(self) -> bool:
        """Whether it reached the end, is plausible and not lost."""
        return self.status == "ok" and not self.lost_why

    @property
    def nis_verdict(self) -> str:
        """The word on the innovations (`innovations_word`); empty where none were formed."""
        return innovations_word(self.nis, self.nis_lower, self.nis_upper, self.lag1, self.lag1_se)

    @property
    def verdict(self) -> str:
        """The word on one log: its status, else overconfident by NEES, else on the innovations."""
        if self.status != "ok":
            return self.status
        return OVERCONFIDENT if overconfident(self.nees, self.nees_lower) else self.nis_verdict


NUMBERS = {
    "rmse": "rmse_position_m",
    "aligned": "rmse_aligned_m",
    "from_batch": "rms_from_batch_m",
    "nees": "nees_pose",
    "nees_median": "nees_pose_median",
    "nees_lower": "nees_pose_lower",
    "lag1": "innovation_lag1",
    "lag1_se": "innovation_lag1_se",
} | {name: name for name in (
    "nees_left_out", "nis", "nis_lower", "nis_upper", "nis_expected", "rejected", "lost_frame",
)}  # fmt: skip
"""Fields of `Scored` that are numbers, and their columns."""


def scored(row: Row) -> Scored:
    """A row of metrics.csv, typed."""
    estimator, association, phase, status = (str(row[c]) for c in ("estimator", "association", "phase", "status"))
    why = row.get("lost_why")
    numbers = {name: value_of(row, column) for name, column in NUMBERS.items()}
    words = {"lost_why": "" if is_blank(why) else str(why)}
    return Scored(estimator, association, phase, status, **numbers, **words)  # type: ignore[arg-type]


def scored_rows(rows: Sequence[Row], diagnoses: Sequence[Trust] = ()) -> list[Scored]:
    """Rows typed, in order, with the bounds of bootstrap replicates where there are some.

    A smoother uses the filter's decisions and noise, so where its row has no innovations of its own, correlated ones of
    a filter that is right otherwise are its own, too.
    """
    found = [scored(r) for r in rows]
    keys = [(str(r["log"]), str(r["task"]), s.association) for r, s in zip(rows, found, strict=True)]
    drawn = {(t.log, t.task, t.association): t for t in diagnoses if t.twins}
    found = [_beside(s, drawn[key]) if key in drawn else s for s, key in zip(found, keys, strict=True)]
    filters = filters_in(found)
    lags = {
        key: (s.lag1, s.lag1_se)
        for s, key in zip(reversed(found), reversed(keys), strict=True)
        if s.estimator in filters and s.ok and s.verdict == CORRELATED
    }
    return [
        s if math.isfinite(s.lag1) or key not in lags else replace(s, lag1=lags[key][0], lag1_se=lags[key][1])
        for s, key in zip(found, keys, strict=True)
    ]


def _beside(row: Scored, trust: Trust) -> Scored:
    """A row with what is expected of it by the replicates; a final cost is that of `batch`."""
    name = row.estimator if row.phase == "online" else "batch"

    def drawn(statistic: str) -> Array:
        values = [t.measured[name, statistic].value for t in trust.twins if (name, statistic) in t.measured]
        known: Array = np.array([v for v in values if math.isfinite(v)], float)
        return known

    nis, lag1 = drawn("nis"), drawn("innovation_lag1")
    lower, upper = battery.bounds(nis)
    if math.isfinite(lower):
        expected = float(np.median(nis))
        row = replace(row, nis_lower=lower, nis_upper=upper, nis_expected=expected, twins=len(nis))
    if len(lag1) > 1 and math.isfinite(row.lag1):
        row = replace(row, lag1=row.lag1 - float(np.median(lag1)), lag1_se=max(row.lag1_se, float(lag1.std(ddof=1))))
    return row


def filters_in(rows: Sequence[Scored]) -> tuple[str, ...]:
    """The estimators that do not revise their past: ours, and of others those that have no final row."""
    return (*FILTERS, *_others(rows, final=False))


def smoothers_in(rows: Sequence[Scored]) -> tuple[str, ...]:
    """The estimators that do."""
    return (*BATCH, *INCREMENTAL, *_others(rows, final=True))


def _others(rows: Sequence[Scored], *, final: bool) -> list[str]:
    finals = {r.estimator for r in rows if r.phase == "final"}
    names = dict.fromkeys(r.estimator for r in rows if r.estimator not in ESTIMATORS)
    return [name for name in names if (name in finals) == final]

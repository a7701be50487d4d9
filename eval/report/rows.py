"""Rows of metrics.csv and association.csv, typed as far as the report uses them, and a trial's file names."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import pandas as pd

from data.log import folder_name
from eval.referee.consistency import CONSERVATIVE, CONSISTENT, OVERCONFIDENT
from eval.referee.score import Trial
from eval.replay.settings import BATCH, ESTIMATORS, FILTERS, INCREMENTAL
from eval.report.page.tables import is_blank

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
    # bounds and expectation: per degree of freedom
    nees: float
    nees_median: float
    nees_left_out: float
    nees_lower: float
    nis: float
    nis_lower: float
    nis_upper: float
    nis_expected: float
    rejected: float  # observations left out
    lost_frame: float
    lost_why: str

    @property
    def ok(self) -> bool:
        """Whether it reached the end, is plausible and not lost."""
        return self.status == "ok" and not self.lost_why

    @property
    def nis_verdict(self) -> str:
        """`overconfident`, `conservative` or `consistent`; empty where no innovations were formed."""
        known = all(map(math.isfinite, (self.nis, self.nis_lower, self.nis_upper)))
        return nis_verdict(self.nis, self.nis_lower, self.nis_upper) if known else ""


def nis_verdict(nis: float, lower: float, upper: float) -> str:
    """`overconfident`, `conservative` or `consistent` of a NIS per dof against its bounds."""
    return OVERCONFIDENT if nis > upper else CONSERVATIVE if nis < lower else CONSISTENT


NUMBERS = {
    "rmse": "rmse_position_m",
    "aligned": "rmse_aligned_m",
    "from_batch": "rms_from_batch_m",
    "nees": "nees_pose",
    "nees_median": "nees_pose_median",
    "nees_lower": "nees_pose_lower",
} | {name: name for name in (
    "nees_left_out", "nis", "nis_lower", "nis_upper", "nis_expected", "rejected", "lost_frame",
)}  # fmt: skip
"""Fields of `Scored` that are numbers, and their columns."""


def scored(row: Row) -> Scored:
    """A row of metrics.csv, typed."""
    estimator, association, phase, status = (str(row[c]) for c in ("estimator", "association", "phase", "status"))
    why = row.get("lost_why")
    numbers = {name: value_of(row, column) for name, column in NUMBERS.items()}
    return Scored(estimator, association, phase, status, lost_why="" if is_blank(why) else str(why), **numbers)


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

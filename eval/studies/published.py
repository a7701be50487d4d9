"""Published numbers: how they are defined, and the differences of ours in standard errors."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from data.se2 import Array
from eval.referee.consistency import QUANTITIES
from eval.referee.result_files import PUBLISHED

COLUMNS = PUBLISHED.names
PUBLISHABLE = (*(f"nees_{q}" for q in QUANTITIES), "rmse_position_m", "rmse_heading_deg")


@dataclass(frozen=True)
class Row:
    """A published number with the standard error of its Monte Carlo (0: unknown)."""

    estimator: str
    quantity: str
    value: float
    se: float


@dataclass(frozen=True)
class Ordering:
    """A published statement that one estimator's number is smaller than another's."""

    quantity: str
    smaller: str
    larger: str


@dataclass(frozen=True)
class Published:
    """Published numbers of a scenario, and the definition of their averages."""

    rows: tuple[Row, ...] = ()
    orderings: tuple[Ordering, ...] = ()  # statements where numbers cannot be compared
    skipped_are_zero: bool = False  # frames before the scenario's first count as zeros in the average NEES
    per_dof: bool = False  # NEES divided by its degrees of freedom
    tolerance: tuple[tuple[str, float], ...] = ()  # of a replay: estimator, largest relative difference of any NEES
    note: str = ""  # for the reader

    def average(self, nees: Array, dof: int, from_frame: int) -> float:
        """Average NEES (N,) of a run by this definition; NaN if a step in the average has none."""
        used = nees[from_frame:]
        total = float(used.sum()) / (dof if self.per_dof else 1)
        return total / (len(nees) if self.skipped_are_zero else len(used)) if len(used) else math.nan


@dataclass(frozen=True)
class Estimate:
    """Our number with its standard error, from `runs` independent runs."""

    value: float
    se: float
    runs: int


def mean_of(values: Sequence[float]) -> Estimate:
    """Mean and its standard error."""
    x = np.asarray(values, float)
    return Estimate(float(x.mean()), float(x.std(ddof=1) / math.sqrt(len(x))) if len(x) > 1 else math.nan, len(x))


def rms_of(squares: Sequence[float], scale: float = 1.0) -> Estimate:
    """Pooled root mean square of each run's mean squared error; standard error to first order."""
    m = mean_of(squares)
    root = math.sqrt(m.value)
    return Estimate(scale * root, scale * m.se / (2.0 * root) if root > 0 else math.nan, m.runs)


def difference(ours: Estimate, published: float, se_published: float) -> float:
    """Difference in standard errors of the difference."""
    spread = math.hypot(ours.se, se_published)
    return (ours.value - published) / spread if spread > 0 else math.nan


def row_of(scenario: str, row: Row, ours: Estimate) -> Mapping[str, object]:
    """A row of published.csv."""
    who, theirs = (scenario, row.estimator, row.quantity), (row.value, row.se or math.nan)
    values = *who, ours.value, ours.se, *theirs, difference(ours, row.value, row.se)
    return dict(zip(COLUMNS, values, strict=True))

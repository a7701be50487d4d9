"""Do relative poses claim the errors that they have? NEES of the factors of a chain, and of loop closures."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from association.scans.constraints import Chain, Loops
from data.se2 import Array, between, wrap_angle
from eval.referee.bounds import LEVEL, chi2_bounds
from eval.referee.consistency import CONSERVATIVE, CONSISTENT, OVERCONFIDENT, squared_distance
from eval.referee.laser.closures import closure_errors, right_closures

DOF = 3


@dataclass(frozen=True)
class FactorNees:
    """NEES per degree of freedom (1 expected) of n relative poses, with the bounds that chance leaves it.

    scale: by which their covariances would have to be multiplied; the same number, under another name. median: of
    NEES / 3, 0.79 expected, which outliers do not move.
    """

    factors: int
    mean: float
    median: float
    lower: float
    upper: float

    @property
    def scale(self) -> float:
        """Factor on the covariances with which the mean would be 1."""
        return self.mean

    @property
    def word(self) -> str:
        """`consistent`, `overconfident` or `conservative`; empty where there is nothing to say it of."""
        if not self.factors:
            return ""
        if self.mean > self.upper:
            return OVERCONFIDENT
        return CONSERVATIVE if self.mean < self.lower else CONSISTENT


def factor_nees(squared: Sequence[Array], level: float = LEVEL) -> FactorNees:
    """NEES of relative poses, pooled over runs: `squared` distances (n,) of each, 3 dof.

    The bounds take them as independent, as the back ends do. Relative poses with a pose in common were matched to the
    same scan, so a mean outside the bounds by little proves nothing.
    """
    every = np.concatenate([np.empty(0), *squared])
    every = every[np.isfinite(every)] / DOF
    if not len(every):
        return FactorNees(0, math.nan, math.nan, math.nan, math.nan)
    return FactorNees(len(every), float(every.mean()), float(np.median(every)), *chi2_bounds(DOF * len(every), level))


def chain_squares(chain: Chain, truth: Array) -> Array:
    """Squared distances (K - 1,) of the chain's motions from the true ones; `truth` (K, 3) true key poses."""
    error = chain.motion[1:] - between(truth[:-1], truth[1:])
    error[:, 2] = wrap_angle(error[:, 2])
    return squared_distance(error, chain.covariance[1:])


def loop_squares(loops: Loops, truth: Array, *, wrong: bool = True) -> Array:
    """Squared distances of the believed loop closures from the true relative poses; `wrong`: of wrong ones, too."""
    which = loops.believed >= 0
    if not wrong:
        which = which & right_closures(loops, truth)
    return squared_distance(closure_errors(loops, truth)[which], loops.covariance[which])

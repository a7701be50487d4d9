"""NEES and NIS and what may be concluded from them: intervals, verdicts, the family-wise test of the exit status.

NEES = e' P^-1 e of the world-frame error; a consistent estimator has E[NEES] = dof. One run's time average is no sample
of independent values, so a verdict needs many runs (Student's t on the run means); see Bar-Shalom, Li, Kirubarajan,
Estimation with Applications to Tracking and Navigation, section 5.4.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import special

from data import se2
from data.se2 import Array

QUANTITIES = {"pose": (0, 1, 2), "position": (0, 1), "heading": (2,)}
MIN_RUNS = 50
"""Fewer runs than this have no power against a wrong covariance."""
LEVEL = 0.95
FAMILY_LEVEL = 0.001
"""False alarm rate of the exit status over all declared verdicts together."""
TAIL_LEVEL = 0.001
"""Probability below which a single run's mean NEES is impossible for a consistent estimator."""
INSIDE_3SIGMA = float(special.chdtr(2, 9.0))
"""Share of positions that a consistent estimator has inside its 3 sigma ellipse (98.89 %)."""

CONSISTENT, OVERCONFIDENT, CONSERVATIVE, TOO_FEW = "consistent", "overconfident", "conservative", "not enough runs"


def squared_distance(error: Array, covariance: Array) -> Array:
    """Squared distance e' P^-1 e (N,) of errors (N, k) and covariances (N, k, k); NaN if P is singular.

    P counts as invertible if its correlation matrix has no eigenvalue below 1e-12 (units must not decide).
    """
    result = np.full(len(error), np.nan)
    variance = np.einsum("nii->ni", covariance)
    usable = np.isfinite(error).all(axis=1) & np.isfinite(covariance).all(axis=(1, 2)) & (variance > 0).all(axis=1)
    if usable.any():
        sigma = np.sqrt(variance[usable])
        correlation = covariance[usable] / (sigma[:, :, None] * sigma[:, None, :])
        regular = np.linalg.eigvalsh(correlation)[:, 0] > 1e-12
        rows = np.flatnonzero(usable)[regular]
        scaled = error[rows] / sigma[regular]
        result[rows] = np.einsum("ni,ni->n", scaled, np.linalg.solve(correlation[regular], scaled[..., None])[..., 0])
    return result


def nees(pose: Array, covariance: Array, truth: Array, quantity: str) -> Array:
    """NEES (N,) per frame of `pose` (dof 3), `position` (2) or `heading` (1)."""
    columns = list(QUANTITIES[quantity])
    error = se2.pose_error(pose, truth)[:, columns]
    return squared_distance(error, covariance[:, columns][:, :, columns])


def mean_or_nan(values: Array) -> float:
    """Mean of the finite values; NaN if there are none."""
    finite = values[np.isfinite(values)]
    return float(finite.mean()) if len(finite) else math.nan


def inside_3sigma(position_nees: Array) -> float:
    """Share of frames whose position error lies inside the 3 sigma ellipse; compare with `INSIDE_3SIGMA`."""
    finite = position_nees[np.isfinite(position_nees)]
    return float(np.mean(finite <= 9.0)) if len(finite) else math.nan


def chi2_bounds(dof: int, level: float = LEVEL) -> tuple[float, float]:
    """Two-sided interval of a chi-square variable divided by its degrees of freedom."""
    if dof <= 0:
        return math.nan, math.nan
    tail = 0.5 * (1.0 - level)
    return float(special.chdtri(dof, 1.0 - tail) / dof), float(special.chdtri(dof, tail) / dof)


def anees_band(dof: int, runs: int, level: float = LEVEL) -> tuple[float, float]:
    """Band of the per-step average NEES over runs: for a plot (5 % of steps lie outside by design), no verdict."""
    lower, upper = chi2_bounds(dof * runs, level)
    return dof * lower, dof * upper


@dataclass(frozen=True)
class Verdict:
    """A mean with its interval, the word it deserves, and what the test could have seen.

    Attributes:
        mean, lower, upper: of the run means, with Student's t interval.
        dof: what a consistent estimator has as mean.
        runs: number of runs that enter.
        word: `consistent`, `overconfident`, `conservative` or `not enough runs`.
        p_value: two-sided, of a mean equal to dof.
        power: probability that this test, with this spread and this many runs, rejects a covariance claimed at 0.8
            of the true one.
    """

    mean: float
    lower: float
    upper: float
    dof: int
    runs: int
    word: str
    p_value: float
    power: float


def verdict(run_means: Array, dof: int, level: float = LEVEL) -> Verdict:
    """Student's t verdict on the run means (N,) of a statistic whose expectation is `dof`.

    A few diverging runs blow up the spread so far that the interval holds any value, dof included. A consistent
    estimator's run mean averages chi-square variables, so its tail is no heavier than theirs: a run mean that not even
    a single chi-square value would reach in N draws (probability `TAIL_LEVEL`) makes the verdict overconfident as well.
    """
    means = np.asarray(run_means, float)
    n = len(means)
    if n < 2 or not np.isfinite(means).all():
        return Verdict(mean_or_nan(means), math.nan, math.nan, dof, n, TOO_FEW, math.nan, math.nan)
    mean, error = float(means.mean()), float(means.std(ddof=1) / math.sqrt(n))
    half = float(special.stdtrit(n - 1, 0.5 * (1.0 + level))) * error
    p_value = float(2.0 * special.stdtr(n - 1, -abs(mean - dof) / error)) if error > 0 else float(mean == dof)
    word = CONSISTENT if mean - half <= dof <= mean + half else OVERCONFIDENT if mean > dof else CONSERVATIVE
    tail = min(n * float(special.chdtrc(dof, means.max())), 1.0)
    if tail < TAIL_LEVEL:
        word, p_value = OVERCONFIDENT, min(p_value, tail)
    if n < MIN_RUNS:
        word = TOO_FEW
    return Verdict(mean, mean - half, mean + half, dof, n, word, p_value, _power(dof, mean, error, n, level))


def _power(dof: int, mean: float, error: float, n: int, level: float, claimed: float = 0.8) -> float:
    """Power of the t test against a claimed covariance of `claimed` times the true one.

    Scaling P divides every NEES by the factor, so mean and spread of a consistent estimator's run means do too.
    """
    if error <= 0.0 or mean <= 0.0:
        return math.nan
    scaled = error * (dof / mean) / claimed
    shift = (dof / claimed - dof) / scaled
    critical = float(special.stdtrit(n - 1, 0.5 * (1.0 + level)))
    return float(special.ndtr(shift - critical) + special.ndtr(-critical - shift))


def holm_rejected(p_values: Sequence[float], level: float = FAMILY_LEVEL) -> list[bool]:
    """Holm's step-down procedure: which hypotheses are rejected at a family-wise level (Holm 1979)."""
    p = np.asarray(p_values, float)
    rejected = np.zeros(len(p), bool)
    for rank, i in enumerate(np.argsort(p, kind="stable")):
        if not p[i] <= level / (len(p) - rank):
            break
        rejected[i] = True
    return [bool(r) for r in rejected]

"""What may be concluded from NEES, NIS and innovations: intervals, verdicts, the family-wise test of the exit status.

NEES = e' P^-1 e of the world-frame error; a consistent estimator has E[NEES] = dof. One run's time average is no sample
of independent values, so a verdict needs many runs (Student's t on the run means); see Bar-Shalom, Li, Kirubarajan,
Estimation with Applications to Tracking and Navigation, section 5.4. docs/verdicts.md has the accept rate and the power
measured of each verdict.

Bounds inside which averages of squared normalized errors lie by chance: chi-square, and behind a gate.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import special

from data import se2
from data.inputs import IntArray
from data.result import Run
from data.se2 import Array, BoolArray

LEVEL = 0.95


def chi2_bounds(dof: int, level: float = LEVEL) -> tuple[float, float]:
    """Two-sided interval of a chi-square variable divided by its degrees of freedom."""
    if dof <= 0:
        return math.nan, math.nan
    tail = 0.5 * (1.0 - level)
    return float(special.chdtri(dof, 1.0 - tail) / dof), float(special.chdtri(dof, tail) / dof)


def nis_bounds(dof: int, gated: tuple[float, float] = (1.0, 2.0), level: float = LEVEL) -> tuple[float, float]:
    """Two-sided interval of NIS per degree of freedom, `gated` its mean and variance per degree of freedom.

    The gamma distribution with these moments: without a gate that is chi-square, exactly.
    """
    mean, variance = gated
    if dof <= 0 or mean <= 0.0 or variance <= 0.0:
        return math.nan, math.nan
    shape, scale = mean**2 * dof / variance, variance / mean / dof
    tail = 0.5 * (1.0 - level)
    return float(special.gammaincinv(shape, tail) * scale), float(special.gammaincinv(shape, 1.0 - tail) * scale)


def gated(run: Run, phase: str) -> tuple[float, float]:
    """Mean and variance per degree of freedom of the squared innovations that gates let a right estimator use."""
    return run.gated_final if phase == "final" and run.gated_final is not None else run.gated


def share_interval(hits: int, n: int, level: float = LEVEL) -> tuple[float, float]:
    """Exact interval of a share seen `hits` times in n (Clopper and Pearson, Biometrika 26, 1934)."""
    tail = 0.5 * (1.0 - level)
    lower = float(special.betaincinv(hits, n - hits + 1, tail)) if hits else 0.0
    upper = float(special.betaincinv(hits + 1, n - hits, 1.0 - tail)) if hits < n else 1.0
    return lower, upper


def anees_band(dof: int, runs: int, level: float = LEVEL) -> tuple[float, float]:
    """Band of the per-step average NEES over runs: for a plot (5 % of steps lie outside by design), no verdict."""
    lower, upper = chi2_bounds(dof * runs, level)
    return dof * lower, dof * upper


QUANTITIES = {"pose": (0, 1, 2), "position": (0, 1), "heading": (2,)}
MIN_RUNS = 50
"""Fewer runs than this have no power against a wrong covariance."""
FAMILY_LEVEL = 0.001
"""False alarm rate of the exit status over all declared verdicts together."""
TAIL_LEVEL = 0.001
"""Probability below which a single run's mean NEES is impossible for a consistent estimator."""
CLAIMED = 0.8
"""Power is stated against a covariance claimed at this fraction of the true one."""
COVERAGE_LEVELS = (0.5, 0.9, 0.95, 0.99)
INSIDE_3SIGMA = float(special.chdtr(2, 9.0))
"""Share of positions that a consistent estimator has inside its 3 sigma ellipse (98.89 %)."""

CHI2_3_MEDIAN = float(special.chdtri(3, 0.5))
"""Median of a chi-square variable with 3 dof (2.366): of the pose NEES of a consistent estimator."""
THIN = 100.0
"""Times the floor of the increments' covariance: a pose covariance with a smaller eigenvalue is nearly singular. What
it claims in that direction is the floor, not the noise. After an exact prior that lasts a frame or two."""

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


def nearly_singular(covariance: Array, floor: float) -> BoolArray:
    """Frames (N,) whose pose covariance (N, 3, 3) has an eigenvalue below `THIN` times the increments' floor."""
    known = np.asarray(np.isfinite(covariance).all(axis=(1, 2)))
    smallest = np.linalg.eigvalsh(np.where(known[:, None, None], covariance, np.eye(3)))[:, 0]
    thin: BoolArray = known & (smallest < THIN * floor)
    return thin


def mean_or_nan(values: Array) -> float:
    """Mean of the finite values; NaN if there are none."""
    finite = values[np.isfinite(values)]
    return float(finite.mean()) if len(finite) else math.nan


def median_or_nan(values: Array) -> float:
    """Median of the finite values; NaN if there are none."""
    finite = values[np.isfinite(values)]
    return float(np.median(finite)) if len(finite) else math.nan


def inside_3sigma(position_nees: Array) -> float:
    """Share of frames whose position error lies inside the 3 sigma ellipse; compare with `INSIDE_3SIGMA`."""
    finite = position_nees[np.isfinite(position_nees)]
    return float(np.mean(finite <= 9.0)) if len(finite) else math.nan


@dataclass(frozen=True)
class Verdict:
    """A mean with its interval, the word it deserves, and what the test could have seen.

    Attributes:
        mean, lower, upper: of what was measured once per run, with its 95 % interval.
        dof: degrees of freedom of the chi-square law behind it; 0 for whiteness, which has none.
        expected: what a consistent estimator has as mean (NEES and NIS: dof; coverage: the level; whiteness: 0).
        runs: number of runs that enter.
        word: `consistent`, `overconfident`, `conservative` or `not enough runs`.
        p_value: two-sided, of a mean equal to `expected`.
        power: probability that this test, with this spread and this many runs, rejects a covariance claimed at 0.8
            of the true one; NaN where that cannot be said.
    """

    mean: float
    lower: float
    upper: float
    dof: int
    expected: float
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
    if not _judgeable(means):
        return _undecided(mean_or_nan(means), len(means), dof, float(dof))
    tail = len(means) * float(special.chdtrc(dof, means.max()))
    mean, half, word, p_value = _student(means, float(dof), tail, level)
    power = _power(dof, mean, float(means.std(ddof=1) / math.sqrt(len(means))), len(means), level)
    return Verdict(mean, mean - half, mean + half, dof, float(dof), len(means), word, p_value, power)


def whiteness(correlations: Array, level: float = LEVEL) -> Verdict:
    """Student's t verdict on the runs' correlations (N,) of successive innovations, see `lag1`; expected 0.

    Positive: a surprise is followed by one alike, so the gain is too low and the prediction trusted too much
    (overconfident). Negative: the gain is too high, each update overshoots (conservative); an R claimed too small looks
    the same (Mehra 1970). A run that diverged counts as in `verdict`: for white Gaussian innovations w'w of one pair
    has Laplace's distribution, P(|w'w| > 2r) = exp(-2r), and an average over pairs has no heavier tail.

    The power is NaN: P, Q and R claimed at 0.8 leave the gain as it is and the innovations white, so the test is blind
    to that by nature; what other faults do to the correlation depends on the system.
    """
    r = np.asarray(correlations, float)
    if not _judgeable(r):
        return _undecided(mean_or_nan(r), len(r), 0, 0.0)
    mean, half, word, p_value = _student(r, 0.0, len(r) * math.exp(-2.0 * float(np.abs(r).max())), level)
    return Verdict(mean, mean - half, mean + half, 0, 0.0, len(r), word, p_value, math.nan)


def _judgeable(values: Array) -> bool:
    return len(values) >= 2 and bool(np.isfinite(values).all())


def _undecided(mean: float, runs: int, dof: int, expected: float) -> Verdict:
    return Verdict(mean, math.nan, math.nan, dof, expected, runs, TOO_FEW, math.nan, math.nan)


def _student(values: Array, expected: float, tail: float, level: float) -> tuple[float, float, str, float]:
    """Mean, half interval, word and p value; `tail`: bound on the probability of the most extreme value in N draws."""
    n = len(values)
    mean, error = float(values.mean()), float(values.std(ddof=1) / math.sqrt(n))
    half = float(special.stdtrit(n - 1, 0.5 * (1.0 + level))) * error
    p_value = float(2.0 * special.stdtr(n - 1, -abs(mean - expected) / error)) if error > 0 else float(mean == expected)
    word = _word(mean - half <= expected <= mean + half, mean > expected, n)
    if tail < TAIL_LEVEL:
        word, p_value = _word(False, True, n), min(p_value, tail)
    return mean, half, word, p_value


def _word(accepted: bool, overconfident: bool, runs: int) -> str:
    if runs < MIN_RUNS:
        return TOO_FEW
    return CONSISTENT if accepted else OVERCONFIDENT if overconfident else CONSERVATIVE


def _power(dof: int, mean: float, error: float, n: int, level: float) -> float:
    """Power of the t test against a claimed covariance of `CLAIMED` times the true one.

    Scaling P divides every NEES by the factor, so mean and spread of a consistent estimator's run means do too.
    """
    if error <= 0.0 or mean <= 0.0:
        return math.nan
    scaled = error * (dof / mean) / CLAIMED
    shift = (dof / CLAIMED - dof) / scaled
    critical = float(special.stdtrit(n - 1, 0.5 * (1.0 + level)))
    return float(special.ndtr(shift - critical) + special.ndtr(-critical - shift))


def coverage(values: Array, dof: int, level: float) -> Verdict:
    """Exact binomial verdict on the share of run-end NEES (N,) inside the chi-square ellipse that should hold `level`.

    Bounds are Clopper and Pearson's (Biometrika 1934) at 95 %, the p value is twice the smaller tail, so that the two
    agree. Counts are whole, so a consistent estimator is accepted in 95 % of studies or more, and with few runs a high
    level cannot be exceeded: `conservative` needs level^N < 2.5 % (0.95: 72 runs, 0.99: 368).
    """
    nees_end = np.asarray(values, float)
    n = len(nees_end)
    if not _judgeable(nees_end):
        return _undecided(math.nan, n, dof, level)
    tail = 0.5 * (1.0 - LEVEL)
    radius = float(special.chdtri(dof, 1.0 - level))
    inside = int(np.count_nonzero(nees_end <= radius))
    lower, upper = share_interval(inside, n)
    word = _word(lower <= level <= upper, upper < level, n)
    counts = np.arange(n + 1)
    p_values = np.minimum(2.0 * np.minimum(special.bdtr(counts, n, level), special.bdtrc(counts - 1, n, level)), 1.0)
    # an ellipse claimed too small by CLAIMED holds what a right one of CLAIMED its squared radius holds
    share = special.bdtr(counts, n, float(special.chdtr(dof, CLAIMED * radius)))
    power = float(np.diff(share, prepend=0.0)[p_values < 2.0 * tail].sum())
    return Verdict(inside / n, lower, upper, dof, level, n, word, float(p_values[inside]), power)


def lag1(white: Array, frame: IntArray, number: IntArray) -> tuple[float, float]:
    """Mean product of a landmark's standardized innovations in consecutive frames, and its standard error if white.

    Args:
        white: (M, 2) innovations times the inverse root of their own 2x2 covariance, at the prediction; NaN: not used.
        frame: (M,) frame of each observation.
        number: (M,) landmark it was paired with; negative: none.

    Given all data up to frame k, a consistent filter's innovation in frame k+1 has mean zero (Bar-Shalom, Li,
    Kirubarajan 5.4.2), so T = sum of w_k' w_k+1 over the landmarks of both frames is a martingale difference. Hence
    r = sum T / (2 pairs) has mean 0 and, although innovations within one frame are correlated, sum T^2 estimates the
    variance of sum T; their ratio r / error is about standard normal in a long run. As w has unit covariance by the
    filter's claim, r is the correlation if the claim is right, and no variance is estimated; where it is not, r is in
    units of the claimed variance and may have any size (see `lag1_correlation`). Returns (nan, nan) without pairs.
    Of a landmark seen twice in a frame, the last observation meets the first of the next frame.
    """
    before, after = successive(white, frame, number)
    if not len(after):
        return math.nan, math.nan
    T = np.bincount(frame[after], np.einsum("pi,pi->p", white[before], white[after]))
    return float(T.sum()) / (2 * len(after)), math.sqrt(float(T @ T)) / (2 * len(after))


def lag1_correlation(white: Array, frame: IntArray, number: IntArray) -> tuple[float, float]:
    """Correlation of a landmark's innovations in consecutive frames, within [-1, 1], and its standard error if white.

    Arguments as of `lag1`, but each component of the innovations is divided by its own spread over the pairs, in
    place of the spread that the filter claims: a noise that is stated wrongly makes NIS large and not this. The spread
    is about zero, the mean of a consistent filter's innovations, so a bias counts as correlation. Mean of both
    components; one without any spread is left out. Returns (nan, nan) where nothing is left.
    """
    before, after = successive(white, frame, number)
    spread = np.linalg.norm(white[before], axis=0) * np.linalg.norm(white[after], axis=0)
    varies = spread > 0.0
    if not varies.any():
        return math.nan, math.nan
    products = white[before][:, varies] * white[after][:, varies] / spread[varies]
    T = np.bincount(frame[after], products.mean(axis=1))
    return float(np.clip(T.sum(), -1.0, 1.0)), math.sqrt(float(T @ T))


def successive(white: Array, frame: IntArray, number: IntArray) -> tuple[IntArray, IntArray]:
    """Rows of a landmark's values `white` (M, 2) in consecutive frames: those before (p,), those after (p,)."""
    rows = np.flatnonzero(np.isfinite(white).all(axis=1) & (number >= 0))
    rows = rows[np.lexsort((frame[rows], number[rows]))]
    before, after = rows[:-1], rows[1:]
    follows = (number[before] == number[after]) & (frame[before] + 1 == frame[after])
    return before[follows], after[follows]


def holm_rejected(p_values: Sequence[float], level: float = FAMILY_LEVEL) -> list[bool]:
    """Holm's step-down procedure: which hypotheses are rejected at a family-wise level (Holm 1979)."""
    p = np.asarray(p_values, float)
    rejected = np.zeros(len(p), bool)
    for rank, i in enumerate(np.argsort(p, kind="stable")):
        if not p[i] <= level / (len(p) - rank):
            break
        rejected[i] = True
    return [bool(r) for r in rejected]

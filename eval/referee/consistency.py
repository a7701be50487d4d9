"""Consistency from NEES, NIS and innovations: bounds, verdicts, the family-wise test of the exit status, proper scores.

NEES = e' P^-1 e of the world-frame error; a consistent estimator has E[NEES] = dof. Errors of successive frames are
correlated, so a verdict needs many runs (Student's t on the run means); see Bar-Shalom, Li, Kirubarajan, Estimation
with Applications to Tracking and Navigation, section 5.4. docs/notes/verdict-rules.md has their measured power.

Proper scores of a Gaussian pose belief are accuracy and consistency in one number, smaller is better: its expectation
is smallest for the true distribution of the errors (Gneiting & Raftery, Strictly Proper Scoring Rules, Prediction, and
Estimation, JASA 102, 2007). Errors are in the world frame, heading wrapped.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy import special

from association.expectation import gate_threshold
from data import se2
from data.inputs import IntArray
from data.pose_measurements import Closures
from data.result import Run
from data.se2 import Array, BoolArray, between, pose_error

LEVEL = 0.95


def nis_bounds(dof: int, gated: tuple[float, float] = (1.0, 2.0), level: float = LEVEL) -> tuple[float, float]:
    """Two-sided interval of NIS per degree of freedom, from the gamma distribution with the moments `gated`. `gated` is
    mean and variance per degree of freedom; without a gate the distribution is chi-square exactly.
    """
    mean, variance = gated
    if dof <= 0 or mean <= 0.0 or variance <= 0.0:
        return math.nan, math.nan
    shape, scale = mean**2 * dof / variance, variance / mean / dof
    tail = 0.5 * (1.0 - level)
    return float(special.gammaincinv(shape, tail) * scale), float(special.gammaincinv(shape, 1.0 - tail) * scale)


def gated(run: Run, phase: str) -> tuple[float, float]:
    """Mean and variance per degree of freedom of the squared innovations of a consistent estimator behind its gates."""
    return run.gated_final if phase == "final" and run.gated_final is not None else run.gated


def share_interval(hits: int, n: int) -> tuple[float, float]:
    """Exact interval of a share with `hits` in n (Clopper and Pearson, Biometrika 26, 1934)."""
    tail = 0.5 * (1.0 - LEVEL)
    lower = float(special.betaincinv(hits, n - hits + 1, tail)) if hits else 0.0
    return lower, (float(special.betaincinv(hits + 1, n - hits, 1.0 - tail)) if hits < n else 1.0)


def anees_band(dof: int, runs: int) -> tuple[float, float]:
    """Band of the per-step average NEES over runs, for plots: 5 % of consistent steps lie outside."""
    lower, upper = nis_bounds(dof * runs)
    return dof * lower, dof * upper


QUANTITIES = {"pose": (0, 1, 2), "position": (0, 1), "heading": (2,)}
MIN_RUNS = 50  # least number of runs for a verdict
FAMILY_LEVEL = 0.001  # false-rejection rate of the exit status over all declared verdicts
TAIL_LEVEL = 0.001  # probability below which a single run's mean NEES makes the verdict overconfident
CLAIMED = 0.8  # stated fraction of the true covariance against which the power is computed
COVERAGE_LEVELS = (0.5, 0.9, 0.95, 0.99)
INSIDE_3SIGMA = float(special.chdtr(2, 9.0))  # Share of positions in the 3 sigma ellipse if consistent (98.89 %)
CHI2_3_MEDIAN = float(special.chdtri(3, 0.5))  # median pose NEES of a consistent estimator (2.366)
THIN = 100.0
"""Eigenvalue below which a pose covariance is nearly singular, in floors of the increments' covariance. After an exact
prior this lasts a frame or two."""

NEES_LIMIT = 9.0
"""Mean pose NEES (expected 3) of one run that is overconfident, however its frames are correlated: a chi-square
variable of 3 degrees of freedom exceeds it in 3 % of logs."""
NEES_LIMITS = {2: 7.06, 3: NEES_LIMIT}  # By degrees of freedom: 2 of the position, where the truth has no headings
ASTRAY_NEES = 300.0  # mean pose NEES of a path that is not where it claims to be: 10 sigma in each of three coordinates

CONSISTENT, OVERCONFIDENT, CONSERVATIVE, TOO_FEW = "consistent", "overconfident", "conservative", "not enough runs"
FIT, LARGE, SMALL, FEW = "innovations fit", "NIS too large", "NIS too small", "too few for a verdict"
UNSUSPICIOUS = ("", FIT, FEW)
WIDEST = 10.0  # ratio of its bounds above which a NIS below them tells nothing: with fewer than 7 degrees of freedom
WHITE, CORRELATED, ANTICORRELATED = "white", "correlated", "anticorrelated"
Words = tuple[str, str, str]
"""Of a property: as expected, above, below. Errors (NEES), innovations (NIS) and their whiteness have words each."""
ERRORS, INNOVATIONS, WHITENESS = (
    (CONSISTENT, OVERCONFIDENT, CONSERVATIVE), (FIT, LARGE, SMALL), (WHITE, CORRELATED, ANTICORRELATED)
)  # fmt: skip
MARKS = {w: sign for kind in (ERRORS, INNOVATIONS, WHITENESS) for w, sign in zip(kind[1:], "+−", strict=True)}
"""Of words that are not as expected: larger or smaller than claimed."""
LAG1_ERRORS, LAG1_LEAST = 3.3, 0.1
"""Standard errors (0.1 % of white series) and size from which innovations of one log are correlated. A correlation of
0.1 adds a fifth to the variance of a mean. Of 170 sound logs with labels none is beyond both."""


def correlations(covariance: Array) -> tuple[Array, Array]:
    """Correlation matrices (N, k, k) and sigmas (N, k) of covariances; of a variance of 0 the sigma is 1."""
    variance = np.einsum("nii->ni", covariance)
    sigma = np.sqrt(np.where(variance > 0.0, variance, 1.0))
    return covariance / (sigma[:, :, None] * sigma[:, None, :]), sigma


def squares(error: Array, covariance: Array) -> Array:
    """Squared distances e' P^-1 e (N,) of errors (N, k) under regular covariances (N, k, k)."""
    return np.asarray(np.einsum("ni,ni->n", error, np.linalg.solve(covariance, error[..., None])[..., 0]))


def squared_distance(error: Array, covariance: Array) -> Array:
    """Squares e' P^-1 e (N,), e (N, k), P (N, k, k); NaN if P's correlation has an eigenvalue below 1e-12."""
    result = np.full(len(error), np.nan)
    positive = (np.einsum("nii->ni", covariance) > 0).all(axis=1)
    rows = np.flatnonzero(np.isfinite(error).all(axis=1) & np.isfinite(covariance).all(axis=(1, 2)) & positive)
    correlation, sigma = correlations(covariance[rows])
    regular = np.linalg.eigvalsh(correlation)[:, 0] > 1e-12
    result[rows[regular]] = squares(error[rows[regular]] / sigma[regular], correlation[regular])
    return result


def nees(pose: Array, covariance: Array, truth: Array, quantity: str) -> Array:
    """NEES (N,) per frame of `pose` (dof 3), `position` (2) or `heading` (1)."""
    columns = list(QUANTITIES[quantity])
    return squared_distance(se2.pose_error(pose, truth)[:, columns], covariance[:, columns][:, :, columns])


def nearly_singular(covariance: Array, floor: float) -> BoolArray:
    """Frames (N,) whose covariance (N, k, k) has an eigenvalue below `THIN` times the increments' floor."""
    known = np.asarray(np.isfinite(covariance).all(axis=(1, 2)))
    smallest = np.linalg.eigvalsh(np.where(known[:, None, None], covariance, np.eye(covariance.shape[-1])))[:, 0]
    return np.asarray(known & (smallest < THIN * floor))


def mean_or_nan(values: Array, of: Callable[[Array], Any] = np.mean) -> float:
    """Mean (or another statistic) of the finite values; NaN if there are none."""
    finite = values[np.isfinite(values)]
    return float(of(finite)) if len(finite) else math.nan


def inside_3sigma(position_nees: Array) -> float:
    """Share of frames whose position error is inside the 3 sigma ellipse (expected: `INSIDE_3SIGMA`)."""
    return mean_or_nan(position_nees, lambda finite: np.mean(finite <= 9.0))


@dataclass(frozen=True)
class Verdict:
    """A mean over runs with its 95 % interval, verdict, p value and power."""

    mean: float
    lower: float
    upper: float
    dof: int  # of the chi-square law; 0 for whiteness
    expected: float  # mean of a consistent estimator (NEES and NIS: dof; coverage: the level; whiteness: 0)
    runs: int
    word: str  # of `Words`, or `not enough runs`
    p_value: float  # two-sided, of a mean equal to `expected`
    power: float  # probability of rejecting a covariance stated at 0.8 of the true one; NaN: unknown


def verdict(run_means: Array, dof: int, words: Words = ERRORS) -> Verdict:
    """Student's t verdict on the run means (N,) of a statistic whose expectation is `dof`.

    A few diverging runs widen the interval so far that it holds any value. Far above `dof` a run mean is most probable
    if all frames are one draw, a chi-square variable: the mean is a sum of eigenvalue times squared Gaussian, none of
    the eigenvalues exceeds 1, and their sum is `dof` (Bock, Diaconis, Huffer and Perlman, Canad. J. Statist. 15, 1987).
    A run mean that this exceeds in N draws with a probability below `TAIL_LEVEL` is overconfident, with one run, too.
    """
    means = np.asarray(run_means, float)
    known = len(means) > 0 and bool(np.isfinite(means).all())
    tail = len(means) * float(special.chdtrc(dof, means.max())) if known else math.nan
    found, n = _student(means, dof, float(dof), tail, words), len(means)
    error = float(means.std(ddof=1) / math.sqrt(n)) if n > 1 else math.nan
    if not math.isfinite(found.lower) or error <= 0.0 or found.mean <= 0.0:
        return found
    # of the t test against a covariance stated at `CLAIMED`, which divides mean and spread of the NEES
    shift = (dof / CLAIMED - dof) / (error * (dof / found.mean) / CLAIMED)
    critical = float(special.stdtrit(n - 1, 0.5 * (1.0 + LEVEL)))
    return replace(found, power=float(special.ndtr(shift - critical) + special.ndtr(-critical - shift)))


def whiteness(correlations: Array) -> Verdict:
    """Student's t verdict on the runs' correlations (N,) of successive innovations, see `lag1`; expected 0.

    A positive one means a gain that is too low (overconfident prediction). A negative one means a gain that is too high
    (conservative), or a stated R that is too small (Mehra 1970). A run that diverged counts as in `verdict`: for white
    Gaussian innovations P(|w'w| > 2r) = exp(-2r) (Laplace), and an average over pairs has no heavier tail.

    The power is NaN: P, Q and R stated at 0.8 leave the gain unchanged and the innovations white.
    """
    r = np.asarray(correlations, float)
    tail = len(r) * math.exp(-2.0 * float(np.abs(r).max())) if _judgeable(r) else math.nan
    return _student(r, 0, 0.0, tail, WHITENESS)


def _judgeable(values: Array) -> bool:
    return len(values) >= 2 and bool(np.isfinite(values).all())


def _student(values: Array, dof: int, expected: float, tail: float, words: Words) -> Verdict:
    """The verdict on values (N,), without power; `tail`: bound on the probability of the largest one in N draws."""
    n, beyond = len(values), tail < TAIL_LEVEL
    if not _judgeable(values):
        word = words[1] if beyond else TOO_FEW
        return Verdict(mean_or_nan(values), math.nan, math.nan, dof, expected, n, word, math.nan, math.nan)
    mean, error = float(values.mean()), float(values.std(ddof=1) / math.sqrt(n))
    half = float(special.stdtrit(n - 1, 0.5 * (1.0 + LEVEL))) * error
    p_value = float(2.0 * special.stdtr(n - 1, -abs(mean - expected) / error)) if error > 0 else float(mean == expected)
    word = words[1] if beyond else _word(mean - half <= expected <= mean + half, mean > expected, n, words)
    p_value = min(p_value, tail) if beyond else p_value
    return Verdict(mean, mean - half, mean + half, dof, expected, n, word, p_value, math.nan)


def _word(accepted: bool, above: bool, runs: int, words: Words = ERRORS) -> str:
    return TOO_FEW if runs < MIN_RUNS else words[0] if accepted else words[1] if above else words[2]


def correlated(lag1: float, lag1_se: float) -> bool:
    """Whether the lag-1 correlation of the innovations of one log is significantly off."""
    return abs(lag1) > max(LAG1_ERRORS * lag1_se, LAG1_LEAST)


def innovations_word(nis: float, lower: float, upper: float, lag1: float = math.nan, lag1_se: float = math.nan) -> str:
    """The word on the innovations of one log: correlated, before NIS against its bounds; empty without any. A sigma
    fitted as if innovations were white says nothing where they are correlated.
    """
    if not all(map(math.isfinite, (nis, lower, upper))):
        return ""
    below = SMALL if upper <= WIDEST * lower else FEW
    return CORRELATED if correlated(lag1, lag1_se) else LARGE if nis > upper else below if nis < lower else FIT


def coverage(values: Array, dof: int, level: float) -> Verdict:
    """Exact binomial verdict on the share of run-end NEES (N,) inside the chi-square ellipse of `level`.

    The p value is twice the smaller tail, in agreement with the 95 % bounds of `share_interval`. At least 95 % of
    studies accept a consistent estimator; `conservative` needs level^N < 2.5 % (0.95: 72 runs, 0.99: 368).
    """
    nees_end = np.asarray(values, float)
    n = len(nees_end)
    if not _judgeable(nees_end):
        return Verdict(*(math.nan,) * 3, dof, level, n, TOO_FEW, math.nan, math.nan)
    tail = 0.5 * (1.0 - LEVEL)
    radius = float(special.chdtri(dof, 1.0 - level))
    inside = int(np.count_nonzero(nees_end <= radius))
    lower, upper = share_interval(inside, n)
    word = _word(lower <= level <= upper, upper < level, n)
    counts = np.arange(n + 1)
    p_values = np.minimum(2.0 * np.minimum(special.bdtr(counts, n, level), special.bdtrc(counts - 1, n, level)), 1.0)
    # the ellipse of a covariance stated at CLAIMED is the right one with CLAIMED times its squared radius
    share = special.bdtr(counts, n, float(special.chdtr(dof, CLAIMED * radius)))
    power = float(np.diff(share, prepend=0.0)[p_values < 2.0 * tail].sum())
    return Verdict(inside / n, lower, upper, dof, level, n, word, float(p_values[inside]), power)


def lag1(white: Array, frame: IntArray, number: IntArray) -> tuple[float, float]:
    """Mean product of a landmark's standardized innovations in consecutive frames, and its standard error if white, of
    `white` (M, 2), times the inverse root of their own covariance, NaN: not used; `number` (M,): landmark or < 0.

    Given all data up to frame k, a consistent filter's innovation in frame k+1 has mean zero (Bar-Shalom, Li,
    Kirubarajan 5.4.2), so T = sum of w_k' w_k+1 over the landmarks of both frames is a martingale difference. Hence r =
    sum T / (2 pairs) has mean 0, and sum T^2 estimates the variance of sum T although innovations within a frame are
    correlated. r is in units of the stated variance; it is a correlation only if that is right (see
    `lag1_correlation`). Returns (nan, nan) without pairs.
    """
    before, after = successive(white, frame, number)
    if not len(after):
        return math.nan, math.nan
    T = np.bincount(frame[after], np.einsum("pi,pi->p", white[before], white[after]))
    return float(T.sum()) / (2 * len(after)), math.sqrt(float(T @ T)) / (2 * len(after))


def lag1_correlation(white: Array, frame: IntArray, number: IntArray) -> tuple[float, float]:
    """Correlation of a landmark's innovations in consecutive frames, within [-1, 1], and its standard error if white.

    As `lag1`, but each component is divided by its own spread over the pairs instead of the stated one, so that a
    wrongly stated noise does not change it. The spread is about zero, so a bias counts as correlation. Mean of both
    components; one without spread is left out. Returns (nan, nan) if none is left.
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
    """Rows (p,), (p,) of a landmark's values `white` (M, 2) in each two consecutive frames."""
    rows = np.flatnonzero(np.isfinite(white).all(axis=1) & (number >= 0))
    rows = rows[np.lexsort((frame[rows], number[rows]))]
    before, after = rows[:-1], rows[1:]
    follows = (number[before] == number[after]) & (frame[before] + 1 == frame[after])
    return before[follows], after[follows]


def holm_rejected(p_values: Sequence[float], level: float = FAMILY_LEVEL) -> list[bool]:
    """Which hypotheses are rejected at a family-wise level (Holm's step-down procedure, 1979)."""
    p = np.asarray(p_values, float)
    order, rejected = np.argsort(p, kind="stable"), np.zeros(len(p), bool)
    rejected[order] = np.logical_and.accumulate(p[order] <= level / np.arange(len(p), 0, -1))
    return rejected.tolist()


NEAR_M, NEAR_RAD = 0.15, 0.02
"""m and rad within which a loop closure is right (outlier limits of Cartographer's `autogenerate_ground_truth`)."""
HONEST = 0.9999  # chi-square probability (3 dof) within which a loop closure is right by its own covariance: 4.6 sigma


def right_relatives(relative: Array, covariance: Array, first: Array, second: Array) -> BoolArray:
    """Which measured relative poses (L, 3) with covariances (L, 3, 3) are right, given true poses (L, 3) of their ends:
    near the truth, or inside their own covariance's gate. False where a pose is NaN.
    """
    error = pose_error(relative, between(first, second))
    near = (np.hypot(error[:, 0], error[:, 1]) <= NEAR_M) & (np.abs(error[:, 2]) <= NEAR_RAD)
    honest: BoolArray = squared_distance(error, covariance) <= gate_threshold(HONEST, 3)
    return near | honest


def true_inliers(closures: Closures, truth: Array) -> IntArray:
    """Which closures (C,) are right, given true poses (F, 3); -1: one of them is unknown."""
    first, second = truth[closures.frame1], truth[closures.frame2]
    right = right_relatives(closures.relative, closures.covariance, first, second)
    return np.where(np.isfinite(first).all(axis=1) & np.isfinite(second).all(axis=1), right, -1).astype(np.int64)


LEVELS = tuple(2**n for n in range(5, 13))  # numbers of directions of half a turn
TOLERANCE = 1e-10  # relative change of the energy score that ends the refinement
CHUNK_OF_ROWS = 50


def log_score(error: Array, covariance: Array) -> Array:
    """Negative log density [nats] (N,) of errors (N, k) under N(0, P), P (N, k, k): (e' P^-1 e + log det 2 pi P) / 2.
    Gneiting & Raftery, section 4.1 (Good 1952). P must be invertible; a row with NaN is NaN.
    """
    result = np.full(len(error), np.nan)
    rows = _known(error, covariance)
    correlation, sigma = correlations(covariance[rows])  # the correlation matrix makes accuracy independent of units
    volume = np.linalg.slogdet(correlation)[1] + 2.0 * np.log(sigma).sum(axis=1)
    result[rows] = 0.5 * (squares(error[rows] / sigma, correlation) + volume + error.shape[1] * math.log(2.0 * math.pi))
    return result


def crps(error: Array, sigma: Array) -> Array:
    """Continuous ranked probability score, in the error's unit, of errors under N(0, sigma²); any shapes.

    sigma (z (2 Phi(z) - 1) + 2 phi(z) - 1 / sqrt(pi)), z = error / sigma (Gneiting & Raftery, section 4.2, after
    equation 20). A heading is treated as a number on the line, for sigma well below pi.
    """
    z = error / sigma
    density = np.exp(-0.5 * z**2) / math.sqrt(2.0 * math.pi)
    return np.asarray(sigma * (z * special.erf(z / math.sqrt(2.0)) + 2.0 * density - 1.0 / math.sqrt(math.pi)))


def energy_score(error: Array, covariance: Array) -> Array:
    """Energy score [m] (N,) of errors y (N, 2) under N(0, P), P (N, 2, 2): E|X - y| - E|X - X'| / 2.

    Gneiting & Raftery, equation 22. The length of a planar vector v is a quarter of the integral of |u(a)' v| over all
    directions u(a), so the score is pi/2 times the average CRPS of the projections u'y under N(0, u'P u). The trapezoid
    rule converges exponentially. Directions are refined until the score changes by less than a tolerance.
    """
    result = np.full(len(error), np.nan)
    rows = np.flatnonzero(_known(error, covariance))
    for first in range(0, len(rows), CHUNK_OF_ROWS):
        part = rows[first : first + CHUNK_OF_ROWS]
        for nodes in LEVELS:
            angle = np.arange(nodes) * (math.pi / nodes)
            u = np.stack([np.cos(angle), np.sin(angle)])
            sigma = np.sqrt(np.einsum("ia,nij,ja->na", u, covariance[part], u, optimize=True))
            score = crps(error[part] @ u, sigma) @ np.full(nodes, 0.5 * math.pi / nodes)
            done = np.abs(score - result[part]) <= TOLERANCE * score
            result[part] = score
            part = part[~done]
            if not len(part):
                break
    return result


def _known(error: Array, covariance: Array) -> BoolArray:
    return np.asarray(np.isfinite(error).all(axis=1) & np.isfinite(covariance).all(axis=(1, 2)))


def mean_scores(pose: Array, covariance: Array, truth: Array, scored: BoolArray) -> dict[str, float]:
    """Means by column of metrics.csv over frames `scored` (N,), with truth and invertible covariance; empty: none."""
    if not scored.any():
        return {}
    error, P = se2.pose_error(pose[scored], truth[scored]), covariance[scored]
    each = crps(error, np.sqrt(np.einsum("nii->ni", P))).mean(axis=0)
    return {
        "log_score": float(log_score(error, P).mean()), "crps_x_m": float(each[0]), "crps_y_m": float(each[1]),
        "crps_heading_rad": float(each[2]), "energy_score_m": float(energy_score(error[:, :2], P[:, :2, :2]).mean()),
    }  # fmt: skip

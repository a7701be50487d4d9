"""P values of a log's statistics by rank among those of its bootstrap replicates ("twins").

Replicates are drawn from the log's own noise model. If that is right, the rank of a statistic among theirs is uniform
(Davison and Hinkley, "Bootstrap methods and their application", section 4.2).
"""

import math

import numpy as np
from scipy import special

from data.se2 import Array, BoolArray

LOWEST, HIGHEST = 0.1587, 0.8413  # quantiles one standard deviation from the median of a Gaussian
LEVEL = 0.05  # family-wise false-rejection rate
THEORY = 0.4  # least share of it for statistics with a distribution from theory: the slopes of systematic errors
DRAWS = 20_000  # of the largest of correlated statistics: a p value of 2 % to 0.1 %
SEED = 0


def rank_p(value: float, twins: Array) -> float:
    """Two-sided p value by rank among twins (N,), or NaN: min(1, 2 min(1 + #{T* >= T}, 1 + #{T* <= T}) / (N + 1))."""
    known = twins[np.isfinite(twins)]
    if not len(known) or not math.isfinite(value):
        return math.nan
    return min(1.0, 2.0 * (1 + min(int(np.sum(known >= value)), int(np.sum(known <= value)))) / (len(known) + 1))


def bounds(twins: Array, level: float = 0.95) -> tuple[float, float]:
    """Bounds that one more draw is within with probability `level`, given N draws (N,); NaN below three. Order
    statistics where there are enough (39 at 95 %), else those of a Gaussian (Student's t).
    """
    known = np.sort(twins[np.isfinite(twins)])
    n, tail = len(known), 0.5 * (1.0 - level)
    k = math.floor((n + 1) * tail + 1e-9)
    if k >= 1:
        return float(known[k - 1]), float(known[n - k])
    if n < 3:
        return math.nan, math.nan
    half = float(special.stdtrit(n - 1, 1.0 - tail) * known.std(ddof=1) * math.sqrt(1.0 + 1.0 / n))
    return float(known.mean()) - half, float(known.mean()) + half


def standardized(real: Array, twins: Array) -> tuple[Array, Array]:
    """Statistics (S,) and their twins (N, S) about their common median, in units of their common spread on either side.

    The spread on a side is the distance to the quantile that is one sigma away in a Gaussian, or where that is zero the
    root mean square. Unknown (NaN) and constant statistics become 0.
    """
    pooled = np.vstack([real, twins])
    result = np.zeros_like(pooled)
    for i, column in enumerate(pooled.T):
        known = column[np.isfinite(column)]
        if not np.isfinite(column[0]) or not len(known) or np.ptp(known) == 0.0:
            continue
        lowest, middle, highest = np.quantile(known, [LOWEST, 0.5, HIGHEST])
        above, below = highest - middle, middle - lowest
        off = column - middle
        root = math.sqrt(float(np.mean(np.square(known - middle))))
        above, below = (side if side > 0.0 else root for side in (above, below))
        result[:, i] = np.where(np.isfinite(off), np.where(off > 0.0, off / above, off / below), 0.0)
    return result[0], result[1:]


def evened(own: Array, others: Array) -> tuple[Array, Array]:
    """Absolute standardized statistics (S,) and twins (N, S) with tails no heavier than a Gaussian's.

    If the mean of its largest twentieth, without the very largest value, exceeds that of a Gaussian, a statistic is
    raised to the power that makes them equal. Otherwise one heavy tail sets the critical value of all.
    """
    pooled = np.abs(np.vstack([own, others]))
    n = len(pooled)
    ranks = np.arange(2, max(n // 20, 2) + 2)
    gaussian = float(special.ndtri(1.0 - 0.5 * (ranks - 0.5) / n).mean())
    tail = np.sort(pooled, axis=0)[-ranks].mean(axis=0)
    even = pooled ** np.minimum(1.0, math.log(gaussian) / np.log(np.maximum(tail, gaussian)))
    return even[0], even[1:]


def family_p(real: Array, twins: Array) -> Array:
    """Family-wise p values (S,): step-down max-T (Westfall and Young 1993, algorithm 2.8); NaN: unknown.

    The largest statistic, standardized and with an even tail, is ranked against the twins' largest, the next against
    their largest of the remaining ones, and so on. p reaches 1 / (N + 1) for any S; Holm's correction would end at
    2 S / (N + 1).
    """
    n = len(twins)
    result = np.full(len(real), np.nan)
    known = np.flatnonzero(np.isfinite(real))
    if not n or not len(known):
        return result
    own, others = evened(*standardized(real[known], twins[:, known]))
    order = np.argsort(-own, kind="stable")
    rest = np.maximum.accumulate(others[:, order[::-1]], axis=1)[:, ::-1]  # largest of this statistic and all after it
    result[known[order]] = np.maximum.accumulate((1 + np.sum(rest >= own[order], axis=0)) / (n + 1))
    return result


def gaussian_p(z: Array, correlation: Array) -> Array:
    """Family-wise p values (S,) of standard Gaussian statistics with a correlation (S, S); NaN: unknown.

    Step-down max-T (Westfall and Young 1993) over draws of the Gaussian; for small ones Holm's procedure (1979), which
    needs no draws.
    """
    result = np.full(len(z), np.nan)
    order = np.argsort(-np.nan_to_num(np.abs(z), nan=-1.0), kind="stable")[: int(np.isfinite(z).sum())]
    if not len(order):
        return result
    own = np.abs(z[order])
    size, axes = np.linalg.eigh(correlation[np.ix_(order, order)])
    root = axes * np.sqrt(np.maximum(size, 0.0))
    drawn = np.abs(np.random.default_rng(SEED).standard_normal((DRAWS, len(order))) @ root.T)
    rest = np.maximum.accumulate(drawn[:, ::-1], axis=1)[:, ::-1]  # of each statistic and all after it
    by_draws = (1 + np.sum(rest >= own, axis=0)) / (DRAWS + 1)
    holm = 2.0 * special.ndtr(-own) * np.arange(len(order), 0, -1)
    result[order] = np.minimum(np.maximum.accumulate(np.minimum(by_draws, holm)), 1.0)
    return result


def shared_p(real: Array, twins: Array, z: Array, theory: BoolArray, correlation: Array) -> Array:
    """Family-wise p values (S,) of statistics by twins, and of those `theory` by their own standard errors.

    correlation (S, S): of the latter. Each part has its share of the level: its p values are divided by it. Ranks
    among N twins are multiples of 1 / (N + 1), so what they leave of their share is added to that of theory. With twins
    too few for their share, all are compared with twins.
    """
    ranks = math.floor((len(twins) + 1) * (1.0 - THEORY) * LEVEL + 1e-9)
    if not ranks or not theory.any():
        return family_p(real, twins)
    share = ranks / (len(twins) + 1) / LEVEL
    result = np.empty(len(real))
    result[theory] = gaussian_p(z[theory], correlation[np.ix_(theory, theory)]) / (1.0 - share)
    result[~theory] = family_p(real[~theory], twins[:, ~theory]) / share
    return np.minimum(result, 1.0)

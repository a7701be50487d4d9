"""Expected NIS of a consistent filter whose pairings were accepted by a gate.

An innovation that passed a gate is a truncated chi-square variable, with a smaller mean and variance. One pairing has a
closed form. For several correlated pairings with a joint test, the moments are those of Gaussian innovations with the
frame's joint covariance, without those outside the gates.
"""

import math
from functools import cache
from typing import NamedTuple

import numpy as np
import scipy
from scipy.special import chdtr, ndtri

from association.appearance import Evidence
from association.expectation import NOTHING, threshold_with
from association.methods import ALPHA, RATIO
from data.compiled import njit
from data.se2 import Array

DRAWS = 64  # innovations drawn per frame, which add 1/64 to the variance of a run's NIS
POINTS = 4096  # quasi-random points that frames take in turn, so that the sampling errors do not add up


class Acceptance(NamedTuple):
    """Thresholds that a pairing had to pass, as squared distances (inf: none)."""

    individual: float = math.inf  # each pairing, 2 dof
    joint: float | None = None  # probability of the joint gate of all pairings of a frame, or None
    conditional: float = math.inf  # each pairing given the others of its frame, 2 dof
    right: Evidence = Evidence()  # appearance of right pairings, which these tests include

    @property
    def everything(self) -> bool:
        """Whether every pairing passes."""
        return math.isinf(self.individual) and self.joint is None and math.isinf(self.conditional)


@cache
def of_places(gate: float | None, dims: int, pairs: int = 1, right: Evidence = NOTHING) -> float:
    """Threshold of a gate of pairings, for their places alone: below it these have the mean that they have where places
    and appearance together pass the gate. E[x; x + y < c] = k F_{k+l+2}(c) of chi-square x and y with k and l dof.
    """
    dof, more = dims * pairs, right.dims * pairs
    threshold = threshold_with(gate, dims, pairs, right)
    if right == NOTHING or math.isinf(threshold):
        return threshold
    wrong = np.arange(pairs + 1)
    share = scipy.stats.binom.pmf(wrong, pairs, right.error)
    left = np.maximum(threshold - right.cost * wrong, 0.0)
    wanted = float(share @ chdtr(dof + more + 2, left)) / float(share @ chdtr(dof + more, left))
    most = threshold + 100.0 * dof
    return float(scipy.optimize.brentq(lambda c: chdtr(dof + 2, c) / chdtr(dof, c) - wanted, 1e-6, most))


def acceptance(method: str, gate: float | None, dims: int = 2, right: Evidence = NOTHING) -> Acceptance:
    """The tests of an association method at a `gate` probability, None for no gate, of observations of `dims` numbers
    and of appearance. `ml-ratio` pairs only landmarks that beat "new" by its ratio, which is the narrower test.
    """
    alone = of_places(gate, dims, 1, right)
    if method in ("jcbb", "jcbb-first"):
        return Acceptance(alone, gate, right=right)
    return Acceptance(min(alone, ALPHA / RATIO)) if method == "ml-ratio" else Acceptance(alone)


@cache
def truncated_square(threshold: float, dof: int = 2) -> tuple[float, float]:
    """Mean and variance of a chi-square variable of `dof` below a threshold. E[x] = k F_{k+2}(c) / F_k(c), E[x^2] = k
    (k + 2) F_{k+4}(c) / F_k(c), with F the distribution function.
    """
    if math.isinf(threshold):
        return float(dof), 2.0 * dof
    inside = chdtr(dof, threshold)
    mean = dof * chdtr(dof + 2, threshold) / inside
    return float(mean), float(dof * (dof + 2) * chdtr(dof + 4, threshold) / inside - mean**2)


def accepted_moments(S: Array, gates: Acceptance, turn: int, measures: tuple[int, ...] = (0, 1)) -> tuple[float, float]:
    """Mean and variance of the joint NIS of accepted pairings with innovation covariance S (2k, 2k). `turn` is the
    number of the frame, which selects its draws; `measures`: which numbers of a pair are measured. Without a gate these
    are d and 2d with d = k len(measures).
    """
    dof = len(S) // 2 * len(measures)
    if dof == 0 or gates.everything:
        return float(dof), 2.0 * dof
    if len(S) == 2:
        return truncated_square(min(gates.individual, gates.conditional), dof)  # the joint gate is the individual one
    points = _points(1 << (dof - 1).bit_length())
    begin = turn * DRAWS % POINTS
    joint = math.inf if gates.joint is None else of_places(gates.joint, len(measures), len(S) // 2, gates.right)
    white = np.zeros((DRAWS, len(S)))
    white[:, (2 * np.arange(len(S) // 2)[:, None] + np.array(measures)).ravel()] = points[begin : begin + DRAWS, :dof]
    try:
        innovation, W = white @ np.linalg.cholesky(S).T, np.asarray(np.linalg.inv(S), float)
        each = gates.individual, joint, gates.conditional
        n, total, squares = _sums(np.array(S), W, white, innovation, innovation @ W, each)
    except np.linalg.LinAlgError:  # singular: the next update raises
        n, total, squares = 0, 0.0, 0.0
    if n < 2:  # hardly anything passes: as if the pairings were independent
        mean, variance = truncated_square(min(gates.individual, gates.conditional), len(measures))
        return mean * dof / len(measures), variance * dof / len(measures)
    return total / n, max(squares / n - (total / n) ** 2, 0.0)


@cache
def _points(dimension: int) -> Array:
    """Standard normal quasi-random points (POINTS, dimension)."""
    sobol = scipy.stats.qmc.Sobol(dimension, seed=np.random.default_rng(0))  # its name before scipy 1.15, known to all
    return np.ascontiguousarray(ndtri(sobol.random(POINTS)))


@njit
def _sums(
    S: Array, W: Array, white: Array, x: Array, y: Array, gates: tuple[float, float, float]
) -> tuple[int, float, float]:  # pragma: no cover - compiled
    """Count, sum and sum of squares of |w|^2 over draws w (n, 2k) whose x = L w pass all gates; W = S^-1, y = W x."""
    n, d = white.shape
    individual, joint, conditional = gates
    count, total, squares = 0, 0.0, 0.0
    for i in range(n):
        q = 0.0
        for j in range(d):
            q += white[i, j] * white[i, j]
        inside = q < joint
        for j in range(0, d, 2):
            if not inside:
                break
            # nu_j' S_jj^-1 nu_j, and given the others: y_j' (W_jj)^-1 y_j with y = S^-1 nu
            a, b, c = S[j, j], S[j, j + 1], S[j + 1, j + 1]
            u, v = x[i, j], x[i, j + 1]
            inside = (c * u * u - 2.0 * b * u * v + a * v * v) < individual * (a * c - b * b)
            if inside and conditional < np.inf:
                a, b, c = W[j, j], W[j, j + 1], W[j + 1, j + 1]
                u, v = y[i, j], y[i, j + 1]
                inside = (c * u * u - 2.0 * b * u * v + a * v * v) < conditional * (a * c - b * b)
        if inside:
            count += 1
            total += q
            squares += q * q
    return count, total, squares

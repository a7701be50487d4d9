"""Association methods without a search: nearest neighbour, maximum likelihood, SINGLES, global nearest neighbour.

Each takes an `Expectation` of n candidates and m observations, and the gate as a chi-square probability or None for no
gate. It returns the landmark number (m,) of each observation, `NEW` for unpaired.
"""

import numpy as np
import scipy

from association.expectation import Expectation
from data.inputs import IntArray
from data.result import DISCARD, NEW
from data.se2 import Array


def cheapest(number: IntArray, cost: Array) -> IntArray:
    """Number (m,) of the candidate of least finite cost (m, n), the first one on a tie; `NEW` where none is finite."""
    if cost.shape[1] == 0:
        return np.full(len(cost), NEW, np.int64)
    best = np.argmin(cost, axis=1)
    return np.where(np.isfinite(cost[np.arange(len(cost)), best]), number[best], NEW)


def _distances(expectation: Expectation, gate: float | None) -> tuple[Expectation, Array, float]:
    """The expectation by age, its squared distances (m, n), and the threshold of a gate."""
    e = expectation.by_age()
    return e, e.individual_distances(), e.threshold(gate)


def nn(expectation: Expectation, gate: float | None) -> IntArray:
    """Individual compatibility nearest neighbour (ICNN; Neira and Tardos 2001).

    The landmark of least squared Mahalanobis distance d^2, paired if d^2 <= chi-square at `gate`, 2 dof (all other
    methods use <). Many observations may take one landmark. By d^2 alone an uncertain landmark attracts more than a
    well-known one (`ml` corrects that). A tie goes to the oldest landmark.
    """
    e, d2, threshold = _distances(expectation, gate)
    return cheapest(e.number, np.where(d2 <= threshold, d2, np.inf))


ALPHA = 0.84  # squared distance of "new" as a candidate, from step 4 of the classic tutorials
RATIO = 1.6  # factor by which the second best squared distance must exceed the best, from the same step


def ml(expectation: Expectation, gate: float | None) -> IntArray:
    """Maximum likelihood (Thrun, Burgard and Fox, Probabilistic Robotics, section 7.5).

    The landmark of least d^2 + ln det S, which is -2 ln of the Gaussian likelihood up to a constant, among those with
    d^2 < chi-square at `gate`, 2 dof. Many observations may take one landmark; a tie goes to the oldest.
    """
    e, d2, threshold = _distances(expectation, gate)
    return cheapest(e.number, np.where(d2 < threshold, d2 + e.log_determinants(), np.inf))


def ml_ratio(expectation: Expectation, gate: float | None, *, alpha: float = ALPHA, ratio: float = RATIO) -> IntArray:
    """Least d^2 with a ratio test (the classic tutorials' step 4, unknown correspondences and number of landmarks).

    "New" is a candidate with d^2 = `alpha`. The least d^2 wins if the second least exceeds `ratio` times it; otherwise
    the observation is ambiguous, and `DISCARD`. A landmark must be inside the gate as well.
    """
    e, d2, threshold = _distances(expectation, gate)
    if d2.shape[1] == 0:
        return np.full(len(d2), NEW, np.int64)
    everything = np.column_stack([d2, np.full(len(d2), alpha)])
    best = np.argmin(everything, axis=1)  # landmarks first: d^2 = alpha precedes "new", and the ratio discards it
    two = np.partition(everything, 1, axis=1)
    winner = np.append(e.number, NEW)[best]
    inside = (best == d2.shape[1]) | (two[:, 0] < threshold)
    return np.where((two[:, 1] > ratio * two[:, 0]) & inside, winner, DISCARD)


def singles(expectation: Expectation, gate: float | None) -> IntArray:
    """Pairs without any ambiguity (SINGLES of the data-association lab after Neira and Tardos 2001). Observation and
    landmark are paired if each is the only one compatible with the other: d^2 < chi-square at `gate`, 2 dof.
    """
    compatible = expectation.individual_distances() < expectation.threshold(gate)
    pair = compatible & (compatible.sum(axis=1) == 1)[:, None] & (compatible.sum(axis=0) == 1)[None, :]
    decisions = np.full(len(pair), NEW, np.int64)
    observation, candidate = np.nonzero(pair)
    decisions[observation] = expectation.number[candidate]
    return decisions


def gnn(expectation: Expectation, gate: float | None) -> IntArray:
    """Global nearest neighbour (Blackman and Popoli, Design and Analysis of Modern Tracking Systems).

    The one-to-one assignment of least total d^2, where an unpaired observation costs the chi-square at `gate`, 2 dof.
    Without a gate as many as possible are paired. Correlations between the pairs are ignored (`jcbb` uses them).
    """
    e, d2, threshold = _distances(expectation, gate)
    decisions = np.full(len(d2), NEW, np.int64)
    compatible = d2 < threshold
    rows, columns = np.flatnonzero(compatible.any(axis=1)), np.flatnonzero(compatible.any(axis=0))
    if len(rows) == 0:
        return decisions
    if compatible.sum() == len(rows) == len(columns):  # nothing to choose
        decisions[rows] = e.number[compatible[rows].argmax(axis=1)]
        return decisions
    some, allowed = d2[np.ix_(rows, columns)], compatible[np.ix_(rows, columns)]
    # costs more than all allowed pairs together: unpaired only if no landmark is left
    new = threshold if np.isfinite(threshold) else 1.0 + 2.0 * some[allowed].sum()
    cost = np.full((len(rows), len(columns) + len(rows)), 1.0 + 2.0 * len(rows) * new)
    cost[:, : len(columns)][allowed] = some[allowed]
    cost[np.arange(len(rows)), len(columns) + np.arange(len(rows))] = new
    choice = cost.argmin(axis=1)
    if len(set(choice.tolist())) < len(rows):  # the cheapest of each, unless two want the same
        choice = scipy.optimize.linear_sum_assignment(cost)[1]
    paired = choice < len(columns)
    decisions[rows[paired]] = e.number[columns[choice[paired]]]
    return decisions


def newness(expectation: Expectation, decisions: IntArray, new_gate: float | None) -> IntArray:
    """Turn `NEW` into `DISCARD` where some landmark is inside the second gate (two-gate rule of Bailey's EKF-SLAM
    simulator).

    An observation initializes a landmark only if d^2 >= chi-square at `new_gate`, 2 dof, for every candidate. With
    `new_gate` equal to the method's gate one true pair in a hundred initializes a duplicate; a wider gate discards it.
    `new_gate` None: only an empty map gets new landmarks.
    """
    inside = (expectation.individual_distances() < expectation.threshold(new_gate)).any(axis=1)
    return np.where((decisions == NEW) & inside, DISCARD, decisions)

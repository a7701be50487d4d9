"""Ways of association that need no search: each pairs what is compatible and leaves the rest at `NEW`.

Nearest neighbour, maximum likelihood (with or without a ratio test), SINGLES and global nearest neighbour; and newness,
which says of an unpaired observation whether it may found a landmark or is too close to one for that.
"""

from __future__ import annotations

import numpy as np
import scipy

from association.expectation import Expectation, gate_threshold
from data.inputs import IntArray
from data.result import DISCARD, NEW
from data.se2 import Array


def cheapest(number: IntArray, cost: Array) -> IntArray:
    """Number (m,) of the candidate of least finite cost (m, n), the first one on a tie; `NEW` where none is finite."""
    if cost.shape[1] == 0:
        return np.full(len(cost), NEW, np.int64)
    best = np.argmin(cost, axis=1)
    finite = np.isfinite(cost[np.arange(len(cost)), best])
    return np.where(finite, number[best], NEW)


def nn(expectation: Expectation, gate: float | None) -> IntArray:
    """Individual compatibility nearest neighbour (ICNN; Neira and Tardos 2001).

    The landmark of least squared Mahalanobis distance d^2, paired if d^2 <= chi-square at `gate`, 2 dof (<=, where
    every other method asks for <: the lab's rule). Many observations may take one landmark. By d^2 alone an uncertain
    landmark attracts more than a certain one (`ml` corrects that). A tie goes to the oldest landmark.

    Args:
        expectation: candidates (n) and observations (m).
        gate: chi-square probability, or None for no gate.

    Returns:
        (m,) landmark number, or `NEW` (-1) for unpaired.
    """
    threshold = gate_threshold(gate)
    e = expectation.by_age()
    d2 = e.individual_distances()
    return cheapest(e.number, np.where(d2 <= threshold, d2, np.inf))


ALPHA = 0.84
"""Squared distance at which "none of them" competes, of the classic tutorials' step 4."""
RATIO = 1.6
"""How many times the best squared distance the second best must exceed, of the same step."""


def ml(expectation: Expectation, gate: float | None) -> IntArray:
    """Maximum likelihood (Thrun, Burgard and Fox, Probabilistic Robotics, section 7.5).

    The landmark that minimises d^2 + ln det S, that is -2 ln of the Gaussian likelihood up to a constant, among those
    with d^2 < chi-square at `gate`, 2 dof. It is never exponentiated: far from every landmark all likelihoods
    underflow to zero together. Many observations may take one landmark; a tie goes to the oldest.

    Args:
        expectation: candidates (n) and observations (m).
        gate: chi-square probability, or None for no gate (then every observation is paired if there is a landmark).

    Returns:
        (m,) landmark number, or `NEW` (-1) for unpaired.
    """
    threshold = gate_threshold(gate)
    e = expectation.by_age()
    d2 = e.individual_distances()
    return cheapest(e.number, np.where(d2 < threshold, d2 + e.log_determinants(), np.inf))


def ml_ratio(expectation: Expectation, gate: float | None, *, alpha: float = ALPHA, ratio: float = RATIO) -> IntArray:
    """Least d^2 with a ratio test (the classic tutorials' step 4, unknown correspondences and number of landmarks).

    "New" is itself a candidate, with d^2 = `alpha`. The least d^2 wins if the second least exceeds `ratio` times it,
    else the observation is ambiguous and discarded: so is one that lies between a landmark and "new". The second least
    is the true one over all candidates, whatever their order. A landmark must also be inside the gate, as everywhere.

    Args:
        expectation: candidates (n) and observations (m).
        gate: chi-square probability, or None for no gate.
        alpha: squared distance of "new".
        ratio: factor by which the best must beat the second best.

    Returns:
        (m,) landmark number, `NEW` (-1) where "new" won, `DISCARD` (-2) where nothing won clearly.
    """
    threshold = gate_threshold(gate)
    e = expectation.by_age()
    d2 = e.individual_distances()
    if d2.shape[1] == 0:
        return np.full(len(d2), NEW, np.int64)
    everything = np.column_stack([d2, np.full(len(d2), alpha)])
    # the landmarks come first, so that one whose d^2 is exactly alpha goes before "new"; the ratio then discards it
    best = np.argmin(everything, axis=1)
    two = np.partition(everything, 1, axis=1)
    clear = two[:, 1] > ratio * two[:, 0]
    winner = np.append(e.number, NEW)[best]
    inside = (best == d2.shape[1]) | (two[:, 0] < threshold)
    return np.where(clear & inside, winner, DISCARD)


def singles(expectation: Expectation, gate: float | None) -> IntArray:
    """Pairs without any ambiguity (SINGLES of the data-association lab after Neira and Tardos 2001).

    Observation i and landmark j are paired if j is the only landmark compatible with i and i the only observation
    compatible with j; compatible: d^2 < chi-square at `gate`, 2 dof.

    Args:
        expectation: candidates (n) and observations (m).
        gate: chi-square probability, or None for no gate (then everything is compatible with everything).

    Returns:
        (m,) landmark number, or `NEW` (-1) for unpaired.
    """
    compatible = expectation.individual_distances() < gate_threshold(gate)
    alone = compatible.sum(axis=1) == 1
    pair = compatible & alone[:, None] & (compatible.sum(axis=0) == 1)[None, :]
    decisions = np.full(len(pair), NEW, np.int64)
    observation, candidate = np.nonzero(pair)
    decisions[observation] = expectation.number[candidate]
    return decisions


def gnn(expectation: Expectation, gate: float | None) -> IntArray:
    """Global nearest neighbour (Blackman and Popoli, Design and Analysis of Modern Tracking Systems).

    One-to-one assignment that minimises the sum of d^2 over the pairs plus, for every observation left unpaired, the
    chi-square at `gate`, 2 dof: what a pair may cost at most, so it is the price of a new landmark. Distances are
    individual ones; correlations between the pairs are not looked at (`jcbb` does). Without a gate as many as possible
    are paired.

    Args:
        expectation: candidates (n) and observations (m).
        gate: chi-square probability, or None for no gate.

    Returns:
        (m,) landmark number, or `NEW` (-1) for unpaired.
    """
    threshold = gate_threshold(gate)
    e = expectation.by_age()
    d2 = e.individual_distances()
    decisions = np.full(len(d2), NEW, np.int64)
    compatible = d2 < threshold
    rows, columns = np.flatnonzero(compatible.any(axis=1)), np.flatnonzero(compatible.any(axis=0))
    if len(rows) == 0:
        return decisions
    some, allowed = d2[np.ix_(rows, columns)], compatible[np.ix_(rows, columns)]
    # dearer than every allowed pair together: worth leaving unpaired only where there is no landmark left
    new = threshold if np.isfinite(threshold) else 1.0 + 2.0 * some[allowed].sum()
    forbidden = 1.0 + 2.0 * len(rows) * new
    cost = np.full((len(rows), len(columns) + len(rows)), forbidden)
    cost[:, : len(columns)][allowed] = some[allowed]
    cost[np.arange(len(rows)), len(columns) + np.arange(len(rows))] = new
    observation, choice = scipy.optimize.linear_sum_assignment(cost)
    paired = choice < len(columns)
    decisions[rows[observation[paired]]] = e.number[columns[choice[paired]]]
    return decisions


def newness(expectation: Expectation, decisions: IntArray, new_gate: float | None) -> IntArray:
    """Turn `NEW` into `DISCARD` where some landmark is inside the second gate: the two-gate rule.

    An inner gate to associate and an outer one to augment, as in Bailey's EKF-SLAM simulator. An observation
    initializes a landmark only if every candidate is outside the gate: d^2 >= chi-square at `new_gate`, 2 dof. With
    `new_gate` equal to the method's gate this is the lab's rule, under which one true pair in a hundred falls out of
    its own landmark's gate and initializes a duplicate; a wider gate discards it instead.

    Args:
        expectation: candidates (n) and observations (m).
        decisions: (m,) as a method made them.
        new_gate: chi-square probability; None: no candidate is ever outside, so only an empty map gets new landmarks.

    Returns:
        (m,) landmark number, `NEW` or `DISCARD`.
    """
    inside = (expectation.individual_distances() < gate_threshold(new_gate)).any(axis=1)
    return np.where((decisions == NEW) & inside, DISCARD, decisions)

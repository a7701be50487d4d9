"""Maximum likelihood: each observation on its own takes the landmark that explains it best, with or without a ratio."""

from __future__ import annotations

import numpy as np

from association.expectation import Expectation, gate_threshold
from association.nearest import cheapest
from data.inputs import IntArray
from data.result import DISCARD, NEW

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

"""Nearest neighbour: each observation on its own takes the landmark of least Mahalanobis distance."""

from __future__ import annotations

import numpy as np

from association.expectation import Expectation, gate_threshold
from data.inputs import IntArray
from data.result import NEW
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

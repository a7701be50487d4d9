"""Global nearest neighbour: the one-to-one assignment of least total distance, a new landmark being an alternative."""

from __future__ import annotations

import numpy as np
from scipy.optimize import linear_sum_assignment

from association.expectation import Expectation, gate_threshold
from data.inputs import IntArray
from data.result import NEW


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
    observation, choice = linear_sum_assignment(cost)
    paired = choice < len(columns)
    decisions[rows[observation[paired]]] = e.number[columns[choice[paired]]]
    return decisions

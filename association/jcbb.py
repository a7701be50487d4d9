"""Joint compatibility branch and bound: the largest set of pairings that are compatible all together."""

from __future__ import annotations

import warnings
from typing import NamedTuple

import numpy as np

from association import jcbb_kernels
from association.expectation import Expectation, SingularInnovationError, gate_threshold
from data.inputs import IntArray
from data.result import NEW

BUDGET = 50_000
"""Nodes that a search may visit: some tenths of a second in a frame of twenty observations."""


class SearchBudgetWarning(UserWarning):
    """A search ended before it was complete; its decisions are the best it had found, valid but maybe not the best."""


class Search(NamedTuple):
    """What a search found.

    decisions: (m,) landmark number, or `NEW` (-1) for unpaired; distance: squared joint Mahalanobis distance of the
    pairings; pairings: how many; nodes: how many were visited; complete: False if the budget ended the search.
    """

    decisions: IntArray
    distance: float
    pairings: int
    nodes: int
    complete: bool


def search(expectation: Expectation, gate: float | None, *, first: bool = False, budget: int = BUDGET) -> Search:
    """The search behind `jcbb` and `jcbb_first`, with all it found and whether it came to its end.

    The joint covariance is asked for once, for those candidates alone that are compatible with some observation.

    Raises:
        SingularInnovationError: the innovation covariance of a pair, or of the pairings together, is not positive
            definite.
    """
    threshold = gate_threshold(gate)
    if budget < 1:
        raise ValueError(f"budget {budget}: a search needs at least one node")
    e = expectation if first else expectation.by_age()
    compatible = e.individual_distances() < threshold
    decisions = np.full(len(compatible), NEW, np.int64)
    rows, columns = np.flatnonzero(compatible.any(axis=1)), np.flatnonzero(compatible.any(axis=0))
    if len(rows) == 0:
        return Search(decisions, 0.0, 0, 0, True)
    thresholds = np.array([np.inf, *(gate_threshold(gate, 2 * (q + 1)) for q in range(len(rows)))])
    kernel = jcbb_kernels.search_first if first else jcbb_kernels.search_best
    choice, distance, pairings, nodes, status = kernel(
        np.array(e.residual(e.z[rows, None, :], e.z_hat[None, columns, :]), float, order="C"),
        np.ascontiguousarray(compatible[np.ix_(rows, columns)]),
        np.array(e.joint(columns), float, order="C"),
        np.array(e.R[rows], float, order="C"),
        thresholds,
        budget,
    )
    if status == jcbb_kernels.SINGULAR_JOINT:
        raise SingularInnovationError(
            f"the joint innovation covariance of observations {rows.tolist()} and landmarks "
            f"{e.number[columns].tolist()} is singular; a positive definite one is needed"
        )
    paired = choice >= 0
    decisions[rows[paired]] = e.number[columns[choice[paired]]]
    return Search(decisions, float(distance), int(pairings), int(nodes), status == jcbb_kernels.COMPLETE)


def jcbb(expectation: Expectation, gate: float | None, *, budget: int = BUDGET) -> IntArray:
    """Joint compatibility branch and bound (Neira and Tardos 2001), ties by the least joint distance.

    Of all one-to-one hypotheses whose pairs are individually compatible (d^2 < chi-square at `gate`, 2 dof) and which
    as a whole are jointly compatible (joint d^2 < chi-square at `gate`, 2 dof per pair, with the full cross-covariance
    of pose and landmarks): the one with most pairings, and of these the one with least joint d^2. Neither the order of
    observations nor that of the map matters; landmarks that nothing tells apart go oldest first.

    Args:
        expectation: candidates (n) and observations (m).
        gate: chi-square probability, or None for no gate.
        budget: nodes the search may visit. If they do not suffice, the best hypothesis found is returned and a
            `SearchBudgetWarning` issued; `search` and `association.decide` report it as a flag instead.

    Returns:
        (m,) landmark number, or `NEW` (-1) for unpaired.
    """
    return _warned(search(expectation, gate, budget=budget))


def jcbb_first(expectation: Expectation, gate: float | None, *, budget: int = BUDGET) -> IntArray:
    """Joint compatibility branch and bound as the recorded lab program does it: ties to the first one found.

    Depth first, observations and candidates in the given order, a pairing being kept if all pairings so far are jointly
    compatible with it; a hypothesis replaces the best one only with strictly more pairings, so the oldest landmarks
    win ties and no distance does. One landmark may be given to two observations (the joint test all but always
    rejects it). Arguments and result as for `jcbb`.
    """
    return _warned(search(expectation, gate, first=True, budget=budget))


def _warned(result: Search) -> IntArray:
    if not result.complete:
        warnings.warn(
            f"JCBB stopped after {result.nodes} nodes with {result.pairings} pairings; they may not be the most",
            SearchBudgetWarning,
            stacklevel=3,
        )
    return result.decisions

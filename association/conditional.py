"""What all other pairings of a frame say about one pairing.

A joint test over many pairings has slack that one wrong pairing can use up: of twelve pairings at 99 % it lets one pass
that lies four sigmas off. And a common error, a robot that turned three sigmas further than it thinks, puts every
single pairing outside its gate, although together they leave no doubt. What tells in both cases is the innovation of
one pairing given all the others of its frame: the robot's own uncertainty has cancelled in it.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from association.expectation import Expectation, SingularInnovationError, gate_threshold
from association.jcbb import BUDGET, search
from data.blocks import diagonal_blocks, of_points
from data.inputs import IntArray
from data.result import DISCARD, NEW
from data.se2 import Array, BoolArray

FREEDOM = 4.0
"""Degrees of freedom of Student's t: its tails fall with d^-6; anything between 3 and 10 does as well."""
SAME_PLACE = 0.05
"""In ranges: from nearer places the view is the same, and what hides a landmark hides it still."""
EXACT_VARIANCE = 1e-12
"""m^2 and rad^2. No point, distance or pose is known better: what is exact has no inverse."""


class Alone(NamedTuple):
    """Innovations (k, 2) of pairings, each given all others of its frame, and their information (k, 2, 2)."""

    innovation: Array
    information: Array

    @property
    def distance(self) -> Array:
        """Squared Mahalanobis distances (k,), chi-square with 2 dof each."""
        d2: Array = np.einsum("ki,kij,kj->k", self.innovation, self.information, self.innovation)
        return d2


def alone(e: Expectation, rows: IntArray, chosen: IntArray) -> Alone:
    """Each pairing's innovation given all others: blocks of S^-1 are the information, (S^-1 nu)_j weighs its residual.

    (Gaussian conditioning in information form.) `rows` (k,) are paired with the candidates `chosen` (k,).
    Raises SingularInnovationError if their joint covariance is not positive definite.
    """
    k = len(rows)
    if not k:
        return Alone(np.empty((0, 2)), np.empty((0, 2, 2)))
    nu, S = e.joint_innovation(rows, chosen)
    try:
        L = np.linalg.inv(np.linalg.cholesky(S))
    except np.linalg.LinAlgError:
        raise SingularInnovationError(
            f"the joint innovation covariance of landmarks {e.number[chosen].tolist()} is singular"
        ) from None
    W = L.T @ L
    information = diagonal_blocks(W)
    return Alone(np.linalg.solve(information, (W @ nu).reshape(k, 2, 1))[..., 0], information)


def prune(e: Expectation, decisions: IntArray, gate: float | None) -> IntArray:
    """Undo, worst first, pairings that the others of their frame contradict: outside `gate`, 2 dof, given those.

    Returns decisions (m,) with `NEW` for what was undone.
    """
    threshold, kept = gate_threshold(gate), decisions.copy()
    while True:
        rows, chosen = e.paired(kept)
        d2 = alone(e, rows, chosen).distance
        if not len(d2) or d2.max() < threshold:
            return kept
        kept[rows[np.argmax(d2)]] = NEW


def given(e: Expectation, decisions: IntArray, candidates: IntArray) -> Expectation:
    """What is expected of some candidates (n,) once the pairings are believed, to first order."""
    rows, chosen = e.paired(decisions)
    few, n = e.only(candidates), len(candidates)
    if not len(rows) or not n:
        return few
    nu, S = e.joint_innovation(rows, chosen)
    every = e.joint(np.concatenate([candidates, chosen]))
    cross = every[: 2 * n, 2 * n :]
    gain = np.linalg.solve(S, cross.T).T
    P = every[: 2 * n, : 2 * n] - gain @ cross.T
    P = 0.5 * (P + P.T)

    def joint(indices: IntArray) -> Array:
        return of_points(P, indices)

    z_hat = few.z_hat + (gain @ nu).reshape(n, 2)
    return replace(few, z_hat=z_hat, HPHt=diagonal_blocks(P), joint=joint, elsewhere=None)


def jcbb_conditional(
    e: Expectation, gate: float | None, new_gate: float | None, *, budget: int = BUDGET
) -> tuple[IntArray, bool]:
    """Decisions (m,) of a frame, and whether the search came to its end.

    JCBB inside the outer gate, where a common error does not hide the landmarks; then every pairing must pass `gate`
    given the others; and an unpaired observation is a new landmark only if it is outside `new_gate` of every other,
    given the pairings (`NEW`; else `DISCARD`). Without one of the gates the search has the inner one.
    """
    outer = gate if gate is None or new_gate is None else max(gate, new_gate)
    found = search(e, outer, budget=budget)
    return settled(e, prune(e, found.decisions, gate), new_gate), found.complete


def settled(e: Expectation, decisions: IntArray, new_gate: float | None) -> IntArray:
    """Decisions (m,) with `DISCARD` for what is unpaired and inside `new_gate` of a landmark, given the pairings."""
    decisions = decisions.copy()
    left = np.flatnonzero(decisions == NEW)
    decisions[left[_close(e, decisions, left, new_gate).any(axis=1)]] = DISCARD
    return decisions


def beside(e: Expectation, decisions: IntArray, new_gate: float | None) -> BoolArray:
    """Observations (m,) that are discarded only for landmarks which another observation of the frame is paired with.

    No landmark is seen twice in a frame: where such an observation is no clutter, two landmarks stand there.
    """
    left = np.flatnonzero(decisions == DISCARD)
    close = _close(e, decisions, left, new_gate)
    found = np.zeros(len(decisions), np.bool_)
    found[left] = close.any(axis=1) & ~close[:, ~np.isin(e.number, decisions)].any(axis=1)
    return found


def _close(e: Expectation, decisions: IntArray, rows: IntArray, gate: float | None) -> BoolArray:
    """Whether observations `rows` (k,) are inside the gate of each candidate (k, n), given the pairings."""
    threshold = gate_threshold(gate)
    # believing the pairings makes an expectation more certain: only what is inside without them can be inside with them
    close: BoolArray = e.individual_distances()[rows] < threshold
    candidates = np.flatnonzero(close.any(axis=0))
    if len(candidates):
        close[:, candidates] &= given(e, decisions, candidates).individual_distances()[rows] < threshold
    return close

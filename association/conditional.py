"""Conditional gates: the innovation of one pairing given all other pairings of its frame.

A joint test over many pairings has slack that one wrong pairing can use: of twelve pairings at 99 % it passes one that
is four sigmas off. A common error, such as a wrong heading, puts every single pairing outside its gate. Given the other
pairings the robot's own uncertainty cancels, and the test decides in both cases.
"""

from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np

from association.expectation import Expectation
from association.jcbb import search
from data.blocks import cholesky, diagonal_blocks, of_points
from data.compiled import njit
from data.inputs import IntArray
from data.result import DISCARD, NEW
from data.se2 import Array, BoolArray

FREEDOM = 4.0  # degrees of freedom of Student's t, whose tails fall with d^-6; values from 3 to 10 work equally well
SAME_PLACE = 0.05  # in ranges: from viewpoints nearer than this the view is the same, and so are the occlusions
EXACT_VARIANCE = 1e-12  # m^2 and rad^2. Smallest variance used, since an exact quantity has no information matrix


class ConditionalInnovations(NamedTuple):
    """Innovations (k, 2) of pairings, each given all others of its frame, and their information (k, 2, 2)."""

    innovation: Array
    information: Array

    @property
    def distance(self) -> Array:
        """Squared Mahalanobis distances (k,), chi-square with 2 dof each."""
        return np.asarray(np.einsum("ki,kij,kj->k", self.innovation, self.information, self.innovation))


def conditional_innovations(e: Expectation, rows: IntArray, chosen: IntArray) -> ConditionalInnovations:
    """Each pairing's innovation given all others, from the blocks of S^-1: observations `rows` (k,), candidates
    `chosen` (k,). Raises SingularInnovationError if their joint covariance is not positive definite.
    """
    pairing = rows.tobytes(), chosen.tobytes()
    found = e.formed.conditional.get(pairing)
    if found is None:
        found = np.empty((len(rows), 2)), np.empty((len(rows), 2, 2))
        nu, S = e.joint_innovation(rows, chosen)
        if not _given_others(nu.copy(), S.copy(), *found):
            raise e.singular(chosen)
        e.formed.conditional[pairing] = found
    return ConditionalInnovations(*found)


@njit
def _given_others(nu: Array, L: Array, innovation: Array, information: Array) -> bool:
    """Fill both from nu (2k,) and its covariance L (2k, 2k), which is overwritten; False if that is singular."""
    n = len(nu)
    if not cholesky(L, L, n):
        return False
    for j in range(n):  # its inverse, and nu times that
        L[j, j] = 1.0 / L[j, j]
        for i in range(j + 1, n):
            total = 0.0
            for c in range(j, i):
                total -= L[i, c] * L[c, j]
            L[i, j] = total / L[i, i]
    for i in range(n - 1, -1, -1):
        nu[i] *= L[i, i]
        for c in range(i):
            nu[i] += L[i, c] * nu[c]
    for k in range(n // 2):
        i, xx, xy, yy, x, y = 2 * k, 0.0, 0.0, 0.0, 0.0, 0.0
        for r in range(i, n):
            a, b = L[r, i], L[r, i + 1] if r > i else 0.0
            xx, xy, yy, x, y = xx + a * a, xy + a * b, yy + b * b, x + a * nu[r], y + b * nu[r]
        det = xx * yy - xy * xy
        innovation[k, 0], innovation[k, 1] = (yy * x - xy * y) / det, (xx * y - xy * x) / det
        information[k, 0, 0], information[k, 0, 1], information[k, 1, 0], information[k, 1, 1] = xx, xy, xy, yy
    return True


def prune(e: Expectation, decisions: IntArray, gate: float | None, share: float = 1.0) -> IntArray:
    """Decisions (m,) without pairings outside `gate` (2 dof) given the others; `share`: see `jcbb_conditional`."""
    threshold, kept = e.threshold(gate), decisions.copy()
    while True:
        rows, chosen = e.paired(kept)
        d2 = conditional_innovations(e, rows, chosen).distance / share
        if e.unlike is not None:
            d2 = d2 + e.unlike.distance[rows, chosen]
        if not len(d2) or d2.max() < threshold:
            return kept
        kept[rows[np.argmax(d2)]] = NEW


def conditional_expectation(e: Expectation, decisions: IntArray, candidates: IntArray) -> Expectation:
    """The expectation of some candidates (n,) given the pairings, to first order."""
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
    z_hat = few.z_hat + (gain @ nu).reshape(n, 2)
    return replace(few, z_hat=z_hat, HPHt=diagonal_blocks(P), joint=partial(of_points, P), elsewhere=None)


class ConditionalDecisions(NamedTuple):
    """Decisions (m,) of a frame, whether the search was completed, and `conditional_distances` (m, n)."""

    decisions: IntArray
    complete: bool
    given: Array


def jcbb_conditional(
    e: Expectation, gate: float | None, new_gate: float | None, *, share: float = 1.0
) -> ConditionalDecisions:
    """JCBB within the outer gate, which a common error passes. Then every pairing must pass `gate` given the others. An
    unpaired observation is `NEW` only outside `new_gate` of every landmark given the pairings, else `DISCARD`. Without
    one of the gates the search uses the inner one. All covariances count as `share` times the stated ones.
    """
    outer = gate if gate is None or new_gate is None else max(gate, new_gate)
    found = search(e, outer, share=share)
    kept = prune(e, found.decisions, gate, share)
    given = conditional_distances(e, kept, new_gate)
    close = e.scaled(given, share) < e.threshold(new_gate)
    return ConditionalDecisions(unless_close(kept, close), found.complete, given)


def conditional_distances(e: Expectation, decisions: IntArray, new_gate: float | None) -> Array:
    """Squared distances (m, n) of unpaired observations to candidates given the pairings, not below those without. Only
    of what is inside `new_gate` without the pairings: conditioning reduces the covariance.
    """
    d2, left = e.individual_distances(), np.flatnonzero(decisions < 0)
    candidates = np.flatnonzero((d2[left] < e.threshold(new_gate)).any(axis=0))
    if not len(candidates):
        return d2
    both, found = (left[:, None], candidates), d2.copy()
    found[both] = np.maximum(d2[both], conditional_expectation(e, decisions, candidates).individual_distances()[left])
    return found


def unless_close(decisions: IntArray, close: BoolArray) -> IntArray:
    """Decisions (m,) with `DISCARD` for new landmarks that are close (m, n) to another one."""
    return np.where((decisions == NEW) & close.any(axis=1), DISCARD, decisions)

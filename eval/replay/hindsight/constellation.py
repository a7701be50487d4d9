"""Constellations: recognize landmarks initialized twice by their relative positions.

After a long drive the pose is uncertain, and several old landmarks are inside the gate of one observation. The window
of landmarks initialized since the robot returned fits the old map in one way or in none. A pair of new landmarks laid
onto a pair of old ones gives an alignment, for which the others vote (geometric consensus). The alignments with most
votes are compared.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numba
import numpy as np

from association.expectation import gate_threshold
from data import se2
from data.blocks import blocks_of, coordinates, diagonal_blocks, of_points
from data.inputs import IntArray
from data.se2 import Array, BoolArray
from eval.replay.hindsight import constants
from eval.replay.hindsight.relocalize import distance_sigmas


class Landmarks(NamedTuple):
    """Mean (n, 2) and joint covariance (2n, 2n) of landmarks."""

    xy: Array
    covariance: Array


def squared_distances(new: Landmarks, old: Landmarks, cross: Array) -> tuple[Array, Array]:
    """Squared Mahalanobis distance (m, n) of each new landmark to each old one, and det (m, n) of their difference.

    `cross` (2m, 2n): covariance between both.
    """
    here, there, both = diagonal_blocks(new.covariance), diagonal_blocks(old.covariance), blocks_of(cross)
    # a landmark compared with itself has no uncertainty
    D = here[:, None] + there[None] - both - both.transpose(0, 1, 3, 2) + constants.EXACT_VARIANCE * np.eye(2)
    nu = new.xy[:, None] - old.xy[None]
    d2: Array = np.einsum("mni,mni->mn", nu, np.linalg.solve(D, nu[..., None])[..., 0])
    det: Array = np.linalg.det(D)
    return d2, det


def spread(landmarks: Landmarks) -> Array:
    """Standard deviation (n,) [m] of each landmark's distance to the others, median over these."""
    sigma = distance_sigmas(*landmarks)
    np.fill_diagonal(sigma, np.nan)
    middle: Array = np.nanmedian(sigma, axis=1)
    return middle


def recognize(
    new: Landmarks,
    old: Landmarks,
    cross: Array,
    allowed: BoolArray,
    density: float,
    max_turn: float,
    scale: float = 1.0,
) -> list[tuple[int, int]]:
    """New landmarks (indices) that equal old ones, [(new, old), ...]; none if no alignment stands out.

    For m new and n old landmarks, cross (2m, 2n) is their covariance, and allowed (m, n) the pairs that may be the same
    by themselves. density [1/m^2] of the old map, max_turn [rad] of the new ones; scale: learned variance scale.
    """
    if len(new.xy) < constants.CONSTELLATION_FEWEST:
        return []
    sides = np.flatnonzero(allowed.any(axis=0))
    if len(sides) < constants.CONSTELLATION_FEWEST:
        return []
    tolerance = constants.DISTANCE_SIGMAS * math.sqrt(scale) * np.hypot(spread(new)[:, None], spread(old)[sides][None])
    choices, counts, misfit = _vote(
        np.ascontiguousarray(new.xy), np.ascontiguousarray(old.xy[sides]), np.ascontiguousarray(allowed[:, sides]),
        tolerance, max_turn,
        constants.CONSTELLATION_LONG, constants.CONSTELLATION_VOTES, constants.CONSTELLATION_KEPT,
    )  # fmt: skip
    if not len(choices):
        return []
    order = np.lexsort((misfit, -counts))
    best = choices[order[0]]
    paired = best >= 0
    second = constants.CONSTELLATION_SECOND
    for other in order[1:]:
        if np.sum((choices[other] == best) & paired) <= constants.CONSTELLATION_SHARED:
            second = max(second, int(counts[other]))
            break
    chance = min(constants.CHANCE_MOST, density * math.pi * float(np.max(tolerance[paired, best[paired]])) ** 2)
    log_odds = (paired.sum() - second) * -math.log(max(chance, constants.CHANCE_LEAST))
    if paired.sum() < constants.CONSTELLATION_FEWEST or log_odds < math.log(constants.CONSTELLATION_ODDS):
        return []
    i, j = np.flatnonzero(paired), sides[best[paired]]
    # a neighbour just as near leaves open which of both it is
    xy = se2.transform_points(se2.rigid_fit(new.xy[i], old.xy[j]), new.xy)
    near = np.hypot(*(xy[:, None] - old.xy[sides][None]).transpose(2, 0, 1)) < tolerance
    sure = (near[i].sum(axis=1) == 1) & (near[:, best[paired]].sum(axis=0) == 1)
    kept = _agreeing(new, old, cross, i[sure], j[sure])
    return (
        []
        if len(kept[0]) < constants.CONSTELLATION_FEWEST
        else list(zip(kept[0].tolist(), kept[1].tolist(), strict=True))
    )


def _agreeing(new: Landmarks, old: Landmarks, cross: Array, i: IntArray, j: IntArray) -> tuple[IntArray, IntArray]:
    """The pairs of new landmarks i (k,) and old ones j (k,) that can be the same, with all their correlations.

    The worst pair that the others contradict is dropped, one at a time (`CONSTELLATION_ALONE`); the rest must pass the
    joint test (`CONSTELLATION_GATE`).
    """
    while len(i) >= constants.CONSTELLATION_FEWEST:
        both = cross[np.ix_(coordinates(i), coordinates(j))]
        W = np.linalg.inv(of_points(new.covariance, i) + of_points(old.covariance, j) - both - both.T)
        nu = (new.xy[i] - old.xy[j]).ravel()
        # each difference given the others: blocks of the inverse, see `association.conditional.alone`
        weighed = (W @ nu).reshape(-1, 2)
        alone = np.einsum("ka,ka->k", weighed, np.linalg.solve(diagonal_blocks(W), weighed[..., None])[..., 0])
        if alone.max() < gate_threshold(constants.CONSTELLATION_ALONE):
            if float(nu @ W @ nu) < gate_threshold(constants.CONSTELLATION_GATE, len(nu)):
                return i, j
            break
        i, j = np.delete(i, alone.argmax()), np.delete(j, alone.argmax())
    return i[:0], j[:0]


@numba.njit(cache=True)
def _vote(
    x: Array, y: Array, allowed: BoolArray, tolerance: Array, max_turn: float, long: float, fewest: int, kept: int
) -> tuple[IntArray, IntArray, Array]:
    """Lay every pair of points x (m, 2) onto every allowed pair of y (n, 2); the other points vote, nearest first.

    Returns the best `kept` assignments (h, m), -1 for none, with their numbers of pairings and sums of squared misfits.
    """
    m, n = allowed.shape
    best, counts = np.full((kept, m), -1), np.zeros(kept, np.int64)
    misfit, h = np.zeros(kept), 0
    choice, taken = np.empty(m, np.int64), np.zeros(n, np.bool_)
    for i in range(m):
        for a in range(n):
            if not allowed[i, a]:
                continue
            for k in range(i + 1, m):
                dx, dy = x[k, 0] - x[i, 0], x[k, 1] - x[i, 1]
                apart = math.hypot(dx, dy)
                for b in range(n):
                    if b == a or not allowed[k, b]:
                        continue
                    reach = math.hypot(tolerance[i, a], tolerance[k, b])
                    ex, ey = y[b, 0] - y[a, 0], y[b, 1] - y[a, 1]
                    # a short pair does not give the rotation
                    if apart < long * reach or abs(math.hypot(ex, ey) - apart) > reach:
                        continue
                    turn = math.atan2(dx * ey - dy * ex, dx * ex + dy * ey)
                    if abs(turn) > max_turn:
                        continue
                    c, s = math.cos(turn), math.sin(turn)
                    mx, my = 0.5 * (x[i, 0] + x[k, 0]), 0.5 * (x[i, 1] + x[k, 1])
                    ux, uy = 0.5 * (y[a, 0] + y[b, 0]), 0.5 * (y[a, 1] + y[b, 1])
                    taken[:] = False
                    votes, total = 0, 0.0
                    for t in range(m):
                        vx, vy = x[t, 0] - mx, x[t, 1] - my
                        tx, ty = ux + c * vx - s * vy, uy + s * vx + c * vy
                        choice[t] = -1
                        least = 1.0
                        for w in range(n):
                            if taken[w] or not allowed[t, w]:
                                continue
                            off = ((y[w, 0] - tx) ** 2 + (y[w, 1] - ty) ** 2) / tolerance[t, w] ** 2
                            if off < least:
                                least, choice[t] = off, w
                        if choice[t] >= 0:
                            taken[choice[t]] = True
                            votes += 1
                            total += least
                    if votes < fewest:
                        continue
                    same = -1
                    for z in range(h):
                        if counts[z] == votes and np.all(best[z] == choice):
                            same = z
                            break
                    if same >= 0:
                        misfit[same] = min(misfit[same], total)
                        continue
                    slot = h
                    if h == kept:
                        slot = int(np.argmin(counts))
                        if counts[slot] >= votes:
                            continue
                    else:
                        h += 1
                    best[slot], counts[slot], misfit[slot] = choice, votes, total
    return best[:h], counts[:h], misfit[:h]

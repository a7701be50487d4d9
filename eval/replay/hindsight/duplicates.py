"""Step 9: find landmarks of SLAM that were initialized twice, by constellation or singly.

Landmarks initialized since the robot returned are compared with the old map as a whole. Landmarks
seen in one frame cannot be the same.

After a long drive the pose is uncertain, and several old landmarks are inside the gate of one observation. The window
of landmarks initialized since the robot returned fits the old map in one way or in none. A pair of new landmarks laid
onto a pair of old ones gives an alignment, for which the others vote (geometric consensus). The alignments with most
votes are compared.
"""

import math
from collections.abc import Collection
from itertools import compress
from typing import NamedTuple

import numpy as np

from association.expectation import gate_threshold
from data import se2
from data.blocks import blocks_of, coordinates, diagonal_blocks, of_points
from data.compiled import njit
from data.inputs import IntArray
from data.se2 import Array, BoolArray
from ekf.slam import EkfSlam
from eval.replay.hindsight import constants
from eval.replay.hindsight.gates import density
from eval.replay.hindsight.ledger import Ledger
from eval.replay.hindsight.relocalize import distance_sigmas


class Landmarks(NamedTuple):
    """Mean (n, 2) and joint covariance (2n, 2n) of landmarks."""

    xy: Array
    covariance: Array


def squared_distances(new: Landmarks, old: Landmarks, cross: Array) -> tuple[Array, Array]:
    """Squared Mahalanobis distance (m, n) of each new landmark to each old one, and det (m, n) of their difference.
    `cross` (2m, 2n): covariance between both. A landmark compared with itself gets the least variance, for its 0.
    """
    x, y = (new.xy[:, None] - old.xy).transpose(2, 0, 1)
    S = diagonal_blocks(new.covariance)[:, None] + diagonal_blocks(old.covariance)
    (xx, xy), (yx, yy) = (S - 2.0 * blocks_of(cross)).transpose(2, 3, 0, 1)
    xx, xy, yy = xx + constants.EXACT_VARIANCE, 0.5 * (xy + yx), yy + constants.EXACT_VARIANCE
    det = xx * yy - xy * xy
    return (yy * x * x - 2.0 * xy * x * y + xx * y * y) / det, det


def spread(landmarks: Landmarks) -> Array:
    """Standard deviation (n,) [m] of each landmark's distance to the others, median over these."""
    sigma = distance_sigmas(*landmarks)
    np.fill_diagonal(sigma, np.nan)
    return np.asarray(np.nanmedian(sigma, axis=1))


def recognize(
    new: Landmarks, old: Landmarks, cross: Array, allowed: BoolArray, density: float, max_turn: float, scale: float
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
    i, j = _agreeing(new, old, cross, i[sure], j[sure])
    return list(zip(i.tolist(), j.tolist(), strict=True))


def _agreeing(new: Landmarks, old: Landmarks, cross: Array, i: IntArray, j: IntArray) -> tuple[IntArray, IntArray]:
    """The pairs of landmarks i, j (k,) that can be the same, in view of all their correlations; or none."""
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


@njit
def _vote(
    x: Array, y: Array, allowed: BoolArray, tolerance: Array, max_turn: float, long: float, fewest: int, kept: int
) -> tuple[IntArray, IntArray, Array]:
    """The `kept` best assignments (h, m) of points x (m, 2) to y (n, 2), -1: none, with their votes and misfits."""
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
                        nearest = 1.0
                        for w in range(n):
                            if taken[w] or not allowed[t, w]:
                                continue
                            off = ((y[w, 0] - tx) ** 2 + (y[w, 1] - ty) ** 2) / tolerance[t, w] ** 2
                            if off < nearest:
                                nearest, choice[t] = off, w
                        if choice[t] >= 0:
                            taken[choice[t]] = True
                            votes += 1
                            total += nearest
                    if votes < fewest:
                        continue
                    slot, least = 0, 0  # the same assignment, or else the first one with the fewest votes
                    while slot < h:
                        same = counts[slot] == votes
                        for t in range(m):
                            same = same and best[slot, t] == choice[t]
                        if same:
                            break
                        least = slot if counts[slot] < counts[least] else least
                        slot += 1
                    if slot < h:
                        misfit[slot] = min(misfit[slot], total)
                        continue
                    if h == kept:
                        slot = least
                        if counts[slot] >= votes:
                            continue
                    h = min(h + 1, kept)
                    counts[slot], misfit[slot] = votes, total
                    best[slot] = choice
    return best[:h], counts[:h], misfit[:h]


Pairs = list[tuple[int, int]]  # landmarks to remove, each with the one that it equals


class Duplicates:
    """Searches when a landmark was initialized, and every few frames."""

    def __init__(self, ledger: Ledger) -> None:
        self.ledger = ledger
        self._searched = (0, 0)  # landmarks initialized and frames with observations at the last search

    def find(self, slam: EkfSlam, scale: float) -> Pairs:
        """Landmarks of the window that were initialized before; `scale`: learned variance scale."""
        ledger, records = self.ledger, self.ledger.records
        created, frames = self._searched
        if ledger.created == created and ledger.frames - frames < constants.WINDOW_EVERY:
            return []
        self._searched = ledger.created, ledger.frames
        span, age = constants.WINDOW_SPAN * ledger.range, constants.WINDOW_AGE * ledger.range
        known = [n for n, r in records.items() if r.times >= constants.WINDOW_OBSERVATIONS]
        window = [n for n in known if ledger.travelled - records[n].last <= span]
        young = [n for n in window if ledger.travelled - records[n].first <= age]
        old = [n for n in known if ledger.travelled - records[n].first > age]
        here, there = map(set, comparable(slam, window, known, gate_threshold(constants.WINDOW_GATE)))
        if not young or not there:
            return []
        young.sort(key=lambda n: records[n].last)
        around, first = density(slam, ledger.range), ledger.epoch.first
        # a window that holds old landmarks has found its place; what this epoch initialized may not have
        pairs, enough = [], constants.CONSTELLATION_FEWEST
        if len(there & set(old)) >= enough and not set(old) & set(window):
            pairs = constellation(slam, ledger, young, old, around, scale)
        if not pairs and sum(n < first for n in there) >= enough:
            new, before = [n for n in young if n >= first], [n for n in known if n < first]
            pairs = constellation(slam, ledger, new, before, around, scale)
        if pairs:
            ledger.epoch = ledger.epoch._replace(begun=-math.inf)  # the ambiguity is resolved
            return pairs
        if not agreeing(slam, ledger, here, there)[2].any():
            return []
        chance = constants.SINGLE_CHANCE, constants.SINGLE_CHANCE_YOUNG * constants.SINGLE_CHANCE
        return single(slam, ledger, here, there.intersection(old), chance[0] / around, scale) or single(
            slam, ledger, here, there, chance[1] / around, scale
        )


class Compared(NamedTuple):
    """New and old landmarks, their joint statistics; `covisible` (m, n): seen together or of other looks."""

    new: Landmarks
    old: Landmarks
    cross: Array
    d2: Array
    det: Array
    covisible: BoolArray


def compare(slam: EkfSlam, ledger: Ledger, young: list[int], old: list[int]) -> Compared:
    """Relations of m landmarks and n others, from the filter's joint covariance."""
    mean, P = slam.position(np.array(young + old))
    m = 2 * len(young)
    new, there = Landmarks(mean[:m].reshape(-1, 2), P[:m, :m]), Landmarks(mean[m:].reshape(-1, 2), P[m:, m:])
    d2, det = squared_distances(new, there, P[:m, m:])
    never = np.array([[b == a or b in ledger.records[a].covisible for b in old] for a in young])
    never |= ledger.looks.differ(np.array(young), np.array(old), gate_threshold(constants.SAME_GATE, 1))
    return Compared(new, there, P[:m, m:], d2, det, never)


def comparable(slam: EkfSlam, young: list[int], old: list[int], gate: float) -> tuple[list[int], list[int]]:
    """Members of two groups whose squared Mahalanobis distance to the other group may be below the gate.

    Uses bounds without the joint covariance: the largest eigenvalue of the covariance of a difference is at most twice
    the sum of both traces.
    """
    (here, a), (there, b) = slam.places(np.array(young, np.int64)), slam.places(np.array(old, np.int64))
    off = here[:, None] - there[None]
    near = (off**2).sum(axis=2) < gate * (2.0 * (a[:, None] + b[None]) + constants.EXACT_VARIANCE)
    near &= np.array(young)[:, None] != np.array(old)[None]
    return list(compress(young, near.any(axis=1))), list(compress(old, near.any(axis=0)))


def constellation(slam: EkfSlam, ledger: Ledger, new: list[int], old: list[int], density: float, scale: float) -> Pairs:
    """Young landmarks, in the order in which they were last seen, that equal old ones by their relative positions.
    density: landmarks per square metre; scale: learned variance scale.
    """
    if not new or not old:
        return []
    new, gate = new[-constants.WINDOW_MOST :], gate_threshold(constants.WINDOW_GATE)
    if len(comparable(slam, new, old, gate)[1]) < constants.CONSTELLATION_FEWEST:
        return []
    c = compare(slam, ledger, new, old)
    turn = constants.DISTANCE_SIGMAS * math.sqrt(slam.estimate().covariance[2, 2]) + constants.TURN_MARGIN
    allowed = (c.d2 < gate) & ~c.covisible
    return [(new[i], old[j]) for i, j in recognize(c.new, c.old, c.cross, allowed, density, turn, scale)]


def agreeing(
    slam: EkfSlam, ledger: Ledger, window: Collection[int], others: Collection[int]
) -> tuple[IntArray, IntArray, BoolArray]:
    """Members (m,) of the window and others (n,) of which some may be at one place, and which of them (m, n)."""
    gate = gate_threshold(constants.SAME_GATE)
    young, old = comparable(slam, sorted(window), sorted(others), gate)
    if not young or not old:
        return np.empty(0, np.int64), np.empty(0, np.int64), np.empty((0, 0), np.bool_)
    c = compare(slam, ledger, young, old)
    return np.array(young), np.array(old), (c.d2 < gate) & ~c.covisible


def single(
    slam: EkfSlam, ledger: Ledger, window: Collection[int], others: Collection[int], area: float, scale: float
) -> Pairs:
    """At most one pair of the window and others, at one place with no other landmark near. `area` [m^2]: upper limit of
    the gate of their difference; `scale`: learned variance scale.
    """
    gate, (young, old, may) = gate_threshold(constants.SAME_GATE), agreeing(slam, ledger, window, others)
    every = np.union1d(young[may.any(axis=1)], old[may.any(axis=0)])
    if not len(every):
        return []
    c = compare(slam, ledger, every.tolist(), every.tolist())
    d2 = np.where(c.covisible, np.inf, c.d2)
    near = d2 < gate
    alone = near & (d2 < scale * gate) & (scale * math.pi * gate * np.sqrt(np.maximum(c.det, 0.0)) < area)
    # a third landmark nearby makes the pair ambiguous, unless all three may be one
    together = near | np.eye(len(every), dtype=np.bool_)
    apart = together.astype(np.int64) @ (~together).astype(np.int64)
    alone &= apart + apart.T == 0
    alone &= (every[:, None] > every[None]) & np.isin(every, young)[:, None] & np.isin(every, old)[None]
    return [(int(every[i]), int(every[j])) for i, j in np.argwhere(alone)[:1]]

"""Step 9: find landmarks of SLAM that were initialized twice, by constellation or singly.

Landmarks initialized since the robot returned are compared with the old map as a whole (`constellation`). Landmarks
seen in one frame cannot be the same.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from association.expectation import gate_threshold
from data.se2 import Array, BoolArray
from ekf.slam import EkfSlam
from eval.replay.hindsight import constants
from eval.replay.hindsight.constellation import Landmarks, recognize, squared_distances
from eval.replay.hindsight.gates import density
from eval.replay.hindsight.ledger import Ledger

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
        if not young:
            return []
        young.sort(key=lambda n: records[n].last)
        around, first = density(slam, ledger.range), ledger.epoch.first
        # a window that holds old landmarks has found its place; what this epoch initialized may not have
        pairs = [] if set(old) & set(window) else constellation(slam, ledger, young, old, around, scale)
        new, before = [n for n in young if n >= first], [n for n in known if n < first]
        pairs = pairs or constellation(slam, ledger, new, before, around, scale)
        if pairs:
            ledger.end_epoch()
            return pairs
        chance = constants.SINGLE_CHANCE, constants.SINGLE_CHANCE_YOUNG * constants.SINGLE_CHANCE
        return single(slam, ledger, window, old, chance[0] / around, scale) or single(
            slam, ledger, window, known, chance[1] / around, scale
        )


class Compared(NamedTuple):
    """New and old landmarks with their joint statistics; `covisible` (m, n): they cannot be the same, as they
    were seen together or look different.
    """

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
    never = np.array([np.isin(old, [*ledger.records[a].covisible, a]) for a in young])
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
    return (
        [n for n, any_ in zip(young, near.any(axis=1), strict=True) if any_],
        [n for n, any_ in zip(old, near.any(axis=0), strict=True) if any_],
    )


def constellation(
    slam: EkfSlam, ledger: Ledger, young: list[int], old: list[int], density: float, scale: float
) -> Pairs:
    """Young landmarks, in the order in which they were last seen, that equal old ones by their relative positions.

    density: landmarks per square metre; scale: learned variance scale.
    """
    if not young or not old:
        return []
    young, gate = young[-constants.WINDOW_MOST :], gate_threshold(constants.WINDOW_GATE)
    if len(comparable(slam, young, old, gate)[1]) < constants.CONSTELLATION_FEWEST:
        return []
    c = compare(slam, ledger, young, old)
    turn = constants.DISTANCE_SIGMAS * math.sqrt(slam.estimate().covariance[2, 2]) + constants.TURN_MARGIN
    allowed = (c.d2 < gate) & ~c.covisible
    return [(young[i], old[j]) for i, j in recognize(c.new, c.old, c.cross, allowed, density, turn, scale)]


def single(slam: EkfSlam, ledger: Ledger, window: list[int], others: list[int], area: float, scale: float) -> Pairs:
    """At most one pair of the window and others, at one place with no other landmark near.

    `area` [m^2]: upper limit of the gate of their difference; `scale`: learned variance scale.
    """
    gate = gate_threshold(constants.SAME_GATE)
    young, old = comparable(slam, sorted(window), sorted(others), gate)
    if not young or not old:
        return []
    c = compare(slam, ledger, young, old)
    may = (c.d2 < gate) & ~c.covisible
    every = np.union1d(np.array(young)[may.any(axis=1)], np.array(old)[may.any(axis=0)])
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

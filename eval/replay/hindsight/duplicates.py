"""Step 9, landmarks of SLAM that were initialized twice: found by their constellation, or alone where one stands.

What was initialized since the robot came back is compared with the old map as a whole (`constellation`). Landmarks that
were seen in one frame cannot be the same.
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

Pairs = list[tuple[int, int]]
"""Landmarks that are to go, each with the one that it is."""


class Duplicates:
    """Looks for them whenever something was initialized, and every few frames."""

    def __init__(self, ledger: Ledger) -> None:
        """Before the first frame."""
        self.ledger = ledger
        self._looked = (0, 0)
        """Landmarks initialized, and frames with observations, when the window was looked at last."""

    def find(self, slam: EkfSlam, scale: float) -> Pairs:
        """Landmarks of the window that were initialized before; `scale`: share of the stated variance that there is."""
        ledger, records = self.ledger, self.ledger.records
        created, frames = self._looked
        if ledger.created == created and ledger.frames - frames < constants.WINDOW_EVERY:
            return []
        self._looked = ledger.created, ledger.frames
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
    """New and old landmarks with what is between them; `covisible` (m, n): they cannot be the same."""

    new: Landmarks
    old: Landmarks
    cross: Array
    d2: Array
    det: Array
    covisible: BoolArray


def compare(slam: EkfSlam, ledger: Ledger, young: list[int], old: list[int]) -> Compared:
    """How m landmarks and n others stand to each other, by the filter's joint covariance."""
    mean, P = slam.position(np.array(young + old))
    m = 2 * len(young)
    new, there = Landmarks(mean[:m].reshape(-1, 2), P[:m, :m]), Landmarks(mean[m:].reshape(-1, 2), P[m:, m:])
    d2, det = squared_distances(new, there, P[:m, m:])
    never = np.array([np.isin(old, [*ledger.records[a].covisible, a]) for a in young])
    return Compared(new, there, P[:m, m:], d2, det, never)


def comparable(slam: EkfSlam, young: list[int], old: list[int], gate: float) -> tuple[list[int], list[int]]:
    """Those of two groups that have one in the other whose squared Mahalanobis distance may be below the gate.

    By bounds that need no joint covariance: the largest eigenvalue of that of a difference is at most twice the sum of
    both traces.
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
    """Young landmarks that are old ones by how they stand to each other, together.

    Args:
        slam: the filter.
        ledger: its landmarks.
        young: in the order in which they were last seen.
        old: with which they are compared.
        density: landmarks per square metre.
        scale: share of the stated variance that there is.
    """
    if not young or not old:
        return []
    young, gate = young[-constants.WINDOW_MOST :], gate_threshold(constants.WINDOW_GATE)
    if len(comparable(slam, young, old, gate)[1]) < constants.CONSTELLATION_FEWEST:
        return []
    c = compare(slam, ledger, young, old)
    turn = constants.TURN_SIGMAS * math.sqrt(slam.estimate().covariance[2, 2]) + constants.TURN_MARGIN
    allowed = (c.d2 < gate) & ~c.covisible
    return [(young[i], old[j]) for i, j in recognize(c.new, c.old, c.cross, allowed, density, turn, scale)]


def single(slam: EkfSlam, ledger: Ledger, window: list[int], others: list[int], area: float, scale: float) -> Pairs:
    """At most one pair, of the window and others, that stands where one landmark does, and no other near.

    `area` [m^2]: the gate of their difference is smaller; `scale`: share of the stated variance that there is.
    """
    gate = gate_threshold(constants.SINGLE_GATE)
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
    # a third one nearby leaves open which of both it is, unless all three may be one
    together = near | np.eye(len(every), dtype=np.bool_)
    apart = together.astype(np.int64) @ (~together).astype(np.int64)
    alone &= apart + apart.T == 0
    alone &= (every[:, None] > every[None]) & np.isin(every, young)[:, None] & np.isin(every, old)[None]
    return [(int(every[i]), int(every[j])) for i, j in np.argwhere(alone)[:1]]

"""Recognizing landmarks of a SLAM filter that were founded twice: by their constellation, or alone where one stands.

`beside` names the landmarks that were seen in one frame with each: they cannot be the same.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from association.evidence import constants
from association.expectation import gate_threshold
from association.geometry.constellation import Landmarks, recognize, squared_distances
from data.se2 import Array, BoolArray
from ekf.slam import EkfSlam

Beside = Mapping[int, set[int]]


class Compared(NamedTuple):
    """New and old landmarks with what is between them; `beside` (m, n): they cannot be the same."""

    new: Landmarks
    old: Landmarks
    cross: Array
    d2: Array
    det: Array
    beside: BoolArray


def compare(slam: EkfSlam, beside: Beside, young: list[int], old: list[int]) -> Compared:
    """How m landmarks and n others stand to each other, by the filter's joint covariance."""
    mean, P = slam.position(np.array(young + old))
    m = 2 * len(young)
    new, there = Landmarks(mean[:m].reshape(-1, 2), P[:m, :m]), Landmarks(mean[m:].reshape(-1, 2), P[m:, m:])
    d2, det = squared_distances(new, there, P[:m, m:])
    never = np.array([np.isin(old, [*beside[a], a]) for a in young])
    return Compared(new, there, P[:m, m:], d2, det, never)


def constellation(
    slam: EkfSlam, beside: Beside, young: list[int], old: list[int], crowd: float, scale: float
) -> list[tuple[int, int]]:
    """Young landmarks that are old ones by how they stand to each other: (away, kept), together.

    Args:
        slam: the filter.
        beside: see above.
        young: in the order in which they were last seen.
        old: with which they are compared.
        crowd: landmarks per square metre.
        scale: share of the stated variance that there is.
    """
    if not young or not old:
        return []
    young = young[-constants.WINDOW_MOST :]
    c = compare(slam, beside, young, old)
    turn = constants.TURN_SIGMAS * math.sqrt(slam.estimate().covariance[2, 2]) + constants.TURN_MARGIN
    allowed = (c.d2 < gate_threshold(constants.WINDOW_GATE)) & ~c.beside
    return [(young[i], old[j]) for i, j in recognize(c.new, c.old, c.cross, allowed, crowd, turn, scale)]


def single(
    slam: EkfSlam, beside: Beside, window: list[int], others: list[int], area: float, scale: float
) -> list[tuple[int, int]]:
    """At most one pair (away, kept), of the window and others, that stands where one landmark does, and no other near.

    `area` [m^2]: the gate of their difference is smaller; `scale`: share of the stated variance that there is.
    """
    young, old, gate = sorted(window), sorted(others), gate_threshold(constants.SINGLE_GATE)
    if not young or not old:
        return []
    c = compare(slam, beside, young, old)
    may = (c.d2 < gate) & ~c.beside
    every = np.union1d(np.array(young)[may.any(axis=1)], np.array(old)[may.any(axis=0)])
    if not len(every):
        return []
    c = compare(slam, beside, every.tolist(), every.tolist())
    d2 = np.where(c.beside, np.inf, c.d2)
    near = d2 < gate
    alone = near & (d2 < scale * gate) & (scale * math.pi * gate * np.sqrt(np.maximum(c.det, 0.0)) < area)
    # a third one nearby leaves open which of both it is, unless all three may be one
    together = near | np.eye(len(every), dtype=np.bool_)
    apart = together.astype(np.int64) @ (~together).astype(np.int64)
    alone &= apart + apart.T == 0
    alone &= (every[:, None] > every[None]) & np.isin(every, young)[:, None] & np.isin(every, old)[None]
    return [(int(every[i]), int(every[j])) for i, j in np.argwhere(alone)[:1]]

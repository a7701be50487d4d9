"""The corridor lab's world: 88 points along a square of four corridors, the true path, and where people walk."""

from __future__ import annotations

import math

import numpy as np

from data.inputs import IntArray, LandmarkMap
from data.se2 import Array, wrap_angle

SIDE = 10
"""m, and moves of 1 m, from corner to corner."""
ROWS = ((-0.60, range(0, 11, 2)), (-0.35, range(0, 11, 2)), (0.35, range(1, 10, 2)), (0.60, range(1, 10, 2)))
"""A corridor's rows of points in its own frame: y [m], and x [m] of each point."""
QUARTERS = ((1, 0), (0, 1), (-1, 0), (0, -1))
"""cos and sin of 0, 90, 180 and 270 degrees, exact."""


def points() -> LandmarkMap:
    """The 88 points: by side, row, and place in the row."""
    side = np.array([(x, y) for y, places in ROWS for x in places], float)
    sides, corner = [], np.zeros(2)
    for c, s in QUARTERS:
        sides.append(corner + side @ np.array([[c, s], [-s, c]]))
        corner = corner + SIDE * np.array([c, s])
    return LandmarkMap(np.arange(1, 4 * len(side) + 1), np.concatenate(sides))


def path(frames: int) -> tuple[Array, IntArray]:
    """True poses (N, 3), and (N,) 1 where the motion into a frame is a turn of 90 degrees, else 0 (a move of 1 m)."""
    turned = (np.arange(frames) % (SIDE + 1) == 0).astype(np.int64)
    turned[0] = 0
    quarter = np.cumsum(turned)
    # the motion into a frame is along the heading of the frame before, which a move leaves as it is
    step = (1 - turned)[:, None] * np.array(QUARTERS)[quarter % 4]
    step[0] = 0
    return np.column_stack([np.cumsum(step, axis=0), wrap_angle(0.5 * math.pi * (quarter % 4))]), turned


def walks(frames: int, crowd: int, sv: float, sa: float, rng: np.random.Generator) -> Array:
    """Where each person is in each frame (N, K, 2); they have made one step by frame 0, and walk through walls.

    sv, sa: m per frame, standard deviations of a coordinate's first velocity and of its change.
    """
    start = rng.uniform(0.0, SIDE, (crowd, 2))
    velocity = sv * rng.standard_normal((crowd, 2))
    change = sa * rng.standard_normal((frames - 1, crowd, 2))
    places: Array = start + np.cumsum(np.cumsum(np.concatenate([velocity[None], change]), axis=0), axis=0)
    return places

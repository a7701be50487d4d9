"""Distances of landmarks that are seen by their bearings alone: triangulated from rays with enough parallax.

A landmark of one bearing could be anywhere along its ray. Rays from different places that cross at an angle place it;
they are laid along the odometry, which is good over the short way between them. Distances are where linearization
begins, not measurements: a smoother then reaches the optimum of the bearings, while a filter, which cannot linearize
again, may still get lost on its first uncertain landmarks.
"""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np

from data.inputs import IntArray
from data.se2 import Array, BoolArray, wrap_angle

PARALLAX = np.radians(8.0)
"""Least angle between the first and the last ray of a window that places a landmark; the distance of a landmark is then
known to a few percent with bearings of half a degree."""


class Triangulated(NamedTuple):
    """Distance (K,) [m] of each bearing's landmark, NaN where there is none, and parallax [rad] of each landmark."""

    distance: Array
    parallax: dict[int, float]


def triangulate(path: Array, frame: IntArray, landmark: IntArray, bearing: Array) -> Triangulated:
    """Distances from bearings (K,) [rad] in the robot's frame of landmarks (K,), at poses (N, 3) of the odometry.

    The bearings of each landmark are cut into windows of enough parallax, each with its own point; what is left at the
    end joins the last one. A point behind the robot places nothing.
    """
    distance, parallax = np.full(len(frame), np.nan), dict[int, float]()
    direction = path[frame, 2] + bearing
    for one in np.unique(landmark).tolist():
        rows = np.flatnonzero(landmark == one)
        rows = rows[np.argsort(frame[rows], kind="stable")]
        turned = np.asarray(wrap_angle(direction[rows] - direction[rows[0]]))
        parallax[one] = float(np.ptp(np.unwrap(turned)))
        for window in _windows(np.unwrap(direction[rows])):
            own = rows[window]
            point = _crossing(path[frame[own], :2], direction[own])
            off = point - path[frame[own], :2]
            ahead = np.einsum("ki,ki->k", off, np.stack([np.cos(direction[own]), np.sin(direction[own])], axis=1))
            if (ahead > 0.0).all():
                distance[own] = np.hypot(*off.T)
    return Triangulated(distance, parallax)


def _windows(direction: Array) -> list[BoolArray]:
    """Windows of consecutive rays (k,) that turn by `PARALLAX` each; none if all of them together do not."""
    ends, first = [0], 0
    for i in range(len(direction)):
        if np.ptp(direction[first : i + 1]) >= PARALLAX:
            ends.append(i + 1)
            first = i + 1
    if len(ends) < 2:
        return []
    ends[-1] = len(direction)
    places = np.arange(len(direction))
    return [(places >= a) & (places < b) for a, b in pairwise(ends)]


def _crossing(origin: Array, direction: Array) -> Array:
    """The point (2,) nearest to rays (k,), by the squares of its distances from them."""
    normal = np.stack([-np.sin(direction), np.cos(direction)], axis=1)
    point: Array = np.linalg.lstsq(normal, np.einsum("ki,ki->k", normal, origin), rcond=None)[0]
    return point

"""Readings of point landmarks as gtsam takes them: bearing and range, or the point itself, in the body frame."""

from __future__ import annotations

import numpy as np

from data.se2 import Array, BoolArray
from data.sensors import RANGE_BEARING, Sensor

NEAR = 3.0
"""Sigmas of a range. A reading that is shorter than so many is taken as a point, see `is_point`. In parks whose trees
stand on the way, searches got stuck at the kink with 1 and none with 2; 3 spares a third of steps."""
UNMEASURED = 10.0
"""Ranges long, and m. A sigma of the range from there on says that it was not measured: a bearing is no near point."""


def bearing_range(sensor: Sensor, z: Array, R: Array) -> tuple[Array, Array]:
    """[bearing, range] (m, 2) in the body frame, gtsam's order, with covariances (m, 2, 2).

    A rotated sensor only shifts the bearing; one mounted off the robot's centre is converted through the point, to
    first order in the noise.
    """
    if sensor.translation == (0.0, 0.0):
        return np.stack([z[:, 1] - sensor.rotation, z[:, 0]], 1), R[:, ::-1, ::-1]
    p, _, G = sensor.inverse(np.zeros(3), z)
    r = np.hypot(p[:, 0], p[:, 1])
    A = np.stack([np.stack([-p[:, 1], p[:, 0]], 1) / r[:, None] ** 2, p / r[:, None]], 1) @ G
    return np.stack([np.arctan2(p[:, 1], p[:, 0]), r], 1), A @ R @ A.transpose(0, 2, 1)


def relative_point(sensor: Sensor, z: Array, R: Array) -> tuple[Array, Array]:
    """Point (m, 2) in the body frame with covariances (m, 2, 2): exact for a sensor of points.

    Of ranges and bearings to first order in their noise, and the bearing's at the true range, whose square is on the
    average larger than the reading's by the range's variance.
    """
    points, C = sensor.body_points(z, R)
    if sensor.kind == RANGE_BEARING:
        b = z[:, 1] + sensor.rotation
        across = np.stack([-np.sin(b), np.cos(b)], 1)
        C = C + (R[:, 0, 0] * R[:, 1, 1])[:, None, None] * across[:, :, None] * across[:, None, :]
    return points, C


def is_point(sensor: Sensor, z: Array, R: Array) -> BoolArray:
    """Which observations z (m, 2), R (m, 2, 2) become relative points: all of a sensor of points, and the nearest.

    Where the landmark may as well stand on the robot, its bearing has no derivative there, and a smoother could get
    stuck at that kink or leave it for the other end of the world.
    """
    sigma = np.sqrt(R[:, 0, 0])
    near: BoolArray = (z[:, 0] < NEAR * sigma) & (sigma < UNMEASURED * np.maximum(z[:, 0], 1.0))
    return near if sensor.kind == RANGE_BEARING else np.ones(len(z), np.bool_)

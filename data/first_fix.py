"""Where a robot is, from its first sightings of known landmarks: a prior for a log without ground truth.

Readings of a few seconds are carried to one body frame with the odometry and laid onto the map by a rigid fit (closed
form, least squares). The readings used are spent: the log starts after them, so they are not counted twice.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from data import se2
from data.inputs import IntArray, Prior
from data.se2 import Array

SPAN = 5.0
"""s of readings that one fix may use; odometry drifts."""
READINGS = 6
"""A fix needs that many, of two different landmarks at least."""
MISFIT = 0.5
"""m rms beyond which the readings contradict the map (or one another) and the next instant is tried."""


class Fix(NamedTuple):
    """The frame of the fix, the pose there as a prior, how many readings it took, and their rms distance [m]."""

    frame: int
    prior: Prior
    readings: int
    rms: float


def rigid_fit(body: Array, world: Array) -> Array:
    """Pose (3,) of the frame in which points `body` (M, 2) were measured, given them in the world (M, 2).

    Least squares over both coordinates (Umeyama 1991, without scale).
    """
    body_mean, world_mean = body.mean(axis=0), world.mean(axis=0)
    b, w = body - body_mean, world - world_mean
    theta = math.atan2(float(np.sum(b[:, 0] * w[:, 1] - b[:, 1] * w[:, 0])), float(np.sum(b * w)))
    xy = world_mean - se2.rotation(theta) @ body_mean
    return np.array([xy[0], xy[1], theta])


def first_fix(
    time: Array, increments: Array, frame: IntArray, points: Array, landmark: Array, sigma: tuple[float, float, float]
) -> Fix | None:
    """The first frame at which the recent readings fix the pose; None if there is none.

    Args:
        time: (N,) s of the frames.
        increments: (N, 3) motion into each.
        frame: (M,) ascending, frame of each reading.
        points: (M, 2) m, the readings in the body frame.
        landmark: (M, 2) m, where the map has the landmark of each.
        sigma: added to the fit's own standard deviations of x, y [m] and theta [rad], for what the fit does not know.
    """
    path = np.zeros((len(time), 3))
    for k in range(1, len(path)):
        path[k] = se2.compose(path[k - 1], increments[k])
    for end in np.flatnonzero(np.diff(frame, append=-1)) + 1:
        now = frame[end - 1]
        begin = int(np.searchsorted(time[frame[:end]], time[now] - SPAN))
        used = slice(begin, end)
        if end - begin < READINGS or len(np.unique(landmark[used], axis=0)) < 2:
            continue
        body = se2.transform_points(se2.between(path[now], path[frame[used]]), points[used])
        pose = rigid_fit(body, landmark[used])
        rms = float(np.sqrt(np.mean(np.sum((se2.transform_points(pose, body) - landmark[used]) ** 2, axis=1))))
        if rms > MISFIT:
            continue
        return Fix(
            int(now), Prior(pose, _covariance(pose, body, rms) + np.diag(np.square(sigma))), int(end - begin), rms
        )
    return None


def _covariance(pose: Array, body: Array, rms: float) -> Array:
    """World-frame covariance (3, 3) of a fit whose points miss by `rms` [m].

    Errors of one landmark's readings are alike, so the points do not count as independent: information is their mean.
    """
    offset = se2.transform_points(np.array([0.0, 0.0, pose[2]]), body)
    J = np.zeros((len(body), 2, 3))
    J[:, 0, 0] = J[:, 1, 1] = 1.0
    J[:, 0, 2], J[:, 1, 2] = -offset[:, 1], offset[:, 0]
    information = np.einsum("mij,mik->jk", J, J) / len(body)
    covariance: Array = rms**2 * np.linalg.inv(information)
    return covariance

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

SPAN = 10.0
"""s of readings that one fix may use; odometry drifts."""
READINGS = 6
"""A fix needs that many, of two different landmarks at least."""
SURE = (0.25, 0.15)
"""m, rad: standard deviations the fit must reach; else it waits for landmarks better placed, or readings that agree."""
USUAL = 0.1
"""m; readings that fit one another better than this do so by luck."""


class Fix(NamedTuple):
    """The frame of the fix, the pose there as a prior, how many readings it took, and their rms distance [m]."""

    frame: int
    prior: Prior
    readings: int
    rms: float


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
    path = se2.dead_reckoned(np.zeros(3), increments)
    path[:, 2] = se2.wrap_angle(path[:, 2])
    for end in np.flatnonzero(np.diff(frame, append=-1)) + 1:
        now = frame[end - 1]
        begin = int(np.searchsorted(time[frame[:end]], time[now] - SPAN))
        used = slice(begin, end)
        different = len(np.unique(landmark[used], axis=0))
        if end - begin < READINGS or different < 2:
            continue
        body = se2.transform_points(se2.between(path[now], path[frame[used]]), points[used])
        pose = se2.rigid_fit(body, landmark[used])
        rms = float(np.sqrt(np.mean(np.sum((se2.transform_points(pose, body) - landmark[used]) ** 2, axis=1))))
        P = _covariance(pose, body, max(rms, USUAL) / math.sqrt(different))
        if P is None or max(P[0, 0], P[1, 1]) > SURE[0] ** 2 or P[2, 2] > SURE[1] ** 2:
            continue
        return Fix(int(now), Prior(pose, P + np.diag(np.square(sigma))), int(end - begin), rms)
    return None


def _covariance(pose: Array, body: Array, sigma: float) -> Array | None:
    """World-frame covariance (3, 3) of a fit whose points' mean errs by `sigma` [m]; None if they are all in one place.

    Errors of one landmark's readings are alike, so the points count as their mean point and spread, not one by one.
    """
    offset = se2.transform_points(np.array([0.0, 0.0, pose[2]]), body)
    x, y = offset.mean(axis=0)
    if float(np.mean(np.sum((offset - [x, y]) ** 2, axis=1))) < 1e-4:
        return None
    information = np.array([[1.0, 0.0, -y], [0.0, 1.0, x], [-y, x, float(np.mean(np.sum(offset**2, axis=1)))]])
    covariance: Array = sigma**2 * np.linalg.inv(information)
    return covariance

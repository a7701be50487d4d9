"""A pose carried along by increments, with its covariance and what was gathered since another one."""

from __future__ import annotations

import math

import numba
import numpy as np

from data.se2 import Array
from data.sensors import wrap_angle


@numba.njit(cache=True)
def advance(mean, P, Q, motion, M):  # type: ignore[no-untyped-def]
    """Pose (3,), its covariance P and the covariance Q gathered since the anchor, one increment later."""
    c, s = math.cos(mean[2]), math.sin(mean[2])
    wx, wy = c * motion[0] - s * motion[1], s * motion[0] + c * motion[1]
    moved = np.array([mean[0] + wx, mean[1] + wy, wrap_angle(mean[2] + motion[2])])
    B = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    F = np.array([[1.0, 0.0, -wy], [0.0, 1.0, wx], [0.0, 0.0, 1.0]])
    G = B @ M @ B.T
    return moved, F @ P @ F.T + G, F @ Q @ F.T + G


def transport(displacement: Array) -> Array:
    """Jacobian of a pose to an earlier one, world frame, for the displacement (3,) between them."""
    F = np.eye(3)
    F[0, 2], F[1, 2] = -displacement[1], displacement[0]
    return F

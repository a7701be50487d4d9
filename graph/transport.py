"""A pose carried along by increments, with its covariance and what was gathered since another one."""

from __future__ import annotations

import numba
import numpy as np

from data.motion.velocity import carried
from data.se2 import Array
from data.sensors import wrap_angle


@numba.njit(cache=True)
def advance(mean, P, Q, motion, M):  # type: ignore[no-untyped-def]
    """Pose (3,), its covariance P and the covariance Q gathered since the anchor, one increment later."""
    wx, wy, F, B = carried(mean[2], motion)
    moved = np.array([mean[0] + wx, mean[1] + wy, wrap_angle(mean[2] + motion[2])])
    G = B @ M @ B.T
    return moved, F @ P @ F.T + G, F @ Q @ F.T + G


def transport(displacement: Array) -> Array:
    """Jacobian of a pose to an earlier one, world frame, for the displacement (3,) between them."""
    F = np.eye(3)
    F[0, 2], F[1, 2] = -displacement[1], displacement[0]
    return F

"""Frames between two scans: odometry from the one, made to arrive where scan matching put the other."""

from __future__ import annotations

import math

import numba
import numpy as np

from association.scans.uncertainty import compose_in_place
from data.se2 import Array


def arrival(start: Array, end: Array, end_covariance: Array, motion: Array, covariance: Array) -> tuple[Array, Array]:
    """Poses (m - 1, 3) and covariances (m - 1, 3, 3) of the frames between two scans, from the one to the other.

    `motion` (m, 3) and `covariance` (m, 3, 3) are odometry's increments, the last one into the frame of the second
    scan; `start` (3,) and `end` (3,) are where the scans were taken. Conditional means given both ends (the fixed-interval
    smoother of Rauch, Tung and Striebel 1965, to first order); what the ends are unsure of is added as the later one's.
    """
    return _arrival(start, end, end_covariance, motion, covariance)  # type: ignore[no-any-return]


@numba.njit(cache=True)
def _arrival(start, end, end_covariance, motion, covariance):  # type: ignore[no-untyped-def]
    m = len(motion)
    pose, P = np.empty((m, 3)), np.empty((m, 3, 3))
    before, none = start.copy(), np.zeros((3, 3))
    for k in range(m):
        compose_in_place(before, none if k == 0 else P[k - 1], motion[k], covariance[k], pose[k], P[k])
        before = pose[k]
    miss = end - pose[m - 1]
    miss[2] -= 2.0 * math.pi * math.ceil((miss[2] - math.pi) / (2.0 * math.pi))
    whole = np.linalg.inv(P[m - 1])
    J = np.eye(3)
    for k in range(m - 1):
        J[0, 2], J[1, 2] = pose[k, 1] - pose[m - 1, 1], pose[m - 1, 0] - pose[k, 0]
        gain = P[k] @ J.T @ whole
        pose[k] += gain @ miss
        P[k] += end_covariance - gain @ J @ P[k]
        P[k] = 0.5 * (P[k] + P[k].T)
    return pose[: m - 1], P[: m - 1]

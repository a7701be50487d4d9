"""A pose and the systematic errors carried along together: the same arithmetic as a filter's joint prediction."""

from __future__ import annotations

import numba
import numpy as np

from data.motion.systematic import correct
from data.motion.velocity import carried
from data.sensors import wrap_angle


@numba.njit(cache=True)
def forget(b, P, F, Q, drift, stays, fresh):  # type: ignore[no-untyped-def]
    """At a new knot, in place: of the drift, at `drift` among errors b (p,), a share stays, and variance comes."""
    i = 3 + drift
    b[drift] *= stays
    for M in (P, Q):
        M[i] *= stays
        M[:, i] *= stays
        M[i, i] += fresh
    F[i] *= stays


@numba.njit(cache=True)
def advance(mean, b, P, F, Q, motion, M, place, mount):  # type: ignore[no-untyped-def]
    """Pose (3,), covariance P of pose and errors b (p,), both (3 + p), Jacobian F and gathered covariance Q since an
    anchor, one raw increment later. Errors stand at `place` among all; `mount` as of `correct`.
    """
    p = len(b)
    errors, moved, A, G = np.zeros(7), np.zeros(3), np.zeros((3, 7)), np.zeros((3, 3))
    for j in range(p):
        errors[place[j]] = b[j]
    correct(motion, errors, mount, moved, A, G)
    wx, wy, Fx, B = carried(mean[2], moved)
    J = np.eye(3 + p)
    J[:3, :3] = Fx
    for j in range(p):
        J[:3, 3 + j] = B @ np.ascontiguousarray(A[:, place[j]])
    W = B @ G
    noise = W @ M @ W.T
    P, F, Q = J @ P @ J.T, J @ F, J @ Q @ J.T
    P[:3, :3] += noise
    Q[:3, :3] += noise
    return np.array([mean[0] + wx, mean[1] + wy, wrap_angle(mean[2] + moved[2])]), P, F, Q

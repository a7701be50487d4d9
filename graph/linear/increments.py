"""Increments under systematic errors, linearized: whitened residuals of what odometry stated, with exact Jacobians.

The residual is Log(m^-1 g(X^-1 Y, b)) for poses X, Y: of what the odometry stated, m, against what it would have stated
of that way without noise, g (`data.motion.stated`). Without errors it is that of gtsam's between factor. The errors
act on the way as smoothed: acting on the one stated they would share its noise, and a scale would come out too small by
the noise's share of the squared motion, however long the log (Fuller, "Measurement Error Models", 1987, section 1.1).
Nor does the whitening depend on the errors: a large range error would make any residual cheap.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from data.motion.stated import stated
from data.sensors import wrap_angle

SMALL = 1e-3
"""rad. Of turns below, the functions of the logarithm are taken by their series, good to 1e-15 there."""


@numba.njit(cache=True)
def _logarithm(theta):  # type: ignore[no-untyped-def]
    """(theta/2) cot(theta/2), and (1 - that) / theta^2."""
    if abs(theta) < SMALL:
        square = theta * theta
        return 1.0 - square / 12.0 - square * square / 720.0, 1.0 / 12.0 + square / 720.0
    a = 0.5 * theta / math.tan(0.5 * theta)
    return a, (1.0 - a) / (theta * theta)


@numba.njit(cache=True)
def _product(left, right, out):  # type: ignore[no-untyped-def]
    """Left @ right, (3, 3) each, into `out`."""
    for i in range(3):
        for j in range(3):
            out[i, j] = left[i, 0] * right[0, j] + left[i, 1] * right[1, j] + left[i, 2] * right[2, j]


@numba.njit(cache=True)
def _adjoint(x, y, theta, out):  # type: ignore[no-untyped-def]
    """Of the inverse of the pose (x, y, theta), into `out` (3, 3): moves before it, as moves after it."""
    c, s = math.cos(theta), math.sin(theta)
    out[0, 0], out[0, 1], out[0, 2] = c, s, s * x - c * y
    out[1, 0], out[1, 1], out[1, 2] = -s, c, c * x + s * y
    out[2, 0], out[2, 1], out[2, 2] = 0.0, 0.0, 1.0


@numba.njit(cache=True)
def linearize_increments(  # type: ignore[no-untyped-def]
    pose, motion, root, errors, place, mount, residual, before, after, by_errors
):
    """Fill in whitened residuals (n, 3) and Jacobians: to the pose before and after (n, 3, 3), body frame of each, and
    to the errors (n, 3, p); of `motion` (n, 3) from pose k to k + 1 of `pose` (n + 1, 3), each under `errors` (n, p).

    `root` (n, 3, 3): R with R'R the information of the odometry's own noise; `place` (p,) and `mount` (3,) as of
    `data.motion.systematic`.
    """
    n, p = errors.shape
    all_errors, way, m, A = np.zeros(7), np.zeros(3), np.zeros(3), np.zeros((3, 7))
    H, B, J, Ad = np.zeros((3, 3)), np.zeros((3, 3)), np.zeros((3, 3)), np.zeros((3, 3))
    W, K = np.zeros((3, 3)), np.zeros((3, 3))
    B[2, 2] = J[2, 2] = 1.0
    for k in range(n):
        for j in range(p):
            all_errors[place[j]] = errors[k, j]
        c, s = math.cos(pose[k, 2]), math.sin(pose[k, 2])
        wx, wy = pose[k + 1, 0] - pose[k, 0], pose[k + 1, 1] - pose[k, 1]
        way[0], way[1], way[2] = c * wx + s * wy, c * wy - s * wx, pose[k + 1, 2] - pose[k, 2]
        stated(way, all_errors, mount, motion[k, 2] > 0.0, m, H, A)
        # what that is more than was stated, (tx, ty, theta), its logarithm (x, y, theta), and that one's Jacobian
        theta: float = wrap_angle(m[2] - motion[k, 2])
        c, s = math.cos(motion[k, 2]), math.sin(motion[k, 2])
        wx, wy = m[0] - motion[k, 0], m[1] - motion[k, 1]
        tx, ty = c * wx + s * wy, c * wy - s * wx
        a, kappa = _logarithm(theta)
        x, y = a * tx + 0.5 * theta * ty, a * ty - 0.5 * theta * tx
        J[0, 0], J[0, 1], J[0, 2] = 1.0 - kappa * theta * theta, -0.5 * theta, 0.5 * y + kappa * theta * x
        J[1, 0], J[1, 1], J[1, 2] = 0.5 * theta, 1.0 - kappa * theta * theta, -0.5 * x + kappa * theta * y
        # whitened in the body frame before: by the logarithm, by m, by the way, by the poses
        B[0, 0], B[0, 1], B[1, 0], B[1, 1] = c, -s, s, c
        _product(root[k], B, W)
        for i in range(3):
            residual[k, i] = W[i, 0] * x + W[i, 1] * y + W[i, 2] * theta
        _product(W, J, K)
        c, s = math.cos(m[2]), math.sin(m[2])
        B[0, 0], B[0, 1], B[1, 0], B[1, 1] = c, s, -s, c
        _product(K, B, W)
        for i in range(3):
            for j in range(p):
                e = place[j]
                by_errors[k, i, j] = W[i, 0] * A[0, e] + W[i, 1] * A[1, e] + W[i, 2] * A[2, e]
        _product(W, H, K)
        c, s = math.cos(way[2]), math.sin(way[2])
        B[0, 0], B[0, 1], B[1, 0], B[1, 1] = c, -s, s, c
        _product(K, B, after[k])
        # what moves the pose before moves the way the other way, as seen from the pose after
        _adjoint(way[0], way[1], way[2], Ad)
        _product(after[k], Ad, K)
        for i in range(3):
            for j in range(3):
                before[k, i, j] = -K[i, j]

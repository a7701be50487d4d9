"""Increments under systematic errors, linearized: whitened residuals of gtsam's between factors, with exact Jacobians.

The residual is Log(m(b)^-1 X^-1 Y) for poses X, Y and the corrected increment m(b), whitened with the covariance of
m(b) at the end pose. Its noise is turned and scaled by the sensor's errors; what that does to the residual is part of
the Jacobian, or the range error would come out wrong by as much as all squared residuals together ask for.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from data.motion.systematic import BEARING, RANGE, correct

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
def linearize_increments(  # type: ignore[no-untyped-def]
    pose, motion, root, errors, place, mount, residual, before, after, by_errors
):
    """Fill in whitened residuals (n, 3) and Jacobians: to the pose before and after (n, 3, 3), body frame of each, and
    to the errors (n, 3, p); of `motion` (n, 3) from pose k to k + 1 of `pose` (n + 1, 3), each under `errors` (n, p).

    `root` (n, 3, 3): R with R'R the information of the odometry's own noise; `place` (p,) and `mount` (3,) as of
    `data.motion.systematic`.
    """
    n, p = errors.shape
    all_errors, m, A, G = np.zeros(7), np.zeros(3), np.zeros((3, 7)), np.zeros((3, 3))
    B, back, J, Ad = np.eye(3), np.eye(3), np.empty((3, 3)), np.eye(3)
    for k in range(n):
        for j in range(p):
            all_errors[place[j]] = errors[k, j]
        correct(motion[k], all_errors, mount, m, A, G)
        # the way by the poses, and what it is more than the increment
        c, s = math.cos(pose[k, 2]), math.sin(pose[k, 2])
        wx, wy = pose[k + 1, 0] - pose[k, 0], pose[k + 1, 1] - pose[k, 1]
        hx, hy, ht = c * wx + s * wy, c * wy - s * wx, pose[k + 1, 2] - pose[k, 2]
        theta = ht - m[2]
        theta -= 2.0 * math.pi * math.floor((theta + math.pi) / (2.0 * math.pi))
        c, s = math.cos(m[2]), math.sin(m[2])
        tx, ty = c * (hx - m[0]) + s * (hy - m[1]), c * (hy - m[1]) - s * (hx - m[0])
        a, kappa = _logarithm(theta)
        x, y = a * tx + 0.5 * theta * ty, a * ty - 0.5 * theta * tx
        # additive in the body frame before, in the odometry's own axes
        B[0, 0], B[0, 1], B[1, 0], B[1, 1] = c, -s, s, c
        own = np.linalg.inv(G)
        to_own = own @ B
        turned = np.array([-s * x - c * y, c * x - s * y, 0.0])  # derivative of B (x, y, theta) by the angle
        plain = np.array([c * x - s * y, s * x + c * y, theta])
        u = own @ plain
        W = root[k] @ to_own
        # right Jacobian of the logarithm: 1 + ad / 2 + kappa ad^2
        J[0, 0], J[0, 1], J[0, 2] = 1.0 - kappa * theta * theta, -0.5 * theta, 0.5 * y + kappa * theta * x
        J[1, 0], J[1, 1], J[1, 2] = 0.5 * theta, 1.0 - kappa * theta * theta, -0.5 * x + kappa * theta * y
        J[2, 0], J[2, 1], J[2, 2] = 0.0, 0.0, 1.0
        WJ = W @ J
        residual[k] = root[k] @ u
        after[k] = WJ
        # what moves the pose before moves the way the other way, as seen from the pose after
        c, s = math.cos(ht), math.sin(ht)
        Ad[0, 0], Ad[0, 1], Ad[1, 0], Ad[1, 1] = c, s, -s, c
        Ad[0, 2], Ad[1, 2] = s * hx - c * hy, c * hx + s * hy
        before[k] = -WJ @ Ad
        # the same of the increment, seen from the end of the residual
        c, s = math.cos(theta), math.sin(theta)
        Ad[0, 0], Ad[0, 1], Ad[1, 0], Ad[1, 1] = c, s, -s, c
        Ad[0, 2], Ad[1, 2] = s * tx - c * ty, c * tx + s * ty
        back[:2, :2] = B[:2, :2].T
        of_mean = -WJ @ Ad @ back
        # G turns with the mount: its last column by the turn
        of_turn = np.array([G[1, 2], -G[0, 2], 0.0])
        size = 1.0 + all_errors[RANGE]
        for j in range(p):
            e = place[j]
            change = own @ (turned * A[2, e]) + own @ (of_turn * (u[2] * A[2, e]))
            if e == RANGE:
                change -= own @ np.array([plain[0], plain[1], 0.0]) / size
            elif e == BEARING:
                change -= own @ np.array([-plain[1], plain[0], 0.0])
            by_errors[k, :, j] = of_mean @ np.ascontiguousarray(A[:, e]) + root[k] @ change

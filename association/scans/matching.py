"""Point-to-line scan matching with robust residuals and a robust motion prior (Censi 2008; Cauchy weights by IRLS)."""

from __future__ import annotations

import math
from typing import NamedTuple

import numba
import numpy as np

from association.scans.nearest import Reference
from association.scans.points import Points
from data.se2 import Array, wrap_angle

SAME_SIDE = 0.5
"""Smallest cosine between two normals that may belong to one surface (60 degrees): never the other side of a wall."""
WIDE, NARROW = 0.3, 0.03
"""m, the Cauchy scale of the first and of the later iterations: first find the place, then count good pairs only."""
ITERATIONS = 30
SMALL_STEP = 1e-5
"""m and rad: a step below it ends the iterations; a hundredth of the spread that a match has."""


class MotionPrior(NamedTuple):
    """What is known of the pose before matching: mean (3,), information (3, 3), in the reference's frame."""

    mean: Array
    information: Array


class Match(NamedTuple):
    """Where a scan lies in the frame of the reference.

    Attributes:
        pose: (3,) of the body.
        covariance: (3, 3) of its additive error, unscaled: from the Hessian, points independent with `sigma`.
        cost: robust cost of the points alone per point: smaller is better, at most 1.
        share: of the scan's points, how many have a partner nearer than twice `NARROW` across its surface.
    """

    pose: Array
    covariance: Array
    cost: float
    share: float


def match(
    points: Points, reference: Reference, start: Array, prior: MotionPrior, sigma: float, prior_scale: float
) -> Match:
    """Match a scan's points to a reference from a start pose (3,).

    Minimizes the sum of Cauchy losses of the distances from each point to the line through its nearest reference
    point, and of the prior's Mahalanobis distance (scale `prior_scale` standard deviations); `sigma` [m] is a
    distance's standard deviation.
    """
    pose, hessian, cost, share = _match(
        points.xy, points.normal, reference.xy, reference.normal, reference.nearest, reference.half, reference.cell,
        start, prior.mean, prior.information, sigma, prior_scale,
    )  # fmt: skip
    pose[2] = wrap_angle(float(pose[2]))
    return Match(pose, np.linalg.inv(hessian), cost, share)


@numba.njit(cache=True)
def _match(xy, normal, r_xy, r_normal, index, half, cell, start, mean, information, sigma, prior_scale):  # type: ignore[no-untyped-def]
    x, y, theta = start[0], start[1], start[2]
    side = len(index)
    H = np.zeros((3, 3))
    b = np.zeros(3)
    d = np.zeros(3)
    J = np.zeros(3)
    cost, inliers = 0.0, 0
    scale = WIDE
    for iteration in range(ITERATIONS + 1):
        c, s = math.cos(theta), math.sin(theta)
        H[:] = 0.0
        b[:] = 0.0
        cost, inliers = 0.0, 0
        for k in range(len(xy)):
            rx, ry = c * xy[k, 0] - s * xy[k, 1], s * xy[k, 0] + c * xy[k, 1]
            qx, qy = rx + x, ry + y
            i, j = math.floor((qx + half) / cell), math.floor((qy + half) / cell)
            if i < 0 or j < 0 or i >= side or j >= side or index[i, j] < 0:
                cost += 1.0
                continue
            m = index[i, j]
            nx, ny = r_normal[m, 0], r_normal[m, 1]
            mx, my = c * normal[k, 0] - s * normal[k, 1], s * normal[k, 0] + c * normal[k, 1]
            same = mx * nx + my * ny
            if same < SAME_SIDE:
                cost += 1.0
                continue
            norm = math.sqrt(2.0 + 2.0 * same)
            nx, ny = (nx + mx) / norm, (ny + my) / norm
            e = nx * (qx - r_xy[m, 0]) + ny * (qy - r_xy[m, 1])
            u = e / scale
            w = 1.0 / (1.0 + u * u)
            f = e / NARROW
            cost += f * f / (1.0 + f * f)
            if abs(e) < 2.0 * NARROW:
                inliers += 1
            J[0], J[1], J[2] = nx, ny, -nx * ry + ny * rx
            w /= sigma * sigma
            for p in range(3):
                b[p] -= w * e * J[p]
                for q in range(3):
                    H[p, q] += w * J[p] * J[q]
        d[0], d[1] = x - mean[0], y - mean[1]
        d[2] = theta - mean[2]
        d[2] -= 2.0 * math.pi * math.ceil((d[2] - math.pi) / (2.0 * math.pi))
        Ld = information @ d
        w = 1.0 / (1.0 + (d @ Ld) / (prior_scale * prior_scale))
        H += w * information
        b -= w * Ld
        if iteration == ITERATIONS:
            break
        step = np.linalg.solve(H, b)
        x += step[0]
        y += step[1]
        theta += step[2]
        size = max(abs(step[0]), abs(step[1]), abs(step[2]))
        if scale > NARROW:
            if size < 0.1 * scale:
                scale = max(0.3 * scale, NARROW)
        elif size < SMALL_STEP:
            break
    return np.array([x, y, theta]), H, cost / max(len(xy), 1), inliers / max(len(xy), 1)

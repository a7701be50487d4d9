"""Parked landmarks that an observation could be paired with, found without restoring any.

All tests are bounds, so no landmark is missed. A landmark's position l and the pose x0 at the beginning of the epoch
(t0) are constant, so

    the covariance of l, and of l - x0, can only have become smaller, and
    the estimate of l - x0 has moved by at most |y| times its standard deviation at t0

(a constant s = m + D y with |D|^2 at most its variance at t0, see `ekf.parking`). An observation z of l within a
squared distance g has |range(z) - range(l)| <= sqrt(g S) with S the variance of the expected range and of the noise
(Cauchy-Schwarz). Bounding boxes exclude distant blocks of landmarks. Of the others, mean and cross-covariance with the
pose are formed, and the squared distance with P_ll of t0, which is too small if anything. Walls are never excluded by
their position.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numba
import numpy as np

from association.candidates import gate_radius
from data.inputs import FrameObservations
from data.se2 import Array, BoolArray
from data.sensors import LINE, Sensor, measure, residual
from ekf.parking import Parked

BLOCK = 64  # landmarks in a bounding box, by number: successive landmarks are near each other
MARGIN = 1.0 + 1e-6  # factor on squared distances, so that rounding excludes no landmark


class ParkedBounds(NamedTuple):
    """Parked landmarks of an epoch, their positions relative to x0."""

    own: Array  # (n, 2, 2) covariance
    sigma: Array  # (n,) m
    boxes: Array  # (n / 64, 5) smallest and largest x, then y [m], largest sigma [m]; NaN where none is parked


EMPTY = ParkedBounds(np.empty((0, 2, 2)), np.empty(0), np.empty((0, 5)))  # no landmark is parked


def parked_bounds(parked: Parked, C: Array, P_xx: Array) -> ParkedBounds:
    """Bounds at the beginning of an epoch; C (2n, 3) and P_xx (3, 3) are the covariances with and of the pose."""
    own = parked.P.blocks()
    trace = np.trace(own, axis1=1, axis2=2) + P_xx[0, 0] + P_xx[1, 1] - 2.0 * (C[0::2, 0] + C[1::2, 1])
    sigma = np.sqrt(np.maximum(trace, 0.0))
    n = len(parked.based)
    boxes = np.full((-(-n // BLOCK), 5), np.nan)
    xy = parked.mean.reshape(-1, 2)
    for b in range(len(boxes)):
        here = b * BLOCK + np.flatnonzero(parked.based[b * BLOCK : (b + 1) * BLOCK])
        if len(here):
            boxes[b] = *np.stack([xy[here].min(0), xy[here].max(0)], 1).ravel(), sigma[here].max()
    return ParkedBounds(own, sigma, boxes)


def may_be_observed(
    parked: Parked,
    around: ParkedBounds,
    sensor: Sensor,
    x: Array,
    P: Array,
    observations: FrameObservations,
    within: float,
) -> BoolArray:
    """Which landmarks (n,) of these rows may be within a squared distance of some observation. `around`: bounds at the
    beginning of the epoch; x (3 + k,), P (3 + k, 3 + k): present mean and covariance of pose and y.
    """
    k, robot = parked.k, parked.robot[:2]
    y, P_yy = x[3:], P[3:, 3:]
    gate = math.sqrt(within * MARGIN)
    # covariance of x - x0, and the position relative to the estimate of x0 at that time
    step = robot @ (P_yy[:3, :3] + np.eye(3)) @ robot.T - 2.0 * P[:2, 3:6] @ robot.T + P[:2, :2]
    centre = x[:2] - robot @ y[:3]
    since = np.diag([step[0, 0], step[1, 1], P[2, 2]])
    reach = gate_radius(sensor, np.maximum(since, 0.0), observations, within * MARGIN)
    found = np.zeros(len(parked.based), np.bool_)
    seen = FrameObservations(np.array(observations.z, float), np.array(observations.R, float))
    near = Query(centre, reach, gate + float(np.linalg.norm(y[:k])), within * MARGIN)
    held = parked.mean, parked.D, parked.based
    _search(sensor.kind, sensor.extrinsic, x, P, held, around, near, seen, found)
    return found


class Query(NamedTuple):
    """A search without landmarks farther from `centre` (2,) than `reach` [m] plus `sigmas` standard deviations."""

    centre: Array
    reach: float
    sigmas: float
    within: float


@numba.njit(cache=True)
def _search(
    kind: int,
    extrinsic: Array,
    x: Array,
    P: Array,
    held: tuple[Array, Array, BoolArray],
    around: ParkedBounds,
    near: Query,
    seen: FrameObservations,
    found: BoolArray,
) -> None:
    """See `may_be_observed`; `held` = means, D and which are based, as of `Parked`."""
    mean, D, based = held
    own, sigma, boxes = around
    centre, reach, sigmas, within = near
    z, R = seen
    k = D.shape[1]
    z_hat, Hx, Hl = np.empty(2), np.empty((2, 3)), np.empty((2, 2))
    place, cross = np.empty(2), np.empty((2, 3))
    for b in range(len(boxes)):
        away = np.hypot(
            max(boxes[b, 0] - centre[0], 0.0, centre[0] - boxes[b, 1]),
            max(boxes[b, 2] - centre[1], 0.0, centre[1] - boxes[b, 3]),
        )
        if not away <= reach + sigmas * boxes[b, 4]:
            continue
        for n in range(b * BLOCK, min((b + 1) * BLOCK, len(based))):
            if not based[n]:
                continue
            away = math.hypot(mean[2 * n] - centre[0], mean[2 * n + 1] - centre[1])
            if away > reach + sigmas * sigma[n]:
                continue
            for q in range(2):
                place[q] = mean[2 * n + q]
                cross[q] = 0.0
                for j in range(k):
                    weight = D[2 * n + q, j]
                    place[q] += weight * x[3 + j]
                    for i in range(3):
                        cross[q, i] += weight * P[3 + j, i]
            measure(kind, extrinsic, x, place[0], place[1], z_hat, Hx, Hl)
            mixed = Hx @ cross.T @ Hl.T
            HPHt = Hx @ np.ascontiguousarray(P[:3, :3]) @ Hx.T + mixed + mixed.T + Hl @ own[n] @ Hl.T
            for i in range(len(z)):
                nx, ny = residual(kind, z[i, 0], z[i, 1], z_hat)
                # the noise of a wall's observation has the sign of its own normal
                side = -1.0 if kind == LINE and math.cos(z[i, 1] - z_hat[1]) < 0.0 else 1.0
                a, c = HPHt[0, 0] + R[i, 0, 0], HPHt[1, 1] + R[i, 1, 1]
                off = 0.5 * (HPHt[0, 1] + HPHt[1, 0] + side * (R[i, 0, 1] + R[i, 1, 0]))
                det = a * c - off * off
                if not det > 0.0 or c * nx**2 - 2.0 * off * nx * ny + a * ny**2 <= within * det:
                    found[n] = True
                    break

"""Accumulated scan: what was seen over a few frames, as points in the newest body frame with their joint covariance.

A map of the surroundings that knows no world frame (robot-centred: Castellanos, Martinez-Cantin, Tardos and Neira,
Robotics and Autonomous Systems 55, 2007): the robot stands at its origin without error, its motion moves the points,
and the uncertainty of that motion is common to all of them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from association.evidence import constants
from association.expectation import gate_threshold
from data import se2
from data.blocks import add_to_diagonal, coordinates, diagonal_blocks, of_points
from data.inputs import Increment, IntArray, Sightings
from data.se2 import Array
from data.sensors import Sensor


@dataclass(frozen=True)
class Scan:
    """Points (n, 2) m in the body frame, their joint covariance (2n, 2n), and each one's rows of the log."""

    xy: Array
    covariance: Array
    rows: tuple[tuple[int, ...], ...]

    def __len__(self) -> int:
        return len(self.xy)


EMPTY = Scan(np.empty((0, 2)), np.empty((0, 0)), ())
"""Nothing seen."""


def moved(scan: Scan, increment: Increment) -> Scan:
    """The scan in the body frame after an increment, without the points that are too uncertain by now (`FADED`)."""
    if not len(scan):
        return scan
    n, (mean, M) = len(scan), increment
    turn = se2.rotation(-float(mean[2]))
    xy = (scan.xy - mean[:2]) @ turn.T
    A, B = np.kron(np.eye(n), turn), np.zeros((2 * n, 3))
    B[:, :2] = np.tile(-turn, (n, 1))
    B[0::2, 2], B[1::2, 2] = xy[:, 1], -xy[:, 0]
    whole = Scan(xy, A @ scan.covariance @ A.T + B @ M @ B.T, scan.rows)
    clear = np.flatnonzero(_variance(whole) < constants.FADED**2)
    if len(clear) == n:
        return whole
    return Scan(xy[clear], of_points(whole.covariance, clear), tuple(whole.rows[i] for i in clear))


def extended(scan: Scan, sensor: Sensor, sightings: Sightings, rows: IntArray) -> Scan:
    """The scan with a frame's sightings (m), whose rows of the log are `rows` (m,).

    A sighting of a point that is there already (nearest first, one to one, d^2 inside `SAME_POINT`) corrects the scan;
    any other is a new point.
    """
    xy, R = sensor.body_points(*sightings)
    n, old = len(scan), _pairs(scan, xy, R)
    mean, P, seen = scan.xy.ravel().copy(), scan.covariance, [list(r) for r in scan.rows]
    if old:
        at = coordinates(np.array([j for _, j in old]))
        S = P[np.ix_(at, at)].copy()
        add_to_diagonal(S, R[[i for i, _ in old]])
        nu = np.concatenate([xy[i] - scan.xy[j] for i, j in old])
        K = np.linalg.solve(S, P[at]).T
        mean = mean + K @ nu
        P = P - K @ P[at]
        P = 0.5 * (P + P.T)
        for i, j in old:
            seen[j].append(int(rows[i]))
    new = np.setdiff1d(np.arange(len(xy)), [i for i, _ in old])
    joint = np.zeros((2 * (n + len(new)),) * 2)
    joint[: 2 * n, : 2 * n] = P
    for q, i in enumerate(new.tolist(), n):
        joint[2 * q : 2 * q + 2, 2 * q : 2 * q + 2] = R[i]
        seen.append([int(rows[i])])
    points = np.concatenate([mean.reshape(-1, 2), xy[new]])
    return Scan(points, joint, tuple(tuple(s) for s in seen))


def _pairs(scan: Scan, xy: Array, R: Array) -> list[tuple[int, int]]:
    """Sightings and the points they show again: nearest pair first, one to one."""
    n = len(scan)
    blocks = diagonal_blocks(scan.covariance)
    nu = xy[:, None] - scan.xy[None]
    S = blocks[None] + R[:, None]
    d2 = np.einsum("mna,mna->mn", nu, np.linalg.solve(S, nu[..., None])[..., 0])
    pairs, threshold = [], gate_threshold(constants.SAME_POINT)
    while d2.size and d2.min() < threshold:
        i, j = divmod(int(np.argmin(d2)), n)
        pairs.append((i, j))
        d2[i], d2[:, j] = np.inf, np.inf
    return pairs


def surest(scan: Scan, limit: int) -> IntArray:
    """Indices of the points known best, `limit` at most."""
    order: IntArray = np.argsort(_variance(scan), kind="stable")[:limit].astype(np.int64)
    return order


def _variance(scan: Scan) -> Array:
    """Sum of both variances (n,) of each point."""
    total: Array = np.diag(scan.covariance).reshape(-1, 2).sum(axis=1)
    return total

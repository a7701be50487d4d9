"""Systematic errors as p states of a filter behind the pose, landmarks after them (see `ekf.kernels`).

An increment is corrected by the estimated errors (`data.motion.systematic`), and its Jacobian A correlates pose and
errors: with D = R(theta) A, x <- x + R(theta) m(b), P <- J P J' + R G M G' R', J = [[F, D], [0, I]]. The drift decays
at every knot.

With errors of the sensor the state is in the sensor's frame (`data.motion.systematic`). A known landmark then depends
on the range error, so it is a temporary state of an update.

In SLAM with walls the state is about the first pose. The plain EKF's NEES depends on the origin of (rho, alpha): a
heading error moves rho by the lever arm from there. With the origin at the first pose, which is known best, it is
consistent in a room; 100 m away it is not.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from data.compiled import njit
from data.inputs import IntArray, Prior, Systematic
from data.motion.systematic import BETWEEN_KNOTS, SensorFrame, correct, forgotten, knot, places, sandwich
from data.result import MapState, Systematics
from data.se2 import Array
from data.sensors import Sensor, about, about_origin
from ekf.kernels import predict


@dataclass(frozen=True, eq=False)
class WallFrame(SensorFrame):
    """The world moved so that its origin is `origin`; the points of `SensorFrame` are walls here."""

    @property
    def same(self) -> bool:
        """False: poses and walls differ from those in the world."""
        return False

    def poses_out(self, pose: Array, errors: Array) -> tuple[Array, Array]:
        """Poses (n, 3) in the world and their Jacobians (n, 3, 3 + p) to pose and errors (n, p)."""
        return pose + np.append(self.origin, 0.0), np.tile(np.eye(3, 3 + errors.shape[1]), (len(pose), 1, 1))

    def poses_in(self, pose: Array, errors: Array) -> Array:
        """Poses (n, 3) in this frame."""
        return np.asarray(pose - np.append(self.origin, 0.0))

    def points_out(self, xy: Array, errors: Array) -> tuple[Array, float, Array]:
        """Walls (n, 2) about the world's origin, alpha wrapped; scale 1, and zero Jacobians to the errors (p,)."""
        return about(xy, -self.origin), 1.0, np.zeros((len(xy), 2, len(errors)))

    def sensor(self, sensor: Sensor) -> Sensor:
        """The sensor as it is: this is the robot's own frame."""
        return sensor


class Errors(NamedTuple):
    """The systematic errors of a run for the kernels."""

    place: IntArray  # (p,) index of each among all errors
    mount: Array  # (3,) as of `data.motion.systematic.correct`
    drift_at: int  # row of the drift in the state, -1: none
    drift: Array  # (3,) its variance, its length [m], metres between knots
    range_at: int  # row of the range error, -1: none
    origin: Array  # (2,) m, fixed point of the scale of the world
    since: Array  # (1,) m since the last knot; a prediction advances it


def as_states(systematic: Systematic | None, frame: SensorFrame) -> Errors:
    """The errors before the first increment; None: there are none."""
    if systematic is None:
        return Errors(np.empty(0, np.int64), np.zeros(3), -1, np.ones(3), -1, np.zeros(2), np.zeros(1))
    drift_at, drift = -1, np.ones(3)
    if systematic.drifts:
        drift_at = systematic.names.index("drift")
        length = systematic.length
        drift = np.array([systematic.sigma[drift_at] ** 2, length, BETWEEN_KNOTS * length])
        drift_at += 3
    range_at = 3 + frame.range_at if frame.range_at >= 0 else -1
    return Errors(places(systematic), frame.mount, drift_at, drift, range_at, frame.origin, np.zeros(1))


def begin(prior: Prior, systematic: Systematic | None, frame: SensorFrame) -> tuple[Array, Array]:
    """Mean (3 + p,) and covariance (3 + p, 3 + p) of pose and errors before the first frame."""
    if systematic is None:
        return frame.poses_in(prior.mean[None], np.empty((1, 0)))[0], prior.covariance
    return frame.prior_in(prior, systematic.sigma)


@njit
def predict_with_errors(mean: Array, P: Array, d: int, motion: Array, M: Array, first: Array, errors: Errors) -> None:
    """`ekf.kernels.predict` by an increment whose systematic errors are states."""
    p = len(errors.place)
    a = errors.drift_at
    if a >= 0:
        ended, errors.since[0] = knot(errors.since[0], motion[0], motion[1], errors.drift[2])
        if ended > 0.0:
            decay, fresh = forgotten(ended, errors.drift[1])
            mean[a] *= decay
            P[a, :d] *= decay
            P[:d, a] = P[a, :d]
            P[a, a] = decay * P[a, a] + fresh * errors.drift[0]  # the diagonal entry was scaled once
    every, corrected, A, G = np.zeros(7), np.empty(3), np.empty((3, 7)), np.empty((3, 3))
    every[errors.place] = mean[3 : 3 + p]
    correct(motion, every, errors.mount, corrected, A, G)
    c, s = math.cos(mean[2]), math.sin(mean[2])
    D = np.empty((3, p))
    for q in range(p):
        x, y = A[0, errors.place[q]], A[1, errors.place[q]]
        D[0, q], D[1, q], D[2, q] = c * x - s * y, s * x + c * y, A[2, errors.place[q]]
    noise = np.empty((3, 3))
    sandwich(G, M, noise)
    predict(mean, P, d, corrected, noise, first)
    for r in range(3):  # J = [[I, D], [0, I]] [[F, 0], [0, I]]: rows, then columns
        for q in range(p):
            for j in range(d):
                P[r, j] += D[r, q] * P[3 + q, j]
    for r in range(3):
        for i in range(r + 1):
            for q in range(p):
                P[i, r] += P[i, 3 + q] * D[r, q]
            P[r, i] = P[i, r]
        P[3:d, r] = P[r, 3:d]


@njit
def hold_known(mean: Array, P: Array, d: int, known: Array, begin: int, end: int, first: Array, errors: Errors) -> None:
    """Append the known landmarks (K, 2), world frame, from row `begin` before `end` as states in the sensor's frame;
    the buffers have room for them. They depend on the range error alone: l' = o + (l - o) (1 + range).
    """
    a = errors.range_at
    for i in range(begin, end):
        for q in range(2):
            away, r = known[i, q] - errors.origin[q], d + 2 * (i - begin) + q
            mean[r] = errors.origin[q] + away * (1.0 + mean[a])
            if len(first):
                first[r] = mean[r]
            for j in range(r):
                P[r, j] = away * P[a, j]
                P[j, r] = P[r, j]
            P[r, r] = away * P[a, r]


def poses(state: Array, P: Array, frame: SensorFrame) -> tuple[Array, Array]:
    """World poses (n, 3) and covariances from pose and errors (n, 3 + p) with theirs (n, 3 + p, 3 + p)."""
    if frame.same:
        return state[:, :3], P[:, :3, :3]
    pose, J = frame.poses_out(state[:, :3], state[:, 3:])
    covariance = J @ P @ J.transpose(0, 2, 1)
    return pose, 0.5 * (covariance + covariance.transpose(0, 2, 1))


def of_frames(systematic: Systematic | None, state: Array, P: Array) -> Systematics | None:
    """The errors estimated at each frame; arguments as of `poses`."""
    if systematic is None:
        return None
    variance = np.diagonal(P, axis1=1, axis2=2)[:, 3:]
    return Systematics(systematic.names, state[:, 3:].copy(), np.sqrt(np.maximum(variance, 0.0)))


def landmarks(map_: MapState, cross: Array, errors: Array, P_bb: Array, frame: SensorFrame) -> MapState:
    """The map in the world; `cross` (n, 2, p): its covariance with the errors, of mean (p,) and covariance P_bb."""
    if isinstance(frame, WallFrame):
        lines, P = about_origin(map_.xy, map_.covariance, frame.origin)
        return MapState(map_.number, lines, 0.5 * (P + P.transpose(0, 2, 1)))
    if frame.range_at < 0:
        return map_
    xy, size, J = frame.points_out(map_.xy, errors)
    mixed = size * cross @ J.transpose(0, 2, 1)
    covariance = size**2 * map_.covariance + mixed + mixed.transpose(0, 2, 1) + J @ P_bb @ J.transpose(0, 2, 1)
    return MapState(map_.number, xy, 0.5 * (covariance + covariance.transpose(0, 2, 1)))

"""Systematic errors of odometry and sensor: their effect on an increment, its inverse, and a frame without sensor
errors.

Uneven wheels and an off-centre steering turn a robot with every metre, and by another angle than measured (Borenstein
and Feng, "Measurement and correction of systematic odometry errors in mobile robots", IEEE Transactions on Robotics and
Automation 12, 1996). A robot that measured (m, t) has moved by (1 + scale) R(e/2) m and turned by t + e, where e = d
(curvature + drift) + left max(t, 0) + right min(t, 0) and d is |m|, negative backwards. The drift is an
Ornstein-Uhlenbeck process over the distance travelled, constant between knots.

A sensor with ranges (1 + range) times the true ones and bearings true + bearing has no error in a frame turned by
-bearing in a world scaled by (1 + range): there a pose X of the robot is X' = S X E Rot(-bearing), a point l is S l,
where E is the sensor's mount on the robot and S scales the world about a fixed origin. In that frame, the sensor's, the
measurement model has no error, and the increments have all of them. So filters and smoothers take the errors in one
place:

    increment(b) = (1 + range) Rot(bearing) E^-1 (corrected odometry) E Rot(-bearing).

All functions return Jacobians.
"""

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from data.compiled import njit
from data.inputs import ERRORS, Increment, Inputs, IntArray, Prior, Systematic
from data.result import Systematics
from data.se2 import Array, BoolArray, compose, inverse, wrap_angle
from data.sensors import RELATIVE_POINT, Sensor, wrap_angle_jit

SCALE, CURVATURE, LEFT, RIGHT, DRIFT, RANGE, BEARING = range(len(ERRORS))  # Indices of the errors
BETWEEN_KNOTS = 0.2
"""Distance of knots over the drift's length. The step at a knot is 0.57 of the drift's sigma; half and twice as many
knots change estimates by at most a tenth of their sigma."""


class Corrected(NamedTuple):
    """An increment under given errors: mean (3,), covariance (3, 3), Jacobian A (3, p) to the errors."""

    mean: Array
    covariance: Array
    A: Array


def places(systematic: Systematic) -> IntArray:
    """Index of each error (p,) among all."""
    return np.array([list(ERRORS).index(n) for n in systematic.names], np.int64)


@njit
def correct(motion: Array, errors: Array, mount: Array, mean: Array, A: Array, G: Array) -> None:
    """The corrected increment `mean` (3,) of odometry's `motion` (3,) under all errors (7,), with Jacobians A (3, 7) to
    the errors and G (3, 3) to the additive noise; `mount` (3,): of the sensor, zero for the robot's own frame.
    """
    x, y, t = motion[0], motion[1], motion[2]
    d = math.hypot(x, y)
    if x < 0.0:
        d = -d
    positive, negative = max(t, 0.0), min(t, 0.0)
    e = d * (errors[CURVATURE] + errors[DRIFT]) + errors[LEFT] * positive + errors[RIGHT] * negative
    ch, sh = math.cos(0.5 * e), math.sin(0.5 * e)
    rx, ry = ch * x - sh * y, sh * x + ch * y
    ux, uy = (1.0 + errors[SCALE]) * rx, (1.0 + errors[SCALE]) * ry
    turn = t + e
    ct, st = math.cos(turn), math.sin(turn)  # R(turn) times the mount's position
    qx, qy = ct * mount[0] - st * mount[1], st * mount[0] + ct * mount[1]
    size = 1.0 + errors[RANGE]  # the whole turn into the sensor's frame: bearing - mount's heading
    angle = errors[BEARING] - mount[2]
    c, s = size * math.cos(angle), size * math.sin(angle)
    vx, vy = ux + qx - mount[0], uy + qy - mount[1]
    mean[0], mean[1], mean[2] = c * vx - s * vy, s * vx + c * vy, turn
    ex, ey = -0.5 * uy - qy, 0.5 * ux + qx  # by e: half of the extra turn precedes the step, all of it moves the mount
    dx, dy = c * ex - s * ey, s * ex + c * ey
    A[0, SCALE], A[1, SCALE], A[2, SCALE] = c * rx - s * ry, s * rx + c * ry, 0.0
    A[0, CURVATURE], A[1, CURVATURE], A[2, CURVATURE] = d * dx, d * dy, d
    A[0, LEFT], A[1, LEFT], A[2, LEFT] = positive * dx, positive * dy, positive
    A[0, RIGHT], A[1, RIGHT], A[2, RIGHT] = negative * dx, negative * dy, negative
    A[0, DRIFT], A[1, DRIFT], A[2, DRIFT] = d * dx, d * dy, d
    A[0, RANGE], A[1, RANGE], A[2, RANGE] = mean[0] / size, mean[1] / size, 0.0
    A[0, BEARING], A[1, BEARING], A[2, BEARING] = -mean[1], mean[0], 0.0
    G[0, 0], G[0, 1], G[0, 2] = c, -s, -c * qy - s * qx
    G[1, 0], G[1, 1], G[1, 2] = s, c, -s * qy + c * qx
    G[2, 0], G[2, 1], G[2, 2] = 0.0, 0.0, 1.0


@njit
def sandwich(G: Array, M: Array, out: Array) -> None:
    """G M G', (3, 3) each, into `out`."""
    for i in range(3):
        a = G[i, 0] * M[0, 0] + G[i, 1] * M[1, 0] + G[i, 2] * M[2, 0]
        b = G[i, 0] * M[0, 1] + G[i, 1] * M[1, 1] + G[i, 2] * M[2, 1]
        c = G[i, 0] * M[0, 2] + G[i, 1] * M[1, 2] + G[i, 2] * M[2, 2]
        for j in range(3):
            out[i, j] = a * G[j, 0] + b * G[j, 1] + c * G[j, 2]


@njit
def _correct_all(
    motion: Array, noise: Array, errors: Array, place: IntArray, mount: Array, mean: Array, covariance: Array, A: Array
) -> None:
    all_errors, whole, G = np.zeros(7), np.zeros((3, 7)), np.zeros((3, 3))
    for k in range(len(motion)):
        for j in range(len(place)):
            all_errors[place[j]] = errors[k, j]
        correct(motion[k], all_errors, mount, mean[k], whole, G)
        sandwich(G, noise[k], covariance[k])
        for j in range(len(place)):
            for i in range(3):
                A[k, i, j] = whole[i, place[j]]


def corrected(increment: Increment, errors: Array, place: IntArray, mount: Array) -> Corrected:
    """One increment under errors (p,) with indices `place` (p,); `mount` as of `correct`."""
    one = corrected_all(increment.mean[None], increment.covariance[None], errors[None], place, mount)
    return Corrected(*(each[0] for each in one))


def corrected_all(mean: Array, covariance: Array, errors: Array, place: IntArray, mount: Array) -> Corrected:
    """The same for increments (n, 3), (n, 3, 3), each under its own errors (n, p): (n, 3), (n, 3, 3), (n, 3, p)."""
    n, p = len(mean), len(place)
    found = Corrected(np.zeros((n, 3)), np.zeros((n, 3, 3)), np.zeros((n, 3, p)))
    motion, noise, each = (np.array(a, float, order="C") for a in (mean, covariance, np.broadcast_to(errors, (n, p))))
    _correct_all(motion, noise, each, place, np.array(mount, float), found.mean, found.covariance, found.A)
    return found


@njit
def knot(since: float, x: float, y: float, step: float) -> tuple[float, float]:
    """Metres ended by a new knot before an increment by (x, y) m, 0 for none, and metres since the last knot after it.
    `since`: metres since the last knot; a knot comes after `step` metres.
    """
    ended = 0.0
    if since >= step:
        ended, since = since, 0.0
    return ended, since + math.hypot(x, y)


@njit
def _knots(mean: Array, step: float, of: IntArray, ended: Array) -> int:
    since, count = 0.0, 0
    for k in range(1, len(mean)):
        end, since = knot(since, mean[k, 0], mean[k, 1], step)
        if end > 0.0:
            ended[count] = end
            count += 1
        of[k] = count
    return count


def knots(length: float, mean: Array) -> tuple[IntArray, Array]:
    """Knot of each increment's drift (N,), of a drift of this length, and metres (K - 1,) of each knot but the last."""
    of, ended = np.zeros(len(mean), np.int64), np.zeros(len(mean))
    count = _knots(np.array(mean, float, order="C"), BETWEEN_KNOTS * length, of, ended)
    return of, ended[:count].copy()


@njit
def forgotten(ended: float, length: float) -> tuple[float, float]:
    """Correlation of the drift over `ended` metres, and the share of its variance that is new."""
    kept = math.exp(-ended / length)
    return kept, 1.0 - kept * kept


@njit
def stated(way: Array, errors: Array, mount: Array, leftwards: bool, m: Array, by_way: Array, by_errors: Array) -> None:
    """Noise-free odometry m (3,) under all errors (7,) for the motion `way` (3,) of the sensor at `mount` (3,).

    Also its Jacobians (3, 3) to the motion and (3, 7) to the errors, all additive. `leftwards`: which turn error
    applies; fixed by the caller, since a search would get stuck at the kink where it changes.
    """
    scale, slope = 1.0 + errors[SCALE], errors[CURVATURE] + errors[DRIFT]
    size, angle = 1.0 + errors[RANGE], errors[BEARING] - mount[2]  # the robot's motion u from the sensor's
    c, s = math.cos(angle) / size, math.sin(angle) / size
    ax, ay = c * way[0] + s * way[1], c * way[1] - s * way[0]
    turn: float = wrap_angle_jit(way[2])
    ct, st = math.cos(turn), math.sin(turn)
    qx, qy = ct * mount[0] - st * mount[1], st * mount[0] + ct * mount[1]
    ux, uy = ax + mount[0] - qx, ay + mount[1] - qy
    D = math.copysign(math.hypot(ux, uy), ux)  # as the odometry measures it
    Dx, Dy = (ux / D, uy / D) if D != 0.0 else (1.0, 0.0)
    d = D / scale
    side = LEFT if leftwards else RIGHT
    more = 1.0 + errors[side]
    t = (turn - slope * d) / more
    half = 0.5 * (turn - t)
    ch, sh = math.cos(half) / scale, math.sin(half) / scale
    x, y = ch * ux + sh * uy, ch * uy - sh * ux
    m[0], m[1], m[2] = x, y, t
    tx, ty, tt = -slope * Dx / (scale * more), -slope * Dy / (scale * more), 1.0 / more  # by u and the turn
    xx, xy, xt = ch - 0.5 * y * tx, sh - 0.5 * y * ty, 0.5 * y * (1.0 - tt)
    yx, yy, yt = -sh + 0.5 * x * tx, ch + 0.5 * x * ty, -0.5 * x * (1.0 - tt)
    by_way[0, 0], by_way[0, 1], by_way[0, 2] = xx * c - xy * s, xx * s + xy * c, xx * qy - xy * qx + xt
    by_way[1, 0], by_way[1, 1], by_way[1, 2] = yx * c - yy * s, yx * s + yy * c, yx * qy - yy * qx + yt
    by_way[2, 0], by_way[2, 1], by_way[2, 2] = tx * c - ty * s, tx * s + ty * c, tx * qy - ty * qx + tt
    for i in range(3):
        for e in range(7):
            by_errors[i, e] = 0.0
    by_errors[2, SCALE] = slope * d / (scale * more)
    by_errors[2, CURVATURE] = by_errors[2, DRIFT] = -d / more
    by_errors[2, side] = -t / more
    for e in range(RANGE):
        by_errors[0, e], by_errors[1, e] = -0.5 * y * by_errors[2, e], 0.5 * x * by_errors[2, e]
    by_errors[0, SCALE] -= x / scale
    by_errors[1, SCALE] -= y / scale
    for e, vx, vy in ((RANGE, -ax / size, -ay / size), (BEARING, ay, -ax)):
        by_errors[0, e], by_errors[1, e], by_errors[2, e] = xx * vx + xy * vy, yx * vx + yy * vy, tx * vx + ty * vy


@njit
def _stated_all(
    way: Array, errors: Array, mount: Array, leftwards: BoolArray, m: Array, by_way: Array, by_errors: Array
) -> None:
    for k in range(len(way)):
        stated(way[k], errors[k], mount, leftwards[k], m[k], by_way[k], by_errors[k])


def stated_all(way: Array, errors: Array, leftwards: BoolArray) -> tuple[Array, Array, Array]:
    """The same for the robot's own motions (n, 3) under errors (n, 7): (n, 3), Jacobians (n, 3, 3) and (n, 3, 7)."""
    n = len(way)
    found = np.empty((n, 3)), np.empty((n, 3, 3)), np.empty((n, 3, 7))
    _stated_all(np.array(way, float, order="C"), np.array(errors, float, order="C"), np.zeros(3), leftwards, *found)
    return found


@dataclass(frozen=True, eq=False)
class SensorFrame:
    """The sensor's frame where sensor errors are estimated, else the robot's own."""

    mount: Array  # (3,) pose of the sensor on the robot (zero: the robot's own frame)
    origin: Array  # (2,) m, centre of the world's scaling
    range_at: int  # range_at, bearing_at: indices of these errors among those estimated, -1: not estimated
    bearing_at: int

    @property
    def same(self) -> bool:
        """Whether it is the robot's own."""
        return self.range_at < 0 and self.bearing_at < 0

    def _errors(self, errors: Array) -> tuple[Array, Array]:
        """Range and bearing error of errors (..., p)."""
        zero = np.zeros(errors.shape[:-1])
        r = errors[..., self.range_at] if self.range_at >= 0 else zero
        return r, errors[..., self.bearing_at] if self.bearing_at >= 0 else zero

    def poses_out(self, pose: Array, errors: Array) -> tuple[Array, Array]:
        """Robot poses (n, 3) from those in this frame, under errors (n, p), and Jacobians (n, 3, 3 + p) to both."""
        n, p = errors.shape
        J = np.zeros((n, 3, 3 + p))
        J[:, 0, 0] = J[:, 1, 1] = J[:, 2, 2] = 1.0
        if self.same:
            return pose.copy(), J
        r, bearing = self._errors(errors)
        heading = pose[:, 2] + bearing - self.mount[2]
        c, s = np.cos(heading), np.sin(heading)
        # the mount's offset from the robot's centre, and its derivative
        off = np.stack([c * self.mount[0] - s * self.mount[1], s * self.mount[0] + c * self.mount[1]], 1)
        turned = np.stack([-off[:, 1], off[:, 0]], 1)
        away = (pose[:, :2] - self.origin) / (1.0 + r)[:, None]
        out = np.empty_like(pose)
        out[:, :2], out[:, 2] = self.origin + away - off, wrap_angle(heading)
        J[:, 0, 0] = J[:, 1, 1] = 1.0 / (1.0 + r)
        J[:, :2, 2] = -turned
        if self.bearing_at >= 0:
            J[:, :2, 3 + self.bearing_at], J[:, 2, 3 + self.bearing_at] = -turned, 1.0
        if self.range_at >= 0:
            J[:, :2, 3 + self.range_at] = -away / (1.0 + r)[:, None]
        return out, J

    def poses_in(self, pose: Array, errors: Array) -> Array:
        """Poses (n, 3) in this frame of the robot's (n, 3), under errors (n, p)."""
        if self.same:
            return pose.copy()
        r, bearing = self._errors(errors)
        seen = compose(pose, self.mount)
        seen[:, :2] = self.origin + (seen[:, :2] - self.origin) * (1.0 + r)[:, None]
        seen[:, 2] = wrap_angle(seen[:, 2] - bearing)
        return seen

    def points_out(self, xy: Array, errors: Array) -> tuple[Array, float, Array]:
        """World points (n, 2) from those in this frame, under errors (p,); Jacobians to both, the first a scalar."""
        r = float(self._errors(errors)[0])
        out = self.origin + (xy - self.origin) / (1.0 + r)
        J = np.zeros((len(xy), 2, len(errors)))
        if self.range_at >= 0:
            J[:, :, self.range_at] = -(out - self.origin) / (1.0 + r)
        return out, 1.0 / (1.0 + r), J

    def points_in(self, xy: Array, errors: Array) -> tuple[Array, Array]:
        """Points (n, 2) in this frame of world points, under errors (p,); Jacobian (n, 2, p) to the errors."""
        r = float(self._errors(errors)[0])
        J = np.zeros((len(xy), 2, len(errors)))
        if self.range_at >= 0:
            J[:, :, self.range_at] = xy - self.origin
        return self.origin + (xy - self.origin) * (1.0 + r), J

    def prior_in(self, prior: Prior, sigma: Array) -> tuple[Array, Array]:
        """Mean (3 + p,) and covariance (3 + p, 3 + p) in this frame of the first pose and the errors, a priori zero."""
        p = len(sigma)
        mean, P = np.zeros(3 + p), np.zeros((3 + p, 3 + p))
        mean[:3] = self.poses_in(prior.mean[None], np.zeros((1, p)))[0]
        _, J = self.poses_out(mean[None, :3], np.zeros((1, p)))
        inside = np.linalg.inv(J[0, :, :3])
        back = np.eye(3 + p)
        back[:3, :3], back[:3, 3:] = inside, -inside @ J[0, :, 3:]
        P[:3, :3], P[3:, 3:] = prior.covariance, np.diag(sigma**2)
        P = back @ P @ back.T
        return mean, 0.5 * (P + P.T)

    def sensor(self, sensor: Sensor) -> Sensor:
        """The sensor in this frame: at its origin."""
        return sensor if self.same else replace(sensor, rotation=0.0, translation=(0.0, 0.0))


def sensor_frame(systematic: Systematic | None, sensor: Sensor, prior: Prior) -> SensorFrame:
    """The frame to work in, scaled about the sensor's first position."""
    names = () if systematic is None else systematic.names
    at = [names.index(n) if n in names else -1 for n in ("range", "bearing")]
    rotation, tx, ty = sensor.extrinsic
    mount = inverse(np.array([tx, ty, rotation])) if max(at) >= 0 else np.zeros(3)
    return SensorFrame(mount, compose(prior.mean, mount)[:2], at[0], at[1])


def all_errors(systematics: Systematics) -> Array:
    """Errors (N, 7) by frame in the order of `ERRORS`, zero where not estimated."""
    found = np.zeros((len(systematics.mean), len(ERRORS)))
    found[:, [list(ERRORS).index(n) for n in systematics.names]] = systematics.mean
    return found


def corrected_inputs(inputs: Inputs, systematics: Systematics | None) -> Inputs:
    """The inputs corrected by these errors, none left to estimate; unchanged for None. Increments are the robot's own;
    a smoother that estimated the errors has, up to squares of the noise, the same optimum.
    """
    if systematics is None:
        return inputs
    errors = all_errors(systematics)
    of_odometry = errors.copy()
    of_odometry[:, [RANGE, BEARING]] = 0.0
    increments = inputs.increments
    found = corrected_all(increments.mean, increments.covariance, of_odometry, np.arange(len(ERRORS)), np.zeros(3))
    # the noise is that of the stated increment
    carried = np.linalg.inv(stated_all(found.mean, of_odometry, increments.mean[:, 2] > 0.0)[1])
    covariance = carried @ increments.covariance @ carried.transpose(0, 2, 1)
    o = inputs.observations
    size, bearing = 1.0 + errors[o.frame, RANGE], errors[o.frame, BEARING]
    z, J = o.z.copy(), np.zeros((len(o.z), 2, 2))
    if inputs.sensor.kind != RELATIVE_POINT:
        z[:, 0], z[:, 1] = z[:, 0] / size, wrap_angle(z[:, 1] - bearing)
        J[:, 0, 0], J[:, 1, 1] = 1.0 / size, 1.0
    else:
        c, s = np.cos(bearing) / size, np.sin(bearing) / size
        J[:, 0, 0], J[:, 0, 1], J[:, 1, 0], J[:, 1, 1] = c, s, -s, c
        z = np.einsum("mij,mj->mi", J, z)
    observations = replace(o, z=z, R=J @ o.R @ J.transpose(0, 2, 1))
    increments = replace(increments, mean=found.mean, covariance=covariance)
    return replace(inputs, increments=increments, observations=observations, systematic=None)

"""Measurement models of landmarks: points by range, bearing, both or relative position, and walls.

A point is (x, y). A wall is the line n(alpha) . x = rho, n = (cos alpha, sin alpha), with signed distance rho [m] from
the origin and direction alpha [rad] of its normal; (-rho, alpha + pi) is the same line. Every measurement is two
numbers: a bearing alone has a zero in the place of the range, and a range alone one in that of the bearing, both
measured and expected, with Jacobians of zero and variance 1. So the innovation there is zero and adds nothing to a NIS.

The compiled functions `measure`, `invert` and `residual` are for one observation; the filters' kernels call them, and
the sensor classes apply them to arrays. Frames: w world, b body, s sensor, p_s = R p_b + T.
"""

import math
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np

from data import se2
from data.compiled import njit
from data.locked import IntArray
from data.se2 import Array, BoolArray

RANGE_BEARING = 0
RELATIVE_POINT = 1
LINE = 2
BEARING = 3
RANGE = 4

MIN_RANGE = 1e-6  # m. A nearer landmark has no direction: its Jacobians are zero, so it carries no information.

wrap_angle_jit = njit(se2.wrap_angle)


@njit
def _measure_line(extrinsic: Array, pose: Array, rho: float, alpha: float, z_hat: Array, Hx: Array, Hl: Array) -> None:
    """`measure` of a wall: z = (rho - n(alpha) p + n(phi) T, alpha - theta + rotation); beyond it (-d, phi + pi)."""
    c, s = math.cos(alpha), math.sin(alpha)
    phi = alpha - pose[2] + extrinsic[0]
    arm = math.cos(phi) * extrinsic[2] - math.sin(phi) * extrinsic[1]  # d (n(phi) . T) / d phi
    d = rho - c * pose[0] - s * pose[1] + math.cos(phi) * extrinsic[1] + math.sin(phi) * extrinsic[2]
    side = 1.0 if d >= 0.0 else -1.0
    z_hat[0] = side * d
    z_hat[1] = wrap_angle_jit(phi if d >= 0.0 else phi + math.pi)
    Hx[0, 0], Hx[0, 1], Hx[0, 2] = -side * c, -side * s, -side * arm
    Hx[1, 0], Hx[1, 1], Hx[1, 2] = 0.0, 0.0, -1.0
    Hl[0, 0], Hl[0, 1] = side, side * (s * pose[0] - c * pose[1] + arm)
    Hl[1, 0], Hl[1, 1] = 0.0, 1.0


@njit
def _invert_line(extrinsic: Array, pose: Array, d: float, phi: float, line: Array, Gx: Array, Gz: Array) -> None:
    """`invert` for a wall: alpha = phi + theta - rotation, rho = d + n(alpha) . p - n(phi) . T."""
    alpha = phi + pose[2] - extrinsic[0]
    c, s = math.cos(alpha), math.sin(alpha)
    turn = c * pose[1] - s * pose[0]  # d (n(alpha) . p) / d alpha
    arm = math.cos(phi) * extrinsic[2] - math.sin(phi) * extrinsic[1]
    line[0] = d + c * pose[0] + s * pose[1] - math.cos(phi) * extrinsic[1] - math.sin(phi) * extrinsic[2]
    line[1] = wrap_angle_jit(alpha)
    Gx[0, 0], Gx[0, 1], Gx[0, 2] = c, s, turn
    Gx[1, 0], Gx[1, 1], Gx[1, 2] = 0.0, 0.0, 1.0
    Gz[0, 0], Gz[0, 1] = 1.0, turn - arm
    Gz[1, 0], Gz[1, 1] = 0.0, 1.0


@njit
def measure(
    kind: int, extrinsic: Array, pose: Array, first: float, second: float, z_hat: Array, Hx: Array, Hl: Array
) -> None:
    """Expected measurement z_hat (2,), Jacobians Hx (2, 3) to the world-frame pose and Hl (2, 2) to the landmark.

    The landmark is (first, second): two numbers, so that a row of any array compiles nothing again. Probabilistic
    Robotics, section 6.6 and Table 7.2; `extrinsic` is (rotation, Tx, Ty) of p_s = R p_b + T.
    """
    if kind == LINE:
        _measure_line(extrinsic, pose, first, second, z_hat, Hx, Hl)
        return
    c, s = math.cos(pose[2]), math.sin(pose[2])
    ce, se = math.cos(extrinsic[0]), math.sin(extrinsic[0])
    dx, dy = first - pose[0], second - pose[1]
    bx, by = c * dx + s * dy, -s * dx + c * dy
    px, py = ce * bx - se * by + extrinsic[1], se * bx + ce * by + extrinsic[2]
    if kind != RELATIVE_POINT:  # A: d z / d p_s, then through the extrinsic to d z / d p_b
        r = math.sqrt(px * px + py * py)
        z_hat[0] = r
        z_hat[1] = math.atan2(py, px)
        if r < MIN_RANGE:
            for i in range(2):
                Hx[i, 0], Hx[i, 1], Hx[i, 2] = 0.0, 0.0, 0.0
                Hl[i, 0], Hl[i, 1] = 0.0, 0.0
            if kind in (BEARING, RANGE):
                z_hat[0 if kind == BEARING else 1] = 0.0
            return
        a00, a01, a10, a11 = px / r, py / r, -py / (r * r), px / (r * r)
        if kind == BEARING:
            z_hat[0], a00, a01 = 0.0, 0.0, 0.0
        elif kind == RANGE:
            z_hat[1], a10, a11 = 0.0, 0.0, 0.0
    else:
        z_hat[0] = px
        z_hat[1] = py
        a00, a01, a10, a11 = 1.0, 0.0, 0.0, 1.0
    b00, b01 = a00 * ce + a01 * se, -a00 * se + a01 * ce
    b10, b11 = a10 * ce + a11 * se, -a10 * se + a11 * ce
    Hl[0, 0] = b00 * c - b01 * s  # d p_b / d l = R(theta)^T = -d p_b / d p;  d p_b / d theta = (b_y, -b_x)
    Hl[0, 1] = b00 * s + b01 * c
    Hl[1, 0] = b10 * c - b11 * s
    Hl[1, 1] = b10 * s + b11 * c
    for i in range(2):
        Hx[i, 0] = -Hl[i, 0]
        Hx[i, 1] = -Hl[i, 1]
    Hx[0, 2] = b00 * by - b01 * bx
    Hx[1, 2] = b10 * by - b11 * bx


@njit
def invert(
    kind: int, extrinsic: Array, pose: Array, z0: float, z1: float, landmark: Array, Gx: Array, Gz: Array
) -> None:
    """Landmark (2,) that z = (z0, z1) implies, Jacobians Gx (2, 3) to the pose and Gz (2, 2) to the measurement. A
    bearing or a range alone implies none: the result is then meaningless, and callers ask `Sensor.locates` first.
    """
    if kind == LINE:
        _invert_line(extrinsic, pose, z0, z1, landmark, Gx, Gz)
        return
    c, s = math.cos(pose[2]), math.sin(pose[2])
    ce, se = math.cos(extrinsic[0]), math.sin(extrinsic[0])
    if kind != RELATIVE_POINT:
        cz, sz = math.cos(z1), math.sin(z1)
        px, py = z0 * cz, z0 * sz
        a00, a01, a10, a11 = cz, -z0 * sz, sz, z0 * cz
    else:
        px, py = z0, z1
        a00, a01, a10, a11 = 1.0, 0.0, 0.0, 1.0
    qx, qy = px - extrinsic[1], py - extrinsic[2]
    bx, by = ce * qx + se * qy, -se * qx + ce * qy
    wx, wy = c * bx - s * by, s * bx + c * by
    landmark[0] = pose[0] + wx
    landmark[1] = pose[1] + wy
    Gx[0, 0], Gx[0, 1], Gx[0, 2] = 1.0, 0.0, -wy
    Gx[1, 0], Gx[1, 1], Gx[1, 2] = 0.0, 1.0, wx
    m00, m01 = c * ce + s * se, c * se - s * ce  # R(theta) Re^T A
    m10, m11 = s * ce - c * se, s * se + c * ce
    Gz[0, 0] = m00 * a00 + m01 * a10
    Gz[0, 1] = m00 * a01 + m01 * a11
    Gz[1, 0] = m10 * a00 + m11 * a10
    Gz[1, 1] = m10 * a01 + m11 * a11


@njit
def residual(kind: int, z0: float, z1: float, z_hat: Array) -> tuple[float, float]:
    """Innovation z - z_hat of z = (z0, z1); the only place that wraps a measured angle. Of a wall, (d, phi) and (-d,
    phi + pi) are one measurement: the one with the nearer normal is used.
    """
    if kind == RELATIVE_POINT:
        return z0 - z_hat[0], z1 - z_hat[1]
    turn: Any = wrap_angle_jit(z1 - z_hat[1])
    if kind == LINE and abs(turn) > 0.5 * math.pi:
        return -z0 - z_hat[0], wrap_angle_jit(turn - math.pi)
    return z0 - z_hat[0], turn


@njit
def name_as_read(kind: int, angle: float, z_hat: Array, Hx: Array, Hl: Array) -> None:
    """Give a wall's expectation and Jacobians the sign of a measurement with this angle, in place: where the robot's
    side of a wall is uncertain, `measure` may choose the other one.
    """
    if kind == LINE and abs(wrap_angle_jit(angle - z_hat[1])) > 0.5 * math.pi:
        z_hat[0] = -z_hat[0]
        z_hat[1] = wrap_angle_jit(z_hat[1] + math.pi)
        for j in range(3):
            Hx[0, j] = -Hx[0, j]
        for j in range(2):
            Hl[0, j] = -Hl[0, j]


@njit
def measure_all(kind: int, extrinsic: Array, pose: Array, landmarks: Array, z_hat: Array, Hx: Array, Hl: Array) -> None:
    """`measure` landmarks (n, 2), each from its own pose (n, 3)."""
    for i in range(len(landmarks)):
        measure(kind, extrinsic, pose[i], landmarks[i, 0], landmarks[i, 1], z_hat[i], Hx[i], Hl[i])


@njit
def invert_all(kind: int, extrinsic: Array, pose: Array, z: Array, landmark: Array, Gx: Array, Gz: Array) -> None:
    """`invert` measurements (n, 2), each from its own pose (n, 3)."""
    for i in range(len(z)):
        invert(kind, extrinsic, pose[i], z[i, 0], z[i, 1], landmark[i], Gx[i], Gz[i])


def about(lines: Array, point: Array) -> Array:
    """Lines (n, 2), [rho, alpha] about the origin, as [rho, alpha] about a point (2,)."""
    out = np.array(lines, float).reshape(-1, 2)
    out[:, 0] -= np.cos(out[:, 1]) * point[0] + np.sin(out[:, 1]) * point[1]
    out[:, 1] = se2.wrap_angle(out[:, 1])
    return out


def about_origin(lines: Array, covariance: Array, point: Array) -> tuple[Array, Array]:
    """Lines (n, 2) about a point (2,), and their covariances (n, 2, 2), as those about the origin."""
    J = np.tile(np.eye(2), (len(lines), 1, 1))
    J[:, 0, 1] = np.cos(lines[:, 1]) * point[1] - np.sin(lines[:, 1]) * point[0]
    return about(lines, -point), J @ covariance @ J.transpose(0, 2, 1)


def _pair(pose: Array, other: Array) -> tuple[Array, Array]:
    """A row of pose per row of `other`: copies, since read-only arrays would compile the kernels once more."""
    rows = np.array(other, float, order="C", ndmin=2)
    poses = np.empty((len(rows), 3))
    poses[:] = pose
    return poses, rows


@dataclass(frozen=True)
class Sensor:
    """A sensor of landmarks; use `RangeBearing`, `RelativePoint`, `Bearing`, `Range` or `Line`."""

    max_range: float = math.inf  # m; observations outside the field of view are kept and counted
    min_angle: float = -math.pi  # rad in the sensor frame, as the next
    max_angle: float = math.pi
    rotation: float = 0.0  # rad, of p_sensor = R(rotation) p_body + translation
    translation: tuple[float, float] = (0.0, 0.0)  # m
    label: str = field(default="", repr=False)  # name among several sensors of a log
    sees: str = field(default="", repr=False)  # kind of landmark that it observes; blank: all

    kind: ClassVar[int]
    name: ClassVar[str]
    units: ClassVar[tuple[str, str]] = ("m", "rad")
    sees_points: ClassVar[bool] = True  # Whether landmarks are points (x, y); else walls (rho, alpha)
    errors: ClassVar[tuple[str, ...]] = ("range", "bearing")
    """Systematic errors of the sensor (`data.inputs.ERRORS`) that can be estimated."""
    measures: ClassVar[tuple[int, ...]] = (0, 1)  # Which of the two numbers are measured

    @property
    def locates(self) -> bool:
        """Whether one observation determines the landmark, given the pose."""
        return len(self.measures) == 2

    @property
    def extrinsic(self) -> Array:
        """(rotation, Tx, Ty), as the compiled functions take it."""
        return np.array([self.rotation, self.translation[0], self.translation[1]])

    def predict(self, pose: Array, landmarks: Array) -> Array:
        """Expected measurements (L, 2) of landmarks (L, 2) from a pose (3,) or a pose per landmark (L, 3)."""
        return self.linearize(pose, landmarks)[0]

    def jacobians(self, pose: Array, landmarks: Array) -> tuple[Array, Array]:
        """Jacobians (L, 2, 3) to the world-frame pose and (L, 2, 2) to the landmark; zero within `MIN_RANGE`."""
        return self.linearize(pose, landmarks)[1:]

    def linearize(self, pose: Array, landmarks: Array) -> tuple[Array, Array, Array]:
        """Expected measurements and both Jacobians (see `predict`, `jacobians`)."""
        poses, points = _pair(pose, landmarks)
        n = len(points)
        z_hat, Hx, Hl = np.empty((n, 2)), np.empty((n, 2, 3)), np.empty((n, 2, 2))
        measure_all(self.kind, self.extrinsic, poses, points, z_hat, Hx, Hl)
        return z_hat, Hx, Hl

    def inverse(self, pose: Array, z: Array) -> tuple[Array, Array, Array]:
        """Landmarks (m, 2) implied by z (m, 2), with Jacobians (m, 2, 3) to the pose and (m, 2, 2) to z."""
        poses, rows = _pair(pose, z)
        n = len(rows)
        landmark, Gx, Gz = np.empty((n, 2)), np.empty((n, 2, 3)), np.empty((n, 2, 2))
        invert_all(self.kind, self.extrinsic, poses, rows, landmark, Gx, Gz)
        return landmark, Gx, Gz

    def body_points(self, z: Array, covariance: Array) -> tuple[Array, Array]:
        """Measurements (m, 2), (m, 2, 2) as body points to first order; of a wall the one nearest to the sensor."""
        points, _, Gz = self.inverse(np.zeros(3), z)
        return points, Gz @ covariance @ Gz.transpose(0, 2, 1)

    def split(self, landmarks: Array) -> tuple[Array, Array]:
        """Those of landmarks (L, 2) that are points (n, 2), and those that are walls (k, 2): all are one of both."""
        return (landmarks, landmarks[:0]) if self.sees_points else (landmarks[:0], landmarks)

    def difference(self, a: Array, b: Array) -> tuple[Array, BoolArray]:
        """Landmarks a - b (n, 2), and which are walls with opposite normals: there b is taken as (-rho, alpha + pi)."""
        return a - b, np.zeros(len(a), np.bool_)

    def distances(self, landmarks: Array, pose: Array) -> Array:
        """Distances (L,) [m] of landmarks (L, 2) from a pose (3,), or from one for each (L, 3)."""
        return np.hypot(landmarks[:, 0] - pose[..., 0], landmarks[:, 1] - pose[..., 1])

    def residual(self, z: Array, z_hat: Array) -> Array:
        """Innovation z - z_hat, angles wrapped to (-pi, pi]; broadcasts over leading axes."""
        z, z_hat = np.asarray(z, float), np.asarray(z_hat, float)
        difference: Array = z - z_hat
        if self.kind != RELATIVE_POINT:
            difference[..., 1] = se2.wrap_angle(difference[..., 1])
        if self.kind == LINE:
            other = np.abs(difference[..., 1]) > 0.5 * math.pi
            difference[..., 0] = np.where(other, -z[..., 0] - z_hat[..., 0], difference[..., 0])
            difference[..., 1] = se2.wrap_angle(difference[..., 1] - math.pi * other)
        return difference

    def polar(self, z: Array) -> Array:
        """Range [m] and bearing [rad] in the sensor frame (m, 2) of measurements (m, 2)."""
        z = np.asarray(z, float)
        if self.kind != RELATIVE_POINT:
            return z
        return np.stack([np.hypot(z[..., 0], z[..., 1]), np.arctan2(z[..., 1], z[..., 0])], axis=-1)

    def in_view(self, z: Array, *, margin_range: Array | float = 0.0, margin_angle: Array | float = 0.0) -> BoolArray:
        """Whether measurements (m, 2) lie in the field of view, widened by the margins [m, rad]."""
        polar = self.polar(z)
        inside = polar[..., 0] <= self.max_range + margin_range
        middle, half = 0.5 * (self.min_angle + self.max_angle), 0.5 * (self.max_angle - self.min_angle)
        return np.asarray(inside & (np.abs(se2.wrap_angle(polar[..., 1] - middle)) <= half + margin_angle + 1e-12))


class RangeBearing(Sensor):
    """z = (range m, bearing rad counter-clockwise from the sensor's x axis)."""

    kind = RANGE_BEARING
    name = "range_bearing"


class RelativePoint(Sensor):
    """z = (x, y) m of the landmark in the sensor frame."""

    kind = RELATIVE_POINT
    name = "relative_point"
    units = ("m", "m")


class Line(Sensor):
    """z = (distance m, direction rad of the normal towards the wall, counter-clockwise from the sensor's x axis)."""

    kind = LINE
    name = "line"
    sees_points = False
    errors = ()

    def body_points(self, z: Array, covariance: Array) -> tuple[Array, Array]:
        """See `Sensor.body_points`."""
        return RangeBearing(rotation=self.rotation, translation=self.translation).body_points(z, covariance)

    def difference(self, a: Array, b: Array) -> tuple[Array, BoolArray]:
        """See `Sensor.difference`."""
        return self.residual(a, b), np.cos(a[:, 1] - b[:, 1]) < 0.0

    def distances(self, landmarks: Array, pose: Array) -> Array:
        """See `Sensor.distances`."""
        rho, alpha = landmarks.T
        return np.asarray(np.abs(rho - np.cos(alpha) * pose[..., 0] - np.sin(alpha) * pose[..., 1]))


class Bearing(Sensor):
    """z = (0, bearing rad counter-clockwise from the sensor's x axis), as of a camera."""

    kind = BEARING
    name = "bearing"
    measures = (1,)


class Range(Sensor):
    """z = (range m, 0), as of radio beacons. Its view has no angle."""

    kind = RANGE
    name = "range"
    measures = (0,)


@dataclass(frozen=True)
class EachSensor:
    """Several sensors, one for each observation: the methods of `Sensor` by row; `which` (m,) is a row in `sensors`."""

    sensors: tuple[Sensor, ...]
    which: IntArray

    def _each(self, name: str, *arrays: Array, locating: bool = False) -> Any:
        """A method of the sensors on rows of arrays; `locating`: NaN where an observation locates no landmark."""
        out: list[Array] = []
        for i, sensor in enumerate(self.sensors):
            rows = np.flatnonzero(self.which == i)
            if not len(rows) and (i or len(self.which)):
                continue
            found = getattr(sensor, name)(*(a[rows] for a in arrays))
            for q, part in enumerate(found if isinstance(found, tuple) else (found,)):
                if len(out) <= q:
                    out.append(np.empty((len(self.which), *part.shape[1:]), part.dtype))
                out[q][rows] = np.nan if locating and not sensor.locates else part
        return out[0] if len(out) == 1 else tuple(out)

    def linearize(self, pose: Array, landmarks: Array) -> tuple[Array, Array, Array]:
        """See `Sensor.linearize`."""
        found: tuple[Array, Array, Array] = self._each("linearize", *_pair(pose, landmarks))
        return found

    def predict(self, pose: Array, landmarks: Array) -> Array:
        """See `Sensor.predict`."""
        return self.linearize(pose, landmarks)[0]

    def jacobians(self, pose: Array, landmarks: Array) -> tuple[Array, Array]:
        """See `Sensor.jacobians`."""
        return self.linearize(pose, landmarks)[1:]

    def inverse(self, pose: Array, z: Array) -> tuple[Array, Array, Array]:
        """See `Sensor.inverse`; NaN where an observation does not locate its landmark."""
        found: tuple[Array, Array, Array] = self._each("inverse", *_pair(pose, z), locating=True)
        return found

    def body_points(self, z: Array, covariance: Array) -> tuple[Array, Array]:
        """See `Sensor.body_points`; NaN where an observation does not locate its landmark."""
        found: tuple[Array, Array] = self._each("body_points", z, covariance, locating=True)
        return found

    def residual(self, z: Array, z_hat: Array) -> Array:
        """See `Sensor.residual`, of (m, 2) each."""
        return np.asarray(self._each("residual", z, z_hat))

    def polar(self, z: Array) -> Array:
        """See `Sensor.polar`; zero in the place of what is not measured."""
        return np.asarray(self._each("polar", z))

    def in_view(self, z: Array) -> BoolArray:
        """See `Sensor.in_view`."""
        return np.asarray(self._each("in_view", z))

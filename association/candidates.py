"""Candidate landmarks: those in the sensor's range and field of view, widened by the uncertainty; faces of walls.

A wall has a face: the sign of the normal that was observed, and the stretch along which it was. It is an infinite line,
and the far side of one box may be collinear with the near side of another. So it is a candidate for an observation of
its other face only within the stretch where it was observed, as a thin wall.
"""

import math
from dataclasses import replace

import numpy as np
import scipy

from association.expectation import Expectation
from data.inputs import FrameObservations, Increment, IntArray
from data.se2 import Array, BoolArray, between, compose, wrap_angle
from data.sensors import BEARING, MIN_RANGE, RANGE_BEARING, RELATIVE_POINT, Sensor

SIGMAS = 3.0  # standard deviations of the expectation by which the field of view is widened, ...
MARGIN = math.radians(5.0)  # ... and an angle [rad] on top

FEW = 100  # number of landmarks up to which a search takes longer than to expect them all


def polar_sigma(sensor: Sensor, z_hat: Array, HPHt: Array) -> Array:
    """Standard deviations (n, 2) of range [m] and bearing [rad] of expected measurements with covariances (n, 2, 2)."""
    along, across = HPHt[:, 0, 0], HPHt[:, 1, 1]
    if sensor.kind == RELATIVE_POINT:
        r, trace = np.maximum(np.hypot(z_hat[:, 0], z_hat[:, 1]), MIN_RANGE), along + across
        x, y = z_hat[:, 0] / r, z_hat[:, 1] / r
        along = x * x * along + x * y * (HPHt[:, 0, 1] + HPHt[:, 1, 0]) + y * y * across
        across = (trace - along) / (r * r)
    return np.asarray(np.sqrt(np.maximum(np.stack([along, across], axis=1), 0.0)))


def in_view(sensor: Sensor, z_hat: Array, HPHt: Array) -> BoolArray:
    """Which expected measurements (n, 2) lie in the field of view, widened by 3 sigma of HPHt and 5 degrees."""
    sigma = SIGMAS * polar_sigma(sensor, z_hat, HPHt)
    return sensor.in_view(z_hat, margin_range=sigma[:, 0], margin_angle=np.minimum(sigma[:, 1] + MARGIN, math.pi))


def holding(sensor: Sensor, polar: Array) -> Sensor:
    """The sensor with its field of view widened to include ranges [m] and bearings [rad] (m, 2)."""
    low, high = polar.min(axis=0, initial=math.inf), polar.max(axis=0, initial=-math.inf)
    if high[0] <= sensor.max_range and low[1] >= sensor.min_angle and high[1] <= sensor.max_angle:
        return sensor
    least, most = min(sensor.min_angle, float(low[1])), max(sensor.max_angle, float(high[1]))
    return replace(sensor, max_range=max(sensor.max_range, float(high[0])), min_angle=least, max_angle=most)


def narrower(sensor: Sensor, other: Sensor) -> Sensor:
    """The sensor with the part of its field of view that is in the other's, too."""
    least, most = max(sensor.min_angle, other.min_angle), min(sensor.max_angle, other.max_angle)
    return replace(sensor, max_range=min(sensor.max_range, other.max_range), min_angle=least, max_angle=most)


def may_be_in_view(sensor: Sensor, pose: Array, xy: Array, sigma: Array, heading: Array) -> BoolArray:
    """A superset of `in_view` for points at xy (n, 2), without a joint covariance. `sigma` (n,) m, `heading` (n,) rad:
    bounds of their uncertainty relative to the robot, and of its heading's.
    """
    z_hat = sensor.predict(pose, xy)
    total = sigma + math.hypot(*sensor.translation) * heading
    angle = SIGMAS * (total / np.maximum(sensor.polar(z_hat)[:, 0], MIN_RANGE) + heading) + MARGIN
    return sensor.in_view(z_hat, margin_range=SIGMAS * total, margin_angle=np.minimum(angle, math.pi))


def view_radius(sensor: Sensor, P: Array) -> float:
    """Distance [m] from a robot of covariance P (3, 3) beyond which no landmark is `in_view`; infinite for walls."""
    if not sensor.sees_points:
        return math.inf
    lever = math.hypot(*sensor.translation)
    return sensor.max_range + lever + SIGMAS * (math.sqrt(P[0, 0] + P[1, 1]) + lever * math.sqrt(P[2, 2])) + 1e-9


def gate_radius(sensor: Sensor, P: Array, observations: FrameObservations, within: float) -> float:
    """Distance [m] from a robot of covariance P (3, 3) beyond which no known landmark passes the gate `within`.

    An observation z and an expectation within a squared Mahalanobis distance g have |range(z) - range| <= sqrt(g S)
    with S the variance of the expected range and of the noise (Cauchy-Schwarz). It is infinite for walls and bearings
    alone.
    """
    if not sensor.sees_points or sensor.kind == BEARING:
        return math.inf
    gate, lever = math.sqrt(within), math.hypot(*sensor.translation)
    R = observations.R
    noise = R[:, 0, 0] if sensor.kind != RELATIVE_POINT else np.trace(R, axis1=1, axis2=2)
    reach = float((sensor.polar(observations.z)[:, 0] + gate * np.sqrt(noise)).max(initial=0.0))
    return reach + lever + gate * (math.sqrt(P[0, 0] + P[1, 1]) + lever * math.sqrt(P[2, 2])) + 1e-9


class Places:
    """A k-d tree of landmarks that do not move."""

    def __init__(self, xy: Array) -> None:
        self._count, self._tree = len(xy), scipy.spatial.cKDTree(xy) if len(xy) > FEW else None

    def around(self, point: Array, radius: float) -> IntArray:
        """Rows (m,), ascending, of the landmarks within a radius [m] of a point (2,); of a few landmarks all."""
        if self._tree is None or not math.isfinite(radius):
            return np.arange(self._count)
        return np.array(self._tree.query_ball_point(point, radius, return_sorted=True), np.int64)


class UncertaintyBounds:
    """Bounds on each landmark's uncertainty relative to the robot, without a joint covariance.

    The lesser of two bounds. The first is the uncertainty when the landmark was last observed or expected, plus
    odometry since then. The second is the landmark's own uncertainty in the world plus the robot's. For points only.
    """

    def __init__(self) -> None:
        self._now = np.zeros(3)  # sums of position variances [m^2] and heading variances [rad^2], path length [m]
        self._then = np.empty((0, 6))
        """By landmark number: the sums when it was last observed or expected, its variance [m^2] and distance [m] then,
        and its sigma [m] in the world."""

    def move(self, increment: Increment) -> None:
        """Add the uncertainty of an increment."""
        mean, P = increment
        self._now = self._now + np.array([P[0, 0] + P[1, 1], P[2, 2], math.hypot(mean[0], mean[1])])

    def see(self, sensor: Sensor, observations: FrameObservations, numbers: IntArray, covariance: Array) -> None:
        """Landmarks `numbers` (m,) were observed from a pose of this covariance (3, 3)."""
        if not len(numbers):
            return
        self._room(numbers)
        variance = np.trace(observations.R, axis1=1, axis2=2)
        r = sensor.polar(observations.z)[:, 0]
        if sensor.kind == RANGE_BEARING:
            variance = observations.R[:, 0, 0] + r**2 * observations.R[:, 1, 1]
        self._then[numbers, :3], self._then[numbers, 3], self._then[numbers, 4] = self._now, variance, r
        lever = r + math.hypot(*sensor.translation)
        own = np.sqrt(covariance[0, 0] + covariance[1, 1]) + lever * math.sqrt(covariance[2, 2]) + np.sqrt(variance)
        self.know(numbers, own)

    def expect(self, sensor: Sensor, numbers: IntArray, z_hat: Array, HPHt: Array) -> None:
        """Landmarks `numbers` (n,) are expected at z_hat (n, 2) now, with covariances HPHt (n, 2, 2)."""
        r, sigma = sensor.polar(z_hat)[:, 0], polar_sigma(sensor, z_hat, HPHt)
        self._then[numbers, :3], self._then[numbers, 4] = self._now, r
        self._then[numbers, 3] = sigma[:, 0] ** 2 + (r * sigma[:, 1]) ** 2

    def know(self, numbers: IntArray, sigma: Array) -> None:
        """Bound the landmarks' standard deviation (n,) [m] in the world, which never grows."""
        self._room(numbers)
        self._then[numbers, 5] = np.minimum(self._then[numbers, 5], sigma)

    def _room(self, numbers: IntArray) -> None:
        """Rows for landmarks (n,); nothing is known of new ones."""
        more = int(numbers.max(initial=-1)) + 1 - len(self._then)
        if more > 0:
            self._then = np.concatenate([self._then, np.tile([0.0, 0.0, 0.0, np.inf, 0.0, np.inf], (more, 1))])

    def sigmas(self, numbers: IntArray, covariance: Array) -> tuple[Array, Array]:
        """Position (n,) [m] and heading (n,) [rad] bounds relative to a robot of this covariance (3, 3)."""
        self._room(numbers)
        then = self._then[numbers]
        position, heading, path = np.maximum(self._now - then[:, :3], 0.0).T
        relative = np.sqrt(then[:, 3] + position + heading * (path + then[:, 4]) ** 2)
        absolute = then[:, 5] + math.sqrt(covariance[0, 0] + covariance[1, 1])
        nearer = relative <= absolute
        return np.where(nearer, relative, absolute), np.sqrt(np.where(nearer, heading, covariance[2, 2]))


def aligned_with_observations(e: Expectation, sensor: Sensor) -> Expectation:
    """The same walls, each with the sign, (d, phi) or (-d, phi + pi), of the nearest observation; points as they are.
    An expectation may have either sign where the robot may be on either side of a wall.
    """
    if sensor.sees_points or not len(e.z) or not len(e.number):
        return e
    off = np.abs(sensor.residual(e.z[:, None], e.z_hat[None])[..., 0])
    turned = np.abs(wrap_angle(e.z[off.argmin(axis=0), 1] - e.z_hat[:, 1])) > 0.5 * math.pi
    if not turned.any():
        return e
    elsewhere, sign = e.elsewhere, np.where(turned, -1.0, 1.0)
    HPHt = e.HPHt.copy()
    HPHt[:, [0, 1], [1, 0]] *= sign[:, None]

    def joint(indices: IntArray) -> Array:
        signs = np.ones(2 * len(indices))
        signs[::2] = sign[indices]
        return np.asarray(e.joint(indices) * signs[:, None] * signs)

    z_hat = np.stack([sign * e.z_hat[:, 0], wrap_angle(e.z_hat[:, 1] + math.pi * turned)], axis=1)
    moved = None if elsewhere is None else lambda pose: aligned_with_observations(elsewhere(pose), sensor)
    return replace(e, z_hat=z_hat, HPHt=HPHt, joint=joint, elsewhere=moved)


BESIDE = 0.5  # m beyond the observed stretch: sonar hears the other face past a thin wall's end


class Faces:
    """For each landmark number, the direction of its normal when first observed, and the stretch observed since."""

    def __init__(self, sensor: Sensor) -> None:
        self._mounting = between(np.array([*sensor.translation, sensor.rotation]), np.zeros(3))
        self._direction = np.empty(0)
        self._stretch = np.empty((0, 2))

    def visible(self, pose: Array, covariance: Array, number: IntArray, z_hat: Array) -> BoolArray:
        """Which landmarks (n,), expected at z_hat (n, 2), may be observed from a pose (3,) with covariance (3, 3)."""
        normal, foot = self._in_world(pose, z_hat)
        first = self._direction[number]
        along = _along(foot, first)
        margin = BESIDE + SIGMAS * math.sqrt(covariance[0, 0] + covariance[1, 1])
        near = (along >= self._stretch[number, 0] - margin) & (along <= self._stretch[number, 1] + margin)
        return np.asarray((np.cos(normal - first) >= 0.0) | near)

    def see(self, pose: Array, number: IntArray, z: Array) -> None:
        """Landmarks `number` (m,) were observed at z (m, 2) from a pose (3,)."""
        if not len(number):
            return
        more = int(number.max()) + 1 - len(self._direction)
        if more > 0:
            self._direction = np.concatenate([self._direction, np.full(more, np.nan)])
            self._stretch = np.concatenate([self._stretch, np.tile([np.inf, -np.inf], (more, 1))])
        normal, foot = self._in_world(pose, z)
        for k, n in enumerate(number.tolist()):
            if math.isnan(self._direction[n]):
                self._direction[n] = normal[k]
            along = float(_along(foot[k], self._direction[n]))
            low, high = self._stretch[n]
            self._stretch[n] = min(low, along), max(high, along)

    def _in_world(self, pose: Array, z: Array) -> tuple[Array, Array]:
        """Directions (n,) of normals towards walls at z (n, 2), and feet (n, 2) of the perpendiculars, world frame."""
        x, y, heading = compose(pose, self._mounting)
        normal = heading + z[:, 1]
        return normal, np.stack([x + z[:, 0] * np.cos(normal), y + z[:, 0] * np.sin(normal)], axis=1)


def _along(foot: Array, direction: Array | float) -> Array:
    return np.asarray(foot[..., 1] * np.cos(direction) - foot[..., 0] * np.sin(direction))

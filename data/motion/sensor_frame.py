"""The frame in which a sensor's systematic errors vanish: there and back, with Jacobians.

A pose X of the robot is there X' = S X E Rot(-bearing), a point l is S l: E is the sensor's mount on the robot, S
scales the world by (1 + range) about a fixed origin. Bearings measured true + bearing and ranges measured (1 + range)
times the true ones are right there, whatever the errors are. `data.motion.systematic` says what becomes of the
increments.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from data.inputs import Prior, Systematic
from data.se2 import Array, compose, inverse, wrap_angle
from data.sensors import Sensor


@dataclass(frozen=True, eq=False)
class SensorFrame:
    """The sensor's frame, where there are errors of a sensor, or else the robot's own, where nothing is to be done.

    Attributes:
        mount: (3,) pose of the sensor on the robot (zero: the robot's own frame).
        origin: (2,) m; what the world is scaled about.
        range_at, bearing_at: where these errors stand among those estimated, -1: they are not estimated.
    """

    mount: Array
    origin: Array
    range_at: int
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
        """Poses (n, 3) of the robot from those there, under errors (n, p), and Jacobians (n, 3, 3 + p) to both.

        World frame, additive, in both.
        """
        n, p = errors.shape
        J = np.zeros((n, 3, 3 + p))
        J[:, 0, 0] = J[:, 1, 1] = J[:, 2, 2] = 1.0
        if self.same:
            return pose.copy(), J
        r, bearing = self._errors(errors)
        heading = pose[:, 2] + bearing - self.mount[2]
        c, s = np.cos(heading), np.sin(heading)
        # where the mount is from the robot's centre, and how that turns
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
        """Poses (n, 3) there of the robot's (n, 3), under errors (n, p)."""
        if self.same:
            return pose.copy()
        r, bearing = self._errors(errors)
        seen = compose(pose, self.mount)
        seen[:, :2] = self.origin + (seen[:, :2] - self.origin) * (1.0 + r)[:, None]
        seen[:, 2] = wrap_angle(seen[:, 2] - bearing)
        return seen

    def points_out(self, xy: Array, errors: Array) -> tuple[Array, float, Array]:
        """Points (n, 2) from those there, under errors (p,); their Jacobian to those there, a scalar; to the errors
        (n, 2, p).
        """
        r = float(self._errors(errors)[0])
        out = self.origin + (xy - self.origin) / (1.0 + r)
        J = np.zeros((len(xy), 2, len(errors)))
        if self.range_at >= 0:
            J[:, :, self.range_at] = -(out - self.origin) / (1.0 + r)
        return out, 1.0 / (1.0 + r), J

    def points_in(self, xy: Array, errors: Array) -> tuple[Array, Array]:
        """Points (n, 2) there of points (n, 2) of the world, under errors (p,); Jacobian (n, 2, p) to the errors."""
        r = float(self._errors(errors)[0])
        J = np.zeros((len(xy), 2, len(errors)))
        if self.range_at >= 0:
            J[:, :, self.range_at] = xy - self.origin
        return self.origin + (xy - self.origin) * (1.0 + r), J

    def prior_in(self, prior: Prior, sigma: Array) -> tuple[Array, Array]:
        """Mean (3 + p,) and covariance (3 + p, 3 + p) there of the first pose and the errors, a priori zero."""
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
        """The sensor as it is there: at the origin of its own frame."""
        return sensor if self.same else replace(sensor, rotation=0.0, translation=(0.0, 0.0))


def sensor_frame(systematic: Systematic | None, sensor: Sensor, prior: Prior) -> SensorFrame:
    """The frame to work in, scaled about where the sensor is first."""
    names = () if systematic is None else systematic.names
    at = [names.index(n) if n in names else -1 for n in ("range", "bearing")]
    rotation, tx, ty = sensor.extrinsic
    mount = inverse(np.array([tx, ty, rotation])) if max(at) >= 0 else np.zeros(3)
    return SensorFrame(mount, compose(prior.mean, mount)[:2], at[0], at[1])

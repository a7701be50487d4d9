"""Sensors: what of a landmark is measured, its field of view, and the compiled formulas (`data.sensors.kernels`)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from data import se2
from data.se2 import Array, BoolArray
from data.sensors.kernels import (
    LINE,
    MIN_RANGE,
    RANGE_BEARING,
    RELATIVE_POINT,
    invert,
    invert_all,
    measure,
    measure_all,
    name_as_read,
    residual,
    wrap_angle,
)

__all__ = [
    "LINE",
    "MIN_RANGE",
    "RANGE_BEARING",
    "RELATIVE_POINT",
    "Line",
    "RangeBearing",
    "RelativePoint",
    "Sensor",
    "invert",
    "measure",
    "name_as_read",
    "residual",
    "wrap_angle",
]


def _pair(pose: Array, other: Array) -> tuple[Array, Array]:
    """One row of pose per row of `other`, contiguous float64."""
    rows = np.ascontiguousarray(np.atleast_2d(np.asarray(other, float)))
    poses = np.ascontiguousarray(np.broadcast_to(np.asarray(pose, float), (len(rows), 3)))
    return poses, rows


@dataclass(frozen=True)
class Sensor:
    """A sensor that sees landmarks; use `RangeBearing`, `RelativePoint` or `Line`.

    Attributes:
        max_range: m; min_angle, max_angle: rad in the sensor frame. They describe the field of view; an observation
            outside is kept and counted, never dropped.
        rotation: rad, translation: m, of p_sensor = R(rotation) p_body + translation.
    """

    max_range: float = math.inf
    min_angle: float = -math.pi
    max_angle: float = math.pi
    rotation: float = 0.0
    translation: tuple[float, float] = (0.0, 0.0)

    kind: ClassVar[int]
    name: ClassVar[str]
    units: ClassVar[tuple[str, str]]
    sees_points: ClassVar[bool] = True
    """Whether a landmark is a point (x, y); else a wall (rho, alpha)."""

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
        """Expected measurements and both Jacobians, in one pass."""
        poses, points = _pair(pose, landmarks)
        n = len(points)
        z_hat, Hx, Hl = np.empty((n, 2)), np.empty((n, 2, 3)), np.empty((n, 2, 2))
        measure_all(self.kind, self.extrinsic, poses, points, z_hat, Hx, Hl)
        return z_hat, Hx, Hl

    def inverse(self, pose: Array, z: Array) -> tuple[Array, Array, Array]:
        """Landmarks (m, 2) that would give z (m, 2), with Jacobians (m, 2, 3) to the pose and (m, 2, 2) to z."""
        poses, rows = _pair(pose, z)
        n = len(rows)
        landmark, Gx, Gz = np.empty((n, 2)), np.empty((n, 2, 3)), np.empty((n, 2, 2))
        invert_all(self.kind, self.extrinsic, poses, rows, landmark, Gx, Gz)
        return landmark, Gx, Gz

    def body_points(self, z: Array, covariance: Array) -> tuple[Array, Array]:
        """Measurements (m, 2) with covariances (m, 2, 2) as points of the body frame with theirs, to first order.

        The point of a wall is the one nearest to the sensor.
        """
        points, _, Gz = self._polar_sensor().inverse(np.zeros(3), z)
        return points, Gz @ covariance @ Gz.transpose(0, 2, 1)

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

    def _polar_sensor(self) -> Sensor:
        """The sensor of points, with this one's extrinsic, that a measurement is plotted by."""
        if self.sees_points:
            return self
        return RangeBearing(rotation=self.rotation, translation=self.translation)

    def polar(self, z: Array) -> Array:
        """Range [m] and bearing [rad] in the sensor frame (m, 2) of measurements (m, 2)."""
        z = np.asarray(z, float)
        if self.kind != RELATIVE_POINT:
            return z
        return np.stack([np.hypot(z[..., 0], z[..., 1]), np.arctan2(z[..., 1], z[..., 0])], axis=-1)

    def in_view(self, z: Array, *, margin_range: Array | float = 0.0, margin_angle: Array | float = 0.0) -> BoolArray:
        """Whether measurements (m, 2) lie in the field of view, widened by the margins [m, rad]; bool (m,)."""
        polar = self.polar(z)
        inside = polar[..., 0] <= self.max_range + margin_range
        middle, half = 0.5 * (self.min_angle + self.max_angle), 0.5 * (self.max_angle - self.min_angle)
        view: BoolArray = inside & (np.abs(se2.wrap_angle(polar[..., 1] - middle)) <= half + margin_angle + 1e-12)
        return view


class RangeBearing(Sensor):
    """z = (range m, bearing rad counter-clockwise from the sensor's x axis)."""

    kind = RANGE_BEARING
    name = "range_bearing"
    units = ("m", "rad")


class RelativePoint(Sensor):
    """z = (x, y) m of the landmark in the sensor frame."""

    kind = RELATIVE_POINT
    name = "relative_point"
    units = ("m", "m")


class Line(Sensor):
    """z = (distance m, direction rad of the normal towards the wall, counter-clockwise from the sensor's x axis)."""

    kind = LINE
    name = "line"
    units = ("m", "rad")
    sees_points = False

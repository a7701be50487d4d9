"""Faces of walls: the sign of a normal, the face that was observed, and the stretch along which it was observed.

A landmark is an infinite line, and the far side of one box may be collinear with the near side of another. A wall is a
candidate for an observation of its other face only within the stretch where it was observed, as a thin wall.
"""

import math
from dataclasses import replace

import numpy as np

from association.expectation import Expectation
from data.inputs import IntArray
from data.se2 import Array, BoolArray, between, compose, wrap_angle
from data.sensors import Sensor

MARGIN = 0.5  # m beyond the observed stretch: sonar hears the other face past a thin wall's end
SIGMAS = 3.0


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
        S: Array = e.joint(indices) * signs[:, None] * signs
        return S

    z_hat = np.stack([sign * e.z_hat[:, 0], wrap_angle(e.z_hat[:, 1] + math.pi * turned)], axis=1)
    moved = None if elsewhere is None else lambda pose: aligned_with_observations(elsewhere(pose), sensor)
    return replace(e, z_hat=z_hat, HPHt=HPHt, joint=joint, elsewhere=moved)


class Faces:
    """For each landmark number, the direction of its normal when first observed, and the stretch observed since."""

    def __init__(self, sensor: Sensor) -> None:
        self._sensor = sensor
        self._mounting = between(np.array([*sensor.translation, sensor.rotation]), np.zeros(3))
        self._direction = np.empty(0)
        self._stretch = np.empty((0, 2))

    def visible(self, pose: Array, covariance: Array, number: IntArray, z_hat: Array) -> BoolArray:
        """Which landmarks (n,), expected at z_hat (n, 2), may be observed from a pose (3,) with covariance (3, 3)."""
        normal, foot = self._in_world(pose, z_hat)
        first = self._direction[number]
        along = _along(foot, first)
        margin = MARGIN + SIGMAS * math.sqrt(covariance[0, 0] + covariance[1, 1])
        near = (along >= self._stretch[number, 0] - margin) & (along <= self._stretch[number, 1] + margin)
        visible: BoolArray = (np.cos(normal - first) >= 0.0) | near
        return visible

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
    along: Array = foot[..., 1] * np.cos(direction) - foot[..., 0] * np.sin(direction)
    return along

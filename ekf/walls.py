"""Walls as landmarks of a filter: the frame of EKF-SLAM, and the options that walls exclude.

The plain EKF's NEES depends on the origin of (rho, alpha): a heading error moves rho by the lever arm from there. With
the origin at the first pose, which is known best, it is consistent in a room; 100 m away it is not.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from data.motion.systematic import SensorFrame
from data.result import MapState
from data.se2 import Array, wrap_angle
from data.sensors import Sensor


@dataclass(frozen=True, eq=False)
class WallFrame(SensorFrame):
    """The world moved so that its origin is `origin`; the points of `SensorFrame` are walls here."""

    @property
    def same(self) -> bool:
        """False: poses and walls differ from those in the world."""
        return False

    def poses_out(self, pose: Array, errors: Array) -> tuple[Array, Array]:
        """Poses (n, 3) in the world and their Jacobians (n, 3, 3 + p) to pose and errors (n, p)."""
        return pose + self._shift, np.tile(np.eye(3, 3 + errors.shape[1]), (len(pose), 1, 1))

    def poses_in(self, pose: Array, errors: Array) -> Array:
        """Poses (n, 3) in this frame."""
        return pose - self._shift

    @property
    def _shift(self) -> Array:
        return np.array([self.origin[0], self.origin[1], 0.0])

    def points_out(self, xy: Array, errors: Array) -> tuple[Array, float, Array]:
        """Walls (n, 2) about the world's origin, alpha wrapped; scale 1, and zero Jacobians to the errors (p,)."""
        return self._moved(xy, self.origin), 1.0, np.zeros((len(xy), 2, len(errors)))

    def points_in(self, xy: Array, errors: Array) -> tuple[Array, Array]:
        """Walls (n, 2) about the origin of this frame, and zero Jacobians to the errors (p,)."""
        return self._moved(xy, -self.origin), np.zeros((len(xy), 2, len(errors)))

    def walls_out(self, map_: MapState) -> MapState:
        """The map about the world's origin, with its covariances."""
        alpha = map_.xy[:, 1]
        J = np.tile(np.eye(2), (len(alpha), 1, 1))
        J[:, 0, 1] = np.cos(alpha) * self.origin[1] - np.sin(alpha) * self.origin[0]
        covariance = J @ map_.covariance @ J.transpose(0, 2, 1)
        covariance = 0.5 * (covariance + covariance.transpose(0, 2, 1))
        return MapState(map_.number, self._moved(map_.xy, self.origin), covariance)

    def sensor(self, sensor: Sensor) -> Sensor:
        """The sensor as it is: this is the robot's own frame."""
        return sensor

    @staticmethod
    def _moved(walls: Array, by: Array) -> Array:
        """Walls (n, 2) about a point at -by."""
        rho, alpha = walls.T
        return np.stack([rho + np.cos(alpha) * by[0] + np.sin(alpha) * by[1], wrap_angle(alpha)], axis=1)

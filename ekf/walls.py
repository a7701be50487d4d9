"""Walls as landmarks of a filter: the frame that EKF-SLAM works in, and what does not hold of walls.

The plain EKF's NEES depends on the point that (rho, alpha) are about: an error of the heading moves rho by the lever
from there. With that point where the robot begins, whose pose is known best, it stays consistent in a room; 100 m away
it does not. So EKF-SLAM works in the world moved to the first pose, and hands poses and walls out in the world.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from data.inputs import Prior, Systematic
from data.motion.systematic import SensorFrame, sensor_frame
from data.result import MapState
from data.se2 import Array, wrap_angle
from data.sensors import Sensor


class Options(Protocol):
    """What of `ekf.filter.FilterOptions` is asked here."""

    @property
    def invariant(self) -> bool:
        """Whether pose and landmarks are moved together."""
        ...

    @property
    def new_variance(self) -> float | None:
        """Of a new landmark, if it is stated."""
        ...

    @property
    def new_variance_per_square(self) -> float | None:
        """The same as a share of its squared distance."""
        ...


@dataclass(frozen=True, eq=False)
class WallFrame(SensorFrame):
    """The world moved so that its origin is `origin`; what is called points in `SensorFrame` are walls here."""

    @property
    def same(self) -> bool:
        """False: poses and walls differ from those in the world."""
        return False

    def poses_out(self, pose: Array, errors: Array) -> tuple[Array, Array]:
        """Poses (n, 3) in the world and their Jacobians (n, 3, 3 + p) to those here and to the errors (n, p)."""
        return pose + self._shift, np.tile(np.eye(3, 3 + errors.shape[1]), (len(pose), 1, 1))

    def poses_in(self, pose: Array, errors: Array) -> Array:
        """Poses (n, 3) here of those in the world."""
        return pose - self._shift

    @property
    def _shift(self) -> Array:
        return np.array([self.origin[0], self.origin[1], 0.0])

    def points_out(self, xy: Array, errors: Array) -> tuple[Array, float, Array]:
        """Walls (n, 2) about the world's origin, alpha wrapped; no scale, and nothing depends on the errors (p,)."""
        return self._moved(xy, self.origin), 1.0, np.zeros((len(xy), 2, len(errors)))

    def points_in(self, xy: Array, errors: Array) -> tuple[Array, Array]:
        """Walls (n, 2) about the origin here; nothing depends on the errors (p,)."""
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
        """The sensor as it is: the robot's frame is its own."""
        return sensor

    @staticmethod
    def _moved(walls: Array, by: Array) -> Array:
        """Walls (n, 2) about a point that stands at -by."""
        rho, alpha = walls.T
        return np.stack([rho + np.cos(alpha) * by[0] + np.sin(alpha) * by[1], wrap_angle(alpha)], axis=1)


def frame_of(
    systematic: Systematic | None, sensor: Sensor, prior: Prior, options: Options, *, slam: bool
) -> SensorFrame:
    """The frame that a filter works in. Raises ValueError for what it cannot do with walls (see `lack`)."""
    if sensor.sees_points:
        return sensor_frame(systematic, sensor, prior)
    why = lack(options, systematic, slam=slam)
    if why is not None:
        raise ValueError(why)
    if not slam:
        return sensor_frame(systematic, sensor, prior)
    return WallFrame(np.zeros(3), np.array(prior.mean[:2]), -1, -1)


def lack(options: Options, systematic: Systematic | None, *, slam: bool) -> str | None:
    """What a filter with these options and errors cannot do with walls, in a sentence; None if nothing."""
    if slam and options.invariant:
        return "the invariant correction moves landmarks as points; walls need another filter"
    if slam and (options.new_variance is not None or options.new_variance_per_square is not None):
        return "a new wall has a distance and a direction, which have no variance in common"
    if systematic is not None and systematic.of_sensor:
        return "errors of range and bearing are those of points; of walls, errors of odometry can be estimated"
    return None

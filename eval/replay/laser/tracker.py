"""Scan-matching odometry: each scan against the last key scans, with odometry as a robust prior."""

from __future__ import annotations

import math

import numpy as np

from association.scans.matching import Match, MotionPrior, NearestGrid, match
from association.scans.points import Points
from association.scans.uncertainty import compose_covariances
from data.se2 import Array, between, compose, transform_points, wrap_angle
from eval.replay.laser.parameters import LaserParameters

REACH = 0.3  # m, the farthest partner of a point
OTHER_START = np.array([0.03, 0.03, 0.01])
"""m, m, rad: a prediction by the last motion that differs from odometry by more is a second start."""
BETTER = 0.02  # least decrease of cost by the second start; where both fit (a corridor), odometry wins
SURPRISE, MUCH_BETTER = 25.0, 0.1
"""Chi-square (3 dof) from which a match contradicts odometry: the wheels slipped, or the scan was matched to the wrong
surface. It is accepted if its cost is smaller by this much than that of a match that keeps to odometry."""
FIRM = 1e3  # scale of a prior that does not yield, in standard deviations


class Tracker:
    """The robot's pose relative to the newest key pose, frame by frame."""

    def __init__(self, parameters: LaserParameters, sigma: float) -> None:
        self.parameters = parameters
        self.sigma = parameters.distance_sigma(sigma)
        self.pose, self.covariance = np.zeros(3), np.zeros((3, 3))
        self._grid = NearestGrid(parameters.max_range + 2.0, REACH)
        self._keys: list[Points] = []
        self._matched = np.zeros(3)
        self._motion = np.zeros(3)
        self._frames = 0

    def predict(self, motion: Array, covariance: Array) -> None:
        """Add the odometry of one frame."""
        self.covariance = compose_covariances(self.pose, self.covariance, motion, covariance)
        self.pose = compose(self.pose, motion)
        self.pose[2] = wrap_angle(float(self.pose[2]))
        self._frames += 1

    def correct(self, points: Points) -> bool:
        """Match the frame's scan; returns False if it does not fit and the prediction is kept."""
        if not self._keys or len(points.xy) == 0:
            return False
        prior = MotionPrior(self.pose, np.asarray(np.linalg.inv(self.covariance + 1e-10 * np.eye(3)), float))
        best = self._match(points, self.pose, prior)
        start = self._matched
        for _ in range(self._frames):
            start = compose(start, self._motion)
        apart = start - self.pose
        apart[2] = wrap_angle(float(apart[2]))
        if (np.abs(apart) > OTHER_START).any():
            other = self._match(points, start, prior)
            if other.cost < best.cost - BETTER:
                best = other
        error = best.pose - self.pose
        error[2] = wrap_angle(float(error[2]))
        if error @ prior.information @ error > SURPRISE:
            held = self._match(points, self.pose, prior, FIRM)
            if best.cost > held.cost - MUCH_BETTER:
                best = held
        if best.share < self.parameters.least_share:
            return False
        self._motion = between(self._matched, best.pose) / max(self._frames, 1)
        self.pose, self.covariance = best.pose, best.covariance
        self._matched, self._frames = best.pose, 0
        return True

    def _match(self, points: Points, start: Array, prior: MotionPrior, prior_scale: float = 0.0) -> Match:
        scale = prior_scale or self.parameters.prior_scale
        return match(points, self._reference, start, prior, self.sigma, scale)

    @property
    def is_due(self) -> bool:
        """Whether the next key pose is due: the newest one is far, or nothing has been seen yet."""
        p = self.parameters
        if not any(len(k.xy) for k in self._keys):
            return True
        far = math.hypot(self.pose[0], self.pose[1]) >= p.keyframe_distance
        return far or abs(float(self.pose[2])) >= p.keyframe_angle

    def make_key(self, points: Points) -> None:
        """Make the current pose the key pose; its scan joins the reference."""
        back = between(self.pose, np.zeros(3))
        moved = [Points(transform_points(back, k.xy), rotated(back[2], k.normal)) for k in self._keys]
        self._keys = [*moved, points][-self.parameters.window :]
        self._reference = self._grid.reference(
            np.concatenate([k.xy for k in self._keys]), np.concatenate([k.normal for k in self._keys])
        )
        self._matched = between(self.pose, self._matched)
        self.pose, self.covariance = np.zeros(3), np.zeros((3, 3))


def rotated(theta: float, vectors: Array) -> Array:
    """Vectors (n, 2) rotated by theta [rad]."""
    c, s = math.cos(theta), math.sin(theta)
    turned: Array = vectors @ np.array([[c, s], [-s, c]])
    return turned

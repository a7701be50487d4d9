"""Fixed transforms between the frames of a robot, as tf states them: chains of rotations and translations."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from data.se2 import Array

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]
"""(x, y, z, w)."""


@dataclass(frozen=True)
class Transform:
    """p_parent = R p_child + t: R (3, 3), t (3,) m."""

    R: Array
    t: Array

    def __matmul__(self, other: Transform) -> Transform:
        return Transform(self.R @ other.R, self.R @ other.t + self.t)

    def inverse(self) -> Transform:
        """p_child = R' p_parent - R' t."""
        return Transform(self.R.T, -self.R.T @ self.t)


def heading(q: Quaternion) -> float:
    """Heading [rad] of a rotation: the angle of its x axis in the plane; NaN if the quaternion is none."""
    R = rotation_of(q)
    return math.atan2(R[1, 0], R[0, 0])


def rotation_of(q: Quaternion) -> Array:
    """Rotation matrix (3, 3) of a quaternion of any length above 0; NaN for one of length 0."""
    x, y, z, w = np.array(q, float) / (math.sqrt(sum(v * v for v in q)) or math.nan)
    return np.array(
        [
            [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - z * w), 2.0 * (x * z + y * w)],
            [2.0 * (x * y + z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - x * w)],
            [2.0 * (x * z - y * w), 2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y)],
        ]
    )


@dataclass
class Transforms:
    """The first transform stated for each frame to its parent: a laser's does not move."""

    parent: dict[str, tuple[str, Transform]] = field(default_factory=dict)

    def add(self, parent: str, child: str, translation: Vector, rotation: Quaternion) -> None:
        """Keep what is stated about a frame, unless something was before."""
        entry = (_name(parent), Transform(rotation_of(rotation), np.array(translation, float)))
        self.parent.setdefault(_name(child), entry)

    def between(self, target: str, source: str) -> Transform | None:
        """p_target = R p_source + t, by the frames above both; None where they are not connected."""
        up, down = self._chain(target), self._chain(source)
        for name, to_common in up.items():
            if name in down:
                return to_common.inverse() @ down[name]
        return None

    def _chain(self, name: str) -> dict[str, Transform]:
        """The frame itself and each above it, with the transform from the frame to it."""
        name, so_far = _name(name), Transform(np.eye(3), np.zeros(3))
        chain = {name: so_far}
        while name in self.parent:
            name, step = self.parent[name]
            if name in chain:  # a circle
                break
            so_far = step @ so_far
            chain[name] = so_far
        return chain


def _name(frame: str) -> str:
    """ROS 1 wrote names with a slash in front."""
    return frame.lstrip("/")

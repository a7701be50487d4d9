"""What a trajectory of somebody else is here: poses in the plane at stamps, and the covariance claimed for them."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from data.inputs import read_only
from data.se2 import Array

WORLD, LOCAL, LEFT = "world", "local", "left"
FRAMES = (WORLD, LOCAL, LEFT)
"""What a covariance is of: errors added in the world's axes; T = T_mean Exp(xi), in the body's axes (right
perturbation); T = Exp(xi) T_mean, in the world's axes about its origin (left perturbation)."""
ROBOT, CAMERA = "robot", "camera"
AXES = (ROBOT, CAMERA)
"""Axes of world and body: x forward, y left, z up (REP 103); or x right, y down, z forward, as KITTI's poses have."""


@dataclass(frozen=True)
class Outside:
    """What the plane has no room for: least and largest z [m], roll and pitch [rad] of a trajectory in space."""

    z: tuple[float, float]
    roll: tuple[float, float]
    pitch: tuple[float, float]


@dataclass(frozen=True, eq=False)
class GivenPath:
    """A trajectory as a file gives it, in the plane.

    Attributes:
        file: where it was read, with the topic of a bag.
        kind: the format, in words.
        time: (n,) s, strictly increasing.
        pose: (n, 3) x [m], y [m], heading [rad].
        covariance: (n, 3, 3) of errors added in the world's axes [x, y, heading]; rows NaN where unknown; None: the
            file has none.
        frame: what the file's covariance was of (`FRAMES`), before it was turned into the above; "" without one.
        outside: of a trajectory in space; None where the file is planar itself.
        notes: what was left out or taken as given, a sentence each.
    """

    file: str
    kind: str
    time: Array
    pose: Array
    covariance: Array | None = None
    frame: str = ""
    outside: Outside | None = None
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        read_only(self)

    def __len__(self) -> int:
        return len(self.time)

    @property
    def digest(self) -> str:
        """sha256 over all that was read."""
        digest = hashlib.sha256(self.time.tobytes() + self.pose.tobytes())
        if self.covariance is not None:
            digest.update(self.covariance.tobytes())
        return digest.hexdigest()


@dataclass(frozen=True)
class Manner:
    """What a file may not say of itself, and the person does.

    Attributes:
        cov: file with the covariances of a TUM file.
        times: file with the stamps of KITTI poses.
        frame: of the covariances (`FRAMES`); None: as the format has them.
        axes: of a trajectory in space (`AXES`).
    """

    cov: Path | None = None
    times: Path | None = None
    frame: str | None = None
    axes: str = ROBOT


def in_order(time: Array) -> Array:
    """Rows (k,) that count where stamps (n,) ascend: of several with one stamp the last."""
    keep = np.append(np.diff(time) > 0.0, True)
    return np.asarray(np.flatnonzero(keep))

"""Trajectories of other programs: poses in space and in the plane at stamps, with claimed covariances."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from data.formats.results.clock import Clock
from data.locked import Locked
from data.se2 import Array

WORLD, LOCAL, LEFT, MIXED = "world", "local", "left", "mixed"
FRAMES = (WORLD, LOCAL, LEFT, MIXED)
"""Frame of a covariance: additive errors in the world's axes; T = T_mean Exp(xi), in the body's axes (right
perturbation); T = Exp(xi) T_mean, in the world's axes about its origin (left perturbation); position in the world's
axes and rotation in the body's (OpenVINS)."""
ROBOT, CAMERA = "robot", "camera"
AXES = (ROBOT, CAMERA)
"""Axes of world and body: x forward, y left, z up (REP 103); or x right, y down, z forward, as in KITTI."""
TRANSLATION, ROTATION = "translation-first", "rotation-first"
COV_ORDERS = (TRANSLATION, ROTATION)


@dataclass(frozen=True)
class Outside:
    """Ranges outside the plane of a trajectory in space: z [m], roll and pitch [rad]."""

    z: tuple[float, float]
    roll: tuple[float, float]
    pitch: tuple[float, float]


@dataclass(frozen=True)
class Stated:
    """What a file states about itself; empty: nothing.

    Attributes:
        world, body: names of its frames.
        convention: whether it states the frame of its covariances.
        order: whether it states the order of their tangent.
        axes: whether the axes are those of its format (not chosen by a flag).
    """

    world: str = ""
    body: str = ""
    convention: bool = False
    order: bool = False
    axes: bool = False


SILENT, UNKNOWN = Stated(), Clock()


@dataclass(frozen=True, eq=False)
class Spatial(Locked):
    """A trajectory in space.

    Attributes:
        file, kind: as of `GivenPath`.
        time: (n,) s, ascending.
        position: (n, 3) m.
        rotation: (n, 3, 3), world from body.
        covariance: (n, 6, 6), translation first, then rotation; rows NaN where unknown; None: none.
        frame: of the covariance (`FRAMES`).
        place: place of row k, for messages.
        notes: sentences.
    """

    file: str
    kind: str
    time: Array
    position: Array
    rotation: Array
    covariance: Array | None
    frame: str
    place: Callable[[int], str]
    stated: Stated = SILENT
    notes: tuple[str, ...] = ()
    clock: Clock = UNKNOWN

    def __len__(self) -> int:
        return len(self.time)


@dataclass(frozen=True, eq=False)
class GivenPath(Locked):
    """A trajectory of a file, in the plane.

    Attributes:
        file: its name, with the topic of a bag.
        kind: the format, in words.
        time: (n,) s, strictly increasing.
        pose: (n, 3) x [m], y [m], heading [rad].
        covariance: (n, 3, 3) of additive errors in the world's axes [x, y, heading]; rows NaN where unknown; None:
            none.
        frame: of the file's covariance (`FRAMES`), before conversion; "" without one.
        outside: of a trajectory in space; None for a planar file.
        notes: sentences about ignored or assumed things.
        clock: unit of the file's stamps.
        space: the trajectory in space at the same stamps, in a robot's axes; None for a planar file.
        transforms: of other frames, from the same file; None: none.
        headings: (n,) of a planar file before wrapping, if the file does not state their unit; read as rad.
    """

    file: str
    kind: str
    time: Array
    pose: Array
    covariance: Array | None = None
    frame: str = ""
    outside: Outside | None = None
    notes: tuple[str, ...] = ()
    clock: Clock = UNKNOWN
    space: Spatial | None = None
    transforms: object | None = None
    headings: Array | None = None

    def __len__(self) -> int:
        return len(self.time)

    @property
    def digest(self) -> str:
        """SHA-256 of all numbers."""
        digest = hashlib.sha256(self.time.tobytes() + self.pose.tobytes())
        if self.covariance is not None:
            digest.update(self.covariance.tobytes())
        return digest.hexdigest()


def restamped(path: GivenPath, time: Array, clock: Clock) -> GivenPath:
    """The trajectory at other stamps (n,) [s]."""
    kind = path.kind.replace(path.clock.words, clock.words)
    space = None if path.space is None else replace(path.space, time=time, clock=clock, kind=kind)
    return replace(path, time=time, clock=clock, kind=kind, space=space)


@dataclass(frozen=True)
class Manner:
    """User options that complete a file.

    Attributes:
        cov: file with the covariances of a TUM file.
        times: file with the stamps of KITTI poses.
        frame: of the covariances (`FRAMES`); None: the format's.
        axes: of a trajectory in space (`AXES`); None: the format's.
        order: of the covariances' tangent (`COV_ORDERS`); None: the file's.
        stamps: unit of the stamps; None: as stated or inferred.
        angles: unit of headings, roll and pitch (`rad`, `deg`); None: as stated, else rad.
        lengths: unit of positions (`m`, `cm`, `mm`); None: as stated, else m.
    """

    cov: Path | None = None
    times: Path | None = None
    frame: str | None = None
    axes: str | None = None
    order: str | None = None
    stamps: str | None = None
    angles: str | None = None
    lengths: str | None = None


def in_order(time: Array) -> Array:
    """Rows (k,) to keep of ascending stamps (n,): the last of equal ones."""
    keep = np.append(np.diff(time) > 0.0, True)
    return np.asarray(np.flatnonzero(keep))

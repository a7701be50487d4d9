"""Trajectories of other programs: poses in the plane at stamps, with claimed covariances, and numbers of text files."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from data.errors import LARGEST, DataError
from data.formats.csv_table import cut_off, is_number
from data.inputs import Locked
from data.se2 import Array

WORLD, LOCAL, LEFT = "world", "local", "left"
FRAMES = (WORLD, LOCAL, LEFT)
"""Frame of a covariance: additive errors in the world's axes; T = T_mean Exp(xi), in the body's axes (right
perturbation); T = Exp(xi) T_mean, in the world's axes about its origin (left perturbation)."""
ROBOT, CAMERA = "robot", "camera"
AXES = (ROBOT, CAMERA)
"""Axes of world and body: x forward, y left, z up (REP 103); or x right, y down, z forward, as in KITTI."""


@dataclass(frozen=True)
class Outside:
    """Ranges outside the plane of a trajectory in space: z [m], roll and pitch [rad]."""

    z: tuple[float, float]
    roll: tuple[float, float]
    pitch: tuple[float, float]


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
    """

    file: str
    kind: str
    time: Array
    pose: Array
    covariance: Array | None = None
    frame: str = ""
    outside: Outside | None = None
    notes: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.time)

    @property
    def digest(self) -> str:
        """SHA-256 of all numbers."""
        digest = hashlib.sha256(self.time.tobytes() + self.pose.tobytes())
        if self.covariance is not None:
            digest.update(self.covariance.tobytes())
        return digest.hexdigest()


@dataclass(frozen=True)
class Manner:
    """User options that complete a file.

    Attributes:
        cov: file with the covariances of a TUM file.
        times: file with the stamps of KITTI poses.
        frame: of the covariances (`FRAMES`); None: the format's.
        axes: of a trajectory in space (`AXES`).
    """

    cov: Path | None = None
    times: Path | None = None
    frame: str | None = None
    axes: str = ROBOT


def in_order(time: Array) -> Array:
    """Rows (k,) to keep of ascending stamps (n,): the last of equal ones."""
    keep = np.append(np.diff(time) > 0.0, True)
    return np.asarray(np.flatnonzero(keep))


@dataclass(frozen=True)
class Text:
    """Data lines of a file, split into fields, with their numbers from 1; and its comments."""

    path: Path
    fields: tuple[tuple[str, ...], ...]
    line: tuple[int, ...]
    comments: tuple[tuple[int, str], ...]
    commas: bool

    def place(self, row: int) -> str:
        """Place of a row, for messages."""
        return f"{self.path}:{self.line[row]}"


def read_text(path: Path) -> Text:
    """Split a file at commas if its first data line has any, else at blanks; `#` begins a comment line."""
    try:
        content = path.read_text(encoding="utf-8-sig")
    except FileNotFoundError:
        raise DataError.at(path, "no such file") from None
    except UnicodeDecodeError:
        raise DataError.at(path, "not a text file; docs/results-files.md lists the formats") from None
    except OSError as fault:
        raise DataError.at(path, f"cannot be read: {fault.strerror}") from None
    lines = [(i, line.strip()) for i, line in enumerate(content.splitlines(), start=1)]
    comments = tuple((i, line) for i, line in lines if line.startswith("#"))
    data = [(i, line) for i, line in lines if line and not line.startswith("#")]
    if not data:
        raise DataError.at(path, "no line of data; at least one is needed")
    commas = "," in data[0][1]
    split = tuple(tuple(f.strip() for f in line.split(",")) if commas else tuple(line.split()) for _, line in data)
    return Text(path, split, tuple(i for i, _ in data), comments, commas)


def numbers(text: Text, columns: Sequence[str], *, more: bool = False) -> Array:
    """The fields as finite numbers (n, columns); `more`: further fields of a line are ignored."""
    k = len(columns)
    for line, fields in zip(text.line, text.fields, strict=True):
        if len(fields) < k or (len(fields) > k and not more):
            last = cut_off(len(fields), k, last=line == text.line[-1])
            raise DataError.at(text.path, f"{len(fields)} fields; {k} are needed{last}", line=line)
        for name, field in zip(columns, fields, strict=False):
            if not is_number(field):
                raise DataError.at(text.path, f"{field[:40]!r} is not a number", line=line, column=name)
            if not math.isfinite(float(field)) or (abs(float(field)) > LARGEST and name != "timestamp [ns]"):
                what = f"{field[:40]}; a finite number in SI units is needed"
                raise DataError.at(text.path, what, line=line, column=name)
    return np.array([[float(f) for f in fields[:k]] for fields in text.fields])


def require_order(text: Text, time: Array) -> None:
    """DataError where stamps (n,) decrease."""
    back = np.flatnonzero(np.diff(time) < 0.0)
    if len(back):
        k = int(back[0]) + 1
        what = f"stamp {float(time[k])!r} is before {float(time[k - 1])!r} of the line above"
        raise DataError.at(text.path, f"{what}; ascending stamps are needed", line=text.line[k])

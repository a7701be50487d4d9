"""Trajectories of other programs: poses in space and in the plane at stamps, with claimed covariances.

Stamps since 1970 tell their unit by their size. Others tell it by their rate: trajectories have poses between 10 kHz
and one in 5 s. A stated unit that neither allows is refused.
"""

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from data.errors import DataError
from data.locked import Locked
from data.se2 import Array

DIGITS = {"s": 0, "ms": 3, "us": 6, "ns": 9}
STATED, SIZE, RATE, ASSUMED, ROWS, DATES = "stated", "size", "rate", "assumed", "rows", "dates"
EPOCH = (1e9, 4.2e9)  # s since 1970 of years 2001 to 2103; less may be ns since a start
STEPS = (1e-4, 5.0)  # s, intervals between successive poses of a trajectory
SLOWEST, ABSURD = 600.0, 1e-5  # s, largest interval beside a stamp since 1970, and smallest that a stated unit may give


@dataclass(frozen=True)
class Clock:
    """Unit of stamps, and how it is known: `STATED`, `SIZE`, `RATE`, `ASSUMED`, `DATES`, or `ROWS`: row numbers."""

    unit: str = "s"
    by: str = ASSUMED
    source: str = ""  # what is said of another file that they are from

    @property
    def words(self) -> str:
        """For the kind of a file."""
        if self.by == ROWS:
            return "without stamps"
        how = {SIZE: " by their size", RATE: " by their rate", DATES: " from dates"}.get(self.by, "")
        return f"stamps{self.source} in {self.unit}{how}"


def clock_of(file: str, stamps: Array, stated: str | None, usual: str = "s") -> Clock:
    """The unit of ascending stamps (n,), or else the `usual`. DataError for a stated unit that they contradict."""
    finite = stamps[np.isfinite(stamps)]
    steps = np.diff(finite)
    steps = steps[steps > 0.0]
    step = float(np.median(steps)) if len(steps) else None
    since = float(np.min(np.abs(finite))) if len(finite) else 0.0

    def epoch(unit: str) -> bool:
        scale = 10.0 ** -DIGITS[unit]
        return EPOCH[0] <= since * scale <= EPOCH[1] and (step is None or ABSURD <= step * scale <= SLOWEST)

    def rate(unit: str) -> bool:
        return step is None or STEPS[0] <= step * 10.0 ** -DIGITS[unit] < STEPS[1]

    by_size = [u for u in DIGITS if epoch(u)]
    if stated is not None:
        absurd = step is not None and step * 10.0 ** -DIGITS[stated] < ABSURD
        if absurd or (by_size and stated not in by_size and not rate(stated)):
            looks = by_size[0] if by_size else next((u for u in DIGITS if rate(u)), "s")
            what = (
                f"its header states stamps in {stated}, but {finite[0]:.10g} and steps of {step or 0.0:.3g} are {looks}"
            )
            raise DataError.at(file, f"{what}; correct the header, or type --unit {looks}")
        return Clock(stated, STATED)
    if by_size:
        return Clock(usual if usual in by_size else by_size[0], SIZE)
    if step is None or rate(usual):
        return Clock(usual, ASSUMED)
    return next((Clock(u, RATE) for u in DIGITS if rate(u)), Clock(usual, ASSUMED))


def seconds(stamps: Array, texts: Sequence[str], unit: str) -> Array:
    """Stamps (n,) in s; whole numbers are divided as written, as they may have more digits than a float."""
    if unit == "s":
        return stamps
    whole = 10 ** DIGITS[unit]
    return np.array([int(t) / whole if t.lstrip("-").isdecimal() else float(t) / whole for t in texts], float)


WORLD, LOCAL, LEFT, MIXED = "world", "local", "left", "mixed"
FRAMES = (WORLD, LOCAL, LEFT, MIXED)
"""Frame of a covariance: additive errors in the world's axes; T = T_mean Exp(xi), in the body's axes (right
perturbation); T = Exp(xi) T_mean, in the world's axes about its origin (left perturbation); position in the world's
axes and rotation in the body's (OpenVINS)."""
ROBOT, CAMERA = "robot", "camera"
AXES = (ROBOT, CAMERA)  # Of world and body: x forward, y left, z up (REP 103); x right, y down, z forward (KITTI)
INVERSE = ("inverse", "inverse-rotations")  # Poses of the world in the body, or their rotations alone
READ_AS = {"-".join(filter(None, (i, a))): (i, a) for i in ("", *INVERSE) for a in ("", *AXES)}  # Values of --axes
TRANSLATION, ROTATION = "translation-first", "rotation-first"
COV_ORDERS = (TRANSLATION, ROTATION)


@dataclass(frozen=True)
class Stated:
    """What a file states about itself; empty: nothing."""

    world: str = ""  # world, body: names of its frames
    body: str = ""
    convention: bool = False  # whether it states the frame of its covariances
    order: bool = False  # whether it states the order of their tangent
    axes: bool = False  # whether the axes are those of its format (not chosen by a flag)
    inverse: str = ""  # as of `Manner`


SILENT, UNKNOWN = Stated(), Clock()


@dataclass(frozen=True, eq=False)
class Spatial(Locked):
    """A trajectory in space."""

    file: str  # file, kind: as of `GivenPath`
    kind: str
    time: Array  # (n,) s, ascending
    position: Array  # (n, 3) m
    rotation: Array  # (n, 3, 3), world from body
    covariance: Array | None  # (n, 6, 6), translation first, then rotation; rows NaN where unknown; None: none
    frame: str  # of the covariance (`FRAMES`)
    place: Callable[[int], str]  # place of row k, for messages
    stated: Stated = SILENT
    notes: tuple[str, ...] = ()  # sentences
    clock: Clock = UNKNOWN

    def __len__(self) -> int:
        return len(self.time)


@dataclass(frozen=True, eq=False)
class GivenPath(Locked):
    """A trajectory of a file, in the plane."""

    file: str  # file, kind: its name, with the topic of a bag, and the format, in words
    kind: str
    time: Array  # (n,) s, strictly increasing
    pose: Array  # (n, 3) x [m], y [m], heading [rad]
    # (n, 3, 3) of additive errors in the world's axes [x, y, heading]; rows NaN where unknown; None: none
    covariance: Array | None = None
    frame: str = ""  # of the file's covariance (`FRAMES`), before conversion; "" without one
    # least and largest z [m], roll and pitch [rad] of a trajectory in space; empty for a planar file
    outside: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    notes: tuple[str, ...] = ()  # sentences about ignored or assumed things
    clock: Clock = UNKNOWN
    space: Spatial | None = None  # the trajectory in space at the same stamps, in a robot's axes; None: planar
    transforms: object | None = None  # of other frames, from the same file; None: none
    headings: Array | None = None  # (n,) of a planar file before wrapping, without a stated unit; read as rad
    datum: tuple[float, ...] = ()  # latitude, longitude [deg], height [m] of the origin, of a file of such; else empty
    every: Array | None = None  # (m,) s, of all rows of the file where some are left out; None: unknown
    runs: str = ""  # what to type where rows without stamps are of several runs

    def __len__(self) -> int:
        return len(self.time)

    @property
    def digest(self) -> str:
        """SHA-256 of all numbers."""
        digest = hashlib.sha256(self.time.tobytes() + self.pose.tobytes())
        if self.covariance is not None:
            digest.update(self.covariance.tobytes())
        return digest.hexdigest()


ABSENT = "no heading in this file: positions alone are scored"


def unturned(quaternion: Array, position: Array) -> bool:
    """Whether quaternions (n, 4) x, y, z, w are all zero, or all the identity (or headings (n,) all zero) though
    positions (n, d) on the ground do not go ahead along x.
    """
    if quaternion.ndim == 1:
        quaternion = np.column_stack([0.0 * quaternion] * 2 + [np.sin(0.5 * quaternion), np.cos(0.5 * quaternion)])
    known = np.isfinite(quaternion).all(axis=1) & np.isfinite(position).all(axis=1)
    q, step = quaternion[known], np.diff(position[known, :2], axis=0)
    if not len(q) or not q.any():
        return bool(len(q))
    moved = np.hypot(step[:, 0], step[:, 1])
    extent = np.ptp(position[known], axis=0)
    if extent[2:].any() and extent[2] > 0.5 * extent[:2].max():  # a camera's axes
        return False
    return bool((q[:, :3] == 0.0).all() and (q[:, 3] != 0.0).all() and step[:, 0].sum() < AHEAD * moved.sum())


AHEAD = 0.5  # Least share of its way that a robot of heading 0 gets ahead along x: less than 60 deg to either side


def without_headings(path: GivenPath, *, flat: bool = True) -> GivenPath:
    """The path as positions alone, in space if its heights differ; `flat`: only then."""
    if ABSENT in path.notes:
        return path
    pose, s = path.pose * [1.0, 1.0, np.nan], path.space
    high = s is not None and (np.ptp(s.position[:, 2]) > 0.0 or not flat)
    space = replace(s, rotation=np.nan * s.rotation, covariance=None) if s is not None and high else None
    return replace(path, pose=pose, space=space, outside={}, headings=None, notes=(*path.notes, ABSENT))


def restamped(path: GivenPath, time: Array, clock: Clock) -> GivenPath:
    """The trajectory at other stamps (n,) [s]."""
    kind = path.kind.replace(path.clock.words, clock.words)
    space = None if path.space is None else replace(path.space, time=time, clock=clock, kind=kind)
    return replace(path, time=time, clock=clock, kind=kind, space=space, every=None)


@dataclass(frozen=True)
class Manner:
    """User options that complete a file."""

    cov: Path | None = None  # file with the covariances of a TUM file
    times: Path | None = None  # file with the stamps of KITTI poses
    frame: str | None = None  # of the covariances (`FRAMES`); None: the format's
    axes: str | None = None  # of a trajectory in space (`AXES`); None: the format's
    inverse: str = ""  # one of `INVERSE`; empty: poses are of the body in the world
    order: str | None = None  # of the covariances' tangent (`COV_ORDERS`); None: the file's
    stamps: str | float | None = None  # unit of the stamps, or s per unit; None: as stated or inferred
    angles: float | None = None  # rad per unit of angles, below 0 of clockwise headings; None: as stated, else rad
    lengths: Mapping[str, float] = field(default_factory=dict)  # m per unit of x, y, z; else as stated, or m
    # names, or numbers from 1, of columns by role (t, x, y, z, lat, lon, alt, roll, pitch, yaw, qx, qy, qz, qw)
    columns: Mapping[str, str] = field(default_factory=dict)
    fixed: Mapping[str, float] = field(default_factory=dict)  # by role what is one number in place of a column
    true: bool = False  # where a row holds both, the true pose is read
    rows: bool = False  # a row holds both: stamps that do not ascend are not read
    datum: tuple[float, ...] = ()  # of latitudes and longitudes, as of `GivenPath`; empty: their first place
    compass: bool = False  # headings begin at y, which is north

    @property
    def scale(self) -> Array:
        """Of x, y and z (3,)."""
        return np.array([self.lengths.get(axis, 1.0) for axis in "xyz"])


COARSE = 1.0 / 3.0  # Largest share of poses that have the stamp of a different one: of more the stamps lack digits


def in_order(file: str, time: Array, pose: Array) -> Array:
    """Rows (k,) of poses (n, d) at stamps (n,), the last of equal ones. DataError where digits do not part poses."""
    same = np.diff(time) <= 0.0
    shared = int((same & (pose[1:] != pose[:-1]).any(axis=1)).sum())
    if shared > COARSE * len(time):
        what = f"{shared} of {len(time)} poses have the stamp of the next one"
        which = "all are equal" if same.all() else "whole seconds" if not (time % 1.0).any() else "few digits"
        raise DataError.at(file, f"{what} ({which}); stamps that tell the poses apart are needed")
    return np.asarray(np.flatnonzero(np.append(~same, True)))

"""A ROS bag as a laser log: every scan is a frame, with interpolated odometry; tf gives the laser's mounting, and the
odometry where no topic does.

Needs `rosbags`.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from data.columns.scans import with_returns
from data.digest import source_file
from data.errors import DataError, UsageError, did_you_mean
from data.formats.recordings.beams import on_one_set
from data.formats.recordings.laser import laser_inputs, without_odometry
from data.formats.recordings.mending import AS_STATED, Mending, beam_angles, piled_up, require_metres
from data.inputs import Scanner, Scans
from data.log import Log
from data.origin import Origin
from data.se2 import Array, interpolate, inverse
from data.terminal import counted
from data.truth import Truth

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
    """Heading [rad] of a rotation: the angle of its x axis in the plane; NaN for an invalid quaternion."""
    R = rotation_of(q)
    return math.atan2(R[1, 0], R[0, 0])


def rotation_of(q: Quaternion | Array) -> Array:
    """Rotation matrices (..., 3, 3) of quaternions (..., 4); NaN for length 0."""
    values = np.asarray(q, float)
    length = np.sqrt(np.sum(values * values, axis=-1, keepdims=True))
    x, y, z, w = np.moveaxis(values / np.where(length > 0.0, length, np.nan), -1, 0)
    rows = [
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - z * w), 2.0 * (x * z + y * w)],
        [2.0 * (x * y + z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - x * w)],
        [2.0 * (x * z - y * w), 2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


@dataclass
class Transforms:
    """The first transform stated for each frame to its parent; a laser's is static."""

    parent: dict[str, tuple[str, Transform]] = field(default_factory=dict)

    def add(self, parent: str, child: str, translation: Vector, rotation: Quaternion) -> None:
        """Keep a frame's transform, unless there is one."""
        entry = (_name(parent), Transform(rotation_of(rotation), np.array(translation, float)))
        self.parent.setdefault(_name(child), entry)

    def between(self, target: str, source: str) -> Transform | None:
        """p_target = R p_source + t through a common ancestor; None without one."""
        up, down = self._chain(target), self._chain(source)
        for name, to_common in up.items():
            if name in down:
                return to_common.inverse() @ down[name]
        return None

    def _chain(self, name: str) -> dict[str, Transform]:
        """The frame and its ancestors, with the transform from the frame to each."""
        name, so_far = _name(name), Transform(np.eye(3), np.zeros(3))
        chain = {name: so_far}
        while name in self.parent:
            name, step = self.parent[name]
            if name in chain:  # a cycle
                break
            so_far = step @ so_far
            chain[name] = so_far
        return chain


def _name(frame: str) -> str:
    """Frame name without the leading slash of ROS 1."""
    return frame.lstrip("/")


SCAN, ODOMETRY, TRANSFORMS = "sensor_msgs/msg/LaserScan", "nav_msgs/msg/Odometry", "tf2_msgs/msg/TFMessage"
SHORT = {SCAN: "sensor_msgs/LaserScan", ODOMETRY: "nav_msgs/Odometry"}
OLD_TRANSFORMS = "tf/msg/tfMessage"
WIDEST = 1e6
"""rad, angle of a beam that is none: beams are told apart by whole numbers of `data.formats.recordings.beams.ANGLE`."""
GEOMETRY = ("angle_min", "angle_max", "angle_increment", "range_min", "range_max")
SHARED = ("range_min", "range_max")
"""Numbers that are the same in every scan; angles may differ (rotating scanners)."""
TF = "tf"
"""In place of a topic of odometry: the transform from the odometry's frame to the robot's."""


@dataclass(frozen=True)
class Bag:
    """The parts of a bag that a log needs, in recorded order.

    Attributes:
        scan_topic, odometry_topic: their topics.
        scan_stamp, odometry_stamp: (S,), (O,) s.
        geometry: numbers of `GEOMETRY`.
        ranges: (S, B) m, as in the messages, or resampled to the angles of the most frequent kind of scan.
        resampled: number of scans with other angles.
        pose: (O, 3) of the robot.
        mounting: of the laser's frame in the robot's, None if unknown.
        frames: names of the robot's frame and of the laser's.
    """

    scan_topic: str
    odometry_topic: str
    scan_stamp: Array
    odometry_stamp: Array
    geometry: dict[str, float]
    ranges: Array
    pose: Array
    mounting: Transform | None
    frames: tuple[str, str]
    resampled: int = 0


def read_bag(
    path: Path, scan_topic: str | None = None, odometry_topic: str | None = None, *, alone: bool = False
) -> Bag:
    """Read a bag; a topic may be left out if it is the only one of its kind. Without a topic of odometry (or with `tf`)
    the poses are the transforms from the odometry's frame, as in bags for gmapping, karto and slam_toolbox. `alone`:
    without either the robot is the laser, at rest.

    Raises:
        UsageError: `rosbags` is not installed, or a topic is missing or ambiguous.
        DataError: no bag, a damaged one, no message, or an invalid scan.
    """
    with opened(path) as reader:
        topics = {c.topic: c.msgtype for c in reader.connections}
        scans = _topic(path, topics, SCAN, scan_topic, "--scan")
        by_tf = odometry_topic == TF or (odometry_topic is None and ODOMETRY not in topics.values())
        odometry = TF if by_tf else _topic(path, topics, ODOMETRY, odometry_topic, "--odom")
        found = _Messages(path, scans, odometry, alone)
        kinds = (TRANSFORMS, OLD_TRANSFORMS)
        wanted = [c for c in reader.connections if c.topic in (scans, odometry) or c.msgtype in kinds]
        for connection, recorded, raw in reader.messages(wanted):
            found.add(connection.topic, reader.deserialize(raw, connection.msgtype), 1e-9 * recorded)
    return found.bag()


BROKEN = (
    *(OSError, ValueError, LookupError, EOFError, RuntimeError, ArithmeticError, AssertionError),
    *(AttributeError, TypeError, SyntaxError, MemoryError, StopIteration, struct.error),
)
"""Errors of `rosbags` for damaged bytes, besides its own; a bag defines its messages, so a field may be missing or have
any type."""


@contextmanager
def _reported(path: Path) -> Iterator[None]:
    """Errors of the library, or of an unexpected message, become a DataError."""
    from data.formats.recordings.ros_bounded import LIBRARY

    try:
        yield
    except (*LIBRARY, *BROKEN) as error:
        what = " ".join(str(error).split())[:120] or type(error).__name__
        right = "a whole .bag, .mcap or .db3 is needed"
        if "index" in what.lower():  # the recorder was stopped
            right = "rebuild its index: `rosbag reindex FILE`, of MCAP `mcap recover FILE`"
        raise DataError.at(path, f"not a bag that can be read ({what}); {right}") from None


@contextmanager
def opened(path: Path, kinds: frozenset[str] = frozenset()) -> Iterator[Any]:
    """A reader of the bag, within bounds; its errors become a DataError. `kinds`: more types than those of a log."""
    try:
        from data.formats.recordings.ros_bounded import any_reader, bounded
    except ImportError as error:
        raise UsageError(f"rosbag needs the package rosbags ({error}): pip install 'slamref[ros]'") from None
    if not path.exists():
        raise DataError.at(path, "no such bag; a .bag file, a folder of ROS 2, or its .mcap or .db3 is needed")
    with bounded(), _reported(path), any_reader(path, {SCAN, ODOMETRY, TRANSFORMS, *kinds}) as reader:
        yield reader


def _topic(path: Path, topics: dict[str, str], kind: str, wanted: str | None, flag: str) -> str:
    """The requested topic, or the only one of a kind."""
    of_kind = sorted(topic for topic, t in topics.items() if t == kind)
    there = f"{SHORT[kind]}: {', '.join(of_kind) or 'none'}"
    if wanted is None:
        if kind == SCAN and not of_kind:
            raise UsageError(f"{path}: no LaserScan; slamref convert bag {path} --list says what it holds instead")
        if len(of_kind) != 1:
            raise UsageError(f"{path}: {flag} TOPIC is needed, because the topic is ambiguous; {there}")
        return of_kind[0]
    if wanted not in topics:
        raise UsageError(f"{flag} {wanted}: no such topic in {path}{did_you_mean(wanted, of_kind)}; of {there}")
    if topics[wanted] != kind:
        raise UsageError(f"{flag} {wanted}: its messages are {topics[wanted]}; topics of {there}")
    return wanted


class _Messages:
    """Collects messages as they come."""

    def __init__(self, path: Path, scan_topic: str, odometry_topic: str, alone: bool) -> None:
        self.path, self.scan_topic, self.odometry_topic, self.alone = path, scan_topic, odometry_topic, alone
        self.scan_stamp: list[float] = []
        self.odometry_stamp: list[float] = []
        self.geometry: dict[str, float] = {}
        self.ranges: list[Array] = []
        self.pose: list[tuple[float, float, float]] = []
        self.transforms = Transforms()
        self.moving: dict[tuple[str, str], list[tuple[float, float, float, float]]] = {}
        self.angles: list[tuple[float, float]] = []
        self.frames = ["", ""]

    def add(self, topic: str, message: Any, recorded: float) -> None:
        """Add a message; `recorded`: the time it was written [s], which replaces a missing stamp."""
        if topic == self.scan_topic:
            self._scan(message, recorded)
        elif topic == self.odometry_topic:
            self._odometry(message, recorded)
        else:
            for t in message.transforms:
                p, q = t.transform.translation, t.transform.rotation
                rotation = (q.x, q.y, q.z, q.w)
                self.transforms.add(t.header.frame_id, t.child_frame_id, (p.x, p.y, p.z), rotation)
                if self.odometry_topic == TF:
                    edge = _name(t.header.frame_id), _name(t.child_frame_id)
                    self.moving.setdefault(edge, []).append((stamp_of(t, recorded), p.x, p.y, heading(rotation)))

    def _scan(self, message: Any, recorded: float) -> None:
        number = len(self.ranges)
        geometry = {name: float(getattr(message, name)) for name in GEOMETRY}
        ranges = np.asarray(message.ranges, np.float64)
        if not self.ranges:
            if not np.isfinite(list(geometry.values())).all() or geometry["angle_increment"] == 0.0 or not len(ranges):
                raise self._error(number, f"{geometry} with {len(ranges)} beams is no scan; finite numbers are needed")
            if not geometry["range_max"] > max(geometry["range_min"], 0.0):
                raise self._error(number, f"range_max {geometry['range_max']:g} m; a number above range_min is needed")
            self.geometry, self.frames[1] = geometry, message.header.frame_id
        elif not len(ranges) or not geometry["angle_increment"]:
            raise self._error(number, f"{geometry} with {len(ranges)} beams is no scan")
        else:
            for name in SHARED:
                value = geometry[name]
                if not abs(value - self.geometry[name]) <= 1e-5:
                    raise self._error(number, f"{name} {value!r}; {self.geometry[name]!r} is needed, as in the first")
        if not abs(geometry["angle_min"]) < WIDEST or not abs(geometry["angle_increment"]) < WIDEST:
            raise self._error(number, f"{geometry} is no scan; angles in rad are needed")
        self.ranges.append(ranges)
        self.angles.append((geometry["angle_min"], geometry["angle_increment"]))
        self.scan_stamp.append(stamp_of(message, recorded))

    def _odometry(self, message: Any, recorded: float) -> None:
        p, q = message.pose.pose.position, message.pose.pose.orientation
        pose = (p.x, p.y, heading((q.x, q.y, q.z, q.w)))
        if not np.isfinite(pose).all():
            place = f"message {len(self.pose)} of {self.odometry_topic}"
            raise DataError.at(self.path, f"{place}: pose {pose}; three finite numbers are needed")
        self.frames[0] = message.child_frame_id
        self.pose.append(pose)
        self.odometry_stamp.append(stamp_of(message, recorded))

    def _error(self, number: int, what: str) -> DataError:
        return DataError.at(self.path, f"message {number} of {self.scan_topic}: {what}")

    def _take_transforms(self) -> None:
        """The poses of the robot from the transforms on the way to the laser: those that move and name the odometry."""
        chain = set(self.transforms._chain(self.frames[1]))
        edges = {e: rows for e, rows in self.moving.items() if e[1] in chain and len({r[1:] for r in rows}) > 1}
        named = {e: rows for e, rows in edges.items() if ODOM_FRAME in e[0]} or edges
        if not named and self.alone:
            self.odometry_stamp, self.frames[0] = self.scan_stamp, self.frames[1]
            self.pose = [(0.0, 0.0, 0.0)] * len(self.scan_stamp)
            return
        if not named:
            what = f"neither a topic of odometry nor a moving transform to {self.frames[1]!r}"
            raise DataError.at(self.path, f"{what}; one is needed: --odom TOPIC, or --no-odometry")
        edge = max(named, key=lambda e: len(named[e]))
        rows = np.array(named[edge])
        if not np.isfinite(rows).all():
            raise DataError.at(
                self.path, f"transform {edge[0]} to {edge[1]}: {len(rows)} poses; finite ones are needed"
            )
        self.frames[0] = edge[1]
        self.odometry_stamp = rows[:, 0].tolist()
        self.pose = [(x, y, a) for _, x, y, a in rows.tolist()]

    def bag(self) -> Bag:
        """All of it."""
        if self.odometry_topic == TF and self.ranges:
            self._take_transforms()
        for topic, messages in ((self.scan_topic, self.ranges), (self.odometry_topic, self.pose)):
            if not messages:
                raise DataError.at(self.path, f"no message of {topic}; at least one is needed")
        robot, laser = self.frames
        angles = np.array(self.angles)
        ranges, low, step, resampled = on_one_set(self.ranges, angles[:, 0], angles[:, 1])
        geometry = self.geometry | {"angle_min": low, "angle_increment": step}
        return Bag(
            self.scan_topic,
            self.odometry_topic,
            np.array(self.scan_stamp),
            np.array(self.odometry_stamp),
            geometry,
            ranges,
            np.array(self.pose),
            self.transforms.between(robot, laser),
            (robot, laser),
            resampled,
        )


ODOM_FRAME = "odom"


def stamp_of(message: Any, recorded: float) -> float:
    """Stamp of a message [s], or the time it was recorded."""
    stamp = message.header.stamp
    return float(stamp.sec + 1e-9 * stamp.nanosec) if stamp.sec or stamp.nanosec else recorded


SIGMA = 0.01
"""m, of a range, which messages do not state; small scanners state 1 to 3 cm."""
MOST_BEYOND = 0.5
"""Share of ranges beyond the stated maximum, in the unit of the ranges, from which on that is in another."""
LONG = 1.0
"""s; longer gaps of the odometry are counted."""
SMALL = 1e-3
"""Largest deviation of the tilt's cosine from 1 (2.6 degrees)."""


def log_of(path: Path, bag: Bag, mending: Mending = AS_STATED) -> Log:
    """The log: frames are the scans within the span of the odometry, which is interpolated at their stamps.

    Scans are taken in the order of their stamps. A range below range_min, not below range_max, infinite or NaN is no
    return, as in sensor_msgs/LaserScan. DataError without a scan within the odometry, or if the laser is not level.
    """
    scanner, mounted = _scanner(path, bag)
    measured = mending.ranges(np.where(np.isfinite(bag.ranges), bag.ranges, 0.0))
    require_metres(path, measured)
    g = bag.geometry
    last = g["angle_min"] + (measured.shape[1] - 1) * g["angle_increment"] if bag.resampled else g["angle_max"]
    asked = beam_angles(g["angle_min"], g["angle_increment"], last, measured.shape[1])
    largest = float(mending.ranges(np.array(scanner.max_range)))
    if (measured > largest).mean() < MOST_BEYOND:  # else it is stated in metres, unlike the ranges
        scanner = replace(scanner, max_range=largest)
    piled = piled_up(measured, scanner.max_range)
    if piled is not None:
        scanner = replace(scanner, max_range=piled[0])
    scanner = mending.scanner(scanner)
    time, first = np.unique(bag.odometry_stamp, return_index=True)
    order = np.argsort(bag.scan_stamp, kind="stable")
    stamp = bag.scan_stamp[order]
    inside = (stamp >= time[0]) & (stamp <= time[-1])
    if not inside.any():
        what = f"scans at {stamp[0]:.3f} to {stamp[-1]:.3f} s, odometry at {time[0]:.3f} to {time[-1]:.3f} s"
        raise DataError.at(path, f"{what}; at least one scan within the odometry is needed")
    stamp, ranges = stamp[inside], measured[order][inside]
    pose = interpolate(time, mending.poses(bag.pose[first]), stamp)
    ranges = np.where(ranges >= float(mending.ranges(np.array(g["range_min"]))), ranges, 0.0)
    scans = Scans(scanner, np.arange(len(stamp)), with_returns(ranges, scanner.max_range))
    notes = [
        "No ground truth: the prior is the first pose of the odometry.",
        f"Frames are the scans of {bag.scan_topic}, with {bag.odometry_topic} interpolated at their stamps.",
        *mounted,
    ]
    if not inside.all():
        scans_of = f"{int((~inside).sum())} of {counted(len(inside), 'scan')}"
        notes.append(f"{scans_of} outside the span of the odometry: left out.")
    after = np.clip(np.searchsorted(time, stamp), 1, len(time) - 1)
    far = int((time[after] - time[after - 1] > LONG).sum()) if len(time) > 1 else 0
    if far:
        notes.append(f"{counted(far, 'scan is', 'scans are')} where the odometry pauses for more than {LONG:g} s.")
    if bag.resampled:
        notes.append(f"{bag.resampled} of {counted(len(inside), 'scan')} with other beams: resampled.")
    if piled is not None:
        top, many = piled
        stated = f"the messages state {g['range_max']:g}"
        notes.append(f"No return: readings of {top:g} m and more, where {many} of {measured.size} pile up; {stated}.")
    source = {"kind": "rosbag", **source_file(path), "scan": bag.scan_topic, "odometry": bag.odometry_topic}
    recorded = laser_inputs(pose, stamp, scans)
    recorded = recorded if mending.odometry else without_odometry(recorded)
    origins = dict.fromkeys(("odometry_noise", "range_noise", *([] if mounted else ["sensor_pose"])), Origin.ASSUMED)
    origins |= {"max_range": Origin.INFERRED} if piled is not None else {}
    return Log(path.stem, recorded, Truth(), source=source, notes=tuple(notes), asked=tuple(asked), origins=origins)


def _scanner(path: Path, bag: Bag) -> tuple[Scanner, list[str]]:
    """The scanner on the robot, and a note about its place, where the bag states it."""
    g, robot, laser = bag.geometry, *bag.frames
    low, step = g["angle_min"], g["angle_increment"]
    if bag.mounting is None:
        return Scanner(low, step, g["range_max"], SIGMA), []
    R, t = bag.mounting.R, bag.mounting.t
    if not abs(abs(R[2, 2]) - 1.0) <= SMALL:
        what = f"the laser {laser!r} is tilted by {np.degrees(np.arccos(np.clip(R[2, 2], -1, 1))):.3g} deg on {robot!r}"
        raise DataError.at(path, f"{what}; a level one is needed")
    upside_down = R[2, 2] < 0.0
    if upside_down:  # seen from above its beams turn the other way
        low, step = -low, -step
    turn = float(np.arctan2(R[1, 0], R[0, 0]))
    tx, ty, rotation = (float(v) + 0.0 for v in inverse(np.array([t[0], t[1], turn])))
    place = f"at ({t[0]:.4g}, {t[1]:.4g}) m, turned by {np.degrees(turn):.4g} deg{', upside down' * bool(upside_down)}"
    return Scanner(low, step, g["range_max"], SIGMA, rotation, (tx, ty)), [f"The laser is mounted {place}."]

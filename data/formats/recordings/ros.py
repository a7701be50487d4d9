"""Messages of a ROS bag as arrays: laser scans, odometry, and where the laser is mounted. Needs `rosbags`."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from data.errors import DataError, UsageError
from data.recordings.ros.transforms import Transform, Transforms, heading
from data.se2 import Array

SCAN, ODOMETRY, TRANSFORMS = "sensor_msgs/msg/LaserScan", "nav_msgs/msg/Odometry", "tf2_msgs/msg/TFMessage"
SHORT = {SCAN: "sensor_msgs/LaserScan", ODOMETRY: "nav_msgs/Odometry"}
OLD_TRANSFORMS = "tf/msg/tfMessage"
GEOMETRY = ("angle_min", "angle_increment", "range_min", "range_max")


@dataclass(frozen=True)
class Bag:
    """What a log needs of a bag, in the order of recording.

    Attributes:
        scan_topic, odometry_topic: where it comes from.
        scan_stamp, odometry_stamp: (S,), (O,) s.
        geometry: numbers of `GEOMETRY`, the same in every scan.
        ranges: (S, B) m, as in the messages.
        pose: (O, 3) of the robot.
        mounting: of the laser's frame in the robot's, None where the bag does not say.
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


def read_bag(path: Path, scan_topic: str | None = None, odometry_topic: str | None = None) -> Bag:
    """Read a bag; a topic may be left out where there is only one of its kind.

    Raises:
        UsageError: `rosbags` is not installed, or a topic is not in the bag, or not the only one of its kind.
        DataError: not a bag, or a broken one; no message; a scan that differs from the first in beams or geometry, or
            a number in it that makes no sense.
    """
    with opened(path) as reader:
        topics = {c.topic: c.msgtype for c in reader.connections}
        scans = _topic(path, topics, SCAN, scan_topic, "--scan")
        odometry = _topic(path, topics, ODOMETRY, odometry_topic, "--odom")
        found = _Messages(path, scans, odometry)
        kinds = (SCAN, ODOMETRY, TRANSFORMS, OLD_TRANSFORMS)
        wanted = [c for c in reader.connections if c.topic in (scans, odometry) or c.msgtype in kinds[2:]]
        for connection, recorded, raw in reader.messages(wanted):
            found.add(connection.topic, reader.deserialize(raw, connection.msgtype), 1e-9 * recorded)
    return found.bag()


BROKEN = (
    *(OSError, ValueError, LookupError, EOFError, RuntimeError, ArithmeticError, AssertionError),
    *(AttributeError, TypeError, SyntaxError, MemoryError, StopIteration, struct.error),
)
"""What `rosbags` raises for bytes that are not what they should be, beside its own errors; a bag brings the definitions
of its messages along, so that a field may be missing, or be anything."""


@contextmanager
def said(path: Path) -> Iterator[None]:
    """What goes wrong in the library, or because a message is not what its type says, is a DataError."""
    from data.recordings.ros.bounded import LIBRARY

    try:
        yield
    except (*LIBRARY, *BROKEN) as error:
        what = " ".join(str(error).split())[:120] or type(error).__name__
        raise DataError.at(
            path, f"not a bag that can be read ({what}); a whole .bag, .mcap or .db3 is needed"
        ) from None


@contextmanager
def opened(path: Path) -> Iterator[Any]:
    """A reader of the bag, within bounds; what goes wrong in it is a DataError."""
    try:
        from data.recordings.ros.bounded import any_reader, bounded
    except ImportError as error:
        raise UsageError(f"rosbag needs the package rosbags ({error}): pip install 'slamref[ros]'") from None
    if not path.exists():
        raise DataError.at(path, "no such bag; a .bag file, a folder of ROS 2, or its .mcap or .db3 is needed")
    with bounded(), said(path), any_reader(path, {SCAN, ODOMETRY, TRANSFORMS}) as reader:
        yield reader


def _topic(path: Path, topics: dict[str, str], kind: str, wanted: str | None, flag: str) -> str:
    """The topic asked for, or the only one of a kind."""
    of_kind = sorted(topic for topic, t in topics.items() if t == kind)
    there = f"{SHORT[kind]}: {', '.join(of_kind) or 'none'}"
    if wanted is None:
        if len(of_kind) != 1:
            raise UsageError(f"{path}: {flag} TOPIC is needed, as there is not one topic of {there}")
        return of_kind[0]
    if wanted not in topics:
        raise UsageError(f"{flag} {wanted}: no such topic in {path}; of {there}")
    if topics[wanted] != kind:
        raise UsageError(f"{flag} {wanted}: its messages are {topics[wanted]}; topics of {there}")
    return wanted


class _Messages:
    """Collects messages as they come."""

    def __init__(self, path: Path, scan_topic: str, odometry_topic: str) -> None:
        self.path, self.scan_topic, self.odometry_topic = path, scan_topic, odometry_topic
        self.scan_stamp: list[float] = []
        self.odometry_stamp: list[float] = []
        self.geometry: dict[str, float] = {}
        self.ranges: list[Array] = []
        self.pose: list[tuple[float, float, float]] = []
        self.transforms = Transforms()
        self.frames = ["", ""]

    def add(self, topic: str, message: Any, recorded: float) -> None:
        """One message; `recorded`: when it was written [s], which stands in for a stamp that was never set."""
        if topic == self.scan_topic:
            self._scan(message, recorded)
        elif topic == self.odometry_topic:
            self._odometry(message, recorded)
        else:
            for t in message.transforms:
                p, q = t.transform.translation, t.transform.rotation
                self.transforms.add(t.header.frame_id, t.child_frame_id, (p.x, p.y, p.z), (q.x, q.y, q.z, q.w))

    def _scan(self, message: Any, recorded: float) -> None:
        number = len(self.ranges)
        geometry = {name: float(getattr(message, name)) for name in GEOMETRY}
        ranges = np.asarray(message.ranges, np.float64)
        if not self.ranges:
            if not np.isfinite(list(geometry.values())).all() or geometry["angle_increment"] == 0.0 or not len(ranges):
                raise self._error(number, f"{geometry} with {len(ranges)} beams is no scan")
            if not geometry["range_max"] > max(geometry["range_min"], 0.0):
                raise self._error(number, f"range_max {geometry['range_max']:g} m; a number above range_min is needed")
            self.geometry, self.frames[1] = geometry, message.header.frame_id
        elif len(ranges) != len(self.ranges[0]):
            raise self._error(number, f"{len(ranges)} beams; {len(self.ranges[0])} are needed, as in the first")
        else:
            for name, value in geometry.items():
                if not abs(value - self.geometry[name]) <= 1e-5:
                    raise self._error(number, f"{name} {value!r}; {self.geometry[name]!r} is needed, as in the first")
        self.ranges.append(ranges)
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

    def bag(self) -> Bag:
        """All of it."""
        for topic, messages in ((self.scan_topic, self.ranges), (self.odometry_topic, self.pose)):
            if not messages:
                raise DataError.at(self.path, f"no message of {topic}; at least one is needed")
        robot, laser = self.frames
        return Bag(
            self.scan_topic, self.odometry_topic, np.array(self.scan_stamp), np.array(self.odometry_stamp),
            self.geometry, np.array(self.ranges), np.array(self.pose), self.transforms.between(robot, laser),
            (robot, laser),
        )  # fmt: skip


def stamp_of(message: Any, recorded: float) -> float:
    """s; `sec` is `secs` nowhere: rosbags names the fields of both versions alike."""
    stamp = message.header.stamp
    return float(stamp.sec + 1e-9 * stamp.nanosec) if stamp.sec or stamp.nanosec else recorded

"""ROS bags (`rosbags`): opening them, stamps, rotations, and the frames that tf states.

`T_pc` is the pose of the child in its parent. A static transform holds always. Others are interpolated between their
stamps, and held before the first and after the last.
"""

import math
import re
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from data import se3
from data.errors import DataError, UsageError
from data.se2 import Array

SCAN, ODOMETRY, TRANSFORMS = "sensor_msgs/msg/LaserScan", "nav_msgs/msg/Odometry", "tf2_msgs/msg/TFMessage"
OLD_TRANSFORMS = "tf/msg/tfMessage"
WITH_ROTATION = ("PoseStamped", "TransformStamped", "Pose", "Pose2D")
POSED = ("turtlesim/msg/Pose", *(f"geometry_msgs/msg/{name}" for name in WITH_ROTATION))
PLACES = (*POSED, *(f"geometry_msgs/msg/{name}" for name in ("PointStamped", "Vector3Stamped", "Point", "Vector3")))
"""Types of one pose, or of one pose or place, without a covariance; some have no stamp."""
STILL = 1e-3  # m and 1: translations and quaternions of a transform that holds differ by at most this
TF = "tf"  # In place of a topic of odometry: the transform from the odometry's frame to the robot's
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
    """A reader of the bag; its errors become a DataError. `kinds`: more types than those of a log."""
    try:
        from data.formats.recordings.ros_bounded import any_reader
    except ImportError as error:
        raise UsageError(f"rosbag needs the package rosbags ({error}): pip install 'slamref[ros]'") from None
    if not path.exists():
        raise DataError.at(path, "no such bag; a .bag file, a folder of ROS 2, or its .mcap or .db3 is needed")
    files = files_of(path) or [path]
    parts = {f"{files[0].stem.removesuffix('_0')}_{k}" for k in range(len(files))}
    if len(files) > 1 and {f.stem for f in files} != parts:
        several = ", ".join(f.name for f in files)
        raise DataError.at(path, f"several bags without {METADATA}: {several}; name one of them")
    with _reported(path), any_reader(files, {SCAN, ODOMETRY, TRANSFORMS, *kinds}) as reader:
        yield reader


def files_of(path: Path) -> list[Path]:
    """The file or folder of a bag, none of any other; the files of a folder whose metadata are missing or of others."""
    folder = path.parent if path.name == METADATA else path
    if not folder.is_dir():
        return [path] * (path.suffix in SUFFIXES)
    metadata, found = folder / METADATA, sorted(f for f in folder.iterdir() if f.suffix in SUFFIXES[1:])
    text = metadata.read_text("utf-8", "replace") if metadata.is_file() else ""
    named = "rosbag2_bagfile_information" in text and (not found or any(f.name in text for f in found))
    return [folder] if named and folder.suffix not in SUFFIXES else found


SUFFIXES, METADATA = (".bag", ".mcap", ".db3"), "metadata.yaml"


def is_bag(path: Path) -> bool:
    """Whether a path looks like a bag: by its suffix, or as a folder of ROS 2."""
    return bool(files_of(path))


def file_and_topic(name: str) -> tuple[Path, str | None]:
    """The bag and the topic that `FILE:TOPIC` names; of any other name the path and None, as files may hold a colon."""
    cuts = [m.start() for m in re.finditer(":", name)] if not Path(name).exists() else []
    return next(((Path(name[:k]), name[k + 1 :]) for k in cuts if is_bag(Path(name[:k]))), (Path(name), None))


def stamp_of(message: Any, recorded: float) -> float:
    """Stamp of a message [s], or the time it was recorded."""
    stamp = message.header.stamp if hasattr(message, "header") else None
    return float(stamp.sec + 1e-9 * stamp.nanosec) if stamp and (stamp.sec or stamp.nanosec) else recorded


def frames_of(message: Any) -> tuple[str, str]:
    """Frames of a message's header and of the body, empty where it states none."""
    return getattr(getattr(message, "header", None), "frame_id", ""), getattr(message, "child_frame_id", "")


def placed(message: Any, where: str) -> tuple[float, ...]:
    """Position and quaternion of the only pose, transform or place of a message, zeros for what turns nothing."""
    if hasattr(message, "poses") and len(message.poses) != 1:
        raise DataError(f"{where}: {len(message.poses)} poses in a message; one is needed")
    of = message.poses[0] if hasattr(message, "poses") else message
    for part in ("transform", "pose", "pose", "point", "vector"):  # of a pose with covariance within its pose
        of = getattr(of, part, of)
    p, q = getattr(of, "position", getattr(of, "translation", of)), getattr(of, "orientation", None)
    if (q := getattr(of, "rotation", q)) is not None:
        return p.x, p.y, p.z, q.x, q.y, q.z, q.w
    turn = (math.sin(0.5 * of.theta), math.cos(0.5 * of.theta)) if hasattr(of, "theta") else (0.0, 0.0)
    return p.x, p.y, getattr(p, "z", 0.0), 0.0, 0.0, *turn


def heading(q: tuple[float, float, float, float] | Array) -> float:
    """Heading [rad] of a rotation (x, y, z, w): the angle of its x axis in the plane; NaN for an invalid quaternion."""
    R = rotation_of(q)
    return math.atan2(R[1, 0], R[0, 0])


def rotation_of(q: tuple[float, float, float, float] | Array) -> Array:
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


def bare(frame: str) -> str:
    """Name of a frame without the leading slash of ROS 1."""
    return frame.lstrip("/")


@dataclass
class Moving:
    """Stamps [s], translations and quaternions (x, y, z, w) of a frame in its parent."""

    parent: str
    static: bool
    stamp: list[float] = field(default_factory=list)
    translation: list[tuple[float, ...]] = field(default_factory=list)
    quaternion: list[tuple[float, ...]] = field(default_factory=list)

    @property
    def moves(self) -> bool:
        """Whether it changes by more than a simulator's rounding."""
        return bool((np.ptp(np.column_stack([self.translation, np.abs(self.quaternion)]), axis=0) > STILL).any())

    def at(self, time: Array) -> tuple[Array, Array]:
        """Rotations (n, 3, 3) and translations (n, 3) at times (n,)."""
        order = np.argsort(self.stamp, kind="stable")
        stamps = np.array(self.stamp)[order]
        R, t = rotation_of(np.array(self.quaternion)[order]), np.array(self.translation)[order]
        if self.static or len(stamps) == 1:
            return np.tile(R[-1], (len(time), 1, 1)), np.tile(t[-1], (len(time), 1))
        after = np.clip(np.searchsorted(stamps, time), 1, len(stamps) - 1)
        width = stamps[after] - stamps[after - 1]
        share = np.clip((time - stamps[after - 1]) / np.where(width > 0.0, width, 1.0), 0.0, 1.0)
        rotation = se3.between_rotations(R[after - 1], R[after], share)
        return rotation, t[after - 1] + share[:, None] * (t[after] - t[after - 1])


@dataclass
class Tree:
    """The last-stated parent of each frame, with its transforms."""

    moving: dict[str, Moving] = field(default_factory=dict)

    def add(self, parent: str, child: str, stamp: float, numbers: tuple[float, ...], *, static: bool) -> None:
        """Keep a transform: translation and quaternion, 7 numbers; one with NaN is left out."""
        if not np.isfinite(numbers).all() or not any(numbers[3:]):
            return
        parent, child = bare(parent), bare(child)
        known = self.moving.get(child)
        if known is None or known.parent != parent:
            known = self.moving[child] = Moving(parent, static)
        known.stamp.append(stamp)
        known.translation.append(numbers[:3])
        known.quaternion.append(numbers[3:])

    def add_message(self, message: Any, recorded: float, *, static: bool) -> None:
        """Keep the transforms of a message of tf, recorded at a time [s]."""
        for t in message.transforms:
            p, q = t.transform.translation, t.transform.rotation
            numbers = (p.x, p.y, p.z, q.x, q.y, q.z, q.w)
            self.add(t.header.frame_id, t.child_frame_id, stamp_of(t, recorded), numbers, static=static)

    def between(self, target: str, source: str, time: Array) -> tuple[Array, Array] | None:
        """Rotations (n, 3, 3) and translations (n, 3) of the source's frame in the target's at times; None: unknown."""
        up, down = self.ancestors(target), self.ancestors(source)
        common = next((name for name in up if name in down), None)
        if common is None:
            return None
        (Rt, tt), (Rs, ts) = self._in(common, target, time), self._in(common, source, time)
        back = Rt.transpose(0, 2, 1)
        return back @ Rs, np.einsum("nij,nj->ni", back, ts - tt)

    def carries(self, body: str, frame: str) -> bool:
        """Whether a frame is mounted on a body, or is the body itself."""
        return bare(body) in self.ancestors(frame)

    def ancestors(self, name: str) -> list[str]:
        """The frame, its parent, and so on."""
        chain = [bare(name)]
        while chain[-1] in self.moving and self.moving[chain[-1]].parent not in chain:
            chain.append(self.moving[chain[-1]].parent)
        return chain

    def _in(self, ancestor: str, name: str, time: Array) -> tuple[Array, Array]:
        R, t = np.tile(np.eye(3), (len(time), 1, 1)), np.zeros((len(time), 3))
        name = bare(name)
        while name != ancestor:
            Rp, tp = self.moving[name].at(time)
            R, t = Rp @ R, np.einsum("nij,nj->ni", Rp, t) + tp
            name = self.moving[name].parent
        return R, t


def table_of(path: Path, topic: str) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Names and rows of the numbers in a topic's messages, beside stamps t: NAME.FIELD, NAME_1, NAME.JOINT."""
    with opened(path) as reader:
        kinds = {c.topic: c.msgtype for c in reader.connections}
    if (kind := {name.strip("/"): of for name, of in kinds.items()}.get(topic.strip("/"))) is None:
        raise DataError.at(path, f"no topic {topic}; it has {', '.join(sorted(kinds))}")
    rows: list[dict[str, float]] = []
    with opened(path, frozenset({kind})) as reader:
        if kind not in reader.typestore.fielddefs:
            what = f"{topic}: the bag does not define {kind}; where it is installed, ros2 bag convert to mcap adds it"
            raise DataError.at(path, what)
        wanted = [c for c in reader.connections if c.topic.strip("/") == topic.strip("/")]
        for c, recorded, raw in reader.messages(wanted):
            message = reader.deserialize(raw, c.msgtype)
            rows.append({"t": stamp_of(message, 1e-9 * recorded)} | _numbers(message, ""))
    names = tuple(dict.fromkeys(name for row in rows for name in row))
    return names, [tuple(repr(row[name]) if name in row else "" for name in names) for row in rows]


def _numbers(value: Any, name: str) -> dict[str, float]:
    """The numbers of a message, or of a part of it, by field."""
    if isinstance(value, bool | int | float | np.number):
        return {name: float(value)}
    if hasattr(value, "__dataclass_fields__"):
        fields = {f: getattr(value, f) for f in value.__dataclass_fields__ if f not in ("header", "__msgtype__")}
        joints = [str(joint) for joint in fields.get("name") or ()] if isinstance(fields.get("name"), list) else []
        parts = {f"{name}.{f}".lstrip("."): item for f, item in fields.items()}
        of = {own: len(joints) > 0 and np.shape(item) == (len(joints),) for own, item in parts.items()}
        each = (
            {f"{own}.{joint}": v for joint, v in zip(joints, item, strict=True)} if of[own] else {own: item}
            for own, item in parts.items()
        )  # fmt: skip
        return {k: v for some in each for own, item in some.items() for k, v in _numbers(item, own).items()}
    most = MOST_LISTED * (MOST_BEAMS if name == "ranges" else 1)
    listed = isinstance(value, list | tuple | np.ndarray) and len(value) <= most
    return {k: v for j, item in enumerate(value, 1) for k, v in _numbers(item, f"{name}_{j}").items()} if listed else {}


MOST_LISTED, MOST_BEAMS = 64, 64  # Most entries of a list in a message that are columns; times as many of a scan

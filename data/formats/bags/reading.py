"""The topics of a ROS bag, and its messages as what they become: poses, fixes, detections, transforms, cameras."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from data.errors import DataError, UsageError, did_you_mean
from data.formats.recordings.ros import ODOMETRY, OLD_TRANSFORMS, SCAN, TF, TRANSFORMS, heading, opened, stamp_of
from data.formats.results.frames import Tree, bare
from data.terminal import in_columns

POSITION, INERTIAL = "sensor_msgs/msg/NavSatFix", "sensor_msgs/msg/Imu"
POSE, BARE = "geometry_msgs/msg/PoseWithCovarianceStamped", "geometry_msgs/msg/PoseStamped"
PLACE = "geometry_msgs/msg/PointStamped"
POSES, MARKERS = "geometry_msgs/msg/PoseArray", "visualization_msgs/msg/MarkerArray"
CAMERA = "sensor_msgs/msg/CameraInfo"
BOXES, FLAT_BOXES = "vision_msgs/msg/Detection3DArray", "vision_msgs/msg/Detection2DArray"
TAGS, FLAT_TAGS = "apriltag_ros/msg/AprilTagDetectionArray", "apriltag_msgs/msg/AprilTagDetectionArray"
STANDARD = frozenset({POSITION, INERTIAL, POSE, BARE, PLACE, POSES, MARKERS, CAMERA})
"""Types that a bag need not define, besides those of a laser log."""


class Role(StrEnum):
    """What a topic becomes."""

    ODOMETRY = "odometry"
    SCANS = "scans"
    POSITIONS = "position fixes"
    HEADINGS = "heading fixes"
    POSES = "pose fixes"
    POINTS = "observations: points"
    BEARINGS = "observations: bearings"
    SECOND = "second odometry: closures"
    TRUTH = "truth"
    TRANSFORMS = "transforms"
    CAMERA = "camera model"
    NOTHING = "-"


OF = {
    ODOMETRY: Role.ODOMETRY, SCAN: Role.SCANS, TRANSFORMS: Role.TRANSFORMS, OLD_TRANSFORMS: Role.TRANSFORMS,
    POSITION: Role.POSITIONS, INERTIAL: Role.HEADINGS, POSE: Role.POSES, BARE: Role.TRUTH, CAMERA: Role.CAMERA,
    PLACE: Role.TRUTH,
    POSES: Role.POINTS, MARKERS: Role.POINTS, BOXES: Role.POINTS, TAGS: Role.POINTS,
    FLAT_BOXES: Role.BEARINGS, FLAT_TAGS: Role.BEARINGS,
}  # fmt: skip
"""What the messages of a type become by default."""
SECOND_FLAG = "--second-odom"
CAN_BE_TRUTH = (ODOMETRY, POSE, BARE, PLACE)
FIXES = (Role.POSITIONS, Role.HEADINGS, Role.POSES)
DETECTIONS = (Role.POINTS, Role.BEARINGS)


@dataclass(frozen=True)
class Topic:
    """A topic: name, type, number of messages, what it becomes, and why, where that is not by its type."""

    name: str
    kind: str
    count: int
    role: Role
    why: str = ""


def topics_of(path: Path) -> tuple[Topic, ...]:
    """The topics of a bag by name, each with what its type becomes.

    Raises:
        UsageError: `rosbags` is not installed.
        DataError: no bag, or a damaged one.
    """
    with opened(path, STANDARD) as reader:
        found: dict[str, Topic] = {}
        for c in reader.connections:
            known = found.get(c.topic)
            role, why = OF.get(c.msgtype, Role.NOTHING), ""
            if role is Role.NOTHING:
                why = "messages of this type are not read"
            elif c.msgtype not in reader.typestore.fielddefs:
                role, why = Role.NOTHING, "the bag does not define this type"
            count = c.msgcount + (known.count if known is not None else 0)
            found[c.topic] = Topic(c.topic, c.msgtype, count, role, why)
        if not all(isinstance(word, str) for t in found.values() for word in (t.name, t.kind)):
            raise TypeError("a topic or its type is no text")  # metadata may hold a date; `opened` says it in a line
    return tuple(found[name] for name in sorted(found))


def chosen(
    path: Path,
    topics: Sequence[Topic],
    *,
    odometry: str | None = None,
    scans: str | None = None,
    truth: str | None = None,
    second: str | None = None,
    skip: Collection[str] = (),
) -> tuple[Topic, ...]:
    """The topics with the roles that the flags give them. UsageError for an unknown or an ambiguous one."""
    names = [t.name for t in topics]
    flags = (("--odom", odometry), ("--scan", scans), ("--truth", truth), (SECOND_FLAG, second))
    for flag, name in (*flags, *(("--skip", s) for s in skip)):
        if name is not None and name not in names and name != TF:
            raise UsageError(f"{flag} {name}: no such topic in {path}{did_you_mean(name, names)}")
    by_name = {t.name: t for t in topics}
    for name in skip:
        by_name[name] = replace(by_name[name], role=Role.NOTHING, why="--skip")
    if truth is not None and truth != TF:
        if by_name[truth].kind not in CAN_BE_TRUTH:
            raise UsageError(f"--truth {truth}: its messages are {by_name[truth].kind}; poses are needed")
        by_name[truth] = replace(by_name[truth], role=Role.TRUTH, why="--truth")
    if second is not None:
        if second in (odometry, truth):
            raise UsageError(
                f"{SECOND_FLAG} {second}: {'--odom' if second == odometry else '--truth'} is the same topic"
            )
        if second not in by_name or by_name[second].kind != ODOMETRY:
            kind = f"its messages are {by_name[second].kind}" if second in by_name else "transforms have no noise"
            raise UsageError(f"{SECOND_FLAG} {second}: {kind}; {ODOMETRY} is needed")
        by_name[second] = replace(by_name[second], role=Role.SECOND, why=SECOND_FLAG)
    for name, t in by_name.items():
        if t.role is Role.TRUTH and name != truth:
            by_name[name] = replace(t, role=Role.NOTHING, why=f"--truth {name} makes it the truth")
    for role, flag, wanted in ((Role.ODOMETRY, "--odom", odometry), (Role.SCANS, "--scan", scans)):
        of_role = [t.name for t in by_name.values() if t.role is role]
        if wanted == TF and role is Role.ODOMETRY:
            keep = ""
        elif wanted is not None and wanted not in of_role:
            raise UsageError(f"{flag} {wanted}: no topic of {role}; such topics: {', '.join(of_role) or 'none'}")
        elif wanted is None and len(of_role) > 1:
            raise UsageError(f"{path}: {flag} TOPIC is needed; topics of {role}: {', '.join(of_role)}")
        else:
            keep = wanted if wanted is not None else (of_role or [""])[0]
        for name in of_role:
            if name != keep:
                why = f"{flag} {keep or TF} is used; --truth {name} makes it the truth"
                why += f", {SECOND_FLAG} {name} closures" if role is Role.ODOMETRY else ""
                by_name[name] = replace(by_name[name], role=Role.NOTHING, why=why)
    return tuple(by_name.values())


def listed(topics: Sequence[Topic]) -> str:
    """A line for each topic: name, type, messages, what it becomes."""
    rows = [(t.name, t.kind, f"{t.count} messages", t.role.value + (f" ({t.why})" if t.why else "")) for t in topics]
    return "\n".join(in_columns(rows)) if rows else "no topic"


ADD = 0
"""Action of a marker that is there."""


class Pose(NamedTuple):
    """A pose in the plane: stamp [s], x, y [m], heading [rad], covariance (3, 3) of these, or NaN where not stated; of
    a place alone the heading is NaN.

    Of a satellite fix: latitude, longitude [deg], height [m], and the covariance (2, 2) east, north [m²].
    """

    stamp: float
    pose: tuple[float, float, float]
    covariance: np.ndarray[Any, Any]


class Detection(NamedTuple):
    """Something seen: stamp [s], frame, id (-1: none), and a point [m] of the frame, or pixels u, v and NaN."""

    stamp: float
    frame: str
    id: int
    at: tuple[float, float, float]


@dataclass
class Collected:
    """Messages by topic.

    Attributes:
        poses: of odometry, truth and fixes, with the frames of each topic: of the header and the body's. Of a second
            odometry the covariance is that of the velocity along, across and of the turn.
        detections: by topic.
        cameras: fx, fy, cx, cy by frame.
        tree: transforms.
    """

    poses: dict[str, list[Pose]] = field(default_factory=dict)
    frames: dict[str, tuple[str, str]] = field(default_factory=dict)
    detections: dict[str, list[Detection]] = field(default_factory=dict)
    cameras: dict[str, tuple[float, float, float, float]] = field(default_factory=dict)
    tree: Tree = field(default_factory=Tree)


def collect(path: Path, topics: Sequence[Topic]) -> Collected:
    """The messages of topics with a role, but scans. DataError for a damaged bag, or an invalid number."""
    role = {t.name: t.role for t in topics if t.role not in (Role.NOTHING, Role.SCANS)}
    found = Collected()
    with opened(path, STANDARD) as reader:
        wanted = [c for c in reader.connections if c.topic in role]
        for c, recorded, raw in reader.messages(wanted) if wanted else ():
            message, time = reader.deserialize(raw, c.msgtype), 1e-9 * recorded
            where = f"{path}: a message of {c.topic}"
            _add(found, role[c.topic], c.topic, c.msgtype, message, time, where)
    return found


def _add(found: Collected, role: Role, topic: str, kind: str, message: Any, recorded: float, where: str) -> None:
    if role is Role.TRANSFORMS:
        found.tree.add_message(message, recorded, static=topic.endswith("static"))
    elif role is Role.CAMERA:
        k = np.asarray(message.k if hasattr(message, "k") else message.K, float)
        if np.isfinite(k).all() and k[0] > 0.0 and k[4] > 0.0:
            found.cameras.setdefault(bare(message.header.frame_id), (k[0], k[4], k[2], k[5]))
    elif role in (Role.POINTS, Role.BEARINGS):
        found.detections.setdefault(topic, []).extend(
            d for d in detections(kind, message, recorded) if _finite(d.at[:2], where)
        )
    elif role is Role.POSITIONS:
        found.frames[topic] = "", bare(message.header.frame_id)
        if message.status.status < 0 or not np.isfinite([message.latitude, message.longitude]).all():
            return
        C = np.asarray(message.position_covariance, float).reshape(3, 3)[:2, :2]
        stated = message.position_covariance_type > 0
        height = message.altitude if math.isfinite(message.altitude) else 0.0
        place = (float(message.latitude), float(message.longitude), float(height))
        P = C if stated else np.full((2, 2), np.nan)
        found.poses.setdefault(topic, []).append(Pose(stamp_of(message, recorded), place, P))
    elif role is Role.HEADINGS:
        found.frames[topic] = "", bare(message.header.frame_id)
        C, q = np.asarray(message.orientation_covariance, float).reshape(3, 3), message.orientation
        angle = heading((q.x, q.y, q.z, q.w))
        if C[0, 0] == -1.0 or not math.isfinite(angle):
            return
        P = np.full((3, 3), np.nan)
        P[2, 2] = C[2, 2] if C[2, 2] > 0.0 else np.nan
        found.poses.setdefault(topic, []).append(Pose(stamp_of(message, recorded), (0.0, 0.0, angle), P))
    else:
        pose = _pose(message, recorded, where)
        if role is Role.SECOND:
            C = np.asarray(message.twist.covariance, float).reshape(6, 6)[np.ix_((0, 1, 5), (0, 1, 5))]
            pose = pose._replace(covariance=0.5 * (C + C.T))
        found.poses.setdefault(topic, []).append(pose)
        found.frames[topic] = bare(message.header.frame_id), bare(getattr(message, "child_frame_id", ""))


def _finite(values: Sequence[float], where: str) -> bool:
    if not np.isfinite(values).all():
        raise DataError(f"{where}: {', '.join(f'{v:g}' for v in values)}; finite numbers are needed")
    return True


def _pose(message: Any, recorded: float, where: str) -> Pose:
    P = np.full((3, 3), np.nan)
    if hasattr(message, "point"):  # a place alone
        x, y = (float(message.point.x), float(message.point.y))
        _finite((x, y), where)
        return Pose(stamp_of(message, recorded), (x, y, math.nan), P)
    pose = message.pose
    if hasattr(pose, "covariance"):
        C = np.asarray(pose.covariance, float).reshape(6, 6)[np.ix_((0, 1, 5), (0, 1, 5))]
        if np.isfinite(C).all() and (np.diagonal(C) > 0.0).all():
            P = 0.5 * (C + C.T)
    pose = pose.pose if hasattr(pose, "pose") else pose
    p, q = pose.position, pose.orientation
    values = (float(p.x), float(p.y), heading((q.x, q.y, q.z, q.w)))
    _finite(values, where)
    return Pose(stamp_of(message, recorded), values, P)


def detections(kind: str, message: Any, recorded: float) -> Iterator[Detection]:
    """What a message of detections holds."""
    if kind == POSES:
        stamp, frame = stamp_of(message, recorded), bare(message.header.frame_id)
        for pose in message.poses:
            yield Detection(stamp, frame, -1, _point(pose.position))
    elif kind == MARKERS:
        for marker in message.markers:
            if marker.action == ADD:
                frame = bare(marker.header.frame_id)
                yield Detection(stamp_of(marker, recorded), frame, _id(marker.id), _point(marker.pose.position))
    elif kind == TAGS:
        for tag in message.detections:
            number = _id(tag.id[0]) if len(tag.id) == 1 else -1
            frame = bare(tag.pose.header.frame_id or message.header.frame_id)
            yield Detection(stamp_of(message, recorded), frame, number, _point(tag.pose.pose.pose.position))
    elif kind == FLAT_TAGS:
        for tag in message.detections:
            at = (float(tag.centre.x), float(tag.centre.y), math.nan)
            yield Detection(stamp_of(message, recorded), bare(message.header.frame_id), _id(tag.id), at)
    elif kind in (BOXES, FLAT_BOXES):
        for box in message.detections:
            centre = box.bbox.center
            frame = bare(box.header.frame_id or message.header.frame_id)
            if kind == BOXES:
                at = _point(centre.position)
            else:
                place = centre.position if hasattr(centre, "position") else centre
                at = (float(place.x), float(place.y), math.nan)
            yield Detection(stamp_of(message, recorded), frame, _id(getattr(box, "id", "")), at)


def _point(p: Any) -> tuple[float, float, float]:
    return float(p.x), float(p.y), float(p.z)


def _id(value: Any) -> int:
    """A whole number from 0 up; -1 for anything else."""
    text = str(value).strip()
    return int(text) if text.isdecimal() and len(text) < 10 else -1

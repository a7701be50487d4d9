"""The topics of a ROS bag, and what each becomes in a log."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from pathlib import Path

from data.errors import UsageError, did_you_mean
from data.formats.recordings.ros import ODOMETRY, OLD_TRANSFORMS, SCAN, TF, TRANSFORMS, opened
from data.terminal import in_columns

POSITION, INERTIAL = "sensor_msgs/msg/NavSatFix", "sensor_msgs/msg/Imu"
POSE, BARE = "geometry_msgs/msg/PoseWithCovarianceStamped", "geometry_msgs/msg/PoseStamped"
POSES, MARKERS = "geometry_msgs/msg/PoseArray", "visualization_msgs/msg/MarkerArray"
CAMERA = "sensor_msgs/msg/CameraInfo"
BOXES, FLAT_BOXES = "vision_msgs/msg/Detection3DArray", "vision_msgs/msg/Detection2DArray"
TAGS, FLAT_TAGS = "apriltag_ros/msg/AprilTagDetectionArray", "apriltag_msgs/msg/AprilTagDetectionArray"
STANDARD = frozenset({POSITION, INERTIAL, POSE, BARE, POSES, MARKERS, CAMERA})
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
    POSES: Role.POINTS, MARKERS: Role.POINTS, BOXES: Role.POINTS, TAGS: Role.POINTS,
    FLAT_BOXES: Role.BEARINGS, FLAT_TAGS: Role.BEARINGS,
}  # fmt: skip
"""What the messages of a type become by default."""
SECOND_FLAG = "--second-odom"
CAN_BE_TRUTH = (ODOMETRY, POSE, BARE)
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

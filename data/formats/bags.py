"""ROS bags as logs: odometry, and whatever of detections, fixes, scans and truth they hold; or a laser log.

Frames are the instants of scans, detections and fixes, and every second, within the span of the odometry, whose poses
are interpolated. The body is the odometry's child frame; tf places cameras, lasers and antennas on it, and is the
odometry where no topic is. In a laser log every scan is a frame.
"""

import math
import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from data import se2
from data.columns.named import LENGTH
from data.columns.scans import with_returns
from data.digest import source_file
from data.earth import east_north_up
from data.errors import DataError, UsageError, did_you_mean
from data.formats.recordings import laser as lasers, ros
from data.formats.recordings.beams import on_one_set
from data.formats.recordings.laser import FLOOR, TravelNoise
from data.formats.recordings.mending import AS_STATED, Mending, beam_angles, piled_up, require_metres
from data.formats.recordings.ros import ODOMETRY, OLD_TRANSFORMS, PLACES, POSED, SCAN, TF, TRANSFORMS, Tree
from data.formats.results.path import ABSENT, unturned
from data.formats.second_odometry import closures_between, covered, of_twists, own_name
from data.inputs import UNLABELLED, Inputs, IntArray, LandmarkMap, Observations, Prior, Scanner, Scans
from data.log import Log
from data.notice import Notice
from data.origin import Origin
from data.pose_measurements import Closures, Fixes, FixKind, FixSource, onto_fixes
from data.se2 import Array, BoolArray, interpolate, inverse
from data.sensors import Bearing, Range, RangeBearing, RelativePoint, Sensor
from data.terminal import counted, in_columns
from data.timeline import frame_times, truth_at
from data.truth import Truth

POSITION, INERTIAL = "sensor_msgs/msg/NavSatFix", "sensor_msgs/msg/Imu"
POSE = "geometry_msgs/msg/PoseWithCovarianceStamped"
POSES, MARKERS = "geometry_msgs/msg/PoseArray", "visualization_msgs/msg/MarkerArray"
CAMERA = "sensor_msgs/msg/CameraInfo"
BOXES, FLAT_BOXES = "vision_msgs/msg/Detection3DArray", "vision_msgs/msg/Detection2DArray"
TAGS, FLAT_TAGS = "apriltag_ros/msg/AprilTagDetectionArray", "apriltag_msgs/msg/AprilTagDetectionArray"
STANDARD = frozenset({POSITION, INERTIAL, POSE, *PLACES, POSES, MARKERS, CAMERA})
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
    RANGES = "observations: ranges"
    POLAR = "observations: ranges and bearings"
    SECOND = "second odometry: closures"
    TRUTH = "truth"
    TRANSFORMS = "transforms"
    CAMERA = "camera model"
    NOTHING = "-"


OF = {
    ODOMETRY: Role.ODOMETRY, SCAN: Role.SCANS, TRANSFORMS: Role.TRANSFORMS, OLD_TRANSFORMS: Role.TRANSFORMS,
    POSITION: Role.POSITIONS, INERTIAL: Role.HEADINGS, POSE: Role.POSES, CAMERA: Role.CAMERA,
    **dict.fromkeys(PLACES, Role.TRUTH),
    POSES: Role.POINTS, MARKERS: Role.POINTS, BOXES: Role.POINTS, TAGS: Role.POINTS,
    FLAT_BOXES: Role.BEARINGS, FLAT_TAGS: Role.BEARINGS,
}  # fmt: skip
"""What the messages of a type become by default."""
SECOND_FLAG = "--second-odom"
CAN_BE_TRUTH = (ODOMETRY, POSE, *PLACES)
FIXES, RANGED = (Role.POSITIONS, Role.HEADINGS, Role.POSES), (Role.RANGES, Role.POLAR)


@dataclass(frozen=True)
class Topic:
    """A topic: name, type, number of messages, what it becomes, and why, where that is not by its type."""

    name: str
    kind: str
    count: int
    role: Role
    why: str = ""


def topics_of(path: Path) -> tuple[Topic, ...]:
    """The topics by name, with what each becomes. UsageError: no `rosbags`. DataError: no bag, or a damaged one."""
    with ros.opened(path, STANDARD) as reader:
        found: dict[str, Topic] = {}
        for c in reader.connections:
            known = found.get(c.topic)
            role, why = OF.get(c.msgtype, Role.NOTHING), ""
            if role is Role.NOTHING:
                role, why = _by_fields(c.msgtype, reader.typestore.fielddefs)
            elif c.msgtype not in reader.typestore.fielddefs:
                role, why = Role.NOTHING, "the bag does not define this type"
            count = c.msgcount + (known.count if known is not None else 0)
            if not count and reader.message_count:
                role, why = Role.NOTHING, "no message"
            found[c.topic] = Topic(c.topic, c.msgtype, count, role, why)
        if not all(isinstance(word, str) for t in found.values() for word in (t.name, t.kind)):
            raise TypeError("a topic or its type is no text")  # metadata may hold a date; `opened` says it in a line
    return tuple(found[name] for name in sorted(found))


NUMBERS = {"float32", "float64", *(f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64))}
RANGE = ("range", "distance", "dist")
TURN = ("bearing", "azimuth", "angle", "yaw")
LANDMARK = ("anchorid", "anchor", "beaconid", "beacon", "landmarkid", "landmark", "markerid", "nodeid", "id", "tagid")


def ranged(names: Sequence[str]) -> tuple[str, ...]:
    """Range, landmark's id, and bearing if there is one, among the numbers of a message or a part; empty without id."""
    plain = {name.lower().replace("_", ""): name for name in names}
    found = [next((plain[word] for word in words if word in plain), "") for words in (RANGE, LANDMARK, TURN)]
    return () if "" in found[:2] else tuple(name for name in found if name)


def _by_fields(kind: str, types: Mapping[str, Any]) -> tuple[Role, str]:
    """What a type becomes by its numbers, or those of the parts in a list, and which these are."""
    fields = types.get(kind, ((), ()))[1]
    parts = [(f"{n}[].", types[of[0][1]][1]) for n, (_, of) in fields if isinstance(of[0], tuple) and of[0][1] in types]
    for within, some in (("", fields), *parts):
        if names := ranged([n for n, (_, of) in some if of[0] in NUMBERS]):
            return RANGED[len(names) - 2], " of ".join(within + name for name in (names[0], names[1]))
    return Role.NOTHING, "a table: slamref convert table BAG:/TOPIC LOG"


def chosen(
    path: Path, topics: Sequence[Topic], *, odometry: str | None = None, scans: str | None = None,
    truth: str | None = None, second: str | None = None, skip: Collection[str] = (), listing: bool = False,
) -> tuple[Topic, ...]:  # fmt: skip
    """The topics with the roles that flags give them. UsageError for an unknown or (unless `listing`) ambiguous one."""
    names = [t.name for t in topics]
    flags = (("--odom", odometry), ("--scan", scans), ("--truth", truth), (SECOND_FLAG, second))
    for flag, name in (*flags, *(("--skip", s) for s in skip)):
        if name is not None and name not in names and name != TF:
            raise UsageError(f"{flag} {name}: no such topic in {path}{did_you_mean(name, names)}")
    by_name = {t.name: t for t in topics}
    for name in skip:
        if (of := by_name[name]).role is Role.NOTHING:
            raise UsageError(f"--skip {name}: it is left out without it, too: {of.why}")
        by_name[name] = replace(by_name[name], role=Role.NOTHING, why="--skip")
    if truth is not None and truth != TF:
        if by_name[truth].kind not in CAN_BE_TRUTH:
            raise UsageError(f"--truth {truth}: its messages are {by_name[truth].kind}; poses are needed")
        by_name[truth] = replace(by_name[truth], role=Role.TRUTH, why="--truth")
    if second is not None:
        if second in (odometry, truth):
            flag = "--odom" if second == odometry else "--truth"
            raise UsageError(f"{SECOND_FLAG} {second}: {flag} is the same topic")
        if second not in by_name or by_name[second].kind != ODOMETRY:
            kind = f"its messages are {by_name[second].kind}" if second in by_name else "transforms have no noise"
            raise UsageError(f"{SECOND_FLAG} {second}: {kind}; {ODOMETRY} is needed")
        by_name[second] = replace(by_name[second], role=Role.SECOND, why=SECOND_FLAG)
    if odometry in by_name and by_name[odometry].kind in (*POSED, POSE) and odometry != truth:
        by_name[odometry] = replace(by_name[odometry], role=Role.ODOMETRY, why="--odom")
    for name, t in by_name.items():
        if t.role is Role.TRUTH and name != truth:
            by_name[name] = replace(t, role=Role.NOTHING, why=f"--truth {name} makes it the truth")
    for role, flag, wanted in ((Role.ODOMETRY, "--odom", odometry), (Role.SCANS, "--scan", scans)):
        of_role = [t.name for t in by_name.values() if t.role is role]
        if wanted == TF and role is Role.ODOMETRY:
            keep = ""
        elif wanted is not None and wanted not in of_role:
            kind = next(t.kind for t in topics if t.name == wanted)
            there = ", ".join(of_role) or "none"
            more = f"; {OTHERWISE}" * (role is Role.ODOMETRY)
            raise UsageError(f"{flag} {wanted}: its messages are {kind}; topics of {role}: {there}{more}")
        elif wanted is None and len(of_role) > 1 and listing:
            by_name |= {name: replace(by_name[name], why=f"if {flag} {name}") for name in of_role}
            continue
        elif wanted is None and len(of_role) > 1:
            raise UsageError(f"{path}: {flag} TOPIC is needed; topics of {role}: {', '.join(of_role)}")
        else:
            keep = wanted if wanted is not None else (of_role or [""])[0]
        for name in of_role:
            if name != keep:
                why = f"{flag} {keep or TF} is used"
                if role is Role.ODOMETRY:
                    why += f"; --truth {name} makes it the truth, {SECOND_FLAG} {name} closures"
                by_name[name] = replace(by_name[name], role=Role.NOTHING, why=why)
    return tuple(by_name.values())


def listed(topics: Sequence[Topic]) -> str:
    """A line for each topic: name, type, messages, what it becomes."""
    rows = [(t.name, t.kind, f"{t.count} messages", t.role.value + (f" ({t.why})" if t.why else "")) for t in topics]
    return "\n".join(in_columns(rows)) if rows else "no topic"


ADD = 0  # Action of a marker that is there
GEOMETRY = ("angle_min", "angle_max", "angle_increment", "range_min", "range_max")
SHARED = ("range_min", "range_max")  # Numbers that are the same in every scan; angles may differ (rotating scanners)
WIDEST = 1e6  # rad, an angle of a beam that is none: beams are told apart by whole numbers of `beams.ANGLE`


class Pose(NamedTuple):
    """A pose in the plane, or of a satellite fix latitude, longitude [deg] and height [m]."""

    stamp: float  # s
    pose: tuple[float, float, float]  # x, y [m], heading [rad], which is NaN of a place alone
    covariance: Array  # (3, 3), NaN where not stated; of a satellite fix (2, 2) of east, north [m^2]


class Detection(NamedTuple):
    """Something seen: stamp [s], frame, id (-1: none), and a point [m] of the frame, or pixels u, v and NaN."""

    stamp: float
    frame: str
    id: int
    at: tuple[float, float, float]


@dataclass
class Scanned:
    """The scans of a bag as recorded."""

    frame: str = ""  # of the first one
    geometry: dict[str, float] = field(default_factory=dict)  # numbers of `GEOMETRY` of the first one
    stamp: list[float] = field(default_factory=list)  # s
    ranges: list[Array] = field(default_factory=list)  # m
    angles: list[tuple[float, float]] = field(default_factory=list)  # first angle and step [rad] of each

    def add(self, message: Any, recorded: float, where: str) -> None:
        """Add a message; DataError for one that is no scan, or unlike the first."""
        geometry = {name: float(getattr(message, name)) for name in GEOMETRY}
        ranges, why = np.asarray(message.ranges, np.float64), ""
        g, first = geometry, self.geometry or geometry
        if not self.ranges and not g["range_max"] > max(g["range_min"], 0.0):
            why = f"range_max {g['range_max']:g} m; a number above range_min is needed"
        for name in SHARED:
            if self.ranges and not abs(g[name] - first[name]) <= 1e-5:
                why = f"{name} {g[name]!r}; {first[name]!r} is needed, as in the first"
        known = list(g.values()) if not self.ranges else [g["angle_min"], g["angle_increment"]]
        level = abs(g["angle_min"]) < WIDEST and 0.0 < abs(g["angle_increment"]) < WIDEST
        if not np.isfinite(known).all() or not level or not len(ranges):
            why = f"{g} with {len(ranges)} beams is no scan; beams at angles in rad and finite numbers are needed"
        if why:
            raise DataError(f"{where}: {why}")
        if not self.ranges:
            self.geometry, self.frame = geometry, ros.bare(message.header.frame_id)
        self.ranges.append(ranges)
        self.angles.append((g["angle_min"], g["angle_increment"]))
        self.stamp.append(ros.stamp_of(message, recorded))


@dataclass
class Collected:
    """Messages by topic."""

    # of odometry, truth and fixes, with the frames of each topic: of the header and the body's. Of a second odometry
    # the covariance is that of the velocity along, across and of the turn
    poses: dict[str, list[Pose]] = field(default_factory=dict)
    frames: dict[str, tuple[str, str]] = field(default_factory=dict)
    unstamped: set[str] = field(default_factory=set)  # topics of poses with stamps 0, which are times of recording then
    detections: dict[str, list[Detection]] = field(default_factory=dict)  # by topic
    whole: set[str] = field(default_factory=set)  # topics of ranges that are whole numbers
    places: dict[str, tuple[float, ...]] = field(default_factory=dict)  # by topic, of a sensor as its messages state it
    cameras: dict[str, tuple[float, float, float, float]] = field(default_factory=dict)  # fx, fy, cx, cy by frame
    tree: Tree = field(default_factory=Tree)  # transforms
    scans: Scanned = field(default_factory=Scanned)  # of the only topic of scans

    def told(self) -> list[str]:
        """A sentence on each topic of poses without stamps."""
        return [f"{topic}: messages without a stamp have that of recording." for topic in sorted(self.unstamped)]


def collect(path: Path, topics: Sequence[Topic]) -> Collected:
    """The messages of topics with a role. DataError for a damaged bag, or an invalid number or scan."""
    role = {t.name: t.role for t in topics if t.role is not Role.NOTHING}
    count = dict.fromkeys(role, 0)
    found = Collected()
    with ros.opened(path, STANDARD) as reader:
        wanted = [c for c in reader.connections if c.topic in role]
        for c, recorded, raw in reader.messages(wanted) if wanted else ():
            message, time = reader.deserialize(raw, c.msgtype), 1e-9 * recorded
            where = f"{path}: message {count[c.topic]} of {c.topic}"
            count[c.topic] += 1
            _add(found, role[c.topic], c.topic, c.msgtype, message, time, where)
    return found


def _add(found: Collected, role: Role, topic: str, kind: str, message: Any, recorded: float, where: str) -> None:
    if role is Role.TRANSFORMS:
        found.tree.add_message(message, recorded, static=topic.endswith("static"))
    elif role is Role.SCANS:
        found.scans.add(message, recorded, where)
    elif role is Role.CAMERA:
        k = np.asarray(message.k if hasattr(message, "k") else message.K, float)
        if np.isfinite(k).all() and k[0] > 0.0 and k[4] > 0.0:
            found.cameras.setdefault(ros.bare(message.header.frame_id), (k[0], k[4], k[2], k[5]))
    elif role in (Role.POINTS, Role.BEARINGS):
        some = (d for d in detections(kind, message, recorded) if _finite(d.at[:2], where))
        found.detections.setdefault(topic, []).extend(some)
    elif role in RANGED:
        stamped = hasattr(message, "header")
        frame = ros.bare(message.header.frame_id) if stamped else ""
        at = ros.stamp_of(message, recorded) if stamped else recorded
        if (own := getattr(message, "sensor_pose_on_robot", None)) is not None:
            p, q = own.position, own.orientation
            found.places[topic] = (p.x, p.y, p.z, q.x, q.y, q.z, q.w)
        for part in (message, *(p for v in vars(message).values() if isinstance(v, list) for p in v)):
            value = {name: v for name, v in getattr(part, "__dict__", {}).items() if isinstance(v, (int, float))}
            far, number, turn = (*(value[name] for name in ranged([*value])), 0.0, 0.0, 0.0)[:3]
            found.whole |= {topic} if far > 0 and isinstance(far, int) else set()
            if far > 0.0 and _finite(z := (float(far), float(turn), 0.0), where):
                found.detections.setdefault(topic, []).append(Detection(at, frame, _id(number), z))
    elif role is Role.POSITIONS:
        found.frames[topic] = "", ros.bare(message.header.frame_id)
        if message.status.status < 0 or not np.isfinite([message.latitude, message.longitude]).all():
            return
        C = np.asarray(message.position_covariance, float).reshape(3, 3)[:2, :2]
        stated = message.position_covariance_type > 0
        height = message.altitude if math.isfinite(message.altitude) else 0.0
        place = (float(message.latitude), float(message.longitude), float(height))
        P = C if stated else np.full((2, 2), np.nan)
        found.poses.setdefault(topic, []).append(Pose(ros.stamp_of(message, recorded), place, P))
    elif role is Role.HEADINGS:
        found.frames[topic] = "", ros.bare(message.header.frame_id)
        C, q = np.asarray(message.orientation_covariance, float).reshape(3, 3), message.orientation
        angle = ros.heading((q.x, q.y, q.z, q.w))
        if C[0, 0] == -1.0 or not math.isfinite(angle):
            return
        P = np.full((3, 3), np.nan)
        P[2, 2] = C[2, 2] if C[2, 2] > 0.0 else np.nan
        found.poses.setdefault(topic, []).append(Pose(ros.stamp_of(message, recorded), (0.0, 0.0, angle), P))
    else:
        pose = _pose(message, recorded, where, role)
        if role is Role.SECOND:
            C = np.asarray(message.twist.covariance, float).reshape(6, 6)[np.ix_((0, 1, 5), (0, 1, 5))]
            pose = pose._replace(covariance=0.5 * (C + C.T))
        found.poses.setdefault(topic, []).append(pose)
        found.unstamped |= {topic} if ros.stamp_of(message, 0.0) == 0.0 else set()
        world, body = ros.frames_of(message)
        found.frames[topic] = ros.bare(world), ros.bare(body)


def _finite(values: Sequence[float], where: str) -> bool:
    if not np.isfinite(values).all():
        raise DataError(f"{where}: {', '.join(f'{v:g}' for v in values)}; finite numbers are needed")
    return True


def _pose(message: Any, recorded: float, where: str, role: Role) -> Pose:
    P = np.full((3, 3), np.nan)
    if role is Role.POSES and hasattr(pose := message.pose, "covariance"):
        C = np.asarray(pose.covariance, float).reshape(6, 6)[np.ix_((0, 1, 5), (0, 1, 5))]
        if np.isfinite(C).all() and (np.diagonal(C) > 0.0).all():
            P = 0.5 * (C + C.T)
    x, y, _, *q = map(float, ros.placed(message, where))
    values = (x, y, ros.heading(np.array(q)))
    _finite(values if any(q) or role is not Role.TRUTH else values[:2], where)
    return Pose(ros.stamp_of(message, recorded), values, P)


def detections(kind: str, message: Any, recorded: float) -> Iterator[Detection]:
    """What a message of detections holds."""
    every: list[tuple[Any, str, Any, Any]]  # message with the stamp, frame if it is another one's, id, point or pixel
    if kind == POSES:
        every = [(message, "", -1, pose.position) for pose in message.poses]
    elif kind == MARKERS:
        every = [(m, m.header.frame_id, m.id, m.pose.position) for m in message.markers if m.action == ADD]
    elif kind == TAGS:
        one = [(t.pose, t.id[0] if len(t.id) == 1 else -1) for t in message.detections]
        every = [(message, pose.header.frame_id, number, pose.pose.pose.position) for pose, number in one]
    elif kind == FLAT_TAGS:
        every = [(message, "", tag.id, tag.centre) for tag in message.detections]
    else:
        boxes = [(box, box.bbox.center) for box in message.detections]
        every = [(message, b.header.frame_id, getattr(b, "id", ""), getattr(c, "position", c)) for b, c in boxes]
    for stamped, frame, number, p in every:
        at = (float(p.x), float(p.y), float(getattr(p, "z", math.nan)))
        yield Detection(ros.stamp_of(stamped, recorded), ros.bare(frame or stamped.header.frame_id), _id(number), at)


def _id(value: Any) -> int:
    """A whole number from 0 up; -1 for anything else."""
    text = str(value).strip()
    return int(text) if text.isdecimal() and len(text) < 10 else -1


SIGMA = 0.01  # m, of a range, which messages do not state; small scanners state 1 to 3 cm
MOST_BEYOND = 0.5  # Share of ranges beyond the stated maximum, in the ranges' unit, from which on that is in another
LONG = 1.0  # s; longer gaps of the odometry are counted
SMALL = 1e-3  # Largest deviation of the tilt's cosine from 1 (2.6 degrees)
ODOM_FRAME = "odom"
BODIES = ("base_link", "base_footprint")  # Usual frames of a robot, where its odometry names none
WHEELS = re.compile("odom|wheel|encoder|tick|motor|joint|twist", re.IGNORECASE)  # In names of other odometry
OTHERWISE = "ticks left, right (joints: in rad), or v, omega, suit slamref convert table BAG:/TOPIC LOG"


def odometry_of(path: Path, topics: Sequence[Topic], found: Collected) -> tuple[str, str, Array, Array]:
    """Topic (or tf), the robot's frame, stamps (K,), ascending, and poses (K, 3). By tf: the transform from a frame of
    odometry, or else the one that moves, on the way to the laser if there is one.
    """
    topic = next((t.name for t in topics if t.role is Role.ODOMETRY), None)
    if topic is not None:
        rows = found.poses.get(topic, [])
        if not rows:
            raise DataError.at(path, f"no message of {topic}; at least one is needed")
        stamp, pose = np.array([r.stamp for r in rows]), np.array([r.pose for r in rows])
        carrying = {m.parent for m in found.tree.moving.values()}
        robot = found.frames[topic][1] or next((name for name in BODIES if name in carrying), "")
    else:
        moving = {child: m for child, m in found.tree.moving.items() if not m.static}
        below = {child: m for child, m in moving.items() if found.tree.carries(child, found.scans.frame)}
        named = [child for child, m in (below or moving).items() if ODOM_FRAME in m.parent]
        if not any(moving[child].moves for child in named):  # the frame that drives is below it
            named = [k for k, m in below.items() if m.moves and found.tree.carries((*named, k)[0], k)] or named
        if not named:
            others = ", ".join(t.name for t in topics if t.kind not in OF and WHEELS.search(t.name + t.kind))
            posed = [t.name for t in topics if t.kind == ODOMETRY or (t.kind in POSED and t.role is Role.NOTHING)]
            ways = [f"--odom {' or '.join(posed)}"] * bool(posed)
            ways += [f"{others}: {OTHERWISE}"] * bool(others)
            ways += [f"slamref convert rosbag {path} LOG --no-odometry: scans alone"] * bool(found.scans.ranges)
            what = "neither a topic of odometry nor a moving transform of the robot; one is needed"
            paths = [f"{path}:/tf:{m.parent}.{child}" for child, m in moving.items() if m.moves]
            ways += [f"as paths slamref score reads {', '.join(paths)}"] * bool(paths)
            raise DataError.at(path, f"{what}{': ' * bool(ways)}{', or '.join(ways)}")
        topic, robot = TF, max(named, key=lambda child: (moving[child].moves, len(moving[child].stamp)))
        stamp = np.array(moving[robot].stamp)
        R, t = moving[robot].at(stamp)
        pose = np.column_stack([t[:, :2], np.arctan2(R[:, 1, 0], R[:, 0, 0])])
    time, first = np.unique(stamp, return_index=True)
    return topic, robot, time, pose[first]


class LaserScans(NamedTuple):
    """Scans within a span, by stamp (S,), and what is said about them."""

    scanner: Scanner  # on the robot
    stamp: Array
    ranges: Array  # (S, B)
    inside: BoolArray  # of all scans, which these are
    resampled: int  # how many had other beams
    notes: tuple[str, ...]
    asked: tuple[Notice, ...]  # questions
    origins: dict[str, Origin]


def scans_of(
    path: Path, topics: Sequence[Topic], found: Collected, robot: str, span: tuple[float, float],
    mending: Mending = AS_STATED,
) -> LaserScans:  # fmt: skip
    """The scans of a bag on a robot's frame within the span [s]. DataError: none there, or the laser is not level."""
    read = found.scans
    if not read.ranges:
        topic = next(t.name for t in topics if t.role is Role.SCANS)
        raise DataError.at(path, f"no message of {topic}; at least one is needed")
    angles, g = np.array(read.angles), read.geometry
    ranges, low, step, resampled = on_one_set(read.ranges, angles[:, 0], angles[:, 1])
    scanner, notes = _scanner(path, found, robot, low, step)
    origins = dict.fromkeys(("odometry_noise", "range_noise", *([] if notes else ["sensor_pose"])), Origin.ASSUMED)
    measured = mending.ranges(np.where(np.isfinite(ranges), ranges, 0.0))
    require_metres(path, measured)
    beams = measured.shape[1]
    asked = beam_angles(low, step, low + (beams - 1) * step if resampled else g["angle_max"], beams)
    largest = float(mending.ranges(np.array(scanner.max_range)))
    if (measured > largest).mean() < MOST_BEYOND:  # else it is stated in metres, unlike the ranges
        scanner = replace(scanner, max_range=largest)
    if (piled := piled_up(measured, scanner.max_range)) is not None:
        scanner, stated = replace(scanner, max_range=piled[0]), f"the messages state {g['range_max']:g}"
        many, origins["max_range"] = f"{piled[1]} of {measured.size}", Origin.INFERRED
        notes.append(f"No return: readings of {piled[0]:g} m and more, where {many} pile up; {stated}.")
    scanner = mending.scanner(scanner)
    order = np.argsort(read.stamp, kind="stable")
    stamp = np.array(read.stamp)[order]
    inside = (stamp >= span[0]) & (stamp <= span[1])
    if not inside.any():
        what = f"scans at {stamp[0]:.3f} to {stamp[-1]:.3f} s, odometry at {span[0]:.3f} to {span[1]:.3f} s"
        raise DataError.at(path, f"{what}; at least one scan within the odometry is needed")
    ranges = measured[order][inside]
    ranges = np.where(ranges >= float(mending.ranges(np.array(g["range_min"]))), ranges, 0.0)
    ranges = with_returns(ranges, scanner.max_range)
    if not inside.all():
        notes.append(f"{np.sum(~inside)} of {counted(len(inside), 'scan')} outside the span of the odometry: left out.")
    return LaserScans(scanner, stamp[inside], ranges, inside, resampled, tuple(notes), tuple(asked), origins)


def _scanner(path: Path, found: Collected, robot: str, low: float, step: float) -> tuple[Scanner, list[str]]:
    """The scanner on the robot, and a note about its place, where the bag states it."""
    laser, max_range = found.scans.frame, found.scans.geometry["range_max"]
    mounting = found.tree.between(robot, laser, np.zeros(1))
    if mounting is None:
        return Scanner(low, step, max_range, SIGMA), []
    R, t = mounting[0][0], mounting[1][0]
    if not abs(abs(R[2, 2]) - 1.0) <= SMALL:
        what = f"the laser {laser!r} is tilted by {np.degrees(np.arccos(np.clip(R[2, 2], -1, 1))):.3g} deg on {robot!r}"
        raise DataError.at(path, f"{what}; a level one is needed")
    upside_down = R[2, 2] < 0.0
    if upside_down:  # seen from above its beams turn the other way
        low, step = -low, -step
    turn = float(np.arctan2(R[1, 0], R[0, 0]))
    tx, ty, rotation = (float(v) + 0.0 for v in inverse(np.array([t[0], t[1], turn])))
    place = f"at ({t[0]:.4g}, {t[1]:.4g}) m, turned by {np.degrees(turn):.4g} deg{', upside down' * bool(upside_down)}"
    return Scanner(low, step, max_range, SIGMA, rotation, (tx, ty)), [f"The laser is mounted {place}."]


def laser_log(path: Path, scan: str | None = None, odometry: str | None = None, mending: Mending = AS_STATED) -> Log:
    """The log: frames are the scans within the span of the odometry, else of tf; without both, if `mending` wants none,
    the robot is the laser, at rest. UsageError: which topic, or no `rosbags`. DataError: a damaged bag, or no scan.
    """
    every = topics_of(path)
    if scan is None and not any(t.role is Role.SCANS for t in every):
        posed = "".join(f", slamref score {path}:{t.name} TRUTH its path" for t in every if t.kind in CAN_BE_TRUTH)
        raise UsageError(f"{path}: no LaserScan; slamref convert bag {path} --list says what it holds instead{posed}")
    roles = (Role.SCANS, Role.ODOMETRY, Role.TRANSFORMS)
    topics = chosen(path, every, odometry=odometry, scans=scan)
    found = collect(path, [t for t in topics if t.role in roles])
    try:
        topic, robot, time, pose = odometry_of(path, topics, found)
    except DataError:
        if mending.odometry or odometry is not None or not found.scans.ranges:
            raise
        topic, robot, time = TF, found.scans.frame, np.unique(found.scans.stamp)
        pose = np.zeros((len(time), 3))
    scans = scans_of(path, topics, found, robot, (float(time[0]), float(time[-1])), mending)
    stamp, inside, name = scans.stamp, scans.inside, next(t.name for t in topics if t.role is Role.SCANS)
    where, source = f"Frames are the scans of {name}", {"kind": "rosbag", **source_file(path), "scan": name}
    notes = ["No ground truth and no odometry: scans alone tell the motion.", f"{where}.", *scans.notes]
    if mending.odometry:
        source["odometry"] = topic
        where += f", with {topic} interpolated at their stamps."
        notes = ["No ground truth: the prior is the first pose of the odometry.", where, *found.told(), *scans.notes]
    if more := [t.name for t in topics if t.role not in (*roles, Role.NOTHING, Role.CAMERA, Role.TRUTH)]:
        notes.append(f"Left out, as slamref convert bag alone reads them: {', '.join(more)}.")
    after = np.clip(np.searchsorted(time, stamp), 1, len(time) - 1)
    far = int((time[after] - time[after - 1] > LONG).sum()) if len(time) > 1 else 0
    if far:
        notes.append(f"{counted(far, 'scan is', 'scans are')} where the odometry pauses for more than {LONG:g} s.")
    if scans.resampled:
        notes.append(f"{scans.resampled} of {counted(len(inside), 'scan')} with other beams: resampled.")
    recorded = lasers.laser_inputs(
        interpolate(time, mending.poses(pose), stamp), stamp, Scans(scans.scanner, np.arange(len(stamp)), scans.ranges)
    )
    recorded = recorded if mending.odometry else lasers.without_odometry(recorded)
    return Log(path.stem, recorded, Truth(), source=source, notes=(*notes,), asked=scans.asked, origins=scans.origins)


# A second odometry topic of a ROS bag (`--second-odom`): closures between successive frames.

STATED = "the twist covariances of its messages, whose errors are taken as independent of each other"


def _poses(topic: Topic, found: Collected, robot: str) -> tuple[Array, Array, Array, Array | None]:
    """Stamps (K,), ascending, poses (K, 3), covariances (K, 3, 3); the robot's frame (3,) in that of the poses."""
    rows = sorted(found.poses[topic.name], key=lambda r: r.stamp)
    stamp, first = np.unique([r.stamp for r in rows], return_index=True)
    pose, C = (np.array([r[k] for r in rows])[first] for k in (1, 2))
    body = found.frames[topic.name][1]
    if not body or body == robot:
        return stamp, pose, C, np.zeros(3)
    placed = found.tree.between(body, robot, np.zeros(1))
    if placed is None:
        return stamp, pose, C, None
    R, t = placed[0][0], placed[1][0]
    return stamp, pose, C, np.array([t[0], t[1], np.arctan2(R[1, 0], R[0, 0])])


def second_closures(
    topic: Topic, found: Collected, noise: TravelNoise | None, robot: str, time: Array, taken: Collection[str]
) -> tuple[Closures, str]:
    """Closures between frames at `time` (N,), and a sentence; `noise`: None: of the twists; `robot`: the frame on which
    tf mounts this one; `taken`: names of other sources. UsageError: no noise. DataError: too few messages, or no mount.
    """
    if not found.poses.get(topic.name):
        raise DataError(f"{topic.name}: no message; some are needed")
    stamp, pose, C, mounted = _poses(topic, found, robot)
    if mounted is None:
        body = found.frames[topic.name][1]
        raise DataError(f"{topic.name}: poses of {body!r}, which tf does not mount on {robot!r}; one is needed")
    if mounted.any():
        x, y, theta = mounted.tolist()
        c, s = np.cos(theta), np.sin(theta)
        J = np.array([[c, s, -y * c + x * s], [-s, c, y * s + x * c], [0.0, 0.0, 1.0]])  # of velocities of two bodies
        pose, C = se2.compose(pose, mounted), np.asarray(J @ C @ J.T)
    frames = np.flatnonzero(covered(stamp, time))
    if len(frames) < 2:
        what = f"its messages at {stamp[0]:.3f} to {stamp[-1]:.3f} s cover {len(frames)} of {len(time)} frames"
        raise DataError(f"{topic.name}: {what}; two are needed")
    at = time[frames]
    if noise is not None:
        motion, how = lasers.increments_of(se2.interpolate(stamp, pose, at), noise)[0], "--second-odom-sigma"
    elif not (np.isfinite(C).all() and (np.linalg.eigvalsh(np.where(np.isfinite(C), C, 0.0)) > 0.0).all()):
        what = "messages whose twist has no positive definite covariance of vx, vy and the turn"
        raise UsageError(f"{topic.name}: {what}; --second-odom-sigma S,S,S,S is needed")
    else:
        motion, how = of_twists(stamp, pose, C, at), STATED
    closures = closures_between(frames, motion, own_name(_named(topic.name), taken))
    pairs = f"{len(closures)} of {len(time) - 1} pairs of successive frames"
    return closures, f"{topic.name} is a second odometry: closures between {pairs}; noise by {how}."


EVERY = 1.0  # s between headings that are used: those of a second have a common error, of magnetic field and filter
LONGEST = 1e6  # s, longest log
FIRST = (0.1, 0.1, 0.05)  # m, m, rad; standard deviations of the first true pose as the prior


@dataclass(frozen=True)
class Wanted:
    """What messages do not state: prior mean and sigma (3,); sigma of points [m], bearings [rad], positions [m] and
    headings [rad] without covariance; second: noise of a second odometry. None: not stated. `assumed`: flags by role.
    """

    prior: Array | None = None
    prior_sigma: Array | None = None
    points: float | None = None
    bearings: float | None = None
    positions: float | None = None
    headings: float | None = None
    second: TravelNoise | None = None
    ranges: float | None = None
    unit: str = ""  # of ranges; empty: mm of whole numbers, else m
    assumed: dict[Role, str] = field(default_factory=dict)

    def sigma(self, role: Role) -> float:
        """The stated sigma of a role's topics, else the usual one, which is noted as assumed."""
        flag, usual, unit = USUAL[role]
        value: float | None = getattr(self, flag + "s")
        if value is None:
            self.assumed[role] = f"--{flag}-sigma {usual:g}{unit}"
            return math.radians(usual) if unit == "deg" else usual
        return value


USUAL = {
    Role.POINTS: ("point", 0.1, "m"), Role.BEARINGS: ("bearing", 2.0, "deg"), Role.POSITIONS: ("position", 1.0, "m"),
    Role.HEADINGS: ("heading", 5.0, "deg"), Role.RANGES: ("range", 0.1, "m"),
}  # fmt: skip
"""Flag and sigma of each role where nobody states it."""
POLAR = (Role.RANGES, Role.BEARINGS)  # Roles whose flags count for ranges with bearings


@dataclass(frozen=True, eq=False)
class _Seen:
    """Observations of one topic: its sensor, stamps (m,) [s], z (m, 2), R (m, 2, 2), ids (m,), -1 for none."""

    sensor: Sensor
    at: Array
    z: Array
    R: Array
    id: IntArray


@dataclass(frozen=True, eq=False)
class _Fixed:
    """Fixes of one topic: their source, kind, stamps (f,) [s], z (f, 3), covariance (f, 3, 3)."""

    source: FixSource
    kind: FixKind
    at: Array
    z: Array
    covariance: Array


def log_of_bag(path: Path, name: str, topics: Sequence[Topic], found: Collected, wanted: Wanted) -> Log:
    """The log. DataError or UsageError where odometry, noise or prior are missing."""
    notes = found.told()
    odometry, robot, stamp, pose = odometry_of(path, topics, found)
    true_rows = [r for t in topics if t.role is Role.TRUTH for r in found.poses.get(t.name, [])]
    late = stamp >= min((r.stamp for r in true_rows), default=-math.inf)
    if wanted.prior is None and late.any() and not late.all():
        notes.append(f"The truth begins {stamp[late][0] - stamp[0]:.3g} s after the odometry; so does the log.")
        stamp, pose = stamp[late], pose[late]
    known, told = _anchors(topics, found)
    seen, left = _observed(topics, found, wanted, robot, stamp)
    notes += told
    fixed, datum = _fixed(topics, found, wanted, robot)
    laser = None
    if any(t.role is Role.SCANS for t in topics):
        laser = scans_of(path, topics, found, robot, (float(stamp[0]), float(stamp[-1])))
        laser = laser._replace(stamp=lasers.made_increasing(laser.stamp))
        notes += laser.notes
    second = next((t for t in topics if t.role is Role.SECOND), None)
    if not seen and not fixed and laser is None and second is None:
        reasons = "; ".join(text.rstrip(".") for text in left) or "no topic of scans, detections or fixes"
        way = f"; as a path slamref score {path}:{odometry} TRUTH compares it"
        raise DataError.at(path, f"nothing beside the odometry: {reasons}; --list names what each topic becomes{way}")
    left += [f"assumed: {flag}" for flag in wanted.assumed.values()]
    if unread := [t.name for t in topics if t.role is Role.NOTHING and t.count and t.why != "--skip"]:
        left.append(f"Left out ({path.name} --list says why): {', '.join(unread)}.")
    notes = [f"Odometry: {odometry}, poses of {robot or 'the robot'} interpolated at the frames.", *notes, *left]
    first, last = float(stamp[0]), float(stamp[-1])
    if last - first > LONGEST:
        raise DataError.at(path, f"the odometry spans {last - first:.6g} s; stamps in seconds are needed")
    at = [s.at for s in seen] + [f.at for f in fixed]
    at += [laser.stamp] if laser is not None else []
    every = np.concatenate([np.empty(0), *at])
    inside = (every >= first) & (every <= last)
    if at and not inside.any():
        what = f"messages at {every.min():.3f} to {every.max():.3f} s, odometry at {first:.3f} to {last:.3f} s"
        raise DataError.at(path, f"{what}; some within the odometry are needed")
    if not inside.all():
        notes.append(f"{int((~inside).sum())} of {len(inside)} messages before or after all odometry: left out.")
    time = frame_times(every[inside], first, last)
    increments, floored = lasers.increments_of(se2.interpolate(stamp, pose, time))
    closures = None
    if second is not None:
        closures, note = second_closures(second, found, wanted.second, robot, time, [f.source.name for f in fixed])
        notes.append(note)
    observations, sensors, label = _joined(seen, time)
    true = _truth(topics, found, robot, time)
    notes += [f"Truth: {ABSENT}."] if true is not None and not np.isfinite(true[:, 2]).any() else []
    if datum is not None:
        notes.append(f"The world's x and y point east and north; its origin is at {datum[0]:.9g}, {datum[1]:.9g} deg.")
    fixes = _all_fixes(fixed, time) if fixed else None
    free = wanted.prior is None and true is None and {f.kind for f in fixed} == {FixKind.POSITION}
    start = onto_fixes(fixes, increments.mean, increments.covariance) if free and fixes is not None else None
    onto = None if start is None else (Prior(start.pose, np.diag(start.sigma**2)), start.said())
    prior, note = onto or _prior(wanted, pose[0], true, fixed, first)
    recorded = Inputs(
        prior=prior, time=time - first, increments=increments, observations=observations,
        sensor=sensors[0] if sensors else RangeBearing(), covariance_floor=FLOOR, floored=floored,
        scans=None if laser is None else Scans(laser.scanner, _at(laser.stamp, time), laser.ranges),
        fixes=fixes, closures=closures, sensors=sensors if len(sensors) > 1 else (), map=known,
    )  # fmt: skip
    origins = {} if laser is None else {**laser.origins}
    origins |= {"odometry_noise": Origin.ASSUMED} | ({"observation_noise": Origin.GIVEN} if seen else {})
    given = {"fix_noise": wanted.positions or wanted.headings, "closure_noise": wanted.second}
    origins |= {quantity: Origin.GIVEN for quantity, value in given.items() if value is not None}
    origins |= {"fix_noise" if role in FIXES else "observation_noise": Origin.ASSUMED for role in wanted.assumed}
    origins |= {f"max_range.{s.sensor.label}": Origin.INFERRED for s in seen if isinstance(s.sensor, RelativePoint)}
    if wanted.prior_sigma is not None or true is not None:
        origins["prior"] = Origin.ASSUMED if wanted.prior_sigma is None else Origin.GIVEN
    origins |= {"prior": Origin.INFERRED} if start is not None else {}
    roles = {t.name: t.role.value for t in topics if t.role not in (Role.NOTHING, Role.TRANSFORMS, Role.CAMERA)}
    source: dict[str, object] = {"kind": "bag", **source_file(path), "topics": roles, "clock": first}
    if datum is not None:
        source["datum"] = datum.tolist()
    return Log(
        name, recorded, Truth(true), label=label, labels_are_sensed=label is not None, source=source,
        notes=(*notes, note), origins=origins,
    )  # fmt: skip


def _at(stamp: Array, time: Array) -> IntArray:
    return np.searchsorted(time, stamp).astype(np.int64)


def _named(topic: str) -> str:
    """A topic as the name of a source."""
    return "".join("_" if c in ',"' or not c.isprintable() else c for c in topic.strip("/ ")) or "topic"


def _observed(
    topics: Sequence[Topic], found: Collected, wanted: Wanted, robot: str, stamp: Array
) -> tuple[list[_Seen], list[str]]:
    """Observations by topic, and a sentence for each that is left out."""
    seen, left = [], []
    for t in topics:
        every = found.detections.get(t.name, [])
        rows = [d for d in every if stamp[0] <= d.stamp <= stamp[-1]]
        if t.role not in (Role.POINTS, Role.BEARINGS, *RANGED) or not every:
            continue
        if len(rows) < len(every):
            lost = f"{len(every) - len(rows)} of {counted(len(every), 'detection')}"
            left.append(f"{t.name}: {lost} before or after all odometry: left out.")
        made = []
        for frame in dict.fromkeys(d.frame for d in rows):
            some = [d for d in rows if d.frame == frame]
            at = np.array([d.stamp for d in some])
            if (place := found.places.get(t.name)) is not None and not found.tree.carries(robot, frame):
                found.tree.add(robot, frame, 0.0, place, static=True)
                left.append(f"{t.name} measures at ({place[0]:.4g}, {place[1]:.4g}) m, as its messages state.")
            placed = found.tree.between(robot, frame, at) if found.tree.carries(robot, frame) else None
            if placed is None and t.role in RANGED:
                placed = np.tile(np.eye(3), (len(some), 1, 1)), np.zeros((len(some), 3))
                left.append(f"assumed: {t.name} measures at the robot's origin: tf does not place {frame or 'it'}")
            if placed is None:
                left.append(f"{t.name}: {counted(len(some), 'detection')} in {frame!r}, which tf does not mount on "
                            f"{robot!r}: left out.")  # fmt: skip
                continue
            where = np.array([d.at for d in some])
            if t.role in RANGED:
                where[:, 0] *= LENGTH[wanted.unit or ("mm" if t.name in found.whole else "m")]
            if t.role is Role.BEARINGS:
                if frame not in found.cameras:
                    left.append(f"{t.name}: no CameraInfo of {frame!r}, so pixels tell no direction: left out.")
                    continue
                fx, fy, cx, cy = found.cameras[frame]  # an optical frame: x to the right, y down, z ahead
                where = np.column_stack([(where[:, 0] - cx) / fx, (where[:, 1] - cy) / fy, np.ones(len(where))])
            made.append((at, *placed, where, np.array([d.id for d in some], np.int64)))
        if made and t.role in RANGED and t.name in found.whole and not wanted.unit:
            left.append("assumed: --range-unit mm, as ranges are whole numbers")
        if made:
            seen.append(_by_sensor(t, [np.concatenate(part) for part in zip(*made, strict=True)], wanted))
    return seen, left


def _anchors(topics: Sequence[Topic], found: Collected) -> tuple[LandmarkMap | None, list[str]]:
    """The map beside ranges: markers in the frame of the truth that hold still, which are no observations then."""
    true = next((found.frames[t.name][0] for t in topics if t.role is Role.TRUTH and t.name in found.frames), "")
    for t in topics:
        some = found.detections.get(t.name, [])
        if t.kind != MARKERS or not true or {d.frame for d in some} != {true} or min(d.id for d in some) < 0:
            continue
        at = {k: np.array([d.at[:2] for d in some if d.id == k]) for k in sorted({d.id for d in some})}
        if any(t.role in RANGED for t in topics) and max(np.ptp(p, axis=0).max() for p in at.values()) < STILL:
            del found.detections[t.name]
            known = LandmarkMap(np.array([*at], np.int64), np.array([p.mean(axis=0) for p in at.values()]))
            return known, [f"{t.name}: {len(at)} markers in {true!r}, the frame of the truth, are the map."]
    return None, []


STILL = 0.01  # m, extent of a marker that is a place


def _by_sensor(topic: Topic, parts: Sequence[Array], wanted: Wanted) -> _Seen:
    """Points in the body frame, or directions from the camera's mean place, turned as the body is."""
    at, R, t, where, ids = parts
    order = np.argsort(at, kind="stable")
    turned = np.einsum("nij,nj->ni", R, where)
    sigma = wanted.sigma(Role.RANGES if topic.role is Role.POLAR else topic.role)
    x, y = (-t[:, :2].mean(axis=0)).tolist()
    if topic.role is Role.POINTS:
        z = (turned + t)[:, :2]
        reach = 1.001 * float(np.hypot(*z.T).max())
        sensor: Sensor = RelativePoint(max_range=reach if reach > 0.0 else np.inf, label=_named(topic.name))
        covariance = np.tile(sigma**2 * np.eye(2), (len(z), 1, 1))
    elif topic.role is Role.RANGES:
        z = where[:, :2]
        sensor = Range(1.001 * float(z.max()), translation=(x + 0.0, y + 0.0), label=_named(topic.name))
        covariance = np.tile(np.diag([sigma**2, 1.0]), (len(z), 1, 1))
    elif topic.role is Role.POLAR:
        z = np.column_stack([where[:, 0], se2.wrap_angle(where[:, 1] + np.arctan2(R[:, 1, 0], R[:, 0, 0]))])
        sensor = RangeBearing(1.001 * float(z[:, 0].max()), translation=(x + 0.0, y + 0.0), label=_named(topic.name))
        covariance = np.tile(np.diag([sigma**2, wanted.sigma(Role.BEARINGS) ** 2]), (len(z), 1, 1))
    else:
        z = np.column_stack([np.zeros(len(at)), np.arctan2(turned[:, 1], turned[:, 0])])
        sensor = Bearing(translation=(x + 0.0, y + 0.0), label=_named(topic.name))
        covariance = np.tile(np.diag([1.0, sigma**2]), (len(z), 1, 1))
    return _Seen(sensor, at[order], z[order], covariance[order], ids[order].astype(np.int64))


def _joined(seen: Sequence[_Seen], time: Array) -> tuple[Observations, tuple[Sensor, ...], IntArray | None]:
    """The observations by frame and sensor, the sensors, and labels; None: nothing has an id."""
    which = np.repeat(np.arange(len(seen)), [len(s.at) for s in seen])
    frame = _at(np.concatenate([np.empty(0), *(s.at for s in seen)]), time)
    z = np.concatenate([np.empty((0, 2)), *(s.z for s in seen)])
    R = np.concatenate([np.empty((0, 2, 2)), *(s.R for s in seen)])
    ids = np.concatenate([np.empty(0, np.int64), *(s.id for s in seen)])
    by = np.lexsort((which, frame))
    several = which[by] if len(seen) > 1 else None
    label = np.where(ids[by] >= 0, ids[by], UNLABELLED) if (ids >= 0).any() else None
    return Observations(frame[by], z[by], R[by], sensor=several), tuple(s.sensor for s in seen), label


def _fixed(topics: Sequence[Topic], found: Collected, wanted: Wanted, robot: str) -> tuple[list[_Fixed], Array | None]:
    """Fixes by topic, and the place (latitude, longitude [deg], height [m]) of the origin of positions."""
    made: list[_Fixed] = []
    origin: Array | None = None
    for t in topics:
        rows = sorted(found.poses.get(t.name, []), key=lambda r: r.stamp)
        if t.role not in FIXES or not rows:
            continue
        mounted = found.tree.between(robot, found.frames[t.name][1], np.zeros(1))
        if t.role is Role.POSITIONS:
            at, place, C = (np.array([r[k] for r in rows]) for k in range(3))
            origin = place[0] if origin is None else origin
            P = np.zeros((len(rows), 3, 3))
            P[:, :2, :2] = _filled(C, t, wanted)
            z = east_north_up(place, origin) * [1.0, 1.0, 0.0]
            x, y = (0.0, 0.0) if mounted is None else mounted[1][0, :2].tolist()
            made.append(_Fixed(FixSource(_named(t.name), (x, y)), FixKind.POSITION, at, z, P))
        else:
            made.append(_of_poses(t, rows, mounted, wanted))
    return made, origin


def _of_poses(topic: Topic, rows: Sequence[Pose], mounted: tuple[Array, Array] | None, wanted: Wanted) -> _Fixed:
    """Headings, one in `EVERY` s, or poses of the robot."""
    at, z, P = (np.array([r[k] for r in rows]) for k in range(3))
    if topic.role is Role.POSES:
        if np.isnan(P).any():
            what = "messages without a covariance"
            raise UsageError(f"{topic.name}: {what}; --truth {topic.name} or --skip {topic.name} is needed")
        return _Fixed(FixSource(_named(topic.name)), FixKind.POSE, at, z, P)
    kept = np.unique(np.floor((at - at.min()) / EVERY), return_index=True)[1]
    at, z = at[kept], z[kept]
    C = np.zeros((len(kept), 3, 3))
    C[:, 2, 2] = _filled(P[kept][:, 2:, 2:], topic, wanted)[:, 0, 0]
    R = np.eye(3) if mounted is None else mounted[0][0]
    turned = float(np.arctan2(R[1, 0], R[0, 0]))
    return _Fixed(FixSource(_named(topic.name), rotation=turned), FixKind.HEADING, at, z, C)


def _filled(covariance: Array, topic: Topic, wanted: Wanted) -> Array:
    """Covariances (n, d, d), those that are not stated from a sigma."""
    lacking = ~(np.linalg.eigvalsh(np.where(np.isfinite(covariance), covariance, 0.0))[:, 0] > 0.0)
    if lacking.any():
        covariance = covariance.copy()
        covariance[lacking] = wanted.sigma(topic.role) ** 2 * np.eye(covariance.shape[-1])
    return np.asarray(0.5 * (covariance + covariance.transpose(0, 2, 1)))


def _all_fixes(fixed: Sequence[_Fixed], time: Array) -> Fixes:
    inside = [(f.at >= time[0]) & (f.at <= time[-1]) for f in fixed]
    frame = np.concatenate([_at(f.at[k], time) for f, k in zip(fixed, inside, strict=True)])
    source = np.concatenate([np.full(int(k.sum()), i) for i, k in enumerate(inside)]).astype(np.int64)
    kind = np.array([f.kind for f in fixed], np.int64)[source]
    z = np.concatenate([f.z[k] for f, k in zip(fixed, inside, strict=True)])
    P = np.concatenate([f.covariance[k] for f, k in zip(fixed, inside, strict=True)])
    by = np.lexsort((source, frame))
    return Fixes(frame[by], kind[by], source[by], z[by], P[by], tuple(f.source for f in fixed))


def _truth(topics: Sequence[Topic], found: Collected, robot: str, time: Array) -> Array | None:
    """True poses (N, 3) of the robot at the frames, NaN where unknown."""
    topic = next((t for t in topics if t.role is Role.TRUTH), None)
    if topic is None or not found.poses.get(topic.name):
        return None
    stamp, pose, _, mounted = _poses(topic, found, robot)
    q = np.where(pose[:, 2:] == 0.0, [0.0, 0.0, 0.0, 1.0], np.nan)  # of a turn there is no need to know it
    if not np.isnan(q).any() and unturned(q, pose[:, :2]):
        pose[:, 2] = np.nan
    true = truth_at(stamp, pose if mounted is None or not mounted.any() else se2.compose(pose, mounted), time)
    if topic.name in found.unstamped and not np.isfinite(true[:, 0]).any():
        what = f"stamps of its messages are 0, and no frame ({time[0]:.3f} to {time[-1]:.3f} s) is near the times of"
        raise DataError(f"{topic.name}: {what} recording ({stamp[0]:.3f} to {stamp[-1]:.3f} s); stamps are needed")
    return true


def _prior(wanted: Wanted, first: Array, true: Array | None, fixed: Sequence[_Fixed], t0: float) -> tuple[Prior, str]:
    """Belief about the first pose, and a sentence about it."""
    if wanted.prior is not None:
        if wanted.prior_sigma is None:
            raise UsageError("--prior: --prior-sigma SX,SY,STHETA (m, m, rad; 0,0,0: exact) is needed")
        return Prior(wanted.prior, np.diag(wanted.prior_sigma**2)), "The prior is as --prior states."
    if true is not None:
        if not np.isfinite(true[0]).all():
            what = "heading" if np.isfinite(true[0, :2]).all() else "pose"
            raise UsageError(f"the first frame has no true {what}; --prior X,Y,THETA and --prior-sigma are needed")
        sigma = np.array(FIRST) if wanted.prior_sigma is None else wanted.prior_sigma
        text = ", ".join(f"{s:g}" for s in sigma)
        return Prior(true[0], np.diag(sigma**2)), f"The prior is the first true pose, with standard deviations {text}."
    whole = next((f for f in fixed if f.kind is FixKind.POSE), None)
    if whole is not None:
        return Prior(whole.z[0], whole.covariance[0]), f"The prior is the first pose of {whole.source.name}."
    place = next((f for f in fixed if f.kind is FixKind.POSITION), None)
    turn = next((f for f in fixed if f.kind is FixKind.HEADING), None)
    if place is None and turn is None:
        return Prior(first, np.zeros((3, 3))), "The prior is the first pose of the odometry, exactly."
    if place is None and turn is not None:  # of a world whose origin is free
        mean = np.array([*first[:2], float(turn.z[0, 2]) - turn.source.rotation])
        P = np.diag([0.0, 0.0, float(turn.covariance[0, 2, 2])])
        return Prior(mean, P), f"The prior is the first place of the odometry, with the heading of {turn.source.name}."
    if place is None or turn is None:
        raise UsageError("the first heading in the frame of the fixes is unknown; --prior X,Y,THETA and --prior-sigma "
                         "SX,SY,STHETA are needed")  # fmt: skip
    theta = float(turn.z[0, 2]) - turn.source.rotation
    mean = np.array([*(place.z[0, :2] - (se2.rotation(theta) @ np.array(place.source.lever))), theta])
    P = np.zeros((3, 3))
    P[:2, :2], P[2, 2] = place.covariance[0, :2, :2], turn.covariance[0, 2, 2]
    late = max(place.at[0], turn.at[0]) - t0
    text = f"The prior is the first fix of {place.source.name} with the first heading of {turn.source.name}"
    return Prior(mean, P), f"{text}, {late:.3g} s after the first frame."

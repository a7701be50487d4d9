"""Messages of a ROS bag by what they become: poses, fixes, detections, transforms and camera models."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from data.errors import DataError
from data.formats.bags.topics import (
    BOXES,
    FLAT_BOXES,
    FLAT_TAGS,
    MARKERS,
    POSES,
    STANDARD,
    TAGS,
    Role,
    Topic,
)
from data.formats.recordings.ros import heading, opened, stamp_of
from data.formats.results.frames import Tree, bare

ADD = 0
"""Action of a marker that is there."""


class Pose(NamedTuple):
    """A pose in the plane: stamp [s], x, y [m], heading [rad], covariance (3, 3) of these, or NaN where not stated."""

    stamp: float
    pose: tuple[float, float, float]
    covariance: np.ndarray[Any, Any]


class Position(NamedTuple):
    """A satellite fix: stamp [s], latitude, longitude [deg], height [m], covariance (2, 2) east, north, or NaN."""

    stamp: float
    place: tuple[float, float, float]
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
        poses: of odometry, truth, pose fixes and headings, with the frames of each topic: of the header and the body's.
            Of a second odometry the covariance is that of the velocity along, across and of the turn.
        positions, detections: by topic.
        cameras: fx, fy, cx, cy by frame.
        tree: transforms.
        unread: numbers of messages without a fix, by topic.
    """

    poses: dict[str, list[Pose]] = field(default_factory=dict)
    frames: dict[str, tuple[str, str]] = field(default_factory=dict)
    positions: dict[str, list[Position]] = field(default_factory=dict)
    detections: dict[str, list[Detection]] = field(default_factory=dict)
    cameras: dict[str, tuple[float, float, float, float]] = field(default_factory=dict)
    tree: Tree = field(default_factory=Tree)
    unread: dict[str, int] = field(default_factory=dict)


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
            found.unread[topic] = found.unread.get(topic, 0) + 1
            return
        C = np.asarray(message.position_covariance, float).reshape(3, 3)[:2, :2]
        stated = message.position_covariance_type > 0
        height = message.altitude if math.isfinite(message.altitude) else 0.0
        place = (float(message.latitude), float(message.longitude), float(height))
        found.positions.setdefault(topic, []).append(
            Position(stamp_of(message, recorded), place, C if stated else np.full((2, 2), np.nan))
        )
    elif role is Role.HEADINGS:
        found.frames[topic] = "", bare(message.header.frame_id)
        C, q = np.asarray(message.orientation_covariance, float).reshape(3, 3), message.orientation
        angle = heading((q.x, q.y, q.z, q.w))
        if C[0, 0] == -1.0 or not math.isfinite(angle):
            found.unread[topic] = found.unread.get(topic, 0) + 1
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
    pose, P = message.pose, np.full((3, 3), np.nan)
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

"""Poses of a ROS bag: `PoseWithCovarianceStamped` and `Odometry`, with their 6x6 covariance, row by row.

The message definitions give the covariance about fixed axes of the frame named in the header: it is `world` here. All
zeros, or -1 in front, mean that it is not known.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from data.errors import DataError, UsageError
from data.recordings.ros.bag import ODOMETRY, opened, stamp_of
from data.results.path import WORLD, GivenPath, Manner
from data.results.space import Spatial, on_plane, rotations

POSE = "geometry_msgs/msg/PoseWithCovarianceStamped"
KINDS = (POSE, ODOMETRY)
SUFFIXES = (".bag", ".mcap", ".db3")


def is_bag(path: Path) -> bool:
    """Whether a path looks like a bag: its ending, or a folder with metadata.yaml."""
    return path.suffix in SUFFIXES or (path / "metadata.yaml").is_file()


def read_bag(path: Path, topic: str | None, manner: Manner) -> GivenPath:
    """The poses of a topic, which may be left out where one alone is of these kinds; sorted by stamp.

    Raises:
        UsageError: no such topic, several to choose from, or `rosbags` is not installed.
        DataError: not a bag, no message, or a number that makes no sense.
    """
    with opened(path) as reader:
        kinds = {c.topic: c.msgtype for c in reader.connections if c.msgtype in KINDS}
        there = ", ".join(sorted(kinds)) or "none"
        if topic is None and len(kinds) != 1:
            raise UsageError(f"{path}: which topic? {path}:/TOPIC is needed; with poses and covariance: {there}")
        topic = topic or next(iter(kinds))
        if topic not in kinds:
            raise UsageError(f"{path}: no poses with covariance on {topic}; such topics: {there}")
        wanted = [c for c in reader.connections if c.topic == topic]
        rows = [_row(reader.deserialize(raw, c.msgtype), recorded) for c, recorded, raw in reader.messages(wanted)]
    file = f"{path}:{topic}"
    if not rows:
        raise DataError.at(file, "no message")
    table = np.array(rows)
    order = np.argsort(table[:, 0], kind="stable")

    def place(k: int) -> str:
        return f"message {int(order[k])}"

    table = table[order]
    bad = np.flatnonzero(~np.isfinite(table).all(axis=1))
    if len(bad):
        raise DataError(f"{file}: {place(int(bad[0]))}: a number is not finite")
    R = rotations(table[:, 4:8], file, place)
    covariance = table[:, 8:].reshape(-1, 6, 6)
    unknown = (covariance[:, 0, 0] < 0.0) | ~covariance.any(axis=(1, 2))
    covariance[unknown] = np.nan
    notes = (f"{int(unknown.sum())} of {len(table)} messages state no covariance",) if unknown.any() else ()
    known = None if unknown.all() else covariance
    spatial = Spatial(file, kinds[topic], table[:, 0], table[:, 1:4], R, known, WORLD, place, notes=notes)
    return on_plane(spatial, manner)


def _row(message: Any, recorded: int) -> list[float]:
    """Stamp, position, quaternion, covariance: 44 numbers."""
    p, q = message.pose.pose.position, message.pose.pose.orientation
    stamp = stamp_of(message, 1e-9 * recorded)
    return [stamp, p.x, p.y, p.z, q.x, q.y, q.z, q.w, *np.asarray(message.pose.covariance, float).tolist()]

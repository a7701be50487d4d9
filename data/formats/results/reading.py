"""Read a result in any format, recognized by content; and poses of a ROS bag.

Bags: `PoseWithCovarianceStamped` and `Odometry`, with a 6x6 covariance, row by row, about fixed axes of the header's
frame: `world` here. All zeros, or -1 first, mean unknown.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from data.errors import DataError, UsageError
from data.formats.csv_table import is_number
from data.formats.recordings.ros import ODOMETRY, opened, stamp_of
from data.formats.results import pose_lines, tables
from data.formats.results.path import WORLD, GivenPath, Manner, Text, read_text
from data.formats.results.space import Spatial, header_of, on_plane, rotations

POSE = "geometry_msgs/msg/PoseWithCovarianceStamped"
KINDS = (POSE, ODOMETRY)
SUFFIXES = (".bag", ".mcap", ".db3")


def is_bag(path: Path) -> bool:
    """Whether a path looks like a bag: by its suffix, or as a folder with metadata.yaml."""
    return path.suffix in SUFFIXES or (path / "metadata.yaml").is_file()


def read_bag(path: Path, topic: str | None, manner: Manner) -> GivenPath:
    """The poses of a topic, which may be left out if it is the only one; sorted by stamp.

    Raises:
        UsageError: a missing or ambiguous topic, or `rosbags` is not installed.
        DataError: no bag, no message, or an invalid number.
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
        raise DataError.at(file, "no message; at least one is needed")
    table = np.array(rows)
    order = np.argsort(table[:, 0], kind="stable")

    def place(k: int) -> str:
        return f"{file}: message {int(order[k])}"

    table = table[order]
    bad = np.flatnonzero(~np.isfinite(table).all(axis=1))
    if len(bad):
        raise DataError(f"{place(int(bad[0]))}: a number is not finite")
    R = rotations(table[:, 4:8], place)
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


PLAIN = Manner()
ACCEPTED = (
    "a CSV with the columns t,x,y,theta, TUM (8 columns), TUM with covariance (29), SQUARE, EuRoC (commas, ns), KITTI "
    "poses (12), or a ROS bag"
)


def read_path(name: str, manner: Manner = PLAIN) -> GivenPath:
    """The trajectory in a file, or in a bag (`FILE` or `FILE:/TOPIC`).

    Raises DataError for an unknown format or invalid value, UsageError for missing or inapplicable options.
    """
    path, topic = _with_topic(name)
    if is_bag(path):
        found, cov, times = read_bag(path, topic, manner), False, False
    elif path.is_dir():
        raise DataError.at(path, "a folder; a result is a file, or the folder of a run with online.csv or final.csv")
    else:
        text = read_text(path)
        read = _reader(text)
        found, cov, times = read(text, manner), read is pose_lines.read_tum, read is pose_lines.read_kitti
    if manner.cov is not None and not cov:
        raise UsageError(f"--cov {manner.cov}: {name} is {found.kind}; a TUM file of 8 columns is needed")
    if manner.times is not None and not times:
        raise UsageError(f"--times {manner.times}: {name} is {found.kind}; KITTI poses are needed")
    if manner.frame is not None and found.covariance is None:
        raise UsageError(f"--cov-frame {manner.frame}: {name} has no covariance")
    return found


def _with_topic(name: str) -> tuple[Path, str | None]:
    """File and topic of `FILE:/TOPIC`; a file name may hold a colon, too."""
    file, colon, topic = name.partition(":/")
    if colon and not Path(name).exists() and is_bag(Path(file)):
        return Path(file), f"/{topic}"
    return Path(name), None


def _reader(text: Text) -> Callable[[Text, Manner], GivenPath]:
    """The reader of a text's format."""
    if "FORMAT" in header_of(text).values:
        return pose_lines.read_square
    if tables.is_plane(text):
        return tables.read_plane
    if tables.is_euroc(text):
        return tables.read_euroc
    first = text.fields[0]
    by_width = {8: pose_lines.read_tum, 29: pose_lines.read_wide, 12: pose_lines.read_kitti}
    if not text.commas and len(first) in by_width and is_number(first[0]):
        return by_width[len(first)]
    shown = f"{len(first)} fields, {','.join(first)[:40]!r}"
    raise DataError.at(text.path, f"{shown}: no known trajectory format; {ACCEPTED} is needed", line=text.line[0])

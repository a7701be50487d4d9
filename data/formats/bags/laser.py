"""A ROS bag as a laser log: every scan is a frame, with interpolated odometry; tf gives the laser's mounting, and the
odometry where no topic does.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from data.columns.scans import with_returns
from data.digest import source_file
from data.errors import DataError, UsageError
from data.formats.bags.reading import Collected, Role, Topic, chosen, collect, topics_of
from data.formats.recordings.beams import on_one_set
from data.formats.recordings.laser import laser_inputs, without_odometry
from data.formats.recordings.mending import AS_STATED, Mending, beam_angles, piled_up, require_metres
from data.formats.recordings.ros import TF
from data.inputs import Scanner, Scans
from data.log import Log
from data.notice import Notice
from data.se2 import Array, BoolArray, interpolate, inverse
from data.terminal import counted
from data.truth import Truth

SIGMA = 0.01
"""m, of a range, which messages do not state; small scanners state 1 to 3 cm."""
MOST_BEYOND = 0.5
"""Share of ranges beyond the stated maximum, in the unit of the ranges, from which on that is in another."""
LONG = 1.0
"""s; longer gaps of the odometry are counted."""
SMALL = 1e-3
"""Largest deviation of the tilt's cosine from 1 (2.6 degrees)."""
ODOM_FRAME = "odom"


def odometry_of(path: Path, topics: Sequence[Topic], found: Collected) -> tuple[str, str, Array, Array]:
    """Topic (or tf), the robot's frame, stamps (K,), ascending, and poses (K, 3).

    By tf: the transform from a frame of odometry, or else the one that moves, on the way to the laser if there is one.
    """
    topic = next((t.name for t in topics if t.role is Role.ODOMETRY), None)
    if topic is not None:
        rows = found.poses.get(topic, [])
        if not rows:
            raise DataError.at(path, f"no message of {topic}; at least one is needed")
        stamp, pose = np.array([r.stamp for r in rows]), np.array([r.pose for r in rows])
        robot = found.frames[topic][1]
    else:
        moving = {child: m for child, m in found.tree.moving.items() if not m.static}
        below = {child: m for child, m in moving.items() if found.tree.carries(child, found.scans.frame)}
        named = [child for child, m in (below or moving).items() if ODOM_FRAME in m.parent]
        named = named or [child for child, m in below.items() if m.moves]
        if not named:
            what = "neither a topic of odometry nor a moving transform of the robot; one is needed"
            raise DataError.at(path, f"{what}: --odom TOPIC{', or --no-odometry' if found.scans.ranges else ''}")
        topic, robot = TF, max(named, key=lambda child: (moving[child].moves, len(moving[child].stamp)))
        stamp = np.array(moving[robot].stamp)
        R, t = moving[robot].at(stamp)
        pose = np.column_stack([t[:, :2], np.arctan2(R[:, 1, 0], R[:, 0, 0])])
    time, first = np.unique(stamp, return_index=True)
    return topic, robot, time, pose[first]


class LaserScans(NamedTuple):
    """Scans within a span, by stamp (S,): ranges (S, B) with their scanner on the robot; notes about both.

    `inside` (all scans): which these are; `resampled`: how many had other beams; `asked`: questions.
    """

    scanner: Scanner
    stamp: Array
    ranges: Array
    inside: BoolArray
    resampled: int
    notes: tuple[str, ...]
    asked: tuple[Notice, ...]


def scans_of(
    path: Path,
    topics: Sequence[Topic],
    found: Collected,
    robot: str,
    span: tuple[float, float],
    mending: Mending = AS_STATED,
) -> LaserScans:
    """The scans of a bag on a robot's frame, those at a time within the span [s].

    A range below range_min, not below range_max, infinite or NaN is no return, as in sensor_msgs/LaserScan. DataError
    without a scan within the span, or if the laser is not level.
    """
    read = found.scans
    if not read.ranges:
        topic = next(t.name for t in topics if t.role is Role.SCANS)
        raise DataError.at(path, f"no message of {topic}; at least one is needed")
    angles, g = np.array(read.angles), read.geometry
    ranges, low, step, resampled = on_one_set(read.ranges, angles[:, 0], angles[:, 1])
    scanner, note = _scanner(path, found, robot, low, step)
    measured = mending.ranges(np.where(np.isfinite(ranges), ranges, 0.0))
    require_metres(path, measured)
    beams = measured.shape[1]
    asked = beam_angles(low, step, low + (beams - 1) * step if resampled else g["angle_max"], beams)
    largest = float(mending.ranges(np.array(scanner.max_range)))
    if (measured > largest).mean() < MOST_BEYOND:  # else it is stated in metres, unlike the ranges
        scanner = replace(scanner, max_range=largest)
    notes = [note]
    if (piled := piled_up(measured, scanner.max_range)) is not None:
        scanner, stated = replace(scanner, max_range=piled[0]), f"the messages state {g['range_max']:g}"
        many = f"{piled[1]} of {measured.size}"
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
    return LaserScans(scanner, stamp[inside], ranges, inside, resampled, tuple(notes), tuple(asked))


def _scanner(path: Path, found: Collected, robot: str, low: float, step: float) -> tuple[Scanner, str]:
    """The scanner on the robot, and a note about its place."""
    laser, max_range = found.scans.frame, found.scans.geometry["range_max"]
    mounting = found.tree.between(robot, laser, np.zeros(1))
    if mounting is None:
        text = f"The bag does not state the pose of {laser!r} on {robot!r}: the origin is assumed."
        return Scanner(low, step, max_range, SIGMA), text
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
    return Scanner(low, step, max_range, SIGMA, rotation, (tx, ty)), f"The laser is mounted {place}."


def laser_log(path: Path, scan: str | None = None, odometry: str | None = None, mending: Mending = AS_STATED) -> Log:
    """The log: frames are the scans within the span of the odometry, which is interpolated at their stamps.

    A topic may be left out if it is the only one of its kind. Without a topic of odometry (or with `tf`) the poses are
    the transforms from the odometry's frame, as in bags for gmapping, karto and slam_toolbox. If there are none, and
    `mending` wants no odometry, the robot is the laser, at rest.

    Raises:
        UsageError: `rosbags` is not installed, or a topic is missing or ambiguous.
        DataError: no bag, a damaged one, no message, or an invalid scan.
    """
    every = topics_of(path)
    if scan is None and not any(t.role is Role.SCANS for t in every):
        raise UsageError(f"{path}: no LaserScan; slamref convert bag {path} --list says what it holds instead")
    roles = (Role.SCANS, Role.ODOMETRY, Role.TRANSFORMS)
    topics = [t for t in chosen(path, every, odometry=odometry, scans=scan) if t.role in roles]
    found = collect(path, topics)
    try:
        topic, robot, time, pose = odometry_of(path, topics, found)
    except DataError:
        if mending.odometry or odometry is not None or not found.scans.ranges:
            raise
        topic, robot, time = TF, found.scans.frame, np.unique(found.scans.stamp)
        pose = np.zeros((len(time), 3))
    scans = scans_of(path, topics, found, robot, (float(time[0]), float(time[-1])), mending)
    stamp, inside, name = scans.stamp, scans.inside, next(t.name for t in topics if t.role is Role.SCANS)
    notes = [
        "No ground truth: the prior is the first pose of the odometry.",
        f"Frames are the scans of {name}, with {topic} interpolated at their stamps.",
        *scans.notes,
    ]
    if not inside.all():
        lost = f"{int((~inside).sum())} of {counted(len(inside), 'scan')}"
        notes.append(f"{lost} outside the span of the odometry: left out.")
    after = np.clip(np.searchsorted(time, stamp), 1, len(time) - 1)
    far = int((time[after] - time[after - 1] > LONG).sum()) if len(time) > 1 else 0
    if far:
        notes.append(f"{counted(far, 'scan is', 'scans are')} where the odometry pauses for more than {LONG:g} s.")
    if scans.resampled:
        notes.append(f"{scans.resampled} of {counted(len(inside), 'scan')} with other beams: resampled.")
    source = {"kind": "rosbag", **source_file(path), "scan": name, "odometry": topic}
    recorded = laser_inputs(
        interpolate(time, mending.poses(pose), stamp), stamp, Scans(scans.scanner, np.arange(len(stamp)), scans.ranges)
    )
    recorded = recorded if mending.odometry else without_odometry(recorded)
    return Log(path.stem, recorded, Truth(), source=source, notes=tuple(notes), asked=scans.asked)

"""A laser log out of the messages of a ROS bag: every scan is a frame, with the odometry at its stamp."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np

from data.errors import DataError
from data.inputs import Scanner, Scans
from data.log import Log
from data.open_log.scans import with_returns
from data.recordings.laser import laser_inputs
from data.recordings.ros.bag import Bag
from data.se2 import interpolate, inverse
from data.terminal.words import counted
from data.truth import Truth

SIGMA = 0.01
"""m, of a range, which messages do not state: the accuracy of the better small scanners; most state 1 to 3 cm."""
LONG = 1.0
"""s between two poses of the odometry, over which it is interpolated all the same, but counted."""
SMALL = 1e-3
"""Share of a laser's tilt that is taken for none: the cosine may miss 1 by so much (2.6 degrees)."""


def log_of(path: Path, bag: Bag) -> Log:
    """The log: frames are the scans within the span of the odometry, which is interpolated at their stamps.

    Odometry may come far more often than scans, or a little before and after them; scan matching needs the pose at the
    scan. Scans are taken in the order of their stamps. A reading below range_min, not below range_max, infinite or NaN
    is no return, as sensor_msgs/LaserScan has it.

    Raises:
        DataError: no scan within the span of the odometry, or a laser that is not level.
    """
    scanner, note = _scanner(path, bag)
    time, first = np.unique(bag.odometry_stamp, return_index=True)
    order = np.argsort(bag.scan_stamp, kind="stable")
    stamp = bag.scan_stamp[order]
    inside = (stamp >= time[0]) & (stamp <= time[-1])
    if not inside.any():
        what = f"scans at {stamp[0]:.3f} to {stamp[-1]:.3f} s, odometry at {time[0]:.3f} to {time[-1]:.3f} s"
        raise DataError.at(path, f"{what}; at least one scan within the odometry is needed")
    stamp, ranges = stamp[inside], bag.ranges[order][inside]
    pose = interpolate(time, bag.pose[first], stamp)
    ranges = np.where(ranges >= bag.geometry["range_min"], ranges, 0.0)
    scans = Scans(scanner, np.arange(len(stamp)), with_returns(ranges, scanner.max_range))
    notes = [
        "No ground truth: the prior is the first pose of the odometry.",
        f"Frames are the scans of {bag.scan_topic}, with {bag.odometry_topic} interpolated at their stamps.",
        note,
    ]
    if not inside.all():
        notes.append(
            f"{int((~inside).sum())} of {counted(len(inside), 'scan')} outside the span of the odometry: left out."
        )
    after = np.clip(np.searchsorted(time, stamp), 1, len(time) - 1)
    far = int((time[after] - time[after - 1] > LONG).sum()) if len(time) > 1 else 0
    if far:
        notes.append(f"{counted(far, 'scan is', 'scans are')} where the odometry pauses for more than {LONG:g} s.")
    source = {"kind": "rosbag", "path": str(path.absolute()), "scan": bag.scan_topic, "odometry": bag.odometry_topic}
    if path.is_file():
        with path.open("rb") as file:
            source["sha256"] = hashlib.file_digest(file, "sha256").hexdigest()
    return Log(path.stem, laser_inputs(pose, stamp, scans), Truth(), source=source, notes=tuple(notes))


def _scanner(path: Path, bag: Bag) -> tuple[Scanner, str]:
    """The scanner on the robot, and a sentence about where it is."""
    g, robot, laser = bag.geometry, *bag.frames
    low, step = g["angle_min"], g["angle_increment"]
    if bag.mounting is None:
        text = f"Where {laser!r} is on {robot!r} is not in the bag: it is taken to be at its origin."
        return Scanner(low, step, g["range_max"], SIGMA), text
    R, t = bag.mounting.R, bag.mounting.t
    if not abs(abs(R[2, 2]) - 1.0) <= SMALL:
        what = f"the laser {laser!r} is tilted by {np.degrees(np.arccos(np.clip(R[2, 2], -1, 1))):.3g} deg on {robot!r}"
        raise DataError.at(path, f"{what}; a level one is needed")
    upside_down = R[2, 2] < 0.0
    if upside_down:  # seen from above its beams turn the other way
        low, step = -low, -step
    turn = float(np.arctan2(R[1, 0], R[0, 0]))
    tx, ty, rotation = (float(v) + 0.0 for v in inverse(np.array([t[0], t[1], turn])))
    place = (
        f"at ({t[0]:.4g}, {t[1]:.4g}) m, turned by {np.degrees(turn):.4g} deg{', upside down' if upside_down else ''}"
    )
    return Scanner(low, step, g["range_max"], SIGMA, rotation, (tx, ty)), f"The laser is mounted {place}."

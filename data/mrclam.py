"""UTIAS MRCLAM: one robot's recording as a log, with the stamps it was recorded with or resampled to a grid.

Frames are the instants with readings (all readings of one image are one frame) and keyframes in between; the odometry
is preintegrated between them. Times are seconds after the robot's first ground-truth row (after its first odometry row
where it has no ground truth); `Inputs.time` counts from the log's first frame.
"""

from __future__ import annotations

import math
import zipfile
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from data import se2
from data.calibration import FROZEN, Calibration
from data.errors import DataError, UsageError
from data.first_fix import first_fix
from data.inputs import CLUTTER, Increments, Inputs, IntArray, LandmarkMap, Observations, Prior, floor_covariances
from data.log import Log
from data.motion import MAX_HOLD, VelocityModel, preintegrate
from data.mrclam_files import (
    ROBOTS,
    Files,
    open_files,
    read_barcodes,
    read_landmarks,
    read_measurements,
    read_odometry,
    read_truth,
)
from data.se2 import Array
from data.sensors import RangeBearing
from data.timeline import MAX_GAP, frame_times, truth_at
from data.truth import Truth

FLOOR = 1e-10
"""Smallest eigenvalue of an increment's covariance."""
SENSOR = RangeBearing(max_range=10.0, min_angle=-0.6, max_angle=0.6)
"""The camera as the recordings show it: ranges up to 9.2 m, bearings up to 0.58 rad to either side."""
MISPLACED = 1.0
"""m; a landmark that its readings miss by more, in the median, is not where the survey says."""
STALE = 0.05
"""s; on a grid, a reading older than this at its frame's instant is dropped, as the classic tutorials do."""


@dataclass(frozen=True)
class _Readings:
    """Corrected readings, ascending by time: time (M,) s, subject (M,), z (M, 2)."""

    time: Array
    subject: IntArray
    z: Array

    def where(self, rows: NDArray[np.bool_]) -> _Readings:
        return _Readings(self.time[rows], self.subject[rows], self.z[rows])


@dataclass(frozen=True)
class _Odometry:
    """Corrected odometry: time (K,) s, v (K,) m/s, omega (K,) rad/s."""

    time: Array
    v: Array
    omega: Array


@dataclass(frozen=True)
class _TruePath:
    """Ground truth: time (K,) s, pose (K, 3), and the stretches that are marked bad."""

    time: Array
    pose: Array
    bad: tuple[tuple[float, float], ...]

    def at(self, instants: Array) -> Array:
        """Poses (N, 3), NaN where unknown or bad."""
        pose = truth_at(self.time, self.pose, instants)
        for begin, end in self.bad:
            pose[(instants >= begin) & (instants <= end)] = np.nan
        return pose


def robots(source: Path) -> list[int]:
    """Robots of a dataset (folder or zip) that have odometry and measurements, ascending."""
    return open_files(Path(source)).robots()


def is_mrclam(source: Path) -> bool:
    """Whether a folder or zip holds an MRCLAM dataset with at least one robot; raises for nothing."""
    source = Path(source)
    if not source.is_dir() and not (source.is_file() and zipfile.is_zipfile(source)):
        return False
    try:
        return bool(robots(source))
    except DataError:
        return False


def load_mrclam(
    source: Path,
    robot: int,
    *,
    start: float | None = None,
    stop: float | None = None,
    landmarks: Path | None = None,
    exclude_truth: Sequence[tuple[float, float]] = (),
    keep_robots: bool = False,
    grid: float | None = None,
    calibration: Calibration = FROZEN,
    motion: VelocityModel | None = None,
    sigma: tuple[float, float] | None = None,
    prior_sigma: tuple[float, float] = (0.05, 0.05),
) -> Log:
    """One robot's log. The barcodes are sensed labels: granting them grants no truth.

    The log starts at the first instant with truth and odometry, with the true pose there as the prior's mean, and ends
    with the odometry. A robot without ground truth gets its prior from its first sightings, which are then not part of
    the log (`data.first_fix`); if they do not fix it, the prior is the zero pose and the map is withheld, because the
    robot's frame is then its own.

    Args:
        source: folder with the .dat files, directly or in one subfolder; or the published zip.
        robot: 1 to 5.
        start, stop: s, window of the recording (see the module's first lines for zero).
        landmarks: file read instead of the dataset's Landmark_Groundtruth.dat.
        exclude_truth: stretches (from, to) [s] whose truth is bad and left out.
        keep_robots: keep sightings of the other robots, as clutter that moves.
        grid: s; resample to frames this far apart, as the classic tutorials do (0.02): odometry interpolated at each
            frame and held until the next, readings moved to the nearest frame.
        calibration: corrections and noise of odometry and camera.
        motion: replaces `calibration.motion`.
        sigma: (m, rad), replaces the calibration's noise of a reading.
        prior_sigma: (m, rad), standard deviations of x and y, and of heading, at the start.

    Raises:
        DataError: anything missing or wrong in the files, with file and line; nothing in the window.
        UsageError: arguments that make no sense.
    """
    _check(start, stop, exclude_truth, grid, prior_sigma)
    if motion is not None:
        calibration = replace(calibration, motion=motion)
    if sigma is not None:
        calibration = replace(calibration, sigma_range=sigma[0], sigma_bearing=sigma[1], sigma_range_growth=0.0)
    files, notes = open_files(Path(source)), list[str]()
    barcodes, survey = read_barcodes(files), read_landmarks(files, landmarks)
    commands, measured, true_rows = read_odometry(files, robot), read_measurements(files, robot), read_truth(files, robot)

    origin = float((commands if true_rows is None else true_rows)[0, 0])
    v, omega = calibration.velocities(commands[:, 1], commands[:, 2])
    odometry = _Odometry(_since(commands[:, 0], origin, calibration.odometry_delay), v, omega)
    truth = None
    if true_rows is not None:
        truth = _TruePath(_since(true_rows[:, 0], origin), true_rows[:, 1:], tuple(exclude_truth))
    first, last = _window(files, odometry, truth, start, stop, notes)
    z = calibration.readings(measured[:, 2:])
    readings = _Readings(_since(measured[:, 0], origin, -calibration.latency), _subjects(measured[:, 1], barcodes), z)
    readings = _chosen(readings, survey, keep_robots, notes)
    readings = _with_odometry(readings, odometry, notes)
    readings = readings.where((readings.time >= first) & (readings.time <= last))

    if grid is None:
        time = frame_times(readings.time, first, last)
        frame = np.searchsorted(time, readings.time).astype(np.int64)
    else:
        time = first + grid * np.arange(math.floor((last - first) / grid + 1e-9) + 1)
        odometry = _on_grid(odometry, time)
        readings, frame = _to_grid(readings, time, grid, notes)
    increments, gaps = preintegrate(calibration.motion, odometry.time, odometry.v, odometry.omega, time)
    if gaps:
        notes.append(f"The odometry has {gaps} gap{'s' * (gaps > 1)} of more than {MAX_HOLD:g} s; the increments' covariance grows there.")

    spread = (prior_sigma[0], prior_sigma[0], prior_sigma[1])
    known: LandmarkMap | None = survey
    if truth is not None:
        pose = truth.at(time)
        prior = Prior(pose[0], np.diag(np.square(spread)))
        notes += _misplaced(readings, pose[frame], survey)
    else:
        pose = None
        where = _of_landmarks(readings, survey)
        seen = where.subject_row >= 0
        fix = first_fix(time, increments.mean, frame[seen], where.body[seen], survey.xy[where.subject_row[seen]], spread)
        if fix is None:
            ...
    raise NotImplementedError

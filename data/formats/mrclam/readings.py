"""Observations of a UTIAS MRCLAM robot: identity by barcode, and a first pose from them.

Without ground truth the first observations of known landmarks give the prior: those of a few seconds are carried to one
body frame by odometry and fitted to the map (rigid least squares, closed form). The log starts after them, so they are
not used twice.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from data import se2
from data.formats.mrclam.files import ROBOTS
from data.inputs import CLUTTER, IntArray, LandmarkMap, Prior
from data.se2 import Array, BoolArray
from data.terminal import counted

UNKNOWN_BARCODE = -2


@dataclass(frozen=True)
class Readings:
    """Observations, ascending by time: time (M,) s, true_id (M,) subject or `CLUTTER`, z (M, 2) in m and rad."""

    time: Array
    true_id: IntArray
    z: Array

    def where(self, rows: BoolArray) -> Readings:
        """Some of them, in order."""
        return Readings(self.time[rows], self.true_id[rows], self.z[rows])

    def body(self) -> Array:
        """Points (M, 2) in the body frame."""
        direction: Array = np.stack([np.cos(self.z[:, 1]), np.sin(self.z[:, 1])], axis=-1)
        return self.z[:, :1] * direction

    def surveyed(self, survey: LandmarkMap) -> Array:
        """Surveyed place (M, 2) of each landmark, NaN for clutter."""
        return survey.positions(self.true_id)


def identify(
    time: Array, barcode: Array, z: Array, subjects: dict[int, int], survey: LandmarkMap, *, keep_robots: bool
) -> tuple[Readings, list[str]]:
    """Observations of landmarks (and of robots as clutter, if kept), and a note for each kind dropped.

    Args:
        time: (M,) s.
        barcode: (M,) read by the camera.
        z: (M, 2) range [m] and bearing [rad].
        subjects: subject by barcode.
        survey: landmarks with known places; observations of others are dropped.
        keep_robots: keep observations of robots.
    """
    notes = []
    subject = np.array([subjects.get(int(b), UNKNOWN_BARCODE) for b in barcode], np.int64)
    nobody = subject == UNKNOWN_BARCODE
    robot = np.isin(subject, ROBOTS)
    stray = ~nobody & ~robot & ~np.isin(subject, survey.id)
    if nobody.any():
        codes = ", ".join(f"{b:g}" for b in np.unique(barcode[nobody]))
        notes.append(f"{counted(nobody.sum(), 'observation')} of a barcode that no subject has ({codes}): skipped.")
    if robot.any():
        share = 100.0 * robot.sum() / len(robot)
        what = "kept as clutter" if keep_robots else "dropped"
        notes.append(f"{counted(robot.sum(), 'observation')} of other robots ({share:.0f} % of all): {what}.")
    if stray.any():
        who = ", ".join(map(str, np.unique(subject[stray])))
        many = counted(stray.sum(), "observation")
        notes.append(f"{many} of subjects that the landmark file does not have ({who}): dropped.")
    keep = ~nobody & ~stray
    if not keep_robots:
        keep &= ~robot
    return Readings(time, np.where(robot, CLUTTER, subject), z).where(keep), notes


def within(readings: Readings, first: float, last: float) -> tuple[Readings, list[str]]:
    """Observations between the first and the last odometry, and a note for each end that lost some."""
    early, late = readings.time < first, readings.time > last
    notes = [
        f"{counted(lost.sum(), 'observation')} {where} odometry: dropped."
        for lost, where in ((early, "before the first"), (late, "after the last"))
        if lost.any()
    ]
    return readings.where(~early & ~late), notes


SPAN = 10.0
"""s, longest stretch of observations of one fix, as odometry drifts."""
READINGS = 6
"""Fewest observations of a fix, of two landmarks at least."""
SURE = (0.25, 0.15)
"""m, rad, largest standard deviations of a fix."""
USUAL = 0.1
"""m, smallest RMS distance that a fix is credited with."""


class Fix(NamedTuple):
    """The frame of the fix, the pose there as a prior, the number of observations, and their RMS distance [m]."""

    frame: int
    prior: Prior
    readings: int
    rms: float


def first_fix(
    time: Array, increments: Array, frame: IntArray, points: Array, landmark: Array, sigma: tuple[float, float, float]
) -> Fix | None:
    """The first frame at which the recent observations fix the pose, or None.

    Args:
        time: (N,) s of the frames.
        increments: (N, 3) motion into each.
        frame: (M,) ascending, frame of each observation.
        points: (M, 2) m, observations in the body frame.
        landmark: (M, 2) m, map position of each landmark.
        sigma: added to the fit's standard deviations of x, y [m] and theta [rad], for systematic errors.
    """
    path = se2.dead_reckoned(np.zeros(3), increments)
    path[:, 2] = se2.wrap_angle(path[:, 2])
    for end in np.flatnonzero(np.diff(frame, append=-1)) + 1:
        now = frame[end - 1]
        begin = int(np.searchsorted(time[frame[:end]], time[now] - SPAN))
        used = slice(begin, end)
        different = len(np.unique(landmark[used], axis=0))
        if end - begin < READINGS or different < 2:
            continue
        body = se2.transform_points(se2.between(path[now], path[frame[used]]), points[used])
        pose = se2.rigid_fit(body, landmark[used])
        rms = float(np.sqrt(np.mean(np.sum((se2.transform_points(pose, body) - landmark[used]) ** 2, axis=1))))
        P = _covariance(pose, body, max(rms, USUAL) / math.sqrt(different))
        if P is None or max(P[0, 0], P[1, 1]) > SURE[0] ** 2 or P[2, 2] > SURE[1] ** 2:
            continue
        return Fix(int(now), Prior(pose, P + np.diag(np.square(sigma))), int(end - begin), rms)
    return None


def _covariance(pose: Array, body: Array, sigma: float) -> Array | None:
    """World-frame covariance (3, 3) of a fit whose points' mean has an error of `sigma` [m]; None if all coincide.

    Errors of one landmark's observations are alike, so the points count by their mean and spread.
    """
    offset = se2.transform_points(np.array([0.0, 0.0, pose[2]]), body)
    x, y = offset.mean(axis=0)
    if float(np.mean(np.sum((offset - [x, y]) ** 2, axis=1))) < 1e-4:
        return None
    information = np.array([[1.0, 0.0, -y], [0.0, 1.0, x], [-y, x, float(np.mean(np.sum(offset**2, axis=1)))]])
    return np.asarray(sigma**2 * np.linalg.inv(information))

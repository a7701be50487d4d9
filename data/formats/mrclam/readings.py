"""Camera readings of a UTIAS MRCLAM robot: whose barcode each shows, whether the survey fits, a first pose from them.

For a log without ground truth the first observations of known landmarks give the prior: readings of a few seconds are
carried to one body frame with the odometry and laid onto the map by a rigid fit (closed form, least squares). They are
spent: the log starts after them, so they are not counted twice.
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
MISPLACED = 1.0
"""m; a landmark that its readings miss by more, in the median, is not where the survey says."""
ENOUGH = 5
"""Readings of a landmark before its place is doubted."""


@dataclass(frozen=True)
class Readings:
    """Readings, ascending by time: time (M,) s, true_id (M,) landmark's subject or `CLUTTER`, z (M, 2) in m and rad."""

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
        """Where the survey has the landmark of each (M, 2), NaN for clutter."""
        return survey.positions(self.true_id)


def identify(
    time: Array, barcode: Array, z: Array, subjects: dict[int, int], survey: LandmarkMap, *, keep_robots: bool
) -> tuple[Readings, list[str]]:
    """Readings of landmarks (and of robots as clutter, if they are to be kept), and a sentence for each kind left out.

    Args:
        time: (M,) s, when each was taken.
        barcode: (M,) what the camera read.
        z: (M, 2) range [m] and bearing [rad].
        subjects: subject by barcode.
        survey: the landmarks whose places are known; readings of any other are left out.
        keep_robots: keep observations of robots.
    """
    notes = []
    subject = np.array([subjects.get(int(b), UNKNOWN_BARCODE) for b in barcode], np.int64)
    nobody = subject == UNKNOWN_BARCODE
    robot = np.isin(subject, ROBOTS)
    stray = ~nobody & ~robot & ~np.isin(subject, survey.id)
    if nobody.any():
        codes = ", ".join(f"{b:g}" for b in np.unique(barcode[nobody]))
        notes.append(f"{counted(nobody.sum(), 'reading')} of a barcode that no subject has ({codes}): skipped.")
    if robot.any():
        share = 100.0 * robot.sum() / len(robot)
        what = "kept as clutter" if keep_robots else "dropped"
        notes.append(f"{counted(robot.sum(), 'reading')} of other robots ({share:.0f} % of all): {what}.")
    if stray.any():
        who = ", ".join(map(str, np.unique(subject[stray])))
        notes.append(
            f"{counted(stray.sum(), 'reading')} of subjects that the landmark file does not have ({who}): dropped."
        )
    keep = ~nobody & ~stray
    if not keep_robots:
        keep &= ~robot
    return Readings(time, np.where(robot, CLUTTER, subject), z).where(keep), notes


def within(readings: Readings, first: float, last: float) -> tuple[Readings, list[str]]:
    """Readings between the first and the last odometry, and a sentence for each end that lost some."""
    early, late = readings.time < first, readings.time > last
    notes = [
        f"{counted(lost.sum(), 'reading')} {where} odometry: dropped."
        for lost, where in ((early, "before the first"), (late, "after the last"))
        if lost.any()
    ]
    return readings.where(~early & ~late), notes


def misplaced(readings: Readings, pose: Array, survey: LandmarkMap) -> list[str]:
    """A sentence if readings contradict the survey, given the true pose (M, 3) of each; none if they agree.

    Where the readings of one landmark lie at the place of another, it says so: two rows may have been exchanged.
    """
    points = se2.transform_points(pose, readings.body())
    known = np.isfinite(points).all(axis=1) & (readings.true_id != CLUTTER)
    distance = np.hypot(*(points - readings.surveyed(survey)).T)
    findings = []
    for number in survey.id.tolist():
        rows = known & (readings.true_id == number)
        if rows.sum() < ENOUGH or (miss := float(np.median(distance[rows]))) <= MISPLACED:
            continue
        away = np.hypot(*(survey.xy - np.median(points[rows], axis=0)).T)
        other = int(survey.id[np.argmin(away)])
        hint = f", seen where {other} should be" if away.min() <= 0.5 * MISPLACED and other != number else ""
        findings.append(f"{number} ({miss:.1f} m{hint})")
    if not findings:
        return []
    who = ", ".join(findings)
    return [f"The readings contradict the landmark file (or the ground truth is wrong); median miss of landmark {who}."]


SPAN = 10.0
"""s of readings that one fix may use; odometry drifts."""
READINGS = 6
"""A fix needs that many, of two different landmarks at least."""
SURE = (0.25, 0.15)
"""m, rad: standard deviations the fit must reach; else it waits for landmarks better placed, or readings that agree."""
USUAL = 0.1
"""m; readings that fit one another better than this do so by luck."""


class Fix(NamedTuple):
    """The frame of the fix, the pose there as a prior, how many readings it took, and their rms distance [m]."""

    frame: int
    prior: Prior
    readings: int
    rms: float


def first_fix(
    time: Array, increments: Array, frame: IntArray, points: Array, landmark: Array, sigma: tuple[float, float, float]
) -> Fix | None:
    """The first frame at which the recent readings fix the pose; None if there is none.

    Args:
        time: (N,) s of the frames.
        increments: (N, 3) motion into each.
        frame: (M,) ascending, frame of each reading.
        points: (M, 2) m, the readings in the body frame.
        landmark: (M, 2) m, where the map has the landmark of each.
        sigma: added to the fit's own standard deviations of x, y [m] and theta [rad], for what the fit does not know.
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
    """World-frame covariance (3, 3) of a fit whose points' mean errs by `sigma` [m]; None if they are all in one place.

    Errors of one landmark's readings are alike, so the points count as their mean point and spread, not one by one.
    """
    offset = se2.transform_points(np.array([0.0, 0.0, pose[2]]), body)
    x, y = offset.mean(axis=0)
    if float(np.mean(np.sum((offset - [x, y]) ** 2, axis=1))) < 1e-4:
        return None
    information = np.array([[1.0, 0.0, -y], [0.0, 1.0, x], [-y, x, float(np.mean(np.sum(offset**2, axis=1)))]])
    covariance: Array = sigma**2 * np.linalg.inv(information)
    return covariance

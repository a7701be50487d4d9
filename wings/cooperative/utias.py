"""A UTIAS MRCLAM dataset as a team: one log for each robot with ground truth, and what the robots saw of each other."""

from dataclasses import fields, replace
from pathlib import Path

import numpy as np

from data.errors import DataError
from data.formats import mrclam
from data.inputs import Inputs
from data.log import Log
from wings.cooperative.team import TeamInputs, team_of


def team_logs(source: Path) -> list[Log]:
    """The logs of all robots of a dataset (folder or zip), ascending.

    Barcodes are sensed labels, of landmarks and robots. A robot starts and ends as without the others; one without
    ground truth is left out, since its start in the map is unknown.

    Raises DataError for missing or invalid files, and fewer than two robots.
    """
    files = mrclam.open_files(source)
    there = [robot for robot in files.robots() if robot in mrclam.ROBOTS]
    true = [robot for robot in there if mrclam.robot_file(robot, "Groundtruth") in files.names]
    if len(true) < 2:
        named = ", ".join(map(str, true)) or "none"
        raise DataError.at(source, f"robots with odometry, measurements and ground truth: {named}; a team needs two")
    treatment = mrclam.Treatment(landmarks=mrclam.corrected_landmarks(source))
    survey, subjects = mrclam.read_landmarks(files, treatment.landmarks), mrclam.subjects_of(files)
    given = [mrclam.read_robot(files, true[0], subjects, treatment)]
    given += [mrclam.read_robot(files, robot, subjects, treatment, given[0].origin) for robot in true[1:]]
    split = [_split(robot) for robot in given]
    instants = np.unique(np.concatenate([seen.at for _, seen in split]))
    logs = []
    for own, _ in split:
        also = instants[(instants >= own.first) & (instants <= own.last)]
        logs.append(mrclam.robot_log(source, files, survey, own, treatment, also))
    seen, clocks = [], [log.clock for log in logs]
    for log, (_, robots) in zip(logs, split, strict=True):
        ticks, wanted = (np.rint(1e6 * t) for t in (log.recorded.time + log.clock, robots.at))
        R = treatment.calibration.noise(robots.z)
        seen.append((np.searchsorted(ticks, wanted), robots.z, R, robots.seen))
    members, labels = [log.recorded for log in logs], [np.asarray(log.granted) for log in logs]  # barcodes
    team = team_of(true, members, labels, clocks, seen, sensed=True)
    left = [robot for robot in there if robot not in true]
    notes = tuple(f"Robot {r} has no ground truth, so its start in the map is unknown: left out." for r in left)
    made = []
    for row, log in enumerate(logs):
        values = {f.name: getattr(log.recorded, f.name) for f in fields(Inputs) if f.init}
        made.append(replace(log, recorded=TeamInputs(**values, team=team, robot=row), notes=(*log.notes, *notes)))
    return made


def _split(given: mrclam.Recorded) -> tuple[mrclam.Recorded, mrclam.Recorded]:
    """What a robot observed of landmarks (and of nobody), and of robots while its log lasts."""
    robots = np.isin(given.seen, mrclam.ROBOTS)
    inside = (given.at >= given.first) & (given.at <= given.last)

    def only(rows: np.ndarray) -> mrclam.Recorded:
        return replace(
            given, at=given.at[rows], z=given.z[rows], seen=given.seen[rows], barcode=given.barcode[rows]
        )  # fmt: skip

    return only(~robots), only(robots & inside)

"""The experiments of `slamref run NAME --cooperative`: each robot of a team, of a UTIAS dataset too, by exchange."""

from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from data.errors import DataError, UsageError
from data.formats import mrclam
from data.inputs import Inputs
from data.log import Log
from data.logs import Reading, as_scored
from data.worlds import registry
from eval.plan.experiment import Experiment, Work, default_task
from eval.plan.flags.table import Selection
from eval.replay.settings import Setup
from wings.cooperative.runs import ESTIMATORS, lack
from wings.cooperative.team import EXCHANGES, TeamInputs, team_of
from wings.cooperative.world import simulate_all

ABOUT = {
    "alone": "the robot alone: no observation of robots is used",
    "naive": "each robot has its own filter, and takes the estimate of another one as independent",
    "intersection": "each robot has its own filter, and fuses the estimate of another one by covariance intersection",
}


def experiments(
    name: str, asked: Selection, setup: Setup, reading: Reading, say: Callable[[str], None]
) -> list[Experiment]:
    """All robots of a team, jointly, and as variants alone and with each exchange. UsageError: a name of no team, or
    nothing that a team can do. DataError: invalid files.
    """
    logs = [as_scored(log, reading) for log in named_team(name)]
    methods = asked.association or ("known",)
    if "slam" in asked.task:
        say("--task slam: jointly and each robot alone; naive exchange and covariance intersection need the known map")
    made = []
    for log in logs:
        given = log.recorded
        assert isinstance(given, TeamInputs)
        for exchange in EXCHANGES:
            inputs = replace(given, exchange=exchange)
            once = [e for e in asked.estimator if e != "dead-reckoning" or exchange == "joint"]
            own = log.name if exchange == "joint" else f"{log.name}:{exchange}"
            variant = {} if exchange == "joint" else {"variant_of": log.name, "about": ABOUT[exchange]}
            for task in asked.task or (default_task(log),):
                works = [
                    (m, [e for e in once if exchange == "alone" or not lack(e, task, m, exchange)]) for m in methods
                ]
                work = tuple(Work(m, tuple(able)) for m, able in works if able)
                if exchange == "joint" and not any(set(able) & {*ESTIMATORS["joint"]} for _, able in works):
                    lacks = (lack(e, task, m, "joint") for e in asked.estimator for m in methods)
                    why = next(filter(None, lacks), "an estimator is needed, ekf or batch")
                    raise UsageError(f"--cooperative: {why}")
                if work:
                    here = replace(log, name=own, recorded=inputs)
                    made.append(Experiment(here, task, work, setup.settled(log.labels_are_sensed), **variant))
    return made


def named_team(name: str) -> list[Log]:
    """The logs of all robots of a team, `NAME-robotN`: of a UTIAS dataset by its path, or of `team:SEED:...`, which is
    `arena:SEED:robots=N+KEY=VALUE`. Raises UsageError for a name of no team.
    """
    world, _, rest = name.partition(":")
    if world == "team" or (world == "arena" and "robots=" in rest):
        parsed: Any = registry.parse(f"team:{rest}")
        logs = simulate_all(parsed.parameters, parsed.seed, name)
        if len(logs) < 2:
            raise UsageError(f"--cooperative {name}: a team needs two robots")
        return [replace(log, name=f"{name}-robot{k}") for k, log in enumerate(logs, 1)]
    path = Path(name)
    if path.exists() and mrclam.is_mrclam(path):
        return team_logs(path)
    right = "name a UTIAS MRCLAM dataset (its folder or zip), or arena:SEED:robots=5"
    raise UsageError(f"--cooperative {name}: no team of robots; {right}")


def team_logs(source: Path) -> list[Log]:
    """The logs of all robots of a dataset (folder or zip) with ground truth, ascending; each starts and ends as without
    the others, barcodes are sensed labels. DataError: missing or invalid files, or fewer than two.
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
        seen.append((np.searchsorted(ticks, wanted), robots.z, treatment.calibration.noise(robots.z), robots.seen))
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
        return replace(given, at=given.at[rows], z=given.z[rows], seen=given.seen[rows], barcode=given.barcode[rows])

    return only(~robots), only(robots & inside)

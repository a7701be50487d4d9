"""Estimators compared on one laser log: the front end once, then each on its constraints."""

from collections.abc import Callable, Sequence
from dataclasses import fields, replace
from typing import Any

import numpy as np

from association.names import SCAN
from data.errors import UsageError
from data.inputs import Increments, Inputs
from data.motion.velocity import floor_covariances
from data.notice import Code, notice
from data.result import Run
from data.se2 import Array, between, compose, dead_reckoned
from data.sensors import RelativePoint
from eval.replay.run import compare
from eval.replay.settings import OF_SCANS, Setup
from wings.laser.scans.constraints import Chain, LaserRun
from wings.laser.scans.corners import corners_at
from wings.laser.slam.backends import Solved, estimated, over_frames, wheels_alone
from wings.laser.slam.front_end import FrontEndResult, run_front_end, scaled_front_end
from wings.laser.slam.parameters import LaserParameters


def between_scans(inputs: Inputs, pose: Array) -> Array:
    """The path (N, 3) with frames between two scans moved by their share (of accumulated variance) of the odometry's
    error between these; frames with a scan, before the first and after the last, stay.
    """
    assert inputs.scans is not None
    count = len(inputs)
    scanned = np.zeros(count, np.bool_)
    scanned[inputs.scans.frame] = True
    frames = np.arange(count)
    before = np.maximum.accumulate(np.where(scanned, frames, -1))
    after = np.minimum.accumulate(np.where(scanned, frames, count)[::-1])[::-1]
    row = np.flatnonzero(~scanned & (before >= 0) & (after < count))
    a, b = before[row], after[row]
    odometry = dead_reckoned(np.zeros(3), inputs.increments.mean)
    gathered = np.cumsum(np.trace(inputs.increments.covariance, axis1=1, axis2=2))
    way = gathered[b] - gathered[a]
    share = np.divide(gathered[row] - gathered[a], way, out=np.zeros(len(row)), where=way > 0.0)
    off = between(between(odometry[a], odometry[b]), between(pose[a], pose[b]))
    result = pose.copy()
    result[row] = compose(compose(pose[a], between(odometry[a], odometry[row])), share[:, None] * off)
    return result


def laser_runs(
    inputs: Inputs, task: str, estimators: Sequence[str], association: str, setup: Setup,
    judge: Callable[[Sequence[Run], Inputs], list[Run]],
) -> list[Run] | None:  # fmt: skip
    """The runs of `eval.replay.run.compare` on scans, matched or by the corners of walls; None of another log."""
    if association == SCAN:
        return judge(compare_laser(inputs, estimators, setup), inputs)
    if inputs.scans is None or len(inputs.observations.frame):
        return None
    front = run_front_end(inputs, LaserParameters(keyframe_distance=setup.keyframe_distance))
    given = _corner_log(inputs, front.chain)
    runs = compare(given, task, estimators, association, setup, judge=judge)
    return [_at_all_frames(run, given, front) for run in runs]


def _corner_log(inputs: Inputs, chain: Chain) -> Inputs:
    """Key poses as a landmark log of corners and scan matches, without loop closures and wheel odometry."""
    scans = inputs.scans
    assert scans is not None
    covariance, floored = floor_covariances(chain.covariance, inputs.covariance_floor)
    lever = float(np.hypot(*scans.scanner.translation))
    return Inputs(
        inputs.prior, inputs.time[chain.frame], Increments(chain.motion, covariance), corners_at(scans, chain.frame),
        RelativePoint(max_range=scans.scanner.max_range + lever), time_is_index=inputs.time_is_index,
        covariance_floor=inputs.covariance_floor, floored=floored,
    )  # fmt: skip


def _at_all_frames(run: Run, given: Inputs, front: FrontEndResult) -> LaserRun:
    """A run over key poses as one over all frames, each attached to its key pose, without decisions about corners."""
    of, whole = front.chain.frame, over_frames(run, front.chain, len(front.online))
    notes = (*run.notes, notice(Code.CORNERS, corners=len(given.observations.frame), scans=len(of)))
    if run.map is not None:
        whole = replace(whole, map=replace(run.map, first_frame=of[np.maximum(run.map.first_frame, 0)]))
    return _laser_run(replace(whole, seconds=run.seconds + float(front.seconds.sum()), notes=notes))


def _laser_run(run: Run, **more: Any) -> LaserRun:
    return LaserRun(**{f.name: getattr(run, f.name) for f in fields(Run)}, **more)


def compare_laser(inputs: Inputs, estimators: Sequence[str], setup: Setup) -> list[LaserRun]:
    """The estimators on the same key poses and loop closures, in the order asked for; dead reckoning uses the wheels.

    Scan-matching covariances are scaled by one factor, so that the loop closures fit the graph; this changes the
    claimed covariance, not the optimum. The filter's gate on loop closures is `setup.gate_known`. Seconds include the
    front end. Raises UsageError for one that estimates nothing from closures.
    """
    for name in estimators:
        if name not in OF_SCANS:
            raise UsageError(f"{name} with association {SCAN}: of laser logs there are {', '.join(OF_SCANS)}")
    found = scaled_front_end(inputs, LaserParameters(keyframe_distance=setup.keyframe_distance))
    front, repeated = found.front, found.repeated
    gate = setup.settled(False).label_gate
    runs = []
    for name in estimators:
        if name == "dead-reckoning":
            runs.append(_laser_run(wheels_alone(inputs)))
            continue
        run = _run(inputs, front, estimated(name, inputs, front.chain, front.loops, setup, gate=gate))
        if found.error is not None:
            run = replace(run, scale=(found.claimed, found.error))
        if repeated is not None:
            shares: dict[str, Any] = {"first": repeated.first.revisits, "taken": repeated.taken.revisits}
            widened = notice(Code.CHAIN_WIDENED, **shares, factor=repeated.factor, believed=repeated.believed)
            run = replace(run, notes=(*run.notes, widened))
        runs.append(run)
    return runs


def _run(inputs: Inputs, front: FrontEndResult, solved: Solved) -> LaserRun:
    """The run of a back end, with every frame at its final place."""
    run, chain = solved.run, front.chain
    last = between_scans(inputs, compose(solved.final_keys[chain.key], chain.since))
    final = None if run.final is None else replace(run.final, pose=last)
    return _laser_run(
        replace(run, seconds=run.seconds + float(front.seconds.sum()), final=final), chain=chain, loops=front.loops,
        loose=front.loose, frame_seconds=front.seconds, key_pose=solved.final_keys, weight=solved.weight, last=last,
    )  # fmt: skip

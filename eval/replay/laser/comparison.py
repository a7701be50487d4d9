"""Back ends compared on one laser log: the front end once, then every estimator on its constraints.

The front end replays the log frame by frame: key poses by scan matching, loop closures, and their pose graph. In the
end frames without a scan get the odometry between two scans, adjusted to connect them.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from association.scans.constraints import SCAN, Chain, LaserRun, Loops
from association.scans.points import beams_of, scan_points
from association.scans.redundant import redundant, without
from association.scans.uncertainty import learned_scale, residuals, spanned
from data.errors import UsageError
from data.formats.recordings.laser import time_steps
from data.inputs import Increments, Inputs
from data.result import Run
from data.se2 import Array, between, compose, dead_reckoned, transform_points, wrap_angle
from eval.replay.laser.backends import NAMES, Solved, backend
from eval.replay.laser.closures import Closure, LoopCloser
from eval.replay.laser.parameters import LaserParameters
from eval.replay.laser.tracker import Tracker
from eval.replay.settings import Setup
from graph.poses.online import PoseGraph


@dataclass(frozen=True, eq=False)
class FrontEndResult:
    """The result of the front end."""

    chain: Chain  # constraints for every back end
    loops: Loops
    online: Array  # (N, 3) online world pose of each frame
    seconds: Array  # (N,) wall time of each frame: matching, loops and graph


def run_front_end(inputs: Inputs, parameters: LaserParameters) -> FrontEndResult:
    """Replay a laser log (`inputs.scans`) once.

    Raises ValueError for a log without scans.
    """
    scans = inputs.scans
    if scans is None:
        raise ValueError("a laser front end needs scans")
    p, count = parameters, len(inputs)
    beams = beams_of(scans.scanner, scans.ranges.shape[1])
    unknown = count > 1 and is_unknown(inputs.increments)
    tracker = Tracker(p, scans.scanner.sigma, steady=unknown)
    closer = LoopCloser(p, scans.scanner)
    graph = PoseGraph(inputs.prior)
    row = np.full(count, -1)
    row[scans.frame] = np.arange(len(scans.frame))
    nothing = np.zeros(scans.ranges.shape[1])
    step = np.zeros(count) if inputs.time_is_index else np.diff(inputs.time, prepend=inputs.time[0])
    step = time_steps(inputs.time) if unknown else step

    frames: list[int] = []
    motions: list[Array] = []
    covariances: list[Array] = []
    key = np.zeros(count, np.int64)
    since, since_covariance = np.zeros((count, 3)), np.zeros((count, 3, 3))
    online, seconds = np.zeros((count, 3)), np.zeros(count)
    poses, waiting, far, updated = np.zeros((0, 3)), False, False, 0
    for frame in range(count):
        began = time.perf_counter()
        if frame:
            tracker.predict(*inputs.increment(frame), float(step[frame]))
        scanned = row[frame] >= 0
        ranges = scans.ranges[row[frame]] if scanned else nothing
        seen = scan_points(ranges, beams, p.max_range)
        if scanned:
            tracker.correct(seen)
        if frame == 0 or (scanned and tracker.is_due):
            motion, covariance = tracker.pose, tracker.covariance
            frames.append(frame)
            motions.append(motion)
            covariances.append(covariance)
            if frame:
                graph.add_key(motion, covariance)
                poses = np.concatenate([poses, compose(poses[-1], motion)[None]])
            else:
                poses = inputs.prior.mean[None].copy()
            closer.add_key(ranges, seen, motion, covariance)
            tracker.make_key(seen)
            believed = closer.find(poses)
            if believed:
                graph.add_loops(
                    np.array([c.key1 for c in believed]), np.array([c.key2 for c in believed]),
                    np.array([c.relative for c in believed]), np.array([c.covariance for c in believed]),
                )  # fmt: skip
                waiting, far = True, far or any(is_far(c, poses) for c in believed)
            # an update costs time with the size of the graph: in large ones key poses have one in common
            due = len(frames) - updated > (len(frames) - LARGE) // AMORTIZED
            if waiting and (far or due):
                graph.update()
                poses, waiting, far, updated = graph.poses(), False, False, len(frames)
                closer.moved(poses)
        key[frame] = len(frames) - 1
        since[frame], since_covariance[frame] = tracker.pose, tracker.covariance
        online[frame] = compose(poses[-1], tracker.pose)
        seconds[frame] = time.perf_counter() - began
    chain = Chain(np.array(frames), np.array(motions), np.array(covariances), key, since, since_covariance)
    return FrontEndResult(chain, closer.loops(), online, seconds)


def is_unknown(increments: Increments) -> bool:
    """Whether the odometry says nothing: no motion, with a standard deviation of centimetres and more."""
    return not increments.mean.any() and bool(np.median(increments.covariance[1:, 0, 0]) > UNKNOWN**2)


LARGE, AMORTIZED = 1500, 300
"""Key poses from which on loop closures wait for others, and how many more make them wait for one more key pose."""
FAR = np.array([0.1, 0.1, 0.03])  # m, m, rad: loop closures that disagree so much with the estimate do not wait


def is_far(closure: Closure, poses: Array) -> bool:
    """Whether a loop closure disagrees with the estimate of the key poses (K, 3)."""
    error = between(poses[closure.key1], poses[closure.key2]) - closure.relative
    error[2] = wrap_angle(float(error[2]))
    return bool((np.abs(error) > FAR).any())


UNKNOWN = 0.01  # m, above the error of a step of any odometry that is at rest


def between_scans(inputs: Inputs, pose: Array) -> Array:
    """The path (N, 3) with frames between two scans moved by their share of the odometry's error between these.

    The share is that of the odometry's accumulated variance. Frames with a scan, and those before the first and after
    the last, stay.
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


CONTRAST = 0.999  # gate of the filter shown for comparison with the ungated one
FEWEST = 20  # loop closures needed to learn a scale, which then is known to a quarter or better


def compare_laser(inputs: Inputs, estimators: Sequence[str], setup: Setup) -> list[LaserRun]:
    """The estimators on the same key poses and loop closures, in the order asked for; dead reckoning uses the wheels.

    Scan-matching covariances are scaled by one factor, so that the loop closures fit the graph; this changes the
    claimed covariance, not the optimum. The filter's gate on loop closures is `setup.gate_known`. Seconds include the
    front end. Raises UsageError for an estimator that is no back end of scan matching.
    """
    for name in estimators:
        if name not in NAMES:
            raise UsageError(f"{name} with association {SCAN}: of laser logs there are {', '.join(NAMES)}")
    parameters = LaserParameters(keyframe_distance=setup.keyframe_distance)
    front = run_front_end(inputs, parameters)
    learned = _learned(inputs, front, setup)
    factor, error = learned or (1.0, 0.0)
    front = _scaled(front, factor)
    if setup.least_information is not None:
        front = _thinned(inputs, front, setup.least_information, parameters)
    claimed = parameters.variance_scale * factor
    gate = setup.settled(False).label_gate
    runs = []
    for name in estimators:
        run = _run(inputs, front, backend(name, inputs, front.chain, front.loops, setup, gate=gate))
        if learned and run.chain is not None:
            run = replace(run, scale=(claimed, parameters.variance_scale * error))
        if name == "ekf" and gate is None and run.failure is None:
            scaled, unscaled = (
                _run(inputs, given, backend(name, inputs, given.chain, given.loops, setup, gate=CONTRAST))
                for given in (front, _scaled(front, 1.0 / claimed))
            )
            run = replace(run, with_gate=(scaled, unscaled))
        runs.append(run)
    return runs


def _learned(inputs: Inputs, front: FrontEndResult, setup: Setup) -> tuple[float, float] | None:
    """Factor on the front end's covariances and its standard error; None with too few loop closures."""
    chain, loops = front.chain, front.loops
    believed = np.flatnonzero(loops.believed >= 0)
    if len(believed) < FEWEST:
        return None
    solved = backend("batch", inputs, chain, loops, setup)
    if solved.run.failure is not None:
        return None
    key1, key2 = loops.key1[believed], loops.key2[believed]
    step = 1 + np.flatnonzero(spanned(len(chain.frame), key1, key2))
    d2 = residuals(
        solved.final_keys, np.concatenate([step - 1, key1]), np.concatenate([step, key2]),
        np.concatenate([chain.motion[step], loops.relative[believed]]),
        np.concatenate([chain.covariance[step], loops.covariance[believed]]),
    )  # fmt: skip
    return learned_scale(d2, len(believed))


def _scaled(front: FrontEndResult, factor: float) -> FrontEndResult:
    c, o = front.chain, front.loops
    chain = replace(c, covariance=factor * c.covariance, since_covariance=factor * c.since_covariance)
    return replace(front, chain=chain, loops=replace(o, covariance=factor * o.covariance))


def _thinned(inputs: Inputs, front: FrontEndResult, least: float, parameters: LaserParameters) -> FrontEndResult:
    """The constraints without the key poses that add little information to the map, placed by the batch smoother.

    They are chosen from the whole log, so online estimates lack them, too.
    """
    solved = backend("batch", inputs, front.chain, front.loops)
    if solved.run.failure is not None or inputs.scans is None:
        return front
    scans, nothing = inputs.scans, np.zeros((0, 2))
    beams = beams_of(scans.scanner, scans.ranges.shape[1])
    row = dict(zip(scans.frame.tolist(), scans.ranges, strict=True))
    ends = [
        transform_points(pose, scan_points(row[frame], beams, parameters.max_range).xy) if frame in row else nothing
        for pose, frame in zip(solved.final_keys, front.chain.frame.tolist(), strict=True)
    ]
    chain, loops = without(front.chain, front.loops, redundant(ends, least))
    return replace(front, chain=chain, loops=loops)


def _run(inputs: Inputs, front: FrontEndResult, solved: Solved) -> LaserRun:
    """The run of a back end, with every frame at its final place."""
    run, chain = solved.run, front.chain
    last = None
    if run.association != "none":
        last = between_scans(inputs, compose(solved.final_keys[chain.key], chain.since))
        final = None if run.final is None else replace(run.final, pose=last)
        run = replace(run, seconds=run.seconds + float(front.seconds.sum()), final=final)
    given = {f.name: getattr(run, f.name) for f in fields(Run)}
    if last is None:
        return LaserRun(**given)
    return LaserRun(
        **given, chain=chain, loops=front.loops, frame_seconds=front.seconds, key_pose=solved.final_keys,
        weight=solved.weight, last=last,
    )  # fmt: skip

"""The laser front end: key poses by scan matching, loop closures, and their pose graph, frame by frame; and again with
a wider chain where its map draws walls twice.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np

from association.scans.consistency import Consistency, consistency
from association.scans.constraints import Chain, Loops
from association.scans.points import beams_of, scan_points
from data.formats.recordings.laser import time_steps
from data.inputs import Increments, Inputs
from data.se2 import Array, between, compose, wrap_angle
from eval.replay.laser.closures import Closure, LoopCloser
from eval.replay.laser.parameters import LaserParameters
from eval.replay.laser.tracker import Tracker
from graph.poses.online import PoseGraph


@dataclass(frozen=True, eq=False)
class FrontEndResult:
    """The result of the front end."""

    chain: Chain  # constraints for every back end
    loops: Loops
    online: Array  # (N, 3) online world pose of each frame
    seconds: Array  # (N,) wall time of each frame: matching, loops and graph
    keys: Array  # (K, 3) all key poses in the end


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
            motion, covariance = tracker.pose, p.chain_factor * tracker.covariance
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
    if waiting:
        graph.update()
        poses = graph.poses()
    chain = Chain(np.array(frames), np.array(motions), np.array(covariances), key, since, since_covariance)
    return FrontEndResult(chain, closer.loops(), online, seconds, poses)


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


FACTORS = (10.0, 100.0)
"""Factors on the variances of the chain that are tried where walls are drawn twice."""
BETTER = 0.5
"""Share of the inconsistency that is left, below which another map is taken."""


@dataclass(frozen=True)
class Repeated:
    """Why loop closures of a first pass are not believed: `first` map, the one that was taken, and its `factor`."""

    first: Consistency
    taken: Consistency
    factor: float
    believed: int


def consistent_front_end(inputs: Inputs, parameters: LaserParameters) -> tuple[FrontEndResult, Repeated | None]:
    """The front end; where its map draws walls twice, that with the most consistent map.

    A systematic error of the odometry makes the chain overconfident: the gate refuses right loop closures, and lets
    those pass that are wrong by as much, in rows of equal things. With larger variances both pass, and the right ones
    come first where anything differs. The loop closures of the worse map are not believed.
    """
    front = run_front_end(inputs, parameters)
    first = best = _seen(inputs, front)
    if first is None or best is None or not first.is_doubled:
        return front, None
    found, seconds = None, front.seconds
    for factor in FACTORS:
        other = run_front_end(inputs, replace(parameters, chain_factor=factor))
        seconds = seconds + other.seconds
        seen = _seen(inputs, other)
        if seen is not None and seen.excess < BETTER * best.excess:
            best, front = seen, other
            found = Repeated(first, seen, factor, int((other.loops.believed >= 0).sum()))
        if not best.is_doubled:
            break
    return replace(front, seconds=seconds), found


def _seen(inputs: Inputs, front: FrontEndResult) -> Consistency | None:
    return None if inputs.scans is None else consistency(inputs.scans, front.chain.frame, front.keys)

"""A laser log replayed frame by frame: key poses by scan matching, loop closures, and the pose graph they feed."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from association.scans.constraints import Chain, Loops
from association.scans.points import beams_of, scan_points
from data.inputs import Inputs
from data.se2 import Array, compose
from eval.replay.laser.closures import LoopCloser
from eval.replay.laser.parameters import LaserParameters
from eval.replay.laser.tracker import Tracker
from graph.poses.online import PoseGraph


@dataclass(frozen=True, eq=False)
class FrontEndResult:
    """What a replayed laser log came to.

    Attributes:
        chain, loops: the constraints for every back end.
        online: (N, 3) world pose of each frame as it was known then.
        seconds: (N,) wall time of each frame, matching, loops and graph.
    """

    chain: Chain
    loops: Loops
    online: Array
    seconds: Array


def run_front_end(inputs: Inputs, parameters: LaserParameters) -> FrontEndResult:
    """Replay a laser log (`inputs.scans`) once, each frame with what is known by then.

    Raises ValueError for a log without scans.
    """
    scans = inputs.scans
    if scans is None:
        raise ValueError("a laser front end needs scans")
    p, count = parameters, len(inputs)
    beams = beams_of(scans.scanner, scans.ranges.shape[1])
    tracker = Tracker(p, scans.scanner.sigma)
    closer = LoopCloser(p, scans.scanner)
    graph = PoseGraph(inputs.prior)
    row = np.full(count, -1)
    row[scans.frame] = np.arange(len(scans.frame))
    nothing = np.zeros(scans.ranges.shape[1])

    frames: list[int] = []
    motions: list[Array] = []
    covariances: list[Array] = []
    key = np.zeros(count, np.int64)
    since, since_covariance = np.zeros((count, 3)), np.zeros((count, 3, 3))
    online, seconds = np.zeros((count, 3)), np.zeros(count)
    poses = np.zeros((0, 3))
    for frame in range(count):
        began = time.perf_counter()
        if frame:
            tracker.predict(*inputs.increment(frame))
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
                graph.update()
                poses = graph.poses()
        key[frame] = len(frames) - 1
        since[frame], since_covariance[frame] = tracker.pose, tracker.covariance
        online[frame] = compose(poses[-1], tracker.pose)
        seconds[frame] = time.perf_counter() - began
    chain = Chain(np.array(frames), np.array(motions), np.array(covariances), key, since, since_covariance)
    return FrontEndResult(chain, closer.loops(), online, seconds)

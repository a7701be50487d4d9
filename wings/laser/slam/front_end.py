"""The laser front end: key poses by scan matching, loop closures, and their pose graph, frame by frame; again with a
wider chain where its map draws walls twice; and its variances scaled by one factor, which loop closures tell, since
scan matching is overconfident.
"""

import time
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from data.formats.recordings.laser import time_steps
from data.inputs import Increments, Inputs
from data.se2 import Array, BoolArray
from wings.laser.scans.constraints import Chain, Consistency, Loops, consistency
from wings.laser.scans.uncertainty import learned_scale, residuals, spanned
from wings.laser.slam.backends import key_inputs, smoothed
from wings.laser.slam.incremental import ScanSlam
from wings.laser.slam.parameters import LaserParameters


@dataclass(frozen=True, eq=False)
class FrontEndResult:
    """The result of the front end."""

    chain: Chain  # constraints for every back end
    loops: Loops
    online: Array  # (N, 3) online world pose of each frame
    seconds: Array  # (N,) wall time of each frame: matching, loops and graph
    keys: Array  # (K, 3) all key poses in the end
    loose: BoolArray  # (N,) frames whose scan did not fix a direction, or did not fit


def run_front_end(inputs: Inputs, parameters: LaserParameters) -> FrontEndResult:
    """Replay a laser log (`inputs.scans`) once. Raises ValueError for a log without scans."""
    scans = inputs.scans
    if scans is None:
        raise ValueError("a laser front end needs scans")
    p, count = parameters, len(inputs)
    unknown = count > 1 and is_unknown(inputs.increments)
    slam = ScanSlam(inputs.prior, scans.scanner, scans.ranges.shape[1], p, steady=unknown)
    slam.seen_by(np.flatnonzero(scans.ranges.any(axis=0)))
    row = np.full(count, -1)
    row[scans.frame] = np.arange(len(scans.frame))
    step = np.zeros(count) if inputs.time_is_index else np.diff(inputs.time, prepend=inputs.time[0])
    step = time_steps(inputs.time) if unknown else step

    key = np.zeros(count, np.int64)
    since, since_covariance = np.zeros((count, 3)), np.zeros((count, 3, 3))
    online, seconds, loose = np.zeros((count, 3)), np.zeros(count), np.zeros(count, np.bool_)
    for frame in range(count):
        began = time.perf_counter()
        increment = inputs.increment(frame) if frame else None
        ranges = scans.ranges[row[frame]] if row[frame] >= 0 else None
        online[frame] = slam.step(increment, ranges, float(step[frame]))
        key[frame] = len(slam.frames) - 1
        since[frame], since_covariance[frame] = slam.tracker.pose, slam.tracker.covariance
        loose[frame] = slam.tracker.loose
        seconds[frame] = time.perf_counter() - began
    if slam.waits:
        slam.update()
    motions, covariances = np.array(slam.motions), np.array(slam.covariances)
    chain = Chain(np.array(slam.frames), motions, covariances, key, since, since_covariance)
    return FrontEndResult(chain, slam.closer.loops(), online, seconds, slam.poses, loose)


def is_unknown(increments: Increments) -> bool:
    """Whether the odometry says nothing: no motion, with a standard deviation of centimetres and more."""
    return not increments.mean.any() and bool(np.median(increments.covariance[1:, 0, 0]) > UNKNOWN**2)


UNKNOWN = 0.01  # m, above the error of a step of any odometry that is at rest


FACTORS = (10.0, 100.0)  # Factors on the variances of the chain that are tried where walls are drawn twice
BETTER = 0.5  # Share of the inconsistency that is left, below which another map is taken


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


FEWEST = 20  # loop closures needed to learn a scale, which then is known to a quarter or better


class Scaled(NamedTuple):
    """The front end's constraints with scaled covariances: `claimed`: scale on the variances that scan matching states,
    `error`: its standard error, None: too few loops tell it; `factor`: the part that was learned.
    """

    front: FrontEndResult
    repeated: Repeated | None
    factor: float
    claimed: float
    error: float | None


def scaled_front_end(inputs: Inputs, parameters: LaserParameters) -> Scaled:
    """The front end over a laser log; the scale follows from the whole log, and leaves the optimum where it is."""
    front, repeated = consistent_front_end(inputs, parameters)
    factor, error = _learned(inputs, front) or (1.0, None)
    own = parameters.variance_scale
    return Scaled(scaled(front, factor), repeated, factor, own * factor, None if error is None else own * error)


def scaled(front: FrontEndResult, factor: float) -> FrontEndResult:
    """The same with all variances times a factor."""
    c, o = front.chain, front.loops
    chain = replace(c, covariance=factor * c.covariance, since_covariance=factor * c.since_covariance)
    return replace(front, chain=chain, loops=replace(o, covariance=factor * o.covariance))


def _learned(inputs: Inputs, front: FrontEndResult) -> tuple[float, float] | None:
    """Factor on the front end's covariances and its standard error; None with too few loop closures."""
    chain, loops = front.chain, front.loops
    believed = np.flatnonzero(loops.believed >= 0)
    if len(believed) < FEWEST:
        return None
    solved = smoothed("batch", key_inputs(inputs, chain, loops))
    if solved.failure is not None or solved.final is None:
        return None
    key1, key2 = loops.key1[believed], loops.key2[believed]
    step = 1 + np.flatnonzero(spanned(len(chain.frame), key1, key2))
    d2 = residuals(
        solved.final.pose, np.concatenate([step - 1, key1]), np.concatenate([step, key2]),
        np.concatenate([chain.motion[step], loops.relative[believed]]),
        np.concatenate([chain.covariance[step], loops.covariance[believed]]),
    )  # fmt: skip
    return learned_scale(d2, len(believed))

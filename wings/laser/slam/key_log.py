"""Key poses of a laser log as frames of a log that every estimator replays: motion, closures, and corners of walls.

Two forms. With `SCAN_MATCH` the motion between key poses is the front end's scan matching, which used the wheels as a
weak prior: wheels enter there and nowhere else, and the closures are the loops that the front end believes. With
`ODOMETRY` the motion is the wheels', and the scan of each frame, matched to those of the key poses before without any
prior, is a closure with the key pose before; other frames than key poses can be asked for. In neither is one pair of
scans both motion and closure.

Corners are labelled by the front end's final path, in which loops are closed. That uses the whole log; it tells the two
sides of a wall apart, 12 cm from each other, which no association can while the path is uncertain.

What remains dependent: a scan is in the reference of the next `LaserParameters.window` matches and of the loops around,
and corners come from scans that are matched, too. Their errors are taken as independent here, as in all back ends.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from data.inputs import Increments, Inputs, IntArray
from data.motion.velocity import floor_covariances
from data.pose_measurements import Closures
from data.se2 import Array, between, compose
from data.sensors import RelativePoint
from eval.replay.settings import Setup
from wings.laser.scans.constraints import Chain
from wings.laser.scans.corners import corner_labels, corners_at
from wings.laser.scans.matching import MotionPrior, NearestGrid, Reference, match
from wings.laser.scans.points import Points, beams_of, joined, scan_points
from wings.laser.scans.uncertainty import compose_covariances
from wings.laser.slam.backends import LOOP, NO_OBSERVATIONS
from wings.laser.slam.closures import NO_PRIOR
from wings.laser.slam.front_end import scaled_front_end
from wings.laser.slam.parameters import LaserParameters

SCAN_MATCH, ODOMETRY = MOTIONS = ("scan-match", "odometry")  # What the motion between key poses is
Edges = tuple[IntArray, IntArray, Array, Array]
"""Frames key1 and key2 (C,), poses (C, 3) of key2 in the frame of key1, and covariances of their additive errors."""
ROBUST = 1e3  # Scale of the prior of a match that has none, in standard deviations: it does not yield


class KeyLog(NamedTuple):
    """The log, and where it comes from."""

    inputs: Inputs  # key poses, and other frames that were asked for, as frames; without scans
    frame: IntArray  # (F,) the frame of the laser log of each
    label: IntArray  # (M,) of the corners, by the front end's final path
    chain: Chain  # of the front end
    claimed: float  # scale on variances that scan matching states; error: its standard error, None: not learned
    error: float | None


def key_log(
    inputs: Inputs, setup: Setup, *, motion: str, loops: bool = True, corners: bool = True, also: IntArray | None = None
) -> KeyLog:
    """The log of key poses of a laser log (`inputs.scans`), with a motion of `MOTIONS`, with or without parts. `also`:
    other frames of the laser log that become frames; with `ODOMETRY` alone.
    """
    scans = inputs.scans
    if scans is None or motion not in MOTIONS or (also is not None and motion != ODOMETRY):
        raise ValueError("a log with scans, a motion, and other frames with odometry alone are needed")
    parameters = LaserParameters(keyframe_distance=setup.keyframe_distance)
    found = scaled_front_end(inputs, parameters)
    chain, tested = found.front.chain, found.front.loops
    frame = chain.frame if also is None else np.union1d(chain.frame, also)
    at = np.searchsorted(frame, chain.frame)  # of each key pose
    believed = np.flatnonzero(tested.believed >= 0) if loops else np.empty(0, np.int64)
    ends = at[tested.key1[believed]], at[tested.key2[believed]]
    parts: list[Edges] = [(*ends, tested.relative[believed], tested.covariance[believed])]
    sources = [LOOP]
    steps = Increments(chain.motion, chain.covariance)
    if motion == ODOMETRY:
        parts = [matches_with_keys(inputs, chain, frame, parameters, found.factor), *parts]
        sources = [SCAN_MATCH, *sources]
        steps = wheels_between(inputs.increments, frame)
    source = np.repeat(np.arange(len(parts)), [len(p[0]) for p in parts])
    every = [*(np.concatenate(a) for a in zip(*parts, strict=True)), source.astype(np.int64)]
    by = np.argsort(every[1], kind="stable")
    key1, key2, relative, uncertainty, which = (a[by] for a in every)
    closures = Closures(key1, key2, relative, uncertainty, which, tuple(sources))
    covariance, floored = floor_covariances(steps.covariance, inputs.covariance_floor)
    seen = corners_at(scans, chain.frame) if corners else NO_OBSERVATIONS
    # corners are recognized far nearer than a scanner reaches: up to the farthest
    sensor = RelativePoint(max_range=1.001 * float(np.hypot(*seen.z.T).max(initial=0.0)) or np.inf)
    given = replace(
        inputs, time=inputs.time[frame], increments=replace(steps, covariance=covariance),
        observations=replace(seen, frame=at[seen.frame]), sensor=sensor, floored=floored, scans=None,
        closures=closures if len(closures) else None,
    )  # fmt: skip
    return KeyLog(given, frame, corner_labels(seen, found.front.keys), chain, found.claimed, found.error)


def wheels_between(increments: Increments, frames: IntArray) -> Increments:
    """Increments (K) between frames (K,), ascending from 0, composed from those of all frames."""
    mean, covariance = np.zeros((len(frames), 3)), np.zeros((len(frames), 3, 3))
    for k in range(1, len(frames)):
        pose, P = np.zeros(3), np.zeros((3, 3))
        for f in range(frames[k - 1] + 1, frames[k] + 1):
            P = compose_covariances(pose, P, increments.mean[f], increments.covariance[f])
            pose = compose(pose, increments.mean[f])
        mean[k], covariance[k] = pose, P
    return Increments(mean, covariance)


def matches_with_keys(
    inputs: Inputs, chain: Chain, frames: IntArray, parameters: LaserParameters, factor: float
) -> Edges:
    """The scan of each of `frames` (F,), all key poses among them, matched to the `parameters.window` key scans before
    it, by the scans alone: its pose relative to the key pose before, by row in `frames`.

    The start is the front end's pose; no odometry weighs in. A metre and a radian of uncertainty about the start keep
    a match solvable along a corridor. Covariances are scaled by `factor` as those of the front end; a match that does
    not fit is left out.
    """
    scans, p = inputs.scans, parameters
    assert scans is not None
    beams = beams_of(scans.scanner, scans.ranges.shape[1])
    nothing = np.zeros(scans.ranges.shape[1])
    grid, sigma = NearestGrid(p.max_range + 2.0), p.distance_sigma(scans.scanner.sigma)
    window: list[Points] = []  # in the frame of the last key pose
    reference: Reference | None = None
    last, key = 0, -1
    found: list[tuple[int, int, Array, Array]] = []
    for row, frame in enumerate(frames.tolist()):
        ranges = scans.of(frame)
        seen = scan_points(nothing if ranges is None else ranges, beams, p.max_range)
        becomes_key = frame == chain.frame[key + 1] if key + 1 < len(chain.frame) else False
        start = chain.motion[key + 1] if becomes_key else chain.since[frame]
        if reference is not None and len(seen.xy):
            one = match(seen, reference, start, MotionPrior(start, NO_PRIOR), sigma, ROBUST)
            if one.share >= p.least_share:
                found.append((last, row, one.pose, factor * one.covariance))
        if becomes_key:
            key, last = key + 1, row
            back = between(start, np.zeros(3))
            window = [*(w.seen_from(back) for w in window), seen][-p.window :]
            every = joined(window)
            reference = grid.reference(*every) if len(every.xy) else None
    first, second = (np.array([e[i] for e in found], np.int64) for i in (0, 1))
    relative, covariance = (np.array([e[i] for e in found]) for i in (2, 3))
    return first, second, relative.reshape(-1, 3), covariance.reshape(-1, 3, 3)

"""Corners of walls as landmarks: a laser log for EKF-SLAM, with scan matching as odometry."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import NamedTuple

import numpy as np

from data.inputs import UNLABELLED, Increments, Inputs, IntArray, Observations, Scans
from data.motion.velocity import floor_covariances
from data.notice import Code, notice
from data.result import Run
from data.se2 import Array, transform_points
from data.sensors import RelativePoint
from eval.replay.settings import Setup
from wings.laser.scans.constraints import Chain, LaserRun
from wings.laser.scans.corners import corners
from wings.laser.slam.backends import over_frames
from wings.laser.slam.front_end import run_front_end
from wings.laser.slam.parameters import LaserParameters


class CornerLog(NamedTuple):
    """Key poses as frames of a landmark log, the chain that leads to all other frames, and the time taken [s]."""

    inputs: Inputs
    chain: Chain
    seconds: float


def corner_log(inputs: Inputs, setup: Setup) -> CornerLog:
    """A laser log with corners of its key scans as observations (body frame) and scan matching as increments.

    It has no loop closures and no wheel odometry: loops are closed by re-observed corners.
    """
    scans = inputs.scans
    assert scans is not None
    front = run_front_end(inputs, LaserParameters(keyframe_distance=setup.keyframe_distance))
    chain = front.chain
    covariance, floored = floor_covariances(chain.covariance, inputs.covariance_floor)
    lever = float(np.hypot(*scans.scanner.translation))
    given = Inputs(
        inputs.prior, inputs.time[chain.frame], Increments(chain.motion, covariance), corners_at(scans, chain.frame),
        RelativePoint(max_range=scans.scanner.max_range + lever), time_is_index=inputs.time_is_index,
        covariance_floor=inputs.covariance_floor, floored=floored,
    )  # fmt: skip
    return CornerLog(given, chain, float(front.seconds.sum()))


def corners_at(scans: Scans, frames: IntArray) -> Observations:
    """Corners (body frame) of the scans at key poses (K,), which are numbered from 0; a key without a scan has none."""
    seen = [(k, *corners(r, scans.scanner)) for k, f in enumerate(frames) if (r := scans.of(int(f))) is not None]
    z = np.concatenate([np.empty((0, 2)), *(xy for _, xy, _ in seen)])
    R = np.concatenate([np.empty((0, 2, 2)), *(R for _, _, R in seen)])
    frame = np.repeat(np.array([k for k, _, _ in seen], np.int64), [len(xy) for _, xy, _ in seen])
    return Observations(frame, z, R)


SAME = 0.05
"""m between corners of two scans that are one corner: three times their spread, half a wall's thickness. Up to twice as
far apart it is unclear."""


def corner_labels(seen: Observations, pose: Array) -> IntArray:
    """Which corners (M,) are the same by the poses (K, 3) of their frames: numbers from 0, `UNLABELLED` where unclear.

    In the order of the frames each takes the nearest corner so far within `SAME`, the nearest first, where no other of
    its scan has taken it.
    """
    place, count = np.empty((0, 2)), np.empty(0)
    label = np.full(len(seen.frame), UNLABELLED, np.int64)
    for frame in np.unique(seen.frame).tolist():
        rows = np.flatnonzero(seen.frame == frame)
        world = transform_points(pose[frame], seen.z[rows])
        apart = (
            np.hypot(*(world[:, None] - place[None]).transpose(2, 0, 1))
            if len(place)
            else np.full((len(rows), 1), np.inf)
        )
        nearest, least = apart.argmin(axis=1), apart.min(axis=1)
        taken: set[int] = set()
        for i in np.argsort(least, kind="stable").tolist():
            k = int(nearest[i])
            if least[i] <= SAME and k not in taken:
                taken.add(k)
                label[rows[i]] = k
                count[k] += 1.0
                place[k] += (world[i] - place[k]) / count[k]
            elif least[i] > 2.0 * SAME:
                label[rows[i]] = len(place)
                place, count = np.concatenate([place, world[i : i + 1]]), np.append(count, 1.0)
    return label


def at_all_frames(run: Run, corners: CornerLog, frames: int) -> LaserRun:
    """A run over key poses as one over all frames, each attached to its key pose; decisions about corners are dropped.

    Dead reckoning here is that of scan matching.
    """
    of, whole = corners.chain.frame, over_frames(run, corners.chain, frames)
    seen = len(corners.inputs.observations.frame)
    notes = (*run.notes, notice(Code.CORNERS, corners=seen, scans=len(of)))
    if run.map is not None:
        whole = replace(whole, map=replace(run.map, first_frame=of[np.maximum(run.map.first_frame, 0)]))
    whole = replace(whole, seconds=run.seconds + corners.seconds, notes=notes)
    return LaserRun(**{f.name: getattr(whole, f.name) for f in fields(Run)})

"""Errors of a path against reference relations.

A reference relation is the pose at one instant in the frame of the pose at another (Kuemmerle et al., "On measuring the
accuracy of SLAM algorithms", Autonomous Robots 27, 2009). With poses a, b and the relation rel, the error is
(a^-1 b) rel^-1 as in Cartographer's evaluation, which published figures use.
"""

import math
from dataclasses import asdict, dataclass
from itertools import product
from typing import Any

import numpy as np

from data.inputs import IntArray
from data.log import Log
from data.result import Run
from data.se2 import Array, BoolArray, between, compose, inverse, wrap_angle
from data.truth import Relations

ROW, TIME = "row", "time"
TIES = (ROW, TIME)
ALL, EXACT = "all", "exact"
SUBSETS = (ALL, EXACT)


@dataclass(frozen=True)
class RelationErrors:
    """Errors over the relations with a pose at both ends; std divides by their number, as published figures do."""

    relations: int
    trans_mean_m: float
    trans_std_m: float
    trans_max_m: float
    rot_mean_deg: float
    rot_std_deg: float
    rot_max_deg: float


def relation_errors(
    path: Array, relations: Relations, time: Array, *, tie: str = ROW, subset: str = ALL
) -> RelationErrors | None:
    """Errors of a path (N, 3) of all frames; None where the relations have no stamps, or no exact subset. `time` (N,)
    [s] stamps the frames if the relations do not. The exact subset has relations with known rows.
    """
    which: BoolArray = np.ones(len(relations), np.bool_)
    if subset == EXACT:
        if relations.exact is None:
            return None
        which = relations.exact == 1
    if tie == ROW:
        first, second = path[relations.row1], path[relations.row2]
    else:
        if relations.stamp is None:
            return None
        recorded = time if relations.frame_stamp is None else relations.frame_stamp
        first, second = (at_stamps(path, recorded, relations.stamp[:, i]) for i in range(2))
    error = errors(first[which], second[which], relations.relative[which])
    error = error[np.isfinite(error).all(axis=1)]
    if not len(error):
        return RelationErrors(0, *[math.nan] * 6)
    both = np.hypot(error[:, 0], error[:, 1]), np.degrees(np.abs(error[:, 2]))
    return RelationErrors(len(error), *(float(f(each)) for each in both for f in (np.mean, np.std, np.max)))


def errors(first: Array, second: Array, relative: Array) -> Array:
    """Errors (K, 3) [m, m, rad] of poses (K, 3) at both ends against relations (K, 3)."""
    return compose(between(first, second), inverse(relative))


def at_stamps(path: Array, frame_stamp: Array, stamp: Array) -> Array:
    """Poses (K, 3) at stamps (K,) of a path (N, 3) with stamps `frame_stamp` (N,), which may be out of order.

    Interpolated between the frame of the nearest stamp (the first of several) and the next frame of the log, else the
    previous one, if the stamp lies strictly between theirs; otherwise the pose of that frame.
    """
    frame = nearest_frames(frame_stamp, stamp)
    result = path[frame].copy()
    open_ = np.ones(len(stamp), np.bool_)
    for step_to in (1, -1):
        other = np.clip(frame + step_to, 0, len(path) - 1)
        own, theirs = frame_stamp[frame], frame_stamp[other]
        inside = open_ & (np.minimum(own, theirs) < stamp) & (stamp < np.maximum(own, theirs))
        share = ((stamp[inside] - own[inside]) / (theirs[inside] - own[inside]))[:, None]
        step = path[other[inside]] - path[frame[inside]]
        step[:, 2] = wrap_angle(step[:, 2])
        result[inside] += share * step
        open_ &= ~inside
    result[:, 2] = wrap_angle(result[:, 2])
    return result


def nearest_frames(frame_stamp: Array, stamp: Array) -> IntArray:
    """Frame (K,) whose stamp is nearest to each of `stamp` (K,), the first of several."""
    order = np.argsort(frame_stamp, kind="stable")
    ordered = frame_stamp[order]
    # of equal stamps the first frame, which a search from the left finds
    after = np.searchsorted(ordered, stamp, side="left")
    right = np.minimum(after, len(ordered) - 1)
    left = np.searchsorted(ordered, ordered[np.maximum(after - 1, 0)], side="left")
    gap_left, gap_right = np.abs(stamp - ordered[left]), np.abs(ordered[right] - stamp)
    earlier = (gap_left < gap_right) | ((gap_left == gap_right) & (order[left] < order[right]))
    return order[np.where(earlier, left, right)].astype(np.int64)


def relation_rows(run: Run, log: Log) -> list[dict[str, Any]]:
    """Rows of relations.csv: for each phase, tie and subset."""
    relations = log.truth.relations
    if relations is None or run.failure is not None:
        return []
    rows = list[dict[str, Any]]()
    name = {"log": log.name, "estimator": run.estimator, "association": run.association}
    for phase, tie, subset in product(run.phases, TIES, SUBSETS):
        found = relation_errors(run.trajectory(phase).pose, relations, log.recorded.time, tie=tie, subset=subset)
        if found is not None:
            rows.append({**name, "phase": phase, "tie": tie, "subset": subset, **asdict(found)})
    return rows

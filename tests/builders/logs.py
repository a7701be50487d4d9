"""Logs of a few frames, written by hand: what is not given is simple and the same everywhere."""

from dataclasses import replace
from operator import attrgetter
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from data.inputs import Increments, Inputs, LabelledObservations, LandmarkMap, Observations, Prior
from data.log import Log
from data.se2 import Array, between
from data.sensors import RelativePoint, Sensor


def increments_of(mean: ArrayLike, covariance: ArrayLike) -> Increments:
    """Of means (N, 3), whose row 0 is replaced by 0, with covariances (3, 3) or (N, 3, 3), whose row 0 as well."""
    moved = np.array(mean, float)
    C = np.broadcast_to(np.asarray(covariance, float), (len(moved), 3, 3)).copy()
    moved[0], C[0] = 0.0, 0.0
    return Increments(moved, C)


def observations_of(
    frame: ArrayLike, z: ArrayLike, R: ArrayLike = 0.01, label: ArrayLike | None = None
) -> Observations:
    """Of frames (M,), z (M, 2) and R: one variance, or (2, 2), or (M, 2, 2); labelled if there are labels."""
    frame, z, R = np.asarray(frame, np.int64), np.reshape(np.asarray(z, float), (-1, 2)), np.asarray(R, float)
    C = np.broadcast_to(R if R.ndim else R * np.eye(2), (len(frame), 2, 2)).copy()
    if label is None:
        return Observations(frame, z, C)
    return LabelledObservations(frame, z, C, np.asarray(label, np.int64))


NOTHING = observations_of([], [])
"""No observation at all."""


def inputs_of(
    increments: Increments, observations: Observations = NOTHING, sensor: Sensor | None = None,
    known: LandmarkMap | None = None, *, start: ArrayLike = (0.0, 0.0, 0.0), spread: ArrayLike = 0.0, **more: Any,
) -> Inputs:  # fmt: skip
    """Frames one second apart; the first pose is `start`, its covariance `spread` (one variance, or (3, 3))."""
    C = np.asarray(spread, float)
    time = np.asarray(more.pop("time", np.arange(len(increments.mean))), float)
    return Inputs(
        Prior(np.asarray(start, float), C if C.ndim else C * np.eye(3)), time, increments, observations,
        sensor or RelativePoint(), known, **more,
    )  # fmt: skip


def still(frames: int, variance: float = 1e-6) -> Increments:
    return increments_of(np.zeros((frames, 3)), variance * np.eye(3))


def along(path: Array, covariance: ArrayLike) -> Increments:
    return increments_of(np.concatenate([np.zeros((1, 3)), between(path[:-1], path[1:])]), covariance)


def map_of(xy: ArrayLike, ids: ArrayLike | None = None) -> LandmarkMap:
    """Landmarks (L, 2), numbered from 0 without ids."""
    places = np.reshape(np.asarray(xy, float), (-1, 2))
    return LandmarkMap(np.arange(len(places)) if ids is None else np.asarray(ids, np.int64), places)


PARTS = attrgetter(
    *(f"recorded.{name}" for name in ("time", "prior.mean", "prior.covariance", "increments.mean",
      "increments.covariance", "observations.frame", "observations.z", "observations.R")),
    "truth.pose", "truth.landmark_of",
)  # fmt: skip


def same(a: Log, b: Log) -> bool:
    arrays = zip(PARTS(a), PARTS(b), strict=True)
    return all((x is None and y is None) or np.array_equal(x, y, equal_nan=True) for x, y in arrays)


def without_frames(log: Log, gone: slice) -> Log:
    r, o, kept = log.recorded, log.recorded.observations, np.ones(len(log.recorded), bool)
    kept[gone] = False
    seen = kept[o.frame]
    observations = replace(o.only(seen), frame=(np.cumsum(kept) - 1)[o.frame[seen]])
    label, ids = (None if of is None else of[seen] for of in (log.label, log.truth.landmark_of))
    recorded = replace(r, time=r.time[: kept.sum()], increments=r.increments.only(kept), observations=observations)
    return replace(
        log, recorded=recorded, truth=replace(log.truth, pose=log.truth.pose[kept], landmark_of=ids), label=label
    )

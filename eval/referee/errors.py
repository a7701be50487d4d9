"""Errors of a trajectory and a map against the truth: RMSE, maxima, alignment. Pure functions on arrays.

Errors are world-frame, additive, heading wrapped; frames without truth (NaN) are left out; no alignment unless a name
says so. A metric without anything to measure is NaN, never zero.
"""

from __future__ import annotations

import math

import numpy as np

from data import se2
from data.inputs import IntArray
from data.result import Run
from data.se2 import Array
from data.sensors import Sensor
from data.truth import Truth


def rms(values: Array) -> float:
    """Root of the mean square of the finite values; NaN if there are none."""
    finite = values[np.isfinite(values)]
    return float(math.sqrt(np.mean(finite**2))) if len(finite) else math.nan


def position_distance(pose: Array, truth: Array) -> Array:
    """Distance [m] (N,) between estimated and true positions, NaN without truth."""
    distance: Array = np.hypot(pose[:, 0] - truth[:, 0], pose[:, 1] - truth[:, 1])
    return distance


def heading_rmse_deg(pose: Array, truth: Array) -> float:
    """RMS heading error [deg]."""
    return math.degrees(rms(se2.pose_error(pose, truth)[:, 2]))


def frame_weights(time: Array) -> Array:
    """Seconds (N,) that each frame stands for: half the way to either neighbour."""
    if len(time) < 2:
        return np.ones(len(time))
    step = np.diff(time)
    weights: Array = 0.5 * (np.append(step, 0.0) + np.append(0.0, step))
    return weights


def time_weighted_rmse(pose: Array, truth: Array, time: Array) -> float:
    """RMS position error [m] with each frame weighted by its time, as on a uniform grid."""
    distance = position_distance(pose, truth)
    known = np.isfinite(distance)
    weight = frame_weights(time)[known]
    if not known.any() or weight.sum() <= 0:
        return rms(distance)
    return float(math.sqrt(np.average(distance[known] ** 2, weights=weight)))


def align(points: Array, onto: Array) -> tuple[Array, Array]:
    """Rotation (2, 2), translation (2,) of the best rigid fit of points (K, 2) onto others (Umeyama 1991, no scale)."""
    a, b = points.mean(axis=0), onto.mean(axis=0)
    U, _, Vt = np.linalg.svd((onto - b).T @ (points - a))
    D = np.diag([1.0, np.linalg.det(U) * np.linalg.det(Vt)])
    R = U @ D @ Vt
    return R, b - R @ a


def aligned_rmse(pose: Array, truth: Array) -> float:
    """RMS position error [m] after the best SE(2) fit; NaN with fewer than two frames of truth."""
    known = np.isfinite(pose[:, :2]).all(axis=1) & np.isfinite(truth[:, :2]).all(axis=1)
    if known.sum() < 2:
        return math.nan
    R, t = align(pose[known, :2], truth[known, :2])
    moved = pose[known, :2] @ R.T + t
    return rms(np.hypot(*(moved - truth[known, :2]).T))


def named(run: Run) -> IntArray:
    """Which landmark (M,) is known by an observation: what it initialized in the end, or at first if that is gone."""
    last = run.initialized
    left = np.where(np.isin(run.created, last[last >= 0]), -1, run.created)
    return np.where(last >= 0, last, left)


def landmark_true_ids(created: IntArray, truth: Truth, numbers: IntArray) -> IntArray:
    """True id (L,) of each landmark, that of the observation that initialized it (-2 where not known)."""
    ids = np.full(int(max(created.max(initial=-1), np.max(numbers, initial=-1))) + 1, -2, np.int64)
    if truth.landmark_of is not None:
        first = np.flatnonzero(created >= 0)
        ids[created[first]] = truth.landmark_of[first]
    return ids[numbers]


def landmark_errors(xy: Array, true_id: IntArray, truth: Truth, sensor: Sensor) -> Array:
    """Position error (L, 2) of each mapped landmark, NaN where its true position is not known, and of walls."""
    if truth.landmarks is None or not sensor.sees_points:
        return np.full((len(xy), 2), np.nan)
    return xy - truth.landmarks.positions(true_id)

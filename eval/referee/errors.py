"""Errors of a trajectory and a map against the truth: RMSE, maxima, alignment. Pure functions on arrays.

Errors are world-frame, additive, heading wrapped; frames without truth (NaN) are left out; no alignment unless a name
says so. A metric without anything to measure is NaN, never zero.

The errors of one run frame by frame along its log, from which its metrics, scores and intervals are made.

Relative pose errors over stated distances: how fast an estimate drifts, whatever its start and gauge.

Sturm et al., A Benchmark for the Evaluation of RGB-D SLAM Systems (IROS 2012), equation 2: the motion between two
poses, true and estimated, and the difference of the two. The pairs are those of evo's `evo_rpe --all_pairs
--pairs_from_reference`: every pose with the one whose way from it, along the true path, comes nearest to the distance,
if within a tenth of it (`--delta_tol 0.1`, evo's default).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from data import se2
from data.inputs import IntArray
from data.log import Log
from data.result import Run
from data.se2 import Array, BoolArray
from data.sensors import Sensor
from data.truth import Truth
from eval.referee import consistency


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


@dataclass(frozen=True, eq=False)
class Along:
    """Errors of one run and phase, per frame (N,); NaN: no truth.

    Attributes:
        distance: of the estimated position from the true one [m].
        thin: frames of nearly singular covariance, which are in no NEES and no score of the belief.
        nees: of each quantity (`consistency.QUANTITIES`); NaN also where thin or not invertible.
    """

    distance: Array
    thin: BoolArray
    nees: Mapping[str, Array]


def along(run: Run, phase: str, log: Log) -> Along | None:
    """Errors of a run in a phase along its log; None where no pose is known or the run did not get to the end."""
    truth = log.truth.pose
    if run.failure is not None or truth is None or not np.isfinite(truth).all(axis=1).any():
        return None
    trajectory = run.trajectory(phase)
    pose, covariance = trajectory.pose, trajectory.covariance
    thin = consistency.nearly_singular(covariance, log.recorded.covariance_floor)
    sound = np.where(thin[:, None], np.nan, pose)
    nees = {q: consistency.nees(sound, covariance, truth, q) for q in consistency.QUANTITIES}
    return Along(position_distance(pose, truth), thin, nees)


DISTANCES = (1.0, 10.0)
"""m: what a robot sees at once, and what it drives between two looks at the same place; the drift over 10 m in metres
is its tenth in percent of the way."""
TOLERANCE = 0.1


@dataclass(frozen=True, eq=False)
class Relative:
    """Relative errors of p pairs: translation (p,) [m] and turn (p,) [rad], neither negative."""

    translation: Array
    turn: Array


def pairs_by_way(xy: Array, distance: float) -> tuple[IntArray, IntArray]:
    """Rows i < j (p,) of positions (n, 2) with a way of `distance` between, within a tenth; of equals the first."""
    n = len(xy)
    none = np.empty(0, np.int64)
    if n < 2:
        return none, none
    way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(xy, axis=0).T))])
    i = np.arange(n - 1)
    high = np.clip(np.searchsorted(way, way[i] + distance), i + 1, n - 1)
    # the first of the poses that stand where the one before stands
    low = np.maximum(np.searchsorted(way, way[np.maximum(high - 1, 0)]), i + 1)
    off_low, off_high = (np.abs(way[j] - way[i] - distance) for j in (low, high))
    j = np.where(off_low <= off_high, low, high)
    kept = np.minimum(off_low, off_high) <= TOLERANCE * distance
    return i[kept], j[kept]


def relative(pose: Array, truth: Array, pairs: tuple[IntArray, IntArray]) -> Relative:
    """Errors of the motions from the first to the second pose of each pair."""
    i, j = pairs
    theirs, ours = se2.between(truth[i], truth[j]), se2.between(pose[i], pose[j])
    return Relative(np.hypot(*(ours - theirs)[:, :2].T), np.abs(se2.wrap_angle(ours[:, 2] - theirs[:, 2])))


def rpe_columns(pose: Array, truth: Array) -> dict[str, float | None]:
    """RMS relative errors of poses (n, 3) over a frame and over `DISTANCES`, by column of metrics.csv.

    Poses without truth are left out first, so that a frame is from one known truth to the next. None: no pair.
    """
    known = np.isfinite(pose).all(axis=1) & np.isfinite(truth).all(axis=1)
    pose, truth = pose[known], truth[known]
    n = len(pose)
    found: dict[str, float | None] = {}
    every = {"frame": (np.arange(max(n - 1, 0)), np.arange(1, max(n, 1)))}
    for name, pairs in (every | {f"{d:g}m": pairs_by_way(truth[:, :2], d) for d in DISTANCES}).items():
        some = len(pairs[0]) > 0
        r = relative(pose, truth, pairs)
        found[f"rpe_{name}_m"] = math.sqrt(np.mean(r.translation**2)) if some else None
        found[f"rpe_{name}_deg"] = math.degrees(math.sqrt(np.mean(r.turn**2))) if some else None
    return found

"""Errors of a trajectory and a map against the truth: RMSE, alignment, relative errors.

Errors are world-frame, additive, heading wrapped. Frames without truth (NaN) are left out. Paths are not aligned unless
a name says so. A metric of no values is NaN.

Relative errors are those of Sturm et al., A Benchmark for the Evaluation of RGB-D SLAM Systems (IROS 2012), equation 2.
The pairs are those of `evo_rpe --all_pairs --pairs_from_reference`: each pose with the one whose distance along the
true path is nearest to the stated one, if within a tenth of it (`--delta_tol 0.1`, evo's default).
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from data import se2
from data.inputs import IntArray
from data.log import Log
from data.result import Run
from data.se2 import Array, BoolArray
from data.sensors import Sensor
from data.timeline import usual_gap
from data.truth import Truth
from eval.referee import consistency


def rms(values: Array) -> float:
    """Root of the mean square of the finite values; NaN if there are none."""
    finite = values[np.isfinite(values)]
    return float(math.sqrt(np.mean(finite**2))) if len(finite) else math.nan


def position_distance(pose: Array, truth: Array) -> Array:
    """Distance [m] (N,) between estimated and true positions, NaN without truth."""
    return np.asarray(np.hypot(pose[:, 0] - truth[:, 0], pose[:, 1] - truth[:, 1]))


def heading_rmse_deg(pose: Array, truth: Array) -> float:
    """RMS heading error [deg]."""
    return math.degrees(rms(se2.pose_error(pose, truth)[:, 2]))


def frame_weights(time: Array) -> Array:
    """Seconds (N,) of each frame: half the intervals to its neighbours."""
    step = np.diff(time)
    return 0.5 * (np.append(step, 0.0) + np.append(0.0, step)) if len(time) > 1 else np.ones(len(time))


def time_weighted_rmse(pose: Array, truth: Array, time: Array) -> float:
    """RMS position error [m] weighted by `frame_weights`."""
    distance = position_distance(pose, truth)
    known = np.isfinite(distance)
    weight = frame_weights(time)[known]
    if not known.any() or weight.sum() <= 0:
        return rms(distance)
    return float(math.sqrt(np.average(distance[known] ** 2, weights=weight)))


def aligned_distance(pose: Array, truth: Array) -> Array:
    """Position errors (N,) [m] after the best rigid fit onto the truth; NaN without truth, or with fewer than two."""
    known = np.isfinite(pose[:, :2]).all(axis=1) & np.isfinite(truth[:, :2]).all(axis=1)
    off = np.full(len(truth), np.nan)
    if known.sum() > 1:
        ours, theirs = pose[known, :2], truth[known, :2]
        off[known] = position_distance(se2.transform_points(se2.rigid_fit(ours, theirs), ours), theirs)
    return off


def aligned_rmse(pose: Array, truth: Array) -> float:
    """RMS position error [m] after the best SE(2) fit; NaN with fewer than two frames of truth."""
    return rms(aligned_distance(pose, truth))


def named(run: Run) -> IntArray:
    """Landmark (M,) that takes its true id from an observation: the one initialized finally, else the one online."""
    last = run.initialized
    return np.where(last >= 0, last, np.where(np.isin(run.created, last[last >= 0]), -1, run.created))


def observed(run: Run) -> IntArray:
    """Landmark (M,) of each observation by the final decisions, initializations included; negative: none."""
    return np.where(run.initialized >= 0, run.initialized, run.final_decisions)


def identified(log: Log) -> Truth:
    """The truth; without true ids, labels that no sensor read (the author's) stand for them."""
    own = log.truth.landmark_of is not None or log.label is None or log.labels_are_sensed
    return log.truth if own else replace(log.truth, landmark_of=log.label)


def landmark_true_ids(created: IntArray, truth: Truth, numbers: IntArray) -> IntArray:
    """True id (L,) of each landmark, by the observation that initialized it; -2: unknown."""
    ids = np.full(int(max(created.max(initial=-1), np.max(numbers, initial=-1))) + 1, -2, np.int64)
    if truth.landmark_of is not None:
        first = np.flatnonzero(created >= 0)
        ids[created[first]] = truth.landmark_of[first]
    return ids[numbers]


def true_ids_of(run: Run, log: Log) -> IntArray:
    """True id (L,) of each landmark of a run's map; -2: unknown, also where the map itself stands for the truth."""
    if run.map is None:
        return np.empty(0, np.int64)
    known, true = log.recorded.map, log.truth.landmarks
    if run.task != "localization" or known is None:
        return landmark_true_ids(named(run), identified(log), run.map.number)
    same = true is None or np.array_equal(known.positions(true.id), true.xy)
    return np.full(len(run.map), -2) if same else run.map.number


def landmark_errors(xy: Array, true_id: IntArray, truth: Truth, sensor: Sensor) -> Array:
    """Position errors (L, 2) of mapped landmarks; NaN where the true position is unknown, and of walls."""
    if truth.landmarks is None or not sensor.sees_points:
        return np.full((len(xy), 2), np.nan)
    return xy - truth.landmarks.positions(true_id)


@dataclass(frozen=True, eq=False)
class Along:
    """Errors of one run and phase, per frame (N,); NaN: no truth."""

    distance: Array  # m, of the positions
    thin: BoolArray  # frames with a nearly singular covariance, which enter no NEES and no proper score
    nees: Mapping[str, Array]  # of each of `consistency.QUANTITIES`; NaN also where thin or singular


def along(run: Run, phase: str, log: Log) -> Along | None:
    """Errors of a run in a phase along its log; None without true poses, and for a run that failed."""
    truth = log.truth.pose
    if run.failure is not None or truth is None or not np.isfinite(truth[:, :2]).all(axis=1).any():
        return None
    trajectory = run.trajectory(phase)
    pose, covariance = trajectory.pose, trajectory.covariance
    floor = log.recorded.covariance_floor
    thin = consistency.nearly_singular(covariance, floor)
    nees = {}
    for quantity, columns in consistency.QUANTITIES.items():
        # another program's covariance may lack a part: the others are scored
        part = covariance[:, columns][:, :, columns] if run.handed_in else covariance
        out = consistency.nearly_singular(part, floor) if run.handed_in else thin
        nees[quantity] = consistency.nees(np.where(out[:, None], np.nan, pose), covariance, truth, quantity)
    return Along(position_distance(pose, truth), thin, nees)


DISTANCES = (1.0, 10.0)  # m
TOLERANCE = 0.1


def pairs_by_way(position: Array, distance: float, tolerance: float | None = None) -> tuple[IntArray, IntArray]:
    """Rows i < j (p,) of positions (n, k) `distance` apart along the path, give or take `tolerance` (a tenth)."""
    n = len(position)
    if n < 2:
        return np.empty(0, np.int64), np.empty(0, np.int64)
    driven = np.concatenate([[0.0], np.cumsum(np.hypot.reduce(np.diff(position, axis=0), axis=1))])
    i = np.arange(n - 1)
    high = np.clip(np.searchsorted(driven, driven[i] + distance), i + 1, n - 1)
    # of poses at the same place the first
    low = np.maximum(np.searchsorted(driven, driven[np.maximum(high - 1, 0)]), i + 1)
    off_low, off_high = (np.abs(driven[j] - driven[i] - distance) for j in (low, high))
    j = np.where(off_low <= off_high, low, high)
    kept = np.minimum(off_low, off_high) <= (TOLERANCE * distance if tolerance is None else tolerance)
    return i[kept], j[kept]


def rpe_columns(pose: Array, truth: Array, time: Array) -> dict[str, float | None]:
    """RMS relative errors of poses (n, 3) over a frame and over `DISTANCES`, by column of metrics.csv; None: no pair. A
    frame lasts from one known true pose to the next. No pair is across a gap of these.
    """
    known = np.isfinite(pose).all(axis=1) & np.isfinite(truth).all(axis=1)
    pose, truth = pose[known], truth[known]
    found: dict[str, float | None] = {}
    pairs = {"frame": successive(len(pose))} | pairs_over(truth[:, :2])
    for name, (i, j) in without_gaps(pairs, time[known]).items():
        off = se2.between(pose[i], pose[j]) - se2.between(truth[i], truth[j])
        some = len(i) > 0
        found[f"rpe_{name}_m"] = rms(np.hypot(off[:, 0], off[:, 1])) if some else None
        found[f"rpe_{name}_deg"] = math.degrees(rms(se2.wrap_angle(off[:, 2]))) if some else None
    return found


def successive(n: int) -> tuple[IntArray, IntArray]:
    """Rows (n - 1,) of the first and of the second of each two successive rows of n."""
    return np.arange(max(n - 1, 0)), np.arange(1, max(n, 1))


def without_gaps(pairs: Mapping[str, tuple[IntArray, IntArray]], time: Array) -> dict[str, tuple[IntArray, IntArray]]:
    """The pairs of rows at stamps (n,) between which no gap is longer than is usual."""
    stretch = np.cumsum(np.diff(time, prepend=time[:1]) > usual_gap(time, math.inf) + 1e-6)
    inside = {name: stretch[i] == stretch[j] for name, (i, j) in pairs.items()}
    return {name: (i[inside[name]], j[inside[name]]) for name, (i, j) in pairs.items()}


def pairs_over(position: Array) -> dict[str, tuple[IntArray, IntArray]]:
    """Pairs by way of true positions (n, k) over `DISTANCES`, as columns name them."""
    return {f"{d:g}m": pairs_by_way(position, d) for d in DISTANCES}

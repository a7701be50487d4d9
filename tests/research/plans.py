"""How good laser SLAM is where the truth is known: simulated floor plans, errors, consistency, loop closures.

Recall over tested loop closures misses loops that were not tested. A second recall is over key poses: of those from
which an earlier one could have been recognized, the share that a right and believed loop closure leads to.
"""

import os
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
import scipy
from joblib import Parallel, delayed

from association.names import SCAN
from data.se2 import Array, BoolArray, between, pose_error
from data.worlds.registry import named_log
from eval.compare import compare
from eval.referee.consistency import LEVEL, chi2_bounds, mean_or_nan, nees, squared_distance, verdict
from eval.referee.errors import aligned_rmse, position_distance, rms
from wings.laser.scans.constraints import LaserRun
from wings.laser.score import closure_counts, fits, right_closures, scan_points_of

REACH = 2.0  # m, largest distance between the true positions of a revisit, as for candidates of loop closures
DRIVEN = 10.0  # m, least distance driven between them: turning in a room closes no loop


class PlanRun(NamedTuple):
    """One simulated plan: RMSE [m] of iSAM2's final, the same aligned, its online path, the filter's, the wheels'."""

    final: float
    aligned: float
    online: float
    filter: float
    wheels: float
    nees_final: float  # mean pose NEES (3 expected)
    nees_online: float
    chain: Array  # squared distances of the factors
    loops: Array
    counts: Mapping[str, object]  # tp, fp, tn, fn of loop closures
    possible: int  # revisits, and those that a right and believed closure leads to
    closed: int
    scale: tuple[float, float]  # learned scale of the claimed variances, and its standard error
    seconds: float  # of the front end
    span: float  # of the drive


def measure_plan(name: str) -> PlanRun:
    """Measure one log of a floor plan."""
    log = named_log(name)
    truth = log.truth.pose
    assert truth is not None
    wheels, ekf, isam2 = compare(log.recorded, "slam", ["dead-reckoning", "ekf", "isam2"], SCAN)
    assert isinstance(isam2, LaserRun)
    assert isam2.frame_seconds is not None
    assert log.recorded.scans is not None
    chain, loops, _, _ = isam2.parts
    final, online, keys = isam2.trajectory("final"), isam2.trajectory("online"), truth[chain.frame]
    points = scan_points_of(log.recorded.scans, chain.frame)
    believed = loops.believed >= 0
    steps = pose_error(chain.motion[1:], between(keys[:-1], keys[1:]))
    possible, led_to = revisits(keys, points), loops.key2[right_closures(loops, keys) & believed]
    off = pose_error(loops.relative, between(keys[loops.key1], keys[loops.key2]))[believed]
    paths = {
        "final": final,
        "online": online,
        "filter": ekf.trajectory("online"),
        "wheels": wheels.trajectory("online"),
    }
    return PlanRun(
        **{path: rms(position_distance(t.pose, truth)) for path, t in paths.items()},
        aligned=aligned_rmse(final.pose, truth),
        nees_final=mean_or_nan(nees(final.pose, final.covariance, truth, "pose")),
        nees_online=mean_or_nan(nees(online.pose, online.covariance, truth, "pose")),
        chain=squared_distance(steps, chain.covariance[1:]),
        loops=squared_distance(off, loops.covariance[believed]),
        counts=closure_counts(isam2, log, "online") or {},
        possible=int(np.count_nonzero(possible)),
        closed=int(np.count_nonzero(possible & np.isin(np.arange(len(keys)), led_to))),
        scale=isam2.scale or (np.nan, np.nan),
        seconds=float(isam2.frame_seconds.sum()),
        span=float(log.recorded.time[-1] - log.recorded.time[0]),
    )


def revisits(truth: Array, points: list[Array]) -> BoolArray:
    """Key poses (K,) from which an earlier one can be recognized, given true key poses (K, 3) and their scans (P, 2).

    The two must be within `REACH`, more than `DRIVEN` apart along the path, and their scans must overlap.
    """
    driven = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(truth[:, 0:2], axis=0).T))])
    places = scipy.spatial.cKDTree(truth[:, :2])
    possible = np.zeros(len(truth), np.bool_)
    for k in range(len(truth)):
        around = np.array(places.query_ball_point(truth[k, :2], REACH), np.int64)
        past = around[driven[k] - driven[around] > DRIVEN]
        # the nearest first, which is the likeliest to overlap
        nearest = past[np.argsort(np.hypot(*(truth[past, :2] - truth[k, :2]).T), kind="stable")]
        possible[k] = any(fits(points[i], points[k], between(truth[i], truth[k])) for i in nearest.tolist())
    return possible


def plan_lines(found: Sequence[PlanRun]) -> list[str]:
    """The measurements, in lines of text."""
    tp, fp, tn, fn = (sum(int(str(r.counts[name])) for r in found) for name in ("tp", "fp", "tn", "fn"))
    of_all = sum(r.possible for r in found)
    lines = [f"{len(found)} simulated plans, position RMSE [mm]: median (largest)"]
    for what in ("final", "aligned", "online", "filter", "wheels"):
        values = 1e3 * np.array([getattr(r, what) for r in found])
        lines.append(f"  {what:8s} {np.median(values):8.1f} ({values.max():.1f})")
    for what in ("nees_final", "nees_online"):
        v = verdict(np.array([getattr(r, what) for r in found]), 3)
        lines.append(f"{what:12s} {v.mean:.2f} [{v.lower:.2f}, {v.upper:.2f}] where 3 is expected: {v.word}")
    for what in ("chain", "loops"):
        # relative poses with a common scan are correlated: a mean little outside the bounds proves nothing
        squares = np.concatenate([getattr(r, what) for r in found])
        squares = squares[np.isfinite(squares)] / 3
        lower, upper = chi2_bounds(3 * max(len(squares), 1), LEVEL)
        lines.append(
            f"NEES/3 of {what}: mean {squares.mean():.3f}, median {np.median(squares):.3f} (1 and 0.79 expected),"
            f" {len(squares)} factors, bounds {lower:.3f} to {upper:.3f}"
        )
    lines.append(
        f"loop closures: {tp} TP, {fp} FP, {tn} TN, {fn} FN; precision {100 * tp / max(tp + fp, 1):.2f} %,"
        f" recall {100 * tp / max(tp + fn, 1):.1f} %;"
        f" {100 * sum(r.closed for r in found) / max(of_all, 1):.1f} % of {of_all} possible revisits closed"
    )
    scale = np.array([r.scale[0] for r in found])
    lines.append(
        f"learned factor on claimed variances: {np.nanmedian(scale):.2f} ({np.nanmin(scale):.2f} to"
        f" {np.nanmax(scale):.2f})"
    )
    speed = [r.span / r.seconds for r in found]
    lines.append(f"front end: {np.median(speed):.0f} times real time")
    return lines


def study(plans: int) -> None:
    """Measure the first plans on all cores, and print what they say."""
    jobs = Parallel(n_jobs=os.cpu_count() or 1)
    print("\n".join(plan_lines(jobs(delayed(measure_plan)(f"floorplan:{seed}") for seed in range(plans)))), flush=True)

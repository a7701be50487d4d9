"""How good laser SLAM is where the truth is known: simulated floor plans, errors, consistency, loop closures."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from joblib import Parallel, delayed

from association.names import SCAN
from data.se2 import Array
from data.worlds.registry import named_log
from eval.compare import compare
from eval.referee.consistency import LEVEL, chi2_bounds, mean_or_nan, nees, verdict
from eval.referee.errors import aligned_rmse, position_distance, rms
from wings.laser.scans.constraints import LaserRun
from wings.laser.score import (
    ClosureCounts,
    chain_squares,
    count_closures,
    loop_squares,
    revisits,
    scan_points_of,
)

SEEDS = 50


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
    counts: ClosureCounts
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
        chain=chain_squares(chain, keys),
        loops=loop_squares(loops, keys),
        counts=count_closures(loops, keys, revisits(keys, points), points),
        scale=isam2.scale or (np.nan, np.nan),
        seconds=float(isam2.frame_seconds.sum()),
        span=float(log.recorded.time[-1] - log.recorded.time[0]),
    )


def measure_plans(seeds: Sequence[int] = range(SEEDS), keys: str = "") -> list[PlanRun]:
    """Plans of several seeds, with further `keys` of the log's name, on all cores."""
    names = [f"floorplan:{seed}" + (f":{keys}" if keys else "") for seed in seeds]
    jobs = Parallel(n_jobs=os.cpu_count() or 1)
    return list(jobs(delayed(measure_plan)(name) for name in names))


def plan_lines(found: Sequence[PlanRun]) -> list[str]:
    """The measurements, in lines of text."""
    counts = sum((r.counts for r in found), ClosureCounts(0, 0, 0, 0))
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
        f"loop closures: {counts.tp} TP, {counts.fp} FP, {counts.tn} TN, {counts.fn} FN; precision"
        f" {100 * counts.precision:.2f} %, recall {100 * counts.recall_of_found:.1f} %;"
        f" {100 * counts.recall:.1f} % of {counts.possible} possible revisits closed"
    )
    scale = np.array([r.scale[0] for r in found])
    lines.append(
        f"learned factor on claimed variances: {np.nanmedian(scale):.2f} ({np.nanmin(scale):.2f} to"
        f" {np.nanmax(scale):.2f})"
    )
    speed = [r.span / r.seconds for r in found]
    lines.append(f"front end: {np.median(speed):.0f} times real time")
    return lines


def lines(quick: bool) -> list[str]:
    """The measurements of all plans, of a tenth of them if `quick`."""
    return plan_lines(measure_plans(range(SEEDS // 10 if quick else SEEDS)))

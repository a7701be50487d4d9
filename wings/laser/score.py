"""Scores of laser runs: outcomes of loop closures.

They have outcomes where the true poses are known: TP right and believed, FP wrong and believed, FN right and not
believed, TN otherwise. A loop closure is right if its relative pose is near the truth, or inside its own covariance's
gate. One that was not believed is right only if its scans overlap.
"""

import math
from collections.abc import Sequence

import numpy as np
import scipy

from data.inputs import IntArray, Scans
from data.log import Log
from data.result import Run
from data.se2 import Array, BoolArray, between, transform_points
from eval.referee.consistency import right_relatives
from eval.referee.score import Trial
from wings.laser.scans.constraints import LaserRun, Loops
from wings.laser.scans.points import beams_of

FIT = 0.1  # m, largest distance of matching scan points: three beams of 1 degree at 2 m
OVERLAP = 0.6  # share of each scan's points that must match at the true poses; scan matching needs 0.5


def mapped(trial: Trial) -> LaserRun | None:
    """The run whose final poses a map is drawn from: isam2's, or the first that has some; None: no laser log."""
    found = [r for r in trial.runs if isinstance(r, LaserRun) and r.failure is None and r.last is not None]
    return min(found, key=lambda r: r.estimator != "isam2", default=None)


def right_closures(loops: Loops, truth: Array) -> BoolArray:
    """Which loop closures (L,) are right, given true key poses (K, 3)."""
    return right_relatives(loops.relative, loops.covariance, truth[loops.key1], truth[loops.key2])


def wrong_closures(run: LaserRun, truth: Array | None) -> BoolArray | None:
    """Which loop closures (L,) of a run are wrong, given the true path (N, 3); None without."""
    if truth is None or run.loops is None or run.chain is None:
        return None
    return ~right_closures(run.loops, truth[run.chain.frame])


def knowable(loops: Loops, truth: Array, points: Sequence[Array]) -> BoolArray:
    """Which loop closures (L,) join key poses whose scans (P, 2) overlap at the true poses (K, 3)."""
    pairs = zip(loops.key1.tolist(), loops.key2.tolist(), strict=True)
    return np.array([fits(points[a], points[b], between(truth[a], truth[b])) for a, b in pairs], np.bool_)


def scan_points_of(scans: Scans, frames: IntArray) -> list[Array]:
    """Points (P, 2) of each frame's scan in the body frame; empty without a scan."""
    beams = beams_of(scans.scanner, scans.ranges.shape[1])
    every = (scans.of(frame) for frame in frames.tolist())
    return [np.empty((0, 2)) if r is None else (beams.origin + r[:, None] * beams.direction)[r > 0.0] for r in every]


def fits(first: Array, second: Array, relative: Array) -> bool:
    """Whether two scans (P, 2), (Q, 2) overlap at the relative pose (3,) of the second in the first's frame."""
    if not len(first) or not len(second):
        return False
    moved = transform_points(relative, second)
    ways = (first, moved), (moved, first)
    apart = (scipy.spatial.cKDTree(a).query(b, distance_upper_bound=FIT)[0] for a, b in ways)
    return all(float(np.mean(each <= FIT)) >= OVERLAP for each in apart)


def closure_counts(run: Run, log: Log, phase: str) -> dict[str, object] | None:
    """Columns of association.csv for loop closures; None where true key poses are unknown, and of other runs."""
    truth = log.truth.pose
    if truth is None or not isinstance(run, LaserRun) or run.loops is None or run.chain is None:
        return None
    keys, loops, scans = truth[run.chain.frame], run.loops, log.recorded.scans
    if not np.isfinite(keys[np.concatenate([loops.key1, loops.key2])]).all():
        return None
    right, believed = right_closures(loops, keys), run.kept(phase)
    if scans is not None:
        right &= (loops.believed >= 0) | knowable(loops, keys, scan_points_of(scans, run.chain.frame))
    outcomes = right & believed, ~right & believed, ~right & ~believed, right & ~believed
    tp, fp, tn, fn = (int(np.count_nonzero(which)) for which in outcomes)
    precision, recall = (tp / (tp + wrong) if tp + wrong else math.nan for wrong in (fp, fn))
    shares: dict[str, object] = {"precision": precision, "recall": recall}
    counted: dict[str, object] = {"tp": tp, "tn": tn, "fp": fp, "fn": fn, "wrong": fp, "missed": fn}
    return shares | counted | dict.fromkeys(("spurious", "duplicate", "deferred"), 0)

"""Relative pose errors over stated distances: how fast an estimate drifts, whatever its start and gauge.

Sturm et al., A Benchmark for the Evaluation of RGB-D SLAM Systems (IROS 2012), equation 2: the motion between two
poses, true and estimated, and the difference of the two. The pairs are those of evo's `evo_rpe --all_pairs
--pairs_from_reference`: every pose with the one whose way from it, along the true path, comes nearest to the distance,
if within a tenth of it (`--delta_tol 0.1`, evo's default).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from data import se2
from data.inputs import IntArray
from data.se2 import Array

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

"""Were the loop closures right? Counted as any association is, where the true poses are known.

                believed                              not believed
    right       TP                                    FN
    wrong       FP                                    TN

over all loop closures that were looked at; precision is TP / (TP + FP). Of those not believed only such count as right
whose two scans show the same (as defined for revisits below): with less in common there was nothing to know. A loop
closure is right if what it says of the
two poses is near the truth, or no farther from it than its own covariance lets expect: an honest match along a corridor
may be a metre off. Recall over what was looked at, TP / (TP + FN), says nothing of the loops that nobody looked for, so
the second one is over places: of the key poses from which an earlier, long past one could have been recognized, the
share that a right and believed loop closure leads to.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from association.expectation import gate_threshold
from association.scans.constraints import Loops
from association.scans.points import beams_of
from data.inputs import IntArray, Scans
from data.se2 import Array, BoolArray, between, transform_points, wrap_angle
from eval.referee.consistency import squared_distance

NEAR_M, NEAR_RAD = 0.15, 0.02
"""m and rad up to which a loop closure is right whatever it claims: beyond them Cartographer takes one of its own for
an outlier where it makes reference relations (defaults of its `autogenerate_ground_truth`)."""
HONEST = 0.9999
"""Chi-square probability (3 dof) within which one is right by its own covariance: 4.6 sigma. Of a thousand honest ones
a tenth of one is called wrong."""
REACH = 2.0
"""m between the true positions of a revisit, as of the candidates of a loop closure."""
DRIVEN = 10.0
"""m driven between the two: a robot that turns in a room has not closed a loop."""
FIT = 0.1
"""m within which a point of one scan has one of the other: three neighbouring beams of 1 degree at 2 m."""
OVERLAP = 0.6
"""Share of a scan's points that must fit at the true poses for the two views to overlap; a match is asked for 0.5."""


@dataclass(frozen=True)
class ClosureCounts:
    """Loop closures looked at, and revisits: key poses from which one was possible, and how many of them got one."""

    tp: int
    fp: int
    tn: int
    fn: int
    possible: int = 0
    closed: int = 0

    @property
    def precision(self) -> float:
        """Share of the believed ones that are right; NaN where none is believed."""
        return self.tp / (self.tp + self.fp) if self.tp + self.fp else math.nan

    @property
    def recall_of_found(self) -> float:
        """Share of the right ones, of those looked at, that are believed; NaN where none is right."""
        return self.tp / (self.tp + self.fn) if self.tp + self.fn else math.nan

    @property
    def recall(self) -> float:
        """Share of the possible revisits that were closed; NaN where none was possible."""
        return self.closed / self.possible if self.possible else math.nan

    def __add__(self, other: ClosureCounts) -> ClosureCounts:
        """Pooled over two runs."""
        return ClosureCounts(
            self.tp + other.tp, self.fp + other.fp, self.tn + other.tn, self.fn + other.fn,
            self.possible + other.possible, self.closed + other.closed,
        )  # fmt: skip


def right_closures(loops: Loops, truth: Array) -> BoolArray:
    """Which loop closures (L,) are right; `truth` (K, 3) are the true key poses."""
    error = closure_errors(loops, truth)
    near = (np.hypot(error[:, 0], error[:, 1]) <= NEAR_M) & (np.abs(error[:, 2]) <= NEAR_RAD)
    honest: BoolArray = squared_distance(error, loops.covariance) <= gate_threshold(HONEST, 3)
    return near | honest


def closure_errors(loops: Loops, truth: Array) -> Array:
    """Measured less true relative pose (L, 3) [m, m, rad], frame of key1."""
    error: Array = loops.relative - between(truth[loops.key1], truth[loops.key2])
    error[:, 2] = wrap_angle(error[:, 2])
    return error


def knowable(loops: Loops, truth: Array, points: Sequence[Array]) -> BoolArray:
    """Which loop closures (L,) are between key poses whose scans (P, 2) show the same at the true poses (K, 3)."""
    trees: dict[int, cKDTree] = {}
    found = np.zeros(len(loops), np.bool_)
    for i, (a, b) in enumerate(zip(loops.key1.tolist(), loops.key2.tolist(), strict=True)):
        if a not in trees:
            trees[a] = cKDTree(points[a])
        found[i] = fits(points[a], points[b], between(truth[a], truth[b]), trees[a])
    return found


def scan_points_of(scans: Scans, frames: IntArray) -> list[Array]:
    """Points (P, 2) of each frame's scan, body frame; none where there is no scan."""
    beams = beams_of(scans.scanner, scans.ranges.shape[1])
    points = []
    for frame in frames.tolist():
        ranges = scans.of(frame)
        if ranges is None:
            points.append(np.empty((0, 2)))
            continue
        points.append((beams.origin + ranges[:, None] * beams.direction)[ranges > 0.0])
    return points


def count_closures(
    loops: Loops, truth: Array, possible: BoolArray | None = None, points: Sequence[Array] | None = None
) -> ClosureCounts:
    """Counts against true key poses (K, 3), with `possible` (K,) from `revisits`; None: those are not counted.

    With the scans' `points` those not believed are right only if they are `knowable`.
    """
    right, believed = right_closures(loops, truth), loops.believed >= 0
    if points is not None:
        right &= believed | knowable(loops, truth, points)
    counts = (
        int((right & believed).sum()), int((~right & believed).sum()),
        int((~right & ~believed).sum()), int((right & ~believed).sum()),
    )  # fmt: skip
    if possible is None:
        return ClosureCounts(*counts)
    led_to = np.zeros(len(truth), np.bool_)
    led_to[loops.key2[right & believed]] = True
    return ClosureCounts(*counts, int(possible.sum()), int((possible & led_to).sum()))


def revisits(truth: Array, points: list[Array]) -> BoolArray:
    """Key poses (K,) from which an earlier one can be recognized: near, long past by the way driven, and seen alike.

    `truth` (K, 3) true key poses, `points` of each the scan's (P, 2), body frame. The pair must be within `REACH`, more
    than `DRIVEN` apart along the way, and at the true poses the share of each scan's points that lie within `FIT` of
    the other's must reach `OVERLAP`.
    """
    way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(truth[:, 0:2], axis=0).T))])
    tree = cKDTree(truth[:, :2])
    trees: dict[int, cKDTree] = {}
    possible = np.zeros(len(truth), np.bool_)
    for k in range(len(truth)):
        around = np.array(tree.query_ball_point(truth[k, :2], REACH), np.int64)
        past = around[way[k] - way[around] > DRIVEN]
        # the nearest first: it is the likeliest to show the same
        for i in _nearest_first(truth, past, k):
            if fits(points[i], points[k], between(truth[i], truth[k]), trees.setdefault(int(i), cKDTree(points[i]))):
                possible[k] = True
                break
    return possible


def fits(first: Array, second: Array, relative: Array, tree: cKDTree | None = None) -> bool:
    """Whether two scans (P, 2), (Q, 2) show the same at a relative pose (3,) of the second in the first's frame."""
    if not len(first) or not len(second):
        return False
    moved = transform_points(relative, second)
    tree = cKDTree(first) if tree is None else tree
    there = float(np.mean(tree.query(moved, distance_upper_bound=FIT)[0] <= FIT))
    if there < OVERLAP:
        return False
    return float(np.mean(cKDTree(moved).query(first, distance_upper_bound=FIT)[0] <= FIT)) >= OVERLAP


def _nearest_first(truth: Array, past: IntArray, key: int) -> IntArray:
    distance = np.hypot(*(truth[past, :2] - truth[key, :2]).T)
    return past[np.argsort(distance, kind="stable")]

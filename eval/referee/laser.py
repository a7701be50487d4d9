"""Scores of laser runs: errors against reference relations, outcomes of loop closures, NEES of relative poses.

A reference relation is the pose at one instant in the frame of the pose at another (Kuemmerle et al., "On measuring the
accuracy of SLAM algorithms", Autonomous Robots 27, 2009). With poses a, b and the relation rel, the error is
(a^-1 b) rel^-1 in Cartographer's evaluation, which published figures use, and rel^-1 (a^-1 b) in the paper (eq. 3).
The rotation error is the same in both.

Loop closures have outcomes where the true poses are known: TP right and believed, FP wrong and believed, FN right and
not believed, TN otherwise. A loop closure is right if its relative pose is near the truth, or inside its own
covariance's gate. One that was not believed is right only if its scans overlap (as for revisits). Recall over tested
loop closures misses loops that were not tested. A second recall is therefore over key poses: of those from which an
earlier one could have been recognized, the share that a right and believed loop closure leads to.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, astuple, dataclass, replace
from functools import cache
from itertools import product

import numpy as np
import scipy

from association.expectation import gate_threshold
from association.scans.constraints import Chain, LaserRun, Loops
from association.scans.points import beams_of
from data.inputs import IntArray, Scans
from data.log import Log
from data.result import Run
from data.se2 import Array, BoolArray, between, compose, inverse, transform_points, wrap_angle
from data.truth import Relations
from eval.referee.consistency import CONSERVATIVE, CONSISTENT, LEVEL, OVERCONFIDENT, chi2_bounds, squared_distance

CARTOGRAPHER, KUEMMERLE = "cartographer", "kuemmerle"
ORDERS = (CARTOGRAPHER, KUEMMERLE)
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
    path: Array,
    relations: Relations,
    time: Array,
    *,
    tie: str = ROW,
    subset: str = ALL,
    order: str = CARTOGRAPHER,
) -> RelationErrors | None:
    """Errors of a path (N, 3) of all frames; None where the relations have no stamps, or no exact subset.

    `time` (N,) [s] stamps the frames if the relations do not. The exact subset has relations with known rows. Raises
    ValueError for names that are not in `TIES`, `SUBSETS` or `ORDERS`.
    """
    for value, known in ((tie, TIES), (subset, SUBSETS), (order, ORDERS)):
        if value not in known:
            raise ValueError(f"{value!r}; known: {', '.join(known)}")
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
    error = errors(first[which], second[which], relations.relative[which], order)
    error = error[np.isfinite(error).all(axis=1)]
    return _summary(np.hypot(error[:, 0], error[:, 1]), np.degrees(np.abs(error[:, 2])))


def errors(first: Array, second: Array, relative: Array, order: str = CARTOGRAPHER) -> Array:
    """Errors (K, 3) [m, m, rad] of poses (K, 3) at both ends against relations (K, 3)."""
    found, back = between(first, second), inverse(relative)
    return compose(found, back) if order == CARTOGRAPHER else compose(back, found)


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


def _summary(trans: Array, rot: Array) -> RelationErrors:
    if not len(trans):
        return RelationErrors(0, *[math.nan] * 6)
    return RelationErrors(len(trans), *(float(f(each)) for each in (trans, rot) for f in (np.mean, np.std, np.max)))


NEAR_M, NEAR_RAD = 0.15, 0.02
"""m and rad within which a loop closure is right (outlier limits of Cartographer's `autogenerate_ground_truth`)."""
HONEST = 0.9999  # chi-square probability (3 dof) within which a loop closure is right by its own covariance: 4.6 sigma
REACH = 2.0  # m, largest distance between the true positions of a revisit, as for candidates of loop closures
DRIVEN = 10.0  # m, least distance driven between them: turning in a room closes no loop
FIT = 0.1  # m, largest distance of matching scan points: three beams of 1 degree at 2 m
OVERLAP = 0.6  # share of each scan's points that must match at the true poses; scan matching needs 0.5


@dataclass(frozen=True)
class ClosureCounts:
    """Outcomes of tested loop closures; revisits that were possible and those that were closed."""

    tp: int
    fp: int
    tn: int
    fn: int
    possible: int = 0
    closed: int = 0

    @property
    def precision(self) -> float:
        """Share of the believed ones that are right; NaN if none is believed."""
        return self.tp / (self.tp + self.fp) if self.tp + self.fp else math.nan

    @property
    def recall_of_found(self) -> float:
        """Share of the right ones that are believed; NaN if none is right."""
        return self.tp / (self.tp + self.fn) if self.tp + self.fn else math.nan

    @property
    def recall(self) -> float:
        """Share of the possible revisits that were closed; NaN if none was possible."""
        return self.closed / self.possible if self.possible else math.nan

    def __add__(self, other: ClosureCounts) -> ClosureCounts:
        """Pooled over two runs."""
        return ClosureCounts(*(a + b for a, b in zip(astuple(self), astuple(other), strict=True)))


def right_closures(loops: Loops, truth: Array) -> BoolArray:
    """Which loop closures (L,) are right, given true key poses (K, 3)."""
    return right_relatives(loops.relative, loops.covariance, truth[loops.key1], truth[loops.key2])


def right_relatives(relative: Array, covariance: Array, first: Array, second: Array) -> BoolArray:
    """Which measured relative poses (L, 3) with covariances (L, 3, 3) are right, given true poses (L, 3) of their ends:
    near the truth, or inside their own covariance's gate. False where a pose is NaN.
    """
    error = _off(relative, first, second)
    near = (np.hypot(error[:, 0], error[:, 1]) <= NEAR_M) & (np.abs(error[:, 2]) <= NEAR_RAD)
    honest: BoolArray = squared_distance(error, covariance) <= gate_threshold(HONEST, 3)
    return near | honest


def _off(relative: Array, first: Array, second: Array) -> Array:
    """Measured minus true relative pose."""
    error: Array = relative - between(first, second)
    error[:, 2] = wrap_angle(error[:, 2])
    return error


def closure_errors(loops: Loops, truth: Array) -> Array:
    """Measured minus true relative pose (L, 3) [m, m, rad], frame of key1."""
    return _off(loops.relative, truth[loops.key1], truth[loops.key2])


def knowable(loops: Loops, truth: Array, points: Sequence[Array]) -> BoolArray:
    """Which loop closures (L,) join key poses whose scans (P, 2) overlap at the true poses (K, 3)."""
    tree = cache(lambda key: scipy.spatial.cKDTree(points[key]))
    pairs = zip(loops.key1.tolist(), loops.key2.tolist(), strict=True)
    return np.array([fits(points[a], points[b], between(truth[a], truth[b]), tree(a)) for a, b in pairs], np.bool_)


def scan_points_of(scans: Scans, frames: IntArray) -> list[Array]:
    """Points (P, 2) of each frame's scan in the body frame; empty without a scan."""
    beams = beams_of(scans.scanner, scans.ranges.shape[1])
    every = (scans.of(frame) for frame in frames.tolist())
    return [np.empty((0, 2)) if r is None else (beams.origin + r[:, None] * beams.direction)[r > 0.0] for r in every]


def count_closures(
    loops: Loops,
    truth: Array,
    possible: BoolArray | None = None,
    points: Sequence[Array] | None = None,
    believed: BoolArray | None = None,
) -> ClosureCounts:
    """Outcomes of loop closures against true key poses (K, 3).

    `possible` (K,): revisits, which are counted then; `points`: scans, with which loop closures outside the graph must
    be `knowable`; `believed` (L,): default those that joined the graph.
    """
    right, joined = right_closures(loops, truth), loops.believed >= 0
    if points is not None:
        right &= joined | knowable(loops, truth, points)
    believed = joined if believed is None else believed
    tp, fp, tn, fn = right & believed, ~right & believed, ~right & ~believed, right & ~believed
    counts = ClosureCounts(*(int(np.count_nonzero(which)) for which in (tp, fp, tn, fn)))
    if possible is None:
        return counts
    led_to = np.zeros(len(truth), np.bool_)
    led_to[loops.key2[tp]] = True
    closed = int(np.count_nonzero(possible & led_to))
    return replace(counts, possible=int(np.count_nonzero(possible)), closed=closed)


def revisits(truth: Array, points: list[Array]) -> BoolArray:
    """Key poses (K,) from which an earlier one can be recognized, given true key poses (K, 3) and their scans (P, 2).

    The two must be within `REACH`, more than `DRIVEN` apart along the path, and their scans must overlap.
    """
    driven = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(truth[:, 0:2], axis=0).T))])
    places = scipy.spatial.cKDTree(truth[:, :2])
    tree = cache(lambda key: scipy.spatial.cKDTree(points[key]))
    possible = np.zeros(len(truth), np.bool_)
    for k in range(len(truth)):
        around = np.array(places.query_ball_point(truth[k, :2], REACH), np.int64)
        past = around[driven[k] - driven[around] > DRIVEN]
        # the nearest first, which is the likeliest to overlap
        nearest = past[np.argsort(np.hypot(*(truth[past, :2] - truth[k, :2]).T), kind="stable")]
        possible[k] = any(fits(points[i], points[k], between(truth[i], truth[k]), tree(i)) for i in nearest.tolist())
    return possible


def fits(first: Array, second: Array, relative: Array, tree: scipy.spatial.cKDTree | None = None) -> bool:
    """Whether two scans (P, 2), (Q, 2) overlap at the relative pose (3,) of the second in the first's frame."""
    if not len(first) or not len(second):
        return False
    moved = transform_points(relative, second)
    tree = scipy.spatial.cKDTree(first) if tree is None else tree
    there = float(np.mean(tree.query(moved, distance_upper_bound=FIT)[0] <= FIT))
    if there < OVERLAP:
        return False
    return float(np.mean(scipy.spatial.cKDTree(moved).query(first, distance_upper_bound=FIT)[0] <= FIT)) >= OVERLAP


DOF = 3  # of a relative pose


@dataclass(frozen=True)
class FactorNees:
    """NEES per degree of freedom of relative poses with bounds (expected 1; the factor that covariances need)."""

    factors: int
    mean: float
    median: float  # of NEES / 3; expected 0.79
    lower: float
    upper: float

    @property
    def word(self) -> str:
        """`consistent`, `overconfident` or `conservative`; empty without relative poses."""
        if not self.factors:
            return ""
        if self.mean > self.upper:
            return OVERCONFIDENT
        return CONSERVATIVE if self.mean < self.lower else CONSISTENT


def factor_nees(squared: Sequence[Array], level: float = LEVEL) -> FactorNees:
    """NEES of relative poses, pooled over runs: `squared` distances (n,) of each, 3 dof.

    The bounds assume independence, as the back ends do. Relative poses with a common scan are correlated, so a mean
    little outside the bounds proves nothing.
    """
    every = np.concatenate([np.empty(0), *squared])
    every = every[np.isfinite(every)] / DOF
    if not len(every):
        return FactorNees(0, math.nan, math.nan, math.nan, math.nan)
    return FactorNees(len(every), float(every.mean()), float(np.median(every)), *chi2_bounds(DOF * len(every), level))


def chain_squares(chain: Chain, truth: Array) -> Array:
    """Squared distances (K - 1,) of the chain's motions from those of the true key poses (K, 3)."""
    error = chain.motion[1:] - between(truth[:-1], truth[1:])
    error[:, 2] = wrap_angle(error[:, 2])
    return squared_distance(error, chain.covariance[1:])


def loop_squares(loops: Loops, truth: Array, *, wrong: bool = True) -> Array:
    """Squared distances of the believed loop closures from the true ones; `wrong`: with wrong ones."""
    which = loops.believed >= 0
    if not wrong:
        which = which & right_closures(loops, truth)
    return squared_distance(closure_errors(loops, truth)[which], loops.covariance[which])


KEPT = 0.05  # weight below which a loop closure is rejected: Cauchy's at 4.4 sigma; GNC's weights are 0 or 1


def paths_of(run: Run) -> dict[str, Array]:
    """Path (N, 3) by phase; a final one with the frames between scans at their places."""
    found = {phase: run.trajectory(phase).pose for phase in run.phases}
    if isinstance(run, LaserRun) and run.last is not None and run.final is not None:
        found["final"] = run.last
    return found


def relation_rows(run: Run, log: Log) -> list[dict[str, object]]:
    """Rows of relations.csv: for each phase, tie and subset."""
    relations = log.truth.relations
    if relations is None or run.failure is not None:
        return []
    rows = list[dict[str, object]]()
    name = {"log": log.name, "estimator": run.estimator, "association": run.association}
    for (phase, path), tie, subset in product(paths_of(run).items(), TIES, SUBSETS):
        found = relation_errors(path, relations, log.recorded.time, tie=tie, subset=subset)
        if found is not None:
            rows.append({**name, "phase": phase, "tie": tie, "subset": subset, **asdict(found)})
    return rows


def kept(loops: Loops, weight: Array | None, phase: str) -> BoolArray:
    """Which loop closures (L,) are believed: online those that joined the graph, finally those that kept weight."""
    believed: BoolArray = loops.believed >= 0
    if phase == "final" and weight is not None:
        believed = believed & ~(weight < KEPT)
    return believed


def closure_counts(run: LaserRun, log: Log, phase: str) -> dict[str, object] | None:
    """Columns of association.csv for loop closures; None where true key poses are unknown."""
    truth = log.truth.pose
    if truth is None or run.loops is None or run.chain is None:
        return None
    keys, loops, scans = truth[run.chain.frame], run.loops, log.recorded.scans
    if not np.isfinite(keys[np.concatenate([loops.key1, loops.key2])]).all():
        return None
    points = None if scans is None else scan_points_of(scans, run.chain.frame)
    c = count_closures(loops, keys, points=points, believed=kept(loops, run.weight, phase))
    shares: dict[str, object] = {"precision": c.precision, "recall": c.recall_of_found}
    counted: dict[str, object] = {"tp": c.tp, "tn": c.tn, "fp": c.fp, "fn": c.fn, "wrong": c.fp, "missed": c.fn}
    return shares | counted | dict.fromkeys(("spurious", "duplicate", "deferred"), 0)

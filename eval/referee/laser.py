"""Laser runs judged: errors against reference relations, loop closures right or wrong, NEES of relative poses.

A reference relation is the pose at one instant in the frame of the pose at another (Kuemmerle, Steder, Dornhege,
Ruhnke, Grisetti, Stachniss and Kleiner, "On measuring the accuracy of SLAM algorithms", Autonomous Robots 27, 2009).
With poses a, b and the relation rel, the error is  (a^-1 b) rel^-1  in Cartographer's evaluation, whose figures are the
published ones, and  rel^-1 (a^-1 b)  in the paper (eq. 3). The rotation's error is the same in both; the translation's
differs by what the error of rotation does over the length of the relation.

Loop closures are counted as any association is, where the true poses are known.

                believed                              not believed
    right       TP                                    FN
    wrong       FP                                    TN

over all loop closures that were looked at; precision is TP / (TP + FP). Of those not believed only such count as right
whose two scans show the same (as defined for revisits below): with less in common there was nothing to know. A loop
closure is right if what it says of the two poses is near the truth, or no farther from it than its own covariance lets
expect: an honest match along a corridor may be a metre off. Recall over what was looked at, TP / (TP + FN), says
nothing of the loops that nobody looked for, so the second one is over places: of the key poses from which an earlier,
long past one could have been recognized, the share that a right and believed loop closure leads to.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, astuple, dataclass, replace
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
    """Errors over a set of relations; std is of the population (divided by their number), as published figures are.

    `relations` counts those with a path at both ends; the figures are NaN where there is none.
    """

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
    """Scores of a path (N, 3) of all frames; `time` (N,) s of the log, where relations bring no recorded stamps.

    `subset` exact: those whose two rows are sure. None where the relations cannot be asked so: no stamps, or it was
    not said which are exact. Raises ValueError for a name that is not in `TIES`, `SUBSETS`, `ORDERS`.
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
    """Errors (K, 3) [m, m, rad] of poses (K, 3) at the two ends against relations (K, 3)."""
    found, back = between(first, second), inverse(relative)
    return compose(found, back) if order == CARTOGRAPHER else compose(back, found)


def at_stamps(path: Array, frame_stamp: Array, stamp: Array) -> Array:
    """Poses (K, 3) at stamps (K,) of a path (N, 3) whose frames were stamped `frame_stamp` (N,), not in order.

    It is the pose of the frame whose stamp is nearest (the first of several), unless the stamp lies strictly between
    that frame's and that of the next frame of the log, or else of the one before: then between these two in proportion,
    headings along the shorter way. Next and before are in line order, which is the true one.
    """
    frame = nearest_frames(frame_stamp, stamp)
    result = path[frame].copy()
    open_ = np.ones(len(stamp), np.bool_)
    for way in (1, -1):
        other = np.clip(frame + way, 0, len(path) - 1)
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
    # of equal stamps the first frame: a search from the left finds it, also from below
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
        return ClosureCounts(*(a + b for a, b in zip(astuple(self), astuple(other), strict=True)))


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
    trees: dict[int, scipy.spatial.cKDTree] = {}
    found = np.zeros(len(loops), np.bool_)
    for i, (a, b) in enumerate(zip(loops.key1.tolist(), loops.key2.tolist(), strict=True)):
        if a not in trees:
            trees[a] = scipy.spatial.cKDTree(points[a])
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
    loops: Loops,
    truth: Array,
    possible: BoolArray | None = None,
    points: Sequence[Array] | None = None,
    believed: BoolArray | None = None,
) -> ClosureCounts:
    """Counts against true key poses (K, 3), with `possible` (K,) from `revisits`; None: those are not counted.

    With the scans' `points` those that did not join the graph are right only if they are `knowable`. `believed` (L,):
    where that is not all that joined.
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
    """Key poses (K,) from which an earlier one can be recognized: near, long past by the way driven, and seen alike.

    `truth` (K, 3) true key poses, `points` of each the scan's (P, 2), body frame. The pair must be within `REACH`, more
    than `DRIVEN` apart along the way, and at the true poses the share of each scan's points that lie within `FIT` of
    the other's must reach `OVERLAP`.
    """
    way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(truth[:, 0:2], axis=0).T))])
    tree = scipy.spatial.cKDTree(truth[:, :2])
    trees: dict[int, scipy.spatial.cKDTree] = {}
    possible = np.zeros(len(truth), np.bool_)
    for k in range(len(truth)):
        around = np.array(tree.query_ball_point(truth[k, :2], REACH), np.int64)
        past = around[way[k] - way[around] > DRIVEN]
        # the nearest first: it is the likeliest to show the same
        distance = np.hypot(*(truth[past, :2] - truth[k, :2]).T)
        for i in past[np.argsort(distance, kind="stable")]:
            if fits(
                points[i],
                points[k],
                between(truth[i], truth[k]),
                trees.setdefault(int(i), scipy.spatial.cKDTree(points[i])),
            ):
                possible[k] = True
                break
    return possible


def fits(first: Array, second: Array, relative: Array, tree: scipy.spatial.cKDTree | None = None) -> bool:
    """Whether two scans (P, 2), (Q, 2) show the same at a relative pose (3,) of the second in the first's frame."""
    if not len(first) or not len(second):
        return False
    moved = transform_points(relative, second)
    tree = scipy.spatial.cKDTree(first) if tree is None else tree
    there = float(np.mean(tree.query(moved, distance_upper_bound=FIT)[0] <= FIT))
    if there < OVERLAP:
        return False
    return float(np.mean(scipy.spatial.cKDTree(moved).query(first, distance_upper_bound=FIT)[0] <= FIT)) >= OVERLAP


DOF = 3


@dataclass(frozen=True)
class FactorNees:
    """NEES per degree of freedom (1 expected) of n relative poses, with the bounds that chance leaves it.

    scale: by which their covariances would have to be multiplied; the same number, under another name. median: of
    NEES / 3, 0.79 expected, which outliers do not move.
    """

    factors: int
    mean: float
    median: float
    lower: float
    upper: float

    @property
    def scale(self) -> float:
        """Factor on the covariances with which the mean would be 1."""
        return self.mean

    @property
    def word(self) -> str:
        """`consistent`, `overconfident` or `conservative`; empty where there is nothing to say it of."""
        if not self.factors:
            return ""
        if self.mean > self.upper:
            return OVERCONFIDENT
        return CONSERVATIVE if self.mean < self.lower else CONSISTENT


def factor_nees(squared: Sequence[Array], level: float = LEVEL) -> FactorNees:
    """NEES of relative poses, pooled over runs: `squared` distances (n,) of each, 3 dof.

    The bounds take them as independent, as the back ends do. Relative poses with a pose in common were matched to the
    same scan, so a mean outside the bounds by little proves nothing.
    """
    every = np.concatenate([np.empty(0), *squared])
    every = every[np.isfinite(every)] / DOF
    if not len(every):
        return FactorNees(0, math.nan, math.nan, math.nan, math.nan)
    return FactorNees(len(every), float(every.mean()), float(np.median(every)), *chi2_bounds(DOF * len(every), level))


def chain_squares(chain: Chain, truth: Array) -> Array:
    """Squared distances (K - 1,) of the chain's motions from the true ones; `truth` (K, 3) true key poses."""
    error = chain.motion[1:] - between(truth[:-1], truth[1:])
    error[:, 2] = wrap_angle(error[:, 2])
    return squared_distance(error, chain.covariance[1:])


def loop_squares(loops: Loops, truth: Array, *, wrong: bool = True) -> Array:
    """Squared distances of the believed loop closures from the true relative poses; `wrong`: of wrong ones, too."""
    which = loops.believed >= 0
    if not wrong:
        which = which & right_closures(loops, truth)
    return squared_distance(closure_errors(loops, truth)[which], loops.covariance[which])


KEPT = 0.05
"""Weight below which a robust back end has left a loop closure out: Cauchy's at 4.4 sigma, beyond which one honest one
in 5000 lies (3 dof); GNC's are 0 or 1."""


def paths_of(run: Run) -> dict[str, Array]:
    """Phase to path (N, 3); of a filter over key poses `final` is the path of its last state."""
    found = {phase: run.trajectory(phase).pose for phase in run.phases}
    if isinstance(run, LaserRun) and run.last is not None:
        found["final"] = run.last
    return found


def relation_rows(run: Run, log: Log) -> list[dict[str, object]]:
    """Errors of a run against the log's reference relations, by row and by time, all and exact ones."""
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
    """Which loop closures (L,) count as believed: online what joined the graph, in the end what kept its weight."""
    believed: BoolArray = loops.believed >= 0
    if phase == "final" and weight is not None:
        believed = believed & ~(weight < KEPT)
    return believed


def closure_counts(run: LaserRun, log: Log, phase: str) -> dict[str, object] | None:
    """Loop closures as columns of association.csv; None where the true poses of their key poses are not known."""
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

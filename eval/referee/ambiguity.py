"""Which landmarks of a finished map are ambiguous: those not to be told from a neighbour, and those that may be two.

Two landmarks are told apart where one frame saw both, or where their difference is significant given the covariances
of both and of a reading. Only marginal covariances are at hand; of neighbours, whose errors are alike, they overstate
that of the difference, so that where a map is badly known rather too many are called ambiguous.

A landmark that its own readings call two is ambiguous with itself. Nothing is seen twice in a frame: where a landmark
is read, another reading next to it is clutter, or two stand there. And readings of two places scatter about two points,
not one. Both are weighed together: the likelihood of two points against that of one with clutter beside it, by the
noise that there is. What says that there are two is learned from one half of a landmark's frames and judged on the
other half, the more likely single point being granted: such a ratio exceeds 1 / a with a probability of at most a if
there is one point (Wasserman, Ramdas and Balakrishnan, "Universal inference", PNAS 117, 2020), as does the mean over
both halves. With a = 1 % over the number of landmarks, a map without any such landmark has one marked in a hundred maps
at most (Bonferroni), if its noise and clutter are as taken.

For that, readings are laid onto the map, each where the others of its frame put it: a path online is as it was known
then, and later loops moved the map. What is then left of a reading is its own error. How large such errors are is taken
from the readings, not from what was stated.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import scipy

from association.conditional import EXACT_VARIANCE, FREEDOM, SAME_PLACE
from association.expectation import gate_threshold
from data.inputs import Inputs, IntArray
from data.result import MapEstimate, Run
from data.se2 import Array, BoolArray

FITS = 2
"""Of a frame onto the map: the first by equal weights, the second without what does not fit the first."""
UNKNOWN_POSE = 1e-6
"""Information (1/m^2, 1/rad^2) about a pose of which a run states no covariance."""
MEDIAN_1, MEDIAN_2 = 0.4549, 1.3863
"""Medians of chi-square with one and two degrees of freedom."""
ENOUGH = 4
"""Readings of a landmark whose median tells of the noise."""
SMALLEST = 1e-4
"""Share of the stated variance that the noise has at least."""


class Registered(NamedTuple):
    """Every reading of a log on the map of a run.

    row: (M,) of the landmark it is taken for in the map, -1: of none; xy: (M, 2) m, where it was read, in the world, by
    the others of its frame; covariance: (M, 2, 2) of that, by the noise that there is; stated: the same as stated.
    """

    row: IntArray
    xy: Array
    covariance: Array
    stated: Array


def taken_for(run: Run) -> IntArray:
    """The landmark (M,) that each reading is taken for by the final decisions, the first one too; negative: none."""
    created = run.initialized
    number: IntArray = np.where(created >= 0, created, run.final_decisions)
    return number


def registered(run: Run, inputs: Inputs) -> Registered | None:
    """The readings of these inputs on the map of a run; None without a map, and where they are not the run's."""
    m, o = run.map, inputs.observations
    if m is None or not len(m) or run.walls or len(run.final_decisions) != len(o.frame) or not run.phases:
        return None
    number, path = taken_for(run), run.trajectory(run.phases[-1])
    rows = np.full(int(max(number.max(initial=0), m.number.max())) + 1, -1, np.int64)
    rows[m.number] = np.where(_finite(m.xy), np.arange(len(m)), -1)
    known = _finite(path.pose)
    row = np.where((number >= 0) & known[o.frame], rows[np.maximum(number, 0)], -1)
    pose = np.where(known[:, None], path.pose, 0.0)[o.frame]
    xy, Gx, Gz = inputs.sensor.inverse(pose, o.z)
    R = Gz @ o.R @ np.swapaxes(Gz, 1, 2) + EXACT_VARIANCE * np.eye(2)
    off = np.where(row[:, None] >= 0, xy - m.xy[np.maximum(row, 0)], 0.0)
    shift, S = _by_others(off, R, Gx, row >= 0, o.frame, _information(path.covariance))
    S = 0.5 * (S + np.swapaxes(S, 1, 2))
    xy = np.where(known[o.frame][:, None], xy + shift, np.nan)
    return Registered(row, xy, _as_it_is(off + shift, S, xy - pose[:, :2], row), S)


def _information(covariance: Array) -> Array:
    """About each pose (N, 3, 3)."""
    known = _finite(covariance.reshape(-1, 9))[:, None, None]
    P = np.where(known, covariance, np.eye(3)) + EXACT_VARIANCE * np.eye(3)
    return np.where(known, inverses(P), UNKNOWN_POSE * np.eye(3))


def _finite(rows: Array) -> BoolArray:
    """Which rows (n,) of a table (n, k) are."""
    return np.asarray(np.isfinite(rows).all(axis=1), np.bool_)


def _by_others(
    off: Array, R: Array, Gx: Array, paired: BoolArray, frame: IntArray, information: Array
) -> tuple[Array, Array]:
    """How the other pairings of its frame shift each reading (M, 2), and the covariance (M, 2, 2) of what is left.

    Least squares in the pose of a frame, without the reading itself; Student's weights for the pairings.
    """
    weight, W = paired.astype(np.float64), np.linalg.inv(R)
    shift, S = np.zeros_like(off), R
    for _ in range(FITS):
        GW = np.swapaxes(Gx, 1, 2) @ (W * weight[:, None, None])
        own, pull = GW @ Gx, np.einsum("mij,mj->mi", GW, off)
        A, b = information.copy(), np.zeros((len(information), 3))
        np.add.at(A, frame, own)
        np.add.at(b, frame, pull)
        P = np.linalg.inv(A[frame] - own)
        shift = -np.einsum("mij,mjk,mk->mi", Gx, P, b[frame] - pull)
        S = R + Gx @ P @ np.swapaxes(Gx, 1, 2)
        if paired.any():
            d2 = squares(off + shift, inverses(S))
            scale = max(float(np.median(d2[paired])) / MEDIAN_2, SMALLEST)
            weight = paired * (FREEDOM + 2.0) / (FREEDOM + d2 / scale)
    return shift, S


def _as_it_is(off: Array, S: Array, sight: Array, row: IntArray) -> Array:
    """Covariances (M, 2, 2) with the variance that there is along the line of sight (M, 2) and across it.

    The median over landmarks of the median over each one's readings: neither a reading nor a landmark that is none
    makes a difference.
    """
    along = sight / np.maximum(np.hypot(sight[:, 0], sight[:, 1]), SMALLEST)[:, None]
    axes = np.stack([along, np.stack([-along[:, 1], along[:, 0]], axis=1)], axis=1)
    turned = axes @ S @ np.swapaxes(axes, 1, 2)
    p = np.flatnonzero(row >= 0)
    count = np.bincount(row[p], minlength=1)
    often = np.flatnonzero(count >= ENOUGH)
    scale = np.ones(2)
    for c in range(2 if len(often) else 0):
        ratio = np.einsum("mj,mj->m", axes[p, c], off[p]) ** 2 / turned[p, c, c]
        order = np.lexsort((ratio, row[p]))
        middle = (np.cumsum(count) - count)[often] + (count[often] - 1) // 2
        scale[c] = max(float(np.median(ratio[order][middle])) / MEDIAN_1, SMALLEST)
    D = np.sqrt(scale)
    found: Array = np.swapaxes(axes, 1, 2) @ (turned * D[:, None] * D[None, :]) @ axes
    return found


def inverses(S: Array) -> Array:
    """Inverses (m, k, k) of covariances (m, k, k)."""
    return np.asarray(np.linalg.inv(S), np.float64)


def squares(off: Array, information: Array) -> Array:
    """Squared distances (m,) of offsets (m, 2) by their information (m, 2, 2), which is symmetric."""
    x, y = off.T
    square: Array = information[:, 0, 0] * x * x + 2.0 * information[:, 0, 1] * x * y + information[:, 1, 1] * y * y
    return square


FALSE = 0.01
"""Share of the maps without one in which some landmark may be called two."""
FEWEST = 3
"""Frames in each half."""
OUTLIERS, OUTLYING = 0.05, 9.0
"""Share of readings in the tails, and their variance in that of the others."""
SPREADS = (1.0, 1.25, 1.5)
"""Variance that a single point may have, in that of the others: not every landmark is read equally well."""
BESIDE = 25.0
"""Squared distance within which a reading is beside a landmark, as stated or as it is, whichever is more; ..."""
AROUND = 100.0
"""... from there to this one it tells how much clutter there is."""
SCATTERED = 2.5
"""Mean squared distance, where 2 is expected, from which one without a reading beside it is looked at, too."""
EDGE = 5.0
"""In mean squared distances: more does not count for that."""
ROUNDS = 10
"""Of expectation maximization, and of the robust mean."""
LEAST = 0.02
"""Share of the readings that are of either of two points at least, and of the frames that read both, or not."""


class Pairs(NamedTuple):
    """The readings of the landmarks in question, a row for each frame and landmark.

    group: (n,) 2 k + half; share: (n,) of a reading that each counts for; beside: (k,) the rows that have a reading
    beside; x: (n + k, 2) m, the readings taken for them, then those beside them, from where the map has them; W:
    (n + k, 2, 2) their information; log_det: (n + k,) of their covariances.
    """

    group: IntArray
    share: Array
    beside: IntArray
    x: Array
    W: Array
    log_det: Array

    @property
    def every(self) -> IntArray:
        """The row (n + k,) of each reading."""
        return np.concatenate([np.arange(len(self.group)), self.beside])

    def total(self, values: Array, groups: int) -> Array:
        """Sums (G,) of values (n,) over the pairs of each group."""
        return np.asarray(np.bincount(self.group, self.share * values, groups), np.float64)


class Two(NamedTuple):
    """Two points (G, 2, 2) for each group, the share (G,) of readings of the first, and that (G,) of frames of both."""

    points: Array
    first: Array
    both: Array


def doubles(run: Run, inputs: Inputs) -> BoolArray:
    """For each landmark (L,) of a run's map whether it may be two; none of walls, and of readings not the run's."""
    r, m = registered(run, inputs), run.map
    found = np.zeros(0 if m is None else len(m), np.bool_)
    if r is None or m is None or not (r.row >= 0).any():
        return found
    evidence = log_evidence(r, m.xy, inputs.observations.frame, _places(inputs))
    found[:] = evidence > math.log(len(m) / FALSE)
    return found


def _places(inputs: Inputs) -> IntArray:
    """Where each frame (N,) was, numbered on the way: from one place errors are alike, and what hides a landmark."""
    sensor, z = inputs.sensor, inputs.observations.z
    reach = min(sensor.max_range, float(sensor.polar(z)[:, 0].max(initial=0.0)))
    travelled = np.cumsum(np.hypot(inputs.increments.mean[:, 0], inputs.increments.mean[:, 1]))
    return np.asarray(travelled / max(SAME_PLACE * reach, EXACT_VARIANCE), np.int64)


def log_evidence(r: Registered, landmarks: Array, frame: IntArray, place: IntArray) -> Array:
    """Logarithm of the ratio of likelihoods, two points to one, for each landmark (L,); -inf where nothing says so.

    `landmarks` (L, 2) m; `frame` (M,) of the readings, `place` (N,) of the frames.
    """
    evidence = np.full(len(landmarks), -np.inf)
    p, beside, clutter = _beside(r, landmarks, frame)
    number = r.row[p]
    count = np.bincount(number, minlength=len(landmarks))
    square = squares(r.xy[p] - landmarks[number], inverses(r.covariance[p]))
    scatter = np.bincount(number, np.minimum(square, EDGE * 2.0), len(landmarks)) / np.maximum(count, 1)
    tested = (np.bincount(number[beside >= 0], minlength=len(landmarks)) > 0) | (scatter > SCATTERED)
    _, cell, alike = np.unique(
        number * (int(place.max()) + 1) + place[frame[p]], return_inverse=True, return_counts=True
    )
    opportunities = np.bincount(number, 1.0 / alike[cell], len(landmarks))
    asked = np.flatnonzero(tested & (opportunities >= 2 * FEWEST))
    if not len(asked):
        return evidence
    pairs = _pairs(r, landmarks, asked, p, beside, 1.0 / alike[cell])
    groups = 2 * len(asked)
    one = _one(pairs, groups)
    two = _two(pairs, groups, clutter)
    other = Two(*(values[np.arange(groups) ^ 1] for values in two))
    ratio = pairs.total(_explained(pairs, other, clutter)[0], groups) - one
    half = np.logaddexp(*ratio.reshape(-1, 2).T) - math.log(2.0)
    evidence[asked] = half
    return evidence


def _beside(r: Registered, landmarks: Array, frame: IntArray) -> tuple[IntArray, IntArray, float]:
    """Readings (n,) taken for landmarks, one for each frame and landmark; one beside each (n,), -1: none; clutter.

    Beside a landmark is what its frame read and nothing explains, and what is taken for it a second time. Clutter
    [1/m^2] is what a frame has around a landmark, farther from it than that.
    """
    p = np.flatnonzero(r.row >= 0)
    first = np.unique(frame[p] * len(landmarks) + r.row[p], return_index=True)[1]
    again = np.setdiff1d(np.arange(len(p)), first)
    q = np.concatenate([np.flatnonzero((r.row < 0) & np.isfinite(r.xy[:, 0])), p[again]])
    p = p[first]  # by frames: so are the readings
    nearest = np.full(len(p), -1, np.int64)
    begin, end = np.searchsorted(frame[p], frame[q], "left"), np.searchsorted(frame[p], frame[q], "right")
    count = end - begin
    which = np.repeat(np.arange(len(q)), count)
    of = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count - begin, count)
    wide = np.trace(r.stated, axis1=1, axis2=2) > np.trace(r.covariance, axis1=1, axis2=2)
    S = np.where(wide[:, None, None], r.stated, r.covariance)
    area = math.pi * np.sqrt(np.linalg.det(S[p])).sum()
    square = squares(r.xy[q[which]] - landmarks[r.row[p[of]]], inverses(S[q])[which])
    around = (square >= BESIDE) & (square < AROUND)
    clutter = (np.count_nonzero(around) + 1.0) / ((AROUND - BESIDE) * area)
    inside = square < BESIDE
    which, of, square = which[inside], of[inside], square[inside]
    order, to = np.argsort(-square, kind="stable"), np.full(len(q), -1, np.int64)
    to[which[order]] = of[order]  # the nearest last, which stays: a reading is beside one landmark of its frame only
    own = to[which] == of
    order = np.argsort(-square[own], kind="stable")
    nearest[of[own][order]] = q[which[own][order]]
    return p, nearest, clutter


def _pairs(r: Registered, landmarks: Array, asked: IntArray, p: IntArray, beside: IntArray, share: Array) -> Pairs:
    """Those of the landmarks asked about, each one's looks in two halves, one after the other."""
    k = np.full(len(landmarks), -1, np.int64)
    k[asked] = np.arange(len(asked))
    few = np.flatnonzero(k[r.row[p]] >= 0)
    few = few[np.argsort(r.row[p[few]], kind="stable")]
    number, share = r.row[p[few]], share[few]
    opportunities = np.bincount(k[number], share)
    so_far = np.cumsum(share) - share - (np.cumsum(opportunities) - opportunities)[k[number]]
    group = 2 * k[number] + (so_far >= 0.5 * opportunities[k[number]])
    there = np.flatnonzero(beside[few] >= 0)
    every = np.concatenate([p[few], beside[few[there]]])
    S, x = r.covariance[every], r.xy[every] - landmarks[np.concatenate([number, number[there]])]
    return Pairs(group, share, there, x, inverses(S), np.log(np.linalg.det(S)))


def _densities(off: Array, W: Array, log_det: Array, spread: float = 1.0) -> tuple[Array, Array]:
    """Logarithm of the density (n,) of offsets (n, 2), normal with heavier tails, and the weight of each in a mean."""
    half = 0.5 * squares(off, W) / spread
    core = math.log1p(-OUTLIERS) - half
    tail = math.log(OUTLIERS / OUTLYING) - half / OUTLYING
    total = np.logaddexp(core, tail)
    share = np.exp(core - total)
    return total - 0.5 * log_det - math.log(2.0 * math.pi * spread), share + (1.0 - share) / OUTLYING


def _means(group: IntArray, x: Array, W: Array, weight: Array, groups: int) -> Array:
    """Weighted means (G, 2) of points (n, 2) of information (n, 2, 2)."""
    part = W * weight[:, None, None]
    pull = np.einsum("mij,mj->mi", part, x)
    a, b, c = (np.bincount(group, part[:, i, j], groups) for i, j in ((0, 0), (0, 1), (1, 1)))
    u, v = (np.bincount(group, pull[:, i], groups) for i in range(2))
    det = a * c - b * b
    det = np.where(det > 0.0, det, 1.0)  # a group without readings has no pull either
    return np.stack([(c * u - b * v) / det, (a * v - b * u) / det], axis=1)


def _one(pairs: Pairs, groups: int) -> Array:
    """Logarithm of the likelihood (G,) of one point, the best one, of what is taken for it."""
    n = len(pairs.group)
    x, W, log_det = pairs.x[:n], pairs.W[:n], pairs.log_det[:n]
    best = np.full(groups, -np.inf)
    for spread in SPREADS:
        weight = np.ones(n)
        for _ in range(ROUNDS):
            mean = _means(pairs.group, x, W, pairs.share * weight, groups)
            density, weight = _densities(x - mean[pairs.group], W, log_det, spread)
        best = np.maximum(best, pairs.total(density, groups))
    return best


def _two(pairs: Pairs, groups: int, clutter: float) -> Two:
    """The two points of each group that explain its readings best: expectation maximization from two beginnings."""
    n, there = len(pairs.group), pairs.group[pairs.beside]
    count = pairs.total(np.ones(n), groups)
    found = np.bincount(there, pairs.share[pairs.beside], groups)
    middle = _means(pairs.group, pairs.x[:n], pairs.W[:n], pairs.share, groups)
    off = pairs.x[:n] - middle[pairs.group]
    moments = [pairs.total(off[:, i] * off[:, j], groups) for i, j in ((0, 0), (0, 1), (0, 1), (1, 1))]
    size, axes = np.linalg.eigh((np.stack(moments, axis=1) / count[:, None]).reshape(-1, 2, 2))
    step = axes[:, :, 1] * np.sqrt(np.maximum(size[:, 1], 0.0))[:, None]
    besides = _means(there, pairs.x[n:], pairs.W[n:], pairs.share[pairs.beside], groups)
    besides = np.where((found > 0)[:, None], besides, middle + step)
    both = (found + 0.5) / (count + 1.0)
    # apart along the longer axis of what is taken for it; or one there, the other where the readings beside it are
    begun = (
        Two(np.stack([middle + step, middle - step], axis=1), np.full(groups, 0.5), both),
        Two(np.stack([middle, besides], axis=1), np.full(groups, 1.0 - LEAST), both),
    )
    first, second = (_fitted(pairs, two, count, clutter) for two in begun)
    likely = [pairs.total(_explained(pairs, two, clutter)[0], groups) for two in (first, second)]
    better = likely[0] > likely[1]
    points = np.where(better[:, None, None], first.points, second.points)
    return Two(points, np.where(better, first.first, second.first), np.where(better, first.both, second.both))


def _fitted(pairs: Pairs, two: Two, count: Array, clutter: float) -> Two:
    """Expectation maximization; `count` (G,) readings of each group."""
    groups, every = len(count), pairs.every
    for _ in range(ROUNDS):
        _, first, both, weight = _explained(pairs, two, clutter)
        weight *= pairs.share[every][:, None]
        points = [_means(pairs.group[every], pairs.x, pairs.W, weight[:, i], groups) for i in range(2)]
        sums = (pairs.total(values, groups) for values in (first, both))
        two = Two(np.stack(points, axis=1), *((total + 0.5) / (count + 1.0) for total in sums))
    return two


def _explained(pairs: Pairs, two: Two, clutter: float) -> tuple[Array, Array, Array, Array]:
    """How two points explain the readings, clutter beside them included, and as likely as the clutter alone.

    Returns the logarithm of the likelihood (n,), the probabilities that what is taken for the landmark is of the first
    point (n,), and that both were read (n,), and the weight of each reading in either mean (n + k, 2).
    """
    n, group = len(pairs.group), pairs.group
    points = [_densities(pairs.x - two.points[group[pairs.every], i], pairs.W, pairs.log_det) for i in range(2)]
    first, both = (np.clip(share, LEAST, 1.0 - LEAST)[group] for share in (two.first, two.both))
    terms, shares = [], []
    for i in range(2):  # what is taken for the landmark is of point i; what is beside it of the other, or clutter
        beside = np.full(n, -np.inf)
        beside[pairs.beside] = np.log(both[pairs.beside] / clutter) + points[1 - i][0][n:]
        total = np.logaddexp(np.log1p(-both), beside)
        terms.append(np.log(first if i == 0 else 1.0 - first) + points[i][0][:n] + total)
        shares.append(np.exp(beside - total))
    likelihood = np.logaddexp(*terms)
    of = [np.exp(term - likelihood) for term in terms]
    real = [p * share for p, share in zip(of, shares, strict=True)]
    weight = [np.concatenate([of[i], real[1 - i][pairs.beside]]) * points[i][1] for i in range(2)]
    return likelihood, of[0], real[0] + real[1], np.stack(weight, axis=1)


GATE = 0.99
"""Chi-square probability inside which a difference is not significant."""
MOST = 32
"""Neighbours of a landmark that are looked at, the nearest ones: of a map that is lost all would be."""
NONE = -1
"""For a landmark that can be told from all others."""


def ambiguous(run: Run, inputs: Inputs) -> IntArray:
    """For each landmark (L,) of a run's map the number of the nearest that it cannot be told from, its own if it may be
    two (and can be told from all others), or `NONE`.

    All `NONE` for walls, and where the decisions are not about the observations of these inputs.
    """
    m, o = run.map, inputs.observations
    if m is None or not len(m) or run.walls or len(run.final_decisions) != len(o.frame) or not len(o.frame):
        return np.full(0 if m is None else len(m), NONE, np.int64)
    number = taken_for(run)
    seen = np.flatnonzero(number >= 0)
    _, covariance = inputs.sensor.body_points(o.z[seen], o.R[seen])
    variance = 0.5 * np.trace(covariance, axis1=1, axis2=2)
    found = neighbours(m, variance_of(m, number[seen], variance), number[seen], o.frame[seen])
    return np.where((found == NONE) & doubles(run, inputs), m.number, found)


def variance_of(m: MapEstimate, number: IntArray, variance: Array) -> Array:
    """Mean variance [m^2] of the readings of each landmark (L,), of readings (M,) of these numbers; 0 without any."""
    size = int(max(m.number.max(initial=-1), number.max(initial=-1))) + 1
    count = np.bincount(number, minlength=size)
    total = np.bincount(number, weights=variance, minlength=size)
    mean: Array = (total / np.maximum(count, 1))[m.number]
    return mean


def neighbours(m: MapEstimate, variance: Array, number: IntArray, frame: IntArray) -> IntArray:
    """The same from the variance of a reading of each landmark (L,) [m^2], number and frame of all readings (M,)."""
    found = np.full(len(m), NONE, np.int64)
    pairs = _near(m, variance)
    if not len(pairs):
        return found
    order = np.lexsort((frame, number))
    number, frame = number[order], frame[order]
    begin, end = np.searchsorted(number, m.number, "left"), np.searchsorted(number, m.number, "right")
    distance = np.linalg.norm(m.xy[pairs[:, 0]] - m.xy[pairs[:, 1]], axis=1)
    for i, j in pairs[np.argsort(-distance, kind="stable")].tolist():  # the nearest last, which stays
        if not np.isin(frame[begin[i] : end[i]], frame[begin[j] : end[j]]).any():
            found[i], found[j] = m.number[j], m.number[i]
    return found


def _near(m: MapEstimate, variance: Array) -> IntArray:
    """Rows (K, 2) of the landmarks whose difference is not significant, each pair once."""
    threshold = gate_threshold(GATE)
    size = np.linalg.eigvalsh(m.covariance)[:, -1]
    known = np.flatnonzero(np.isfinite(m.xy).all(axis=1) & np.isfinite(size))
    xy, size = m.xy[known], size[known]
    # a pair is found from the landmark that is known worse, whose circle holds all that can be near it
    reach = np.sqrt(threshold * (2.0 * np.maximum(size, 0.0) + variance.max(initial=0.0)))
    if len(xy) < 2:
        return np.empty((0, 2), np.int64)
    distance, around = scipy.spatial.cKDTree(xy).query(xy, k=min(MOST + 1, len(xy)))
    first, which = np.nonzero(distance <= reach[:, None])
    second = np.asarray(around)[first, which]
    pairs = np.unique(np.sort(np.stack([first, second], axis=1)[first != second], axis=1), axis=0)
    rows = known[pairs]
    i, j = rows.T
    S = m.covariance[i] + m.covariance[j] + np.maximum(variance[i], variance[j])[:, None, None] * np.eye(2)
    d = m.xy[i] - m.xy[j]
    square = np.einsum("ka,ka->k", d, np.linalg.solve(S, d[:, :, None])[:, :, 0])
    near: IntArray = rows[square < threshold]
    return near

"""Ambiguous landmarks of a final map: those that may be the same as a neighbour, and those that may be two.

Two landmarks are distinct where one frame observed both, or where their difference is significant given their
covariances and an observation's. Neighbours have correlated errors, so marginal covariances call rather too many
ambiguous.

A landmark may be two if its observations scatter about two points, or if frames have a second observation next to it,
which is clutter otherwise. The likelihoods of two points and of one point with clutter are compared. The two points are
fitted to one half of a landmark's frames and tested on the other half, the single point on the tested half. If there is
one point, this ratio and its mean over both halves exceed 1 / a with a probability of at most a (Wasserman, Ramdas and
Balakrishnan, "Universal inference", PNAS 117, 2020). With a = 1 % over the number of landmarks (Bonferroni), one of a
hundred maps without such a landmark has one marked.

Observations are first registered to the map, each by the other pairings of its frame, because later loops moved the
map but not the online path. The remaining errors have a variance that is estimated from the observations.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from association.conditional import EXACT_VARIANCE, FREEDOM, SAME_PLACE
from association.expectation import gate_threshold
from data.inputs import Inputs, IntArray
from data.result import MapEstimate, Run
from data.se2 import Array, BoolArray
from eval.referee.consistency import squares as squared_errors
from eval.referee.errors import observed

FITS = 2  # registrations of a frame: the second is weighted by the residuals of the first
UNKNOWN_POSE = 1e-6  # 1/m^2 and 1/rad^2, information about a pose without a covariance
MEDIAN_1, MEDIAN_2 = 0.4549, 1.3863  # medians of chi-square with one and two degrees of freedom
ENOUGH = 4  # least number of observations of a landmark that the noise is estimated from
SMALLEST = 1e-4  # least noise, as a share of the stated variance


class Registered(NamedTuple):
    """Observations of a log, registered to the map of a run."""

    row: IntArray  # (M,) row of the paired landmark in the map, -1: none
    xy: Array  # (M, 2) m, world frame, by the other pairings of the frame
    covariance: Array  # (M, 2, 2) by the estimated noise
    stated: Array  # (M, 2, 2) by the stated noise


def _finite(rows: Array) -> BoolArray:
    return np.asarray(np.isfinite(rows).all(axis=1))


def registered(run: Run, inputs: Inputs) -> Registered | None:
    """The observations of these inputs on the map of a run; None without a map, and where they are not the run's."""
    m, o = run.map, inputs.observations
    if m is None or not len(m) or run.walls or len(run.final_decisions) != len(o.frame) or not run.phases:
        return None
    if inputs.several_or_partial:
        return None
    number, path = observed(run), run.trajectory(run.phases[-1])
    rows = np.full(int(max(number.max(initial=0), m.number.max())) + 1, -1, np.int64)
    rows[m.number] = np.where(_finite(m.xy), np.arange(len(m)), -1)
    known = _finite(path.pose)
    row = np.where((number >= 0) & known[o.frame], rows[np.maximum(number, 0)], -1)
    pose = np.where(known[:, None], path.pose, 0.0)[o.frame]
    xy, Gx, Gz = inputs.sensor.inverse(pose, o.z)
    R = Gz @ o.R @ np.swapaxes(Gz, 1, 2) + EXACT_VARIANCE * np.eye(2)
    off = np.where(row[:, None] >= 0, xy - m.xy[np.maximum(row, 0)], 0.0)
    certain = _finite(path.covariance.reshape(-1, 9))[:, None, None]
    P = np.where(certain, path.covariance, np.eye(3)) + EXACT_VARIANCE * np.eye(3)
    information = np.where(certain, np.linalg.inv(P), UNKNOWN_POSE * np.eye(3))
    shift, S = _by_others(off, R, Gx, row >= 0, o.frame, information)
    S = 0.5 * (S + np.swapaxes(S, 1, 2))
    xy = np.where(known[o.frame][:, None], xy + shift, np.nan)
    return Registered(row, xy, _estimated(off + shift, S, xy - pose[:, :2], row), S)


def _by_others(
    off: Array, R: Array, Gx: Array, paired: BoolArray, frame: IntArray, information: Array
) -> tuple[Array, Array]:
    """Shift (M, 2) of each observation by the other pairings of its frame, and covariance (M, 2, 2) of the rest.

    Least squares in the pose of a frame, without the observation itself; pairings have Student's weights.
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
            d2 = squares(off + shift, np.linalg.inv(S))
            scale = max(float(np.median(d2[paired])) / MEDIAN_2, SMALLEST)
            weight = paired * (FREEDOM + 2.0) / (FREEDOM + d2 / scale)
    return shift, S


def _estimated(off: Array, S: Array, sight: Array, row: IntArray) -> Array:
    """Covariances (M, 2, 2) with estimated variances along and across the line of sight (M, 2).

    The median over landmarks of the median over each one's observations is robust against wrong ones.
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


def squares(off: Array, information: NDArray[Any]) -> Array:
    """Squared distances (m,) of offsets (m, 2) by their information (m, 2, 2), which is symmetric."""
    x, y = off.T
    square: Array = information[:, 0, 0] * x * x + 2.0 * information[:, 0, 1] * x * y + information[:, 1, 1] * y * y
    return square


FALSE = 0.01  # false-rejection rate of a whole map
FEWEST = 3  # least number of frames in each half
OUTLIERS, OUTLYING = 0.05, 9.0  # share of observations in the tails, and their variance relative to the others
SPREADS = (1.0, 1.25, 1.5)  # variance factors of a single point: noise differs between landmarks
BESIDE = 25.0  # squared distance of a neighbouring observation, by the larger of stated and estimated covariance
AROUND = 100.0  # squared distance up to which farther ones count as clutter
SCATTERED = 2.5  # mean squared distance (expected 2) from which a landmark without neighbouring observations is tested
EDGE = 5.0  # limit of a squared distance in that mean, in units of 2
ROUNDS = 10  # iterations of expectation maximization, and of the robust mean
LEAST = 0.02  # least share of observations of either point, and of frames that observed both, or one


class Pairs(NamedTuple):
    """Observations of the tested landmarks: n pairings, one per frame and landmark, and k neighbours of these."""

    group: IntArray  # (n,) 2 * tested landmark + half
    share: Array  # (n,) weight of each pairing
    neighbour: IntArray  # (k,) pairings with a neighbouring observation
    x: Array  # (n + k, 2) m, pairings, then neighbours, relative to the mapped landmark
    W: Array  # (n + k, 2, 2) information
    log_det: Array  # (n + k,) of the covariances

    @property
    def every(self) -> IntArray:
        """Pairing (n + k,) of each observation."""
        return np.concatenate([np.arange(len(self.group)), self.neighbour])

    def total(self, values: Array, groups: int) -> Array:
        """Sums (G,) of values (n,) over the pairs of each group."""
        return np.asarray(np.bincount(self.group, self.share * values, groups), np.float64)


class Two(NamedTuple):
    """Two points (G, 2, 2) for each group; shares (G,) of observations of the first, and of frames with both."""

    points: Array
    first: Array
    both: Array


def doubles(run: Run, inputs: Inputs) -> BoolArray:
    """Whether each landmark (L,) of a run's map may be two; False for walls, and for inputs not the run's."""
    r, m = registered(run, inputs), run.map
    if r is None or m is None or not (r.row >= 0).any():
        return np.zeros(0 if m is None else len(m), np.bool_)
    return log_evidence(r, m.xy, inputs.observations.frame, _places(inputs)) > math.log(len(m) / FALSE)


def _places(inputs: Inputs) -> IntArray:
    """Viewpoint cell (N,) of each frame, numbered along the path; errors and occlusions are alike within a cell."""
    sensor, z = inputs.sensor, inputs.observations.z
    reach = min(sensor.max_range, float(sensor.polar(z)[:, 0].max(initial=0.0)))
    travelled = np.cumsum(np.hypot(inputs.increments.mean[:, 0], inputs.increments.mean[:, 1]))
    return np.asarray(travelled / max(SAME_PLACE * reach, EXACT_VARIANCE), np.int64)


def log_evidence(r: Registered, landmarks: Array, frame: IntArray, place: IntArray) -> Array:
    """Log likelihood ratio (L,) of two points to one for each landmark; -inf if not tested.

    `landmarks` (L, 2) m; `frame` (M,) of the observations, `place` (N,) of the frames.
    """
    evidence = np.full(len(landmarks), -np.inf)
    p, neighbour, clutter = _neighbours(r, landmarks, frame)
    number = r.row[p]
    count = np.bincount(number, minlength=len(landmarks))
    square = squares(r.xy[p] - landmarks[number], np.linalg.inv(r.covariance[p]))
    scatter = np.bincount(number, np.minimum(square, EDGE * 2.0), len(landmarks)) / np.maximum(count, 1)
    tested = (np.bincount(number[neighbour >= 0], minlength=len(landmarks)) > 0) | (scatter > SCATTERED)
    _, cell, alike = np.unique(
        number * (int(place.max()) + 1) + place[frame[p]], return_inverse=True, return_counts=True
    )
    opportunities = np.bincount(number, 1.0 / alike[cell], len(landmarks))
    asked = np.flatnonzero(tested & (opportunities >= 2 * FEWEST))
    if not len(asked):
        return evidence
    pairs = _pairs(r, landmarks, asked, p, neighbour, 1.0 / alike[cell])
    groups = 2 * len(asked)
    one = _one(pairs, groups)
    two = _two(pairs, groups, clutter)
    other = Two(*(values[np.arange(groups) ^ 1] for values in two))
    ratio = pairs.total(_explained(pairs, other, clutter)[0], groups) - one
    evidence[asked] = np.logaddexp(*ratio.reshape(-1, 2).T) - math.log(2.0)
    return evidence


def _neighbours(r: Registered, landmarks: Array, frame: IntArray) -> tuple[IntArray, IntArray, float]:
    """Pairings (n,), one per frame and landmark; a neighbouring observation (n,) of each, -1: none; clutter [1/m^2].

    Neighbours are unpaired or second observations of the frame near the landmark; farther ones count as clutter.
    """
    p = np.flatnonzero(r.row >= 0)
    first = np.unique(frame[p] * len(landmarks) + r.row[p], return_index=True)[1]
    again = np.setdiff1d(np.arange(len(p)), first)
    q = np.concatenate([np.flatnonzero((r.row < 0) & np.isfinite(r.xy[:, 0])), p[again]])
    p = p[first]
    nearest = np.full(len(p), -1, np.int64)
    begin, end = np.searchsorted(frame[p], frame[q], "left"), np.searchsorted(frame[p], frame[q], "right")
    count = end - begin
    which = np.repeat(np.arange(len(q)), count)
    of = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count - begin, count)
    wide = np.trace(r.stated, axis1=1, axis2=2) > np.trace(r.covariance, axis1=1, axis2=2)
    S = np.where(wide[:, None, None], r.stated, r.covariance)
    area = math.pi * np.sqrt(np.linalg.det(S[p])).sum()
    square = squares(r.xy[q[which]] - landmarks[r.row[p[of]]], np.linalg.inv(S[q])[which])
    around = (square >= BESIDE) & (square < AROUND)
    clutter = (np.count_nonzero(around) + 1.0) / ((AROUND - BESIDE) * area)
    inside = square < BESIDE
    which, of, square = which[inside], of[inside], square[inside]
    order, to = np.argsort(-square, kind="stable"), np.full(len(q), -1, np.int64)
    to[which[order]] = of[order]  # the nearest last, which stays: one landmark for each observation
    own = to[which] == of
    order = np.argsort(-square[own], kind="stable")
    nearest[of[own][order]] = q[which[own][order]]
    return p, nearest, clutter


def _pairs(r: Registered, landmarks: Array, asked: IntArray, p: IntArray, neighbour: IntArray, share: Array) -> Pairs:
    """Observations of the tested landmarks, split in time into halves."""
    k = np.full(len(landmarks), -1, np.int64)
    k[asked] = np.arange(len(asked))
    few = np.flatnonzero(k[r.row[p]] >= 0)
    few = few[np.argsort(r.row[p[few]], kind="stable")]
    number, share = r.row[p[few]], share[few]
    opportunities = np.bincount(k[number], share)
    so_far = np.cumsum(share) - share - (np.cumsum(opportunities) - opportunities)[k[number]]
    group = 2 * k[number] + (so_far >= 0.5 * opportunities[k[number]])
    there = np.flatnonzero(neighbour[few] >= 0)
    every = np.concatenate([p[few], neighbour[few[there]]])
    S, x = r.covariance[every], r.xy[every] - landmarks[np.concatenate([number, number[there]])]
    return Pairs(group, share, there, x, np.linalg.inv(S), np.log(np.linalg.det(S)))


def _densities(off: Array, W: Array, log_det: Array, spread: float = 1.0) -> tuple[Array, Array]:
    """Log density (n,) of offsets (n, 2), normal with heavier tails, and weight of each in a mean."""
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
    det = np.where(det > 0.0, det, 1.0)  # an empty group
    return np.stack([(c * u - b * v) / det, (a * v - b * u) / det], axis=1)


def _one(pairs: Pairs, groups: int) -> Array:
    """Log likelihood (G,) of the best single point of each group."""
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
    """The most likely two points of each group: expectation maximization from two initial guesses."""
    n, there = len(pairs.group), pairs.group[pairs.neighbour]
    count = pairs.total(np.ones(n), groups)
    found = np.bincount(there, pairs.share[pairs.neighbour], groups)
    middle = _means(pairs.group, pairs.x[:n], pairs.W[:n], pairs.share, groups)
    off = pairs.x[:n] - middle[pairs.group]
    moments = [pairs.total(off[:, i] * off[:, j], groups) for i, j in ((0, 0), (0, 1), (0, 1), (1, 1))]
    size, axes = np.linalg.eigh((np.stack(moments, axis=1) / count[:, None]).reshape(-1, 2, 2))
    step = axes[:, :, 1] * np.sqrt(np.maximum(size[:, 1], 0.0))[:, None]
    second = _means(there, pairs.x[n:], pairs.W[n:], pairs.share[pairs.neighbour], groups)
    second = np.where((found > 0)[:, None], second, middle + step)
    both = (found + 0.5) / (count + 1.0)
    # apart along the longer axis of the pairings; or at their mean and at the mean of the neighbours
    guesses = (
        Two(np.stack([middle + step, middle - step], axis=1), np.full(groups, 0.5), both),
        Two(np.stack([middle, second], axis=1), np.full(groups, 1.0 - LEAST), both),
    )
    a, b = (_fitted(pairs, two, count, clutter) for two in guesses)
    likely = [pairs.total(_explained(pairs, two, clutter)[0], groups) for two in (a, b)]
    better = likely[0] > likely[1]
    points = np.where(better[:, None, None], a.points, b.points)
    return Two(points, np.where(better, a.first, b.first), np.where(better, a.both, b.both))


def _fitted(pairs: Pairs, two: Two, count: Array, clutter: float) -> Two:
    """Expectation maximization; `count` (G,) pairings of each group."""
    groups, every = len(count), pairs.every
    for _ in range(ROUNDS):
        _, first, both, weight = _explained(pairs, two, clutter)
        weight *= pairs.share[every][:, None]
        points = [_means(pairs.group[every], pairs.x, pairs.W, weight[:, i], groups) for i in range(2)]
        sums = (pairs.total(values, groups) for values in (first, both))
        two = Two(np.stack(points, axis=1), *((total + 0.5) / (count + 1.0) for total in sums))
    return two


def _explained(pairs: Pairs, two: Two, clutter: float) -> tuple[Array, Array, Array, Array]:
    """The mixture of two points and clutter, relative to clutter alone.

    Returns log likelihoods (n,), probabilities that a pairing is of the first point (n,) and that both points were
    observed (n,), and the weight of each observation in either mean (n + k, 2).
    """
    n, group = len(pairs.group), pairs.group
    points = [_densities(pairs.x - two.points[group[pairs.every], i], pairs.W, pairs.log_det) for i in range(2)]
    first, both = (np.clip(share, LEAST, 1.0 - LEAST)[group] for share in (two.first, two.both))
    terms, shares = [], []
    for i in range(2):  # the pairing is of point i, its neighbour of the other one, or clutter
        other = np.full(n, -np.inf)
        other[pairs.neighbour] = np.log(both[pairs.neighbour] / clutter) + points[1 - i][0][n:]
        total = np.logaddexp(np.log1p(-both), other)
        terms.append(np.log(first if i == 0 else 1.0 - first) + points[i][0][:n] + total)
        shares.append(np.exp(other - total))
    likelihood = np.logaddexp(*terms)
    of = [np.exp(term - likelihood) for term in terms]
    real = [p * share for p, share in zip(of, shares, strict=True)]
    weight = [np.concatenate([of[i], real[1 - i][pairs.neighbour]]) * points[i][1] for i in range(2)]
    return likelihood, of[0], real[0] + real[1], np.stack(weight, axis=1)


GATE = 0.99  # chi-square probability of a significant difference
MOST = 32  # largest number of neighbours of a landmark that are tested
NONE = -1  # for a landmark that is not ambiguous


def ambiguous(run: Run, inputs: Inputs) -> IntArray:
    """Number (L,) of the nearest landmark that each one may be the same as; its own if it may be two; else `NONE`.

    All `NONE` for walls, and where the decisions are not about the observations of these inputs.
    """
    m, o = run.map, inputs.observations
    given = run.task == "localization"  # the landmarks are no mistakes of the run
    strange = given or inputs.several_or_partial or run.walls or len(run.final_decisions) != len(o.frame)
    if m is None or not len(m) or strange or not len(o.frame):
        return np.full(0 if m is None else len(m), NONE, np.int64)
    number = observed(run)
    seen = np.flatnonzero(number >= 0)
    _, covariance = inputs.sensor.body_points(o.z[seen], o.R[seen])
    variance = 0.5 * np.trace(covariance, axis1=1, axis2=2)
    found = neighbours(m, variance_of(m, number[seen], variance), number[seen], o.frame[seen])
    return np.where((found == NONE) & doubles(run, inputs), m.number, found)


def variance_of(m: MapEstimate, number: IntArray, variance: Array) -> Array:
    """Mean variance [m^2] (L,) of each landmark's observations, of these numbers (M,) and variances (M,); else 0."""
    size = int(max(m.number.max(initial=-1), number.max(initial=-1))) + 1
    count = np.bincount(number, minlength=size)
    total = np.bincount(number, weights=variance, minlength=size)
    mean: Array = (total / np.maximum(count, 1))[m.number]
    return mean


def neighbours(m: MapEstimate, variance: Array, number: IntArray, frame: IntArray) -> IntArray:
    """Numbers as of `ambiguous`, given each landmark's `variance_of`, and number and frame of all observations (M,)."""
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
    # a pair is found from the landmark of larger covariance
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
    near: IntArray = rows[squared_errors(d, S) < threshold]
    return near

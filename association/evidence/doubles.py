"""Which landmarks of a finished map may be two, by their own readings: two that were taken for one from the start.

Nothing is seen twice in a frame: where a landmark is read, another reading next to it is clutter, or two stand there.
And readings of two places scatter about two points, not one. Both are weighed together: the likelihood of two points
against that of one with clutter beside it, by the noise that there is. What says that there are two is learned from one
half of a landmark's frames and judged on the other half, the more likely single point being granted: such a ratio
exceeds 1 / a with a probability of at most a if there is one point (Wasserman, Ramdas and Balakrishnan, "Universal
inference", PNAS 117, 2020), as does the mean over both halves. With a = 1 % over the number of landmarks, a map without
any such landmark has one marked in a hundred maps at most (Bonferroni), if its noise and clutter are as taken.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from association.evidence import constants
from association.evidence.registered import Registered, inverses, registered, squares
from data.inputs import Inputs, IntArray
from data.result import Run
from data.se2 import Array, BoolArray

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
"""Of the readings are of either of two points, and as many frames read both, or not."""


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
    return np.asarray(travelled / max(constants.SAME_PLACE * reach, constants.EXACT_VARIANCE), np.int64)


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
    doubtful = (np.bincount(number[beside >= 0], minlength=len(landmarks)) > 0) | (scatter > SCATTERED)
    _, cell, alike = np.unique(
        number * (int(place.max()) + 1) + place[frame[p]], return_inverse=True, return_counts=True
    )
    looks = np.bincount(number, 1.0 / alike[cell], len(landmarks))
    asked = np.flatnonzero(doubtful & (looks >= 2 * FEWEST))
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
    looks = np.bincount(k[number], share)
    so_far = np.cumsum(share) - share - (np.cumsum(looks) - looks)[k[number]]
    group = 2 * k[number] + (so_far >= 0.5 * looks[k[number]])
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

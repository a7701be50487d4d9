"""Bad ground truth and wrong map rows: where true path, odometry and observations contradict each other.

Two witnesses outvote the third. The truth is bad where observations of landmarks lie far from what it predicts, and the
odometry, from the last or back from the next good pose, predicts them better. After a slip or a kidnapping observations
fit the truth; under a fault of the sensor odometry does. Without observations only a truth that departs from the
odometry by a step and comes back to it, or stands still and catches up, is called bad.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from data import se2
from data.inputs import IntArray
from data.log import Log
from data.se2 import Array, BoolArray
from data.truth import BadTruth

Rows = BoolArray | NDArray[np.integer] | slice

FAR = 9.0  # Squared distance of an observation, in robust sigmas, beyond which it speaks against the truth (3 sigma)
FEWEST = 10  # Observations beyond `FAR`, less those within, that make a window; least that judge a landmark's row
BETTER = 0.3  # Largest median distance of observations from the odometry's prediction, over that from the truth's
EDGE = (15, 30, 60, 120)  # Observations at an edge of a window over which these are compared, as odometry drifts
STEP = 10.0  # Robust sigmas of the difference between one increment of truth and odometry that is a step
UNUSUAL = 2.0  # Times the 0.8 quantile of true increments and the 0.99 quantile of the odometry's: beyond is a jump
RETURNED = 0.25  # Largest rest of a step, over the step, after which the truth has come back
STILL = 1e-6  # m and rad below which two true poses are one
MISPLACED, SWAPPED = 10.0, 4.0  # Robust sigmas that all but `RARE` of a row's observations are off; of exchanged ones
RARE = 0.1
ALIKE = 0.1  # Least way of another path, over the extent of the true one, that speaks against a truth in one place
ENOUGH = 5  # Fewest observations that give a landmark its place


class MapRow(NamedTuple):
    """A landmark observed elsewhere: its id, the distance [m], the row at that place (-1: none), its observations."""

    id: int
    distance: float
    at: int
    observations: int


class _Evidence(NamedTuple):
    """Observations (n) of identified landmarks from known true poses, ascending by frame."""

    frame: IntArray
    id: IntArray
    z: Array
    root: Array  # (n, 2, 2) inverse roots of their covariances
    place: Array  # (n, 2) of their landmarks
    scale: Array  # (2,) robust spread of their residuals, at least 1


def bad_truth(log: Log) -> tuple[BadTruth, ...]:
    """Windows of bad ground truth, ascending; those already left out (`Truth.left_out`) are not found again."""
    pose = log.truth.pose
    known: IntArray = np.flatnonzero(False if pose is None else np.isfinite(pose).all(axis=1))
    if pose is None or len(known) < 2 or not np.ptp(log.recorded.increments.mean[1:], axis=0).any():
        return ()  # without odometry nobody knows who of two is wrong; positions alone tell no motion of the body
    odometry = se2.dead_reckoned(np.zeros(3), log.recorded.increments.mean)
    stated = np.sqrt(np.median(np.diagonal(log.recorded.increments.covariance[1:], axis1=1, axis2=2), axis=0))
    steps = _Steps(known, pose, odometry, stated)
    seen = _evidence(log)
    found = _contradicted(log, pose, odometry, seen)
    outside = np.ones(len(seen.frame), bool)
    for a, b, *_ in found:
        outside[a : b + 1] = False
    if found and (rows := _misplaced(log, seen, outside)):
        seen = _evidence(log, frozenset(r.id for r in rows))
        found = _contradicted(log, pose, odometry, seen)
    spans = []
    for a, b, far, carried in found:  # to a step before and after the far observations, else to those that fit
        begin = int(seen.frame[a - 1]) + 1 if a > 0 else int(known[0])
        end = int(seen.frame[b + 1]) - 1 if b + 1 < len(seen.frame) else int(known[-1])
        into, out = steps.largest(begin, int(seen.frame[a])), steps.largest(int(seen.frame[b]) + 1, end + 1)
        spans.append((begin if into is None else into, end if out is None else out - 1, far, carried))
    for a, b in steps.excursions():
        inside = (seen.frame >= a) & (seen.frame <= b)
        # the place of others may be from within; along a wall nothing changes
        inside &= np.isin(seen.id, seen.id[~inside]) & log.recorded.sensor.sees_points
        off = _distance(log, pose[seen.frame[inside]], seen, inside)
        if inside.sum() < ENOUGH or np.median(off) > FAR:
            spans.append((a, b, float(np.sqrt(np.median(off))) if len(off) else math.nan, math.nan))
    merged: list[tuple[int, int, float, float]] = []
    for first, last, distance, rest in sorted(spans):
        if merged and first <= merged[-1][1] + 1:
            before = merged[-1]
            last, distance = max(last, before[1]), float(np.fmax(distance, before[2]))
            merged[-1] = (before[0], last, distance, float(np.fmin(rest, before[3])))
        elif last >= first:
            merged.append((first, last, distance, rest))
    time = log.recorded.time + log.clock
    low, high = np.floor(1000.0 * time + 1e-6) / 1000.0, np.ceil(1000.0 * time - 1e-6) / 1000.0
    return tuple(BadTruth(a, b, float(low[a]), float(high[b]), *more) for a, b, *more in merged)


def leaps(truth: Array, other: Array) -> list[tuple[int, int]]:
    """First and last rows of true poses (n, 3) that leap away from another path (n, 3) and come back, or stay where
    they leapt to the end of the file, or from its beginning; NaN: unknown. Where all others are in one place, though
    the other path moves, these are the bad ones.
    """
    known = np.flatnonzero(np.isfinite(np.hstack([truth, other])).all(axis=1))
    if len(known) <= FEWEST:
        return []
    steps, found = _Steps(known, truth, other, np.zeros(3)), []
    ends = steps.excursions()
    ends += [end for end in steps.resets() if not any(a <= end[1] + 1 and end[0] <= b + 1 for a, b in ends)]
    for first, last in sorted(ends):
        a, b = np.searchsorted(known, (first, last)).tolist()
        i, j = known[: a - b - 1], known[b - a + 1 :]  # what the paths drift apart as long a time elsewhere
        usual = se2.between(se2.between(other[i], other[j]), se2.between(truth[i], truth[j]))
        if (np.abs(steps.off[a - 1 if a else b]) > UNUSUAL * np.quantile(np.abs(usual), 0.8, axis=0)).any():
            found.append((first if a else 0, last if b < len(known) - 1 else len(truth) - 1))
    rest = np.setdiff1d(known, [k for first, last in found for k in range(first, last + 1)])
    if not found or not len(rest) or np.ptp(truth[rest, :2], axis=0).any():
        return found
    extent = np.ptp(other[rest, :2], axis=0).max(), np.ptp(truth[known, :2], axis=0).max()
    edges = [-1, *(row for window in found for row in window), len(truth)]
    others = [(end + 1, begin - 1) for end, begin in zip(edges[::2], edges[1::2], strict=True) if begin - end > 1]
    return others if extent[0] > ALIKE * extent[1] else found


def without(log: Log, stretches: Sequence[tuple[float, float]]) -> Log:
    """The log without true poses in stretches (from, to) [s of its recording], both ends included."""
    if log.truth.pose is None or not stretches:
        return log
    pose = log.truth.pose.copy()
    pose[_inside(log, log.recorded.time, stretches)] = np.nan
    return replace(log, truth=replace(log.truth, pose=pose))


def scored(log: Log, excluded: Sequence[tuple[float, float]] = (), *, keep: bool = False) -> Log:
    """The log with the ground truth that counts: what every command and `Trial` scores.

    Left out are the stretches `excluded` (from, to) [s of its recording] and, unless `keep`, windows of bad ground
    truth, which are in `Truth.left_out` then. A log that was screened before stays as it is.
    """
    if log.truth.screened:
        return log
    rest = without(log, excluded)
    found = () if keep else bad_truth(rest)
    pose = without(rest, [(w.start, w.end) for w in found]).truth.pose
    return replace(log, truth=replace(log.truth, pose=pose, left_out=found, excluded=tuple(excluded), screened=True))


def unscored(log: Log, time: Array) -> BoolArray:
    """Which of the times (n,) [s of `Inputs.time`] are in windows or stretches that are not scored."""
    return _inside(log, time, [*log.truth.excluded, *((w.start, w.end) for w in log.truth.left_out)])


def _inside(log: Log, time: Array, stretches: Sequence[tuple[float, float]]) -> BoolArray:
    recorded, inside = time + log.clock, np.zeros(len(time), bool)
    for a, b in stretches:
        inside |= (recorded >= a) & (recorded <= b)
    return inside


def misplaced(log: Log) -> tuple[MapRow, ...]:
    """Rows of the map that are seen elsewhere from the true path or the rest of the map; none if half of it is."""
    inputs = log.recorded
    if inputs.map is None or (log.truth.pose is None and (log.granted is None or not inputs.locates_points)):
        return ()
    if log.truth.pose is None:
        log = replace(log, truth=replace(log.truth, pose=_by_map(log)))
    seen = _evidence(log)
    return _misplaced(log, seen, np.ones(len(seen.frame), bool))


WINDOW, WINDOWS, TOGETHER = 5.0, 60, 5  # s of odometry laid onto the map together; most such windows; fewest landmarks


def _by_map(log: Log) -> Array:
    """Poses (N, 3) by odometry from which most landmarks of a window are where the map has them; NaN elsewhere."""
    inputs, ids = log.recorded, log.granted
    assert inputs.map is not None
    assert ids is not None  # the caller asked
    o, path = inputs.observations, se2.dead_reckoned(np.zeros(3), inputs.increments.mean)
    point, place = inputs.sensor.inverse(path[o.frame], o.z)[0], inputs.map.positions(ids)
    fine = (ids >= 0) & np.isfinite(place).all(axis=1)
    window = np.where(fine, (inputs.time[o.frame] - inputs.time[0]) // WINDOW, -1.0)
    found, each = np.full((len(path), 3), np.nan), np.unique(window[fine])
    for w in each[:: len(each) // WINDOWS + 1].tolist():
        rows = np.flatnonzero(window == w)
        _, first, which = np.unique(ids[rows], return_index=True, return_inverse=True)
        if len(first) < TOGETHER:
            continue
        x = np.bincount(which, point[rows, 0]) + 1j * np.bincount(which, point[rows, 1])
        x, y = x / np.bincount(which), place[rows[first]] @ [1.0, 1j]
        i, j = np.triu_indices(len(x), 1)
        turn = np.exp(1j * np.angle((y[j] - y[i]) / (x[j] - x[i])))
        off = np.abs(y[i, None] + turn[:, None] * (x - x[i, None]) - y)  # of each pair that is laid exactly
        best = off[np.argmin(np.median(off, axis=1))]
        near = best <= 3.0 * np.median(best)
        T = se2.rigid_fit(*(np.column_stack([p.real, p.imag])[near] for p in (x, y)))
        within = slice(o.frame[rows[0]], o.frame[rows[-1]] + 1)
        found[within] = se2.compose(T, path[within])
    return found


def _evidence(log: Log, unmapped: frozenset[int] = frozenset()) -> _Evidence:
    """All of it; a landmark without place, or `unmapped`, is where it is seen from the true path in the median."""
    inputs, pose, ids = log.recorded, log.truth.pose, log.truth.landmark_of
    ids = log.label if ids is None else ids
    o, known = inputs.observations, inputs.map if inputs.map is not None else log.truth.landmarks
    if pose is None or ids is None or not len(o.z) or inputs.several_or_partial:
        none = np.zeros(0, np.int64)
        return _Evidence(none, none, np.zeros((0, 2)), np.zeros((0, 2, 2)), np.zeros((0, 2)), np.ones(2))
    place = np.full((len(o.z), 2), np.nan) if known is None else known.positions(ids)
    place[np.isin(ids, list(unmapped))] = np.nan
    there = np.isfinite(pose[o.frame]).all(axis=1) & (ids >= 0)
    lost = there & ~np.isfinite(place).all(axis=1)
    if lost.any() and inputs.sensor.sees_points:
        points = np.full((len(o.z), 2), np.nan)
        points[lost] = inputs.sensor.inverse(pose[o.frame[lost]], o.z[lost])[0]
        for number in np.unique(ids[lost]):
            rows = lost & (ids == number)
            if rows.sum() >= ENOUGH:
                place[rows] = np.median(points[rows], axis=0)
    rows = there & np.isfinite(place).all(axis=1)
    root = np.linalg.inv(np.linalg.cholesky(o.R[rows]))
    seen = _Evidence(o.frame[rows], ids[rows], o.z[rows], root, place[rows], np.ones(2))
    if not rows.any():
        return seen
    spread = np.median(np.abs(_residuals(log, pose[seen.frame], seen)), axis=0) / 0.6745
    return seen._replace(scale=np.maximum(spread, 1.0))


def _residuals(log: Log, poses: Array, seen: _Evidence, rows: Rows = slice(None)) -> Array:
    """Residuals (n, 2) of some observations from poses (n, 3), in robust sigmas."""
    sensor = log.recorded.sensor
    difference = sensor.residual(seen.z[rows], sensor.predict(poses, seen.place[rows]))
    return np.asarray(np.einsum("nij,nj->ni", seen.root[rows], difference) / seen.scale)


def _distance(log: Log, poses: Array, seen: _Evidence, rows: Rows = slice(None)) -> Array:
    """Their squares (n,)."""
    return np.asarray(np.sum(_residuals(log, poses, seen, rows) ** 2, axis=1))


def _contradicted(log: Log, pose: Array, odometry: Array, seen: _Evidence) -> list[tuple[int, int, float, float]]:
    """Stretches (first, last row) where odometry predicts better than the truth; median distances from both."""
    squared = _distance(log, pose[seen.frame], seen)
    found = []
    for a, b in _stretches(np.minimum(squared, 2.0 * FAR) - FAR):
        far = np.flatnonzero(squared[a : b + 1] > FAR) + a
        if len(np.unique(seen.id[far])) < 2 or seen.frame[b] == seen.frame[a]:
            continue
        sides = []  # anchor and the observations from the edge on
        if a > 0:
            sides.append((seen.frame[a - 1], far))
        if b + 1 < len(squared):
            sides.append((seen.frame[b + 1], far[::-1]))
        best = (math.inf, math.nan, math.nan)
        for anchor, rows in sides:
            carried = se2.compose(pose[anchor], se2.between(odometry[anchor], odometry[seen.frame[rows]]))
            own, other = np.sqrt(squared[rows]), np.sqrt(_distance(log, carried, seen, rows))
            for n in EDGE:
                off, rest = float(np.median(own[:n])), float(np.median(other[:n]))
                best = min(best, (rest / off, off, rest))
        if best[0] < BETTER:
            found.append((a, b, best[1], best[2]))
    return found


def _stretches(score: Array) -> list[tuple[int, int]]:
    """Stretches (first, last) in which the sum of scores rises by `FEWEST` times `FAR` and then falls as much."""
    found = []
    begin, total, peak, at = 0, 0.0, 0.0, -1
    for i, x in enumerate([*score.tolist(), -math.inf]):
        if total <= 0.0:
            begin, total, peak = i, 0.0, 0.0
        total += x
        if total > peak:
            peak, at = total, i
        if peak >= FEWEST * FAR and (total <= 0.0 or peak - total >= FEWEST * FAR):
            found.append((begin, at))
            total = 0.0
    return found


def _misplaced(log: Log, seen: _Evidence, rows: BoolArray) -> tuple[MapRow, ...]:
    """Rows of the map that these observations contradict."""
    known, pose, sensor = log.recorded.known_points, log.truth.pose, log.recorded.sensor
    if known is None or pose is None or not rows.any():
        return ()
    off = np.sqrt(_distance(log, pose[seen.frame], seen))
    point = sensor.inverse(pose[seen.frame], seen.z)[0]
    ids, times = np.unique(seen.id[rows & (known.rows(seen.id) >= 0)], return_counts=True)
    size = {i: float(np.quantile(off[rows & (seen.id == i)], RARE)) for i in ids[times >= ENOUGH].tolist()}
    suspects = [i for i in size if size[i] > SWAPPED]
    fit = np.flatnonzero(rows & ~np.isin(seen.id, suspects) & (off**2 <= FAR))
    found = []
    for number in suspects:
        own = np.flatnonzero(rows & (seen.id == number))
        if 2 * ((fit > own[0]) & (fit < own[-1])).sum() < len(own):  # the pose or the sensor may be wrong
            continue
        there = np.median(point[own], axis=0)
        away = np.hypot(*(known.xy - there).T)
        distance, nearest = float(away[known.rows(np.array([number]))[0]]), int(np.argmin(away))
        if np.median(np.hypot(*(point[own] - there).T)) > BETTER * distance:  # nowhere else either
            continue
        at = int(known.id[nearest]) if away[nearest] < 0.5 * distance else -1
        found.append(MapRow(number, distance, at, len(own)))
    to = {row.id: row.at for row in found}
    sure = tuple(
        row for row in found if to.get(row.at) == row.id or (size[row.id] > MISPLACED and row.observations >= FEWEST)
    )
    return sure if 2 * len(sure) < (times >= ENOUGH).sum() else ()


class _Steps:
    """Differences of increments of the truth, between frames with a true pose, and of the odometry."""

    def __init__(self, known: IntArray, pose: Array, odometry: Array, stated: Array) -> None:
        """Frames (n,) with a true pose; poses and dead reckoning (N, 3); sigmas (3,)."""
        self.known, self.pose, self.odometry = known, pose, odometry
        self.true = se2.between(pose[known[:-1]], pose[known[1:]])
        self.driven = se2.between(odometry[known[:-1]], odometry[known[1:]])
        self.off = se2.between(self.driven, self.true)
        moving = (np.abs(np.hstack([self.true, self.driven])) > STILL).any(axis=1)
        usual = moving | (moving.sum() < FEWEST)  # at rest there is no noise to compare
        scale = np.maximum(1.4826 * np.median(np.abs(self.off[usual]), axis=0), stated)
        self.size = np.max(np.abs(self.off) / np.maximum(scale, STILL), axis=1)
        leap, spin = (
            moved > UNUSUAL * max(np.quantile(moved[usual], 0.8), np.quantile(driven[usual], 0.99))
            for moved, driven in (
                (np.hypot(*self.true[:, :2].T), np.hypot(*self.driven[:, :2].T)),
                (np.abs(self.true[:, 2]), np.abs(self.driven[:, 2])),
            )
        )
        self.large = np.flatnonzero((self.size > STEP) & (leap | spin))

    def largest(self, first: int, last: int) -> int | None:
        """The frame in first to last with the largest step into it; None where no increment is one."""
        i, j = np.searchsorted(self.known[1:], (first, last + 1))
        if i >= j:
            return None
        k = int(i + np.argmax(self.size[i:j]))
        return int(self.known[k + 1]) if self.size[k] > STEP else None

    def excursions(self) -> list[tuple[int, int]]:
        """First and last frames between a step of the truth (or its standstill before) and the step that ends it."""
        found: list[tuple[int, int]] = []
        still = np.max(np.abs(self.true), axis=1) < STILL
        ends = self.large[~np.isin(self.large + 1, self.large)]  # who leaps on was not back
        after = -1
        for k in self.large.tolist():
            if k <= after:
                continue
            i = k
            while i > 0 and still[i - 1]:
                i -= 1
            stood = i < k - 1 and bool(self._back(i, np.array([k]), still=True)[0])
            later = ends[ends > k]
            back = k if stood else next(iter(later[self._back(k, later)].tolist()), None)
            if back is not None:
                found.append((int(self.known[(i if stood else k) + 1]), int(self.known[back])))
                after = back
        return found

    def resets(self) -> list[tuple[int, int]]:
        """First and last frames of less than half of the truth that stand still at an end of it, a rare step away."""
        far, moved = np.hypot(*self.true[:, :2].T), np.flatnonzero(np.max(np.abs(self.true), axis=1) >= STILL)
        rare = self.large[far[self.large] > UNUSUAL * np.sort(far)[-5]]  # few others leap as far
        found = [(0, k) for k in rare[np.isin(rare, moved[:1]) & (2 * rare + 2 < len(self.known))].tolist()]
        found += [(k + 1, -1) for k in rare[np.isin(rare, moved[-1:]) & (2 * rare + 2 > len(self.known))].tolist()]
        return [(int(self.known[a]), int(self.known[b])) for a, b in found]

    def _back(self, i: int, k: IntArray, *, still: bool = False) -> BoolArray:
        """Whether the truth after steps (K,) agrees with the odometry from before step `i` on; `still`: with none."""
        a, b = self.known[i], self.known[k + 1]
        rest = se2.between(se2.between(self.odometry[a], self.odometry[b]), se2.between(self.pose[a], self.pose[b]))
        far, turn, left = (np.hypot(*self.off[k, :2].T), np.abs(self.off[k, 2]), np.hypot(*rest[:, :2].T))
        if not still:
            far, turn = np.minimum(far, np.hypot(*self.off[i, :2])), np.minimum(turn, np.abs(self.off[i, 2]))
        turned = (np.abs(rest[:, 2]) < RETURNED * turn) & (RETURNED * turn > 0.1)
        return np.asarray((left < RETURNED * far) | turned)

"""Witnesses of a log: what two of its parts say of one quantity, relative to its size, so that no unit is favoured.

They are the path of the odometry and the truth, what is observed as the odometry or the truth moves, observations and
the map. A log whose witnesses agree up to its stated noise is sound.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import cast

import numpy as np
import scipy

from data import se2
from data.inputs import Increments, IntArray
from data.log import INTEGRATION, ODOMETRY_KIND, ODOMETRY_PERIOD, Log
from data.se2 import Array, BoolArray, between, dead_reckoned, inverse, transform_points, wrap_angle
from data.timeline import truth_at

MOST = 200  # Largest number of pairs of a witness; more of them tell nothing more
KEPT, HALF = (0.8, 0.598), (0.5, 0.307)
"""Share of the smallest differences that count, and mean of so many smallest squares of normal vectors of the plane,
over that of all: others are clutter, slips, and wrong ids; without ids many are of landmarks not seen again."""
AGREES = 1.5  # Two parts agree if they differ by at most this multiple of the stated noise
WEIGHT = 100.0  # Largest number of independent differences of a witness; errors of neighbouring ones are alike


@dataclass(frozen=True)
class Fit:
    """How well two parts agree: RMS difference per size of either (2: none), per noise, number of differences."""

    off: float
    noise: float
    count: int

    @property
    def agrees(self) -> bool:
        """Whether the difference is noise: as large as stated, or noise hides everything, as turns on straight ways."""
        return self.off <= AGREES * self.noise or self.noise >= LOUDEST

    @property
    def cost(self) -> float:
        """Minus the log-likelihood, with the noise that fits best, but not less than what is stated."""
        return min(self.count, WEIGHT) * math.log(max(self.off, self.noise))


def fit_of(difference: Array, size: Array, variance: Array, kept: tuple[float, float] = KEPT) -> Fit | None:
    """Of differences (n, k) of quantities of a size (n,), with variances (n,) by the stated noise."""
    count = len(difference)
    if count < FEWEST:
        return None
    square = np.sort(np.sum(difference**2, axis=1))[: max(int(kept[0] * count), 1)]
    scale = float(np.median(size))
    if not scale > 0.0 or not np.isfinite(square).all():
        return None
    noise = math.sqrt(kept[1] * float(np.median(variance))) / scale
    return Fit(float(np.sqrt(np.mean(square))) / scale, min(max(noise, EXACT), LOUDEST), count)


FEWEST = 12  # Fewest differences of a witness
EXACT, LOUDEST = 1e-3, 1.0  # Least and largest noise over what is compared: rounding, and one that hides everything


@dataclass(frozen=True, eq=False)
class Case:
    """The parts of a log as they are read."""

    time: Array  # time: (N,) s of frames; u: (N, 3) increments; spread: (N, 3) their variances along, across, heading
    u: Array
    spread: Array
    start: Array  # (3,) first pose
    truth: Array | None  # truth, truth_time: (N, 3) true poses, NaN where unknown, and their stamps
    truth_time: Array
    frame: IntArray  # frame, at: (M,) frame, stamp of observations; z, R: (M, 2) range and bearing, their variances
    at: Array
    z: Array
    R: Array
    mount: Array  # (3,) pose of the sensor on the body
    id: IntArray | None  # (M,) landmarks, negative where unknown; None: there are no ids
    names: IntArray | None  # names, places: (L,) and (L, 2) of the map; None: there is none
    places: Array | None
    world: bool = False
    cartesian: bool = False  # cartesian: points are observed; world: bearings count from the world's x axis
    stamped: bool = True  # stamps are in s
    kind: str = "velocities"  # of the odometry, as of tables
    # (N,) samples of velocities in each increment, of arcs; None: another order of turning is stated
    steps: Array | None = None

    @cached_property
    def odometry(self) -> Array:
        """Dead-reckoned path (N, 3), headings not wrapped."""
        return dead_reckoned(self.start, self.u)

    @cached_property
    def along(self) -> tuple[Array, BoolArray] | None:
        """Poses of the odometry (M, 3) at the observations' stamps, and which are within its span."""
        return _poses_at(self.at, self.time, self.odometry)

    @cached_property
    def seen_from(self) -> tuple[Array, BoolArray] | None:
        """The same of the truth."""
        return None if self.truth is None else _poses_at(self.at, self.truth_time, self.truth)

    def points(self, rows: IntArray, heading: Array) -> Array:
        """Observed points (n, 2) in the body frame, with headings (n,) of the body."""
        bearing = self.z[rows, 1] - (heading if self.world else 0.0)
        return transform_points(self.mount, self.z[rows, :1] * np.stack([np.cos(bearing), np.sin(bearing)], axis=1))


def _poses_at(at: Array, time: Array, pose: Array) -> tuple[Array, BoolArray] | None:
    """Poses (M, 3) at stamps (M,), and which are known: within a gap of known ones."""
    known = np.flatnonzero(np.isfinite(pose).all(axis=1))
    if len(known) < 2:
        return None
    found = truth_at(time[known], pose[known], at)
    return np.nan_to_num(found), np.asarray(np.isfinite(found).all(axis=1))


def case_of(log: Log) -> Case:
    """The log as it is read; observations only of one sensor that locates points."""
    r, truth = log.recorded, log.truth
    o, sensor = r.observations, r.sensor
    locates = r.locates_points and len(o.z) > 0
    z = sensor.polar(o.z) if locates else np.zeros((0, 2))
    R = np.diagonal(o.R, axis1=1, axis2=2).copy() if locates else np.zeros((0, 2))
    if locates and sensor.units[1] == "m":
        across = 0.5 * R.sum(axis=1)
        R = np.stack([across, across / np.maximum(z[:, 0], 1e-6) ** 2], axis=1)
    frame = o.frame if locates else np.zeros(0, np.int64)
    ids = log.granted if locates else None
    known = (truth.landmarks if r.known_points is None else r.known_points) if locates else None
    known = known if known is not None and len(known.id) else None
    time = r.time.astype(float)
    mean, spread = r.increments.mean, np.diagonal(r.increments.covariance, axis1=1, axis2=2)
    pose = truth.pose if truth.pose is not None and truth.known_poses > 1 else None
    mount = inverse(np.array([*sensor.translation, sensor.rotation]))
    return Case(
        time, mean, spread, np.array(r.prior.mean), pose, time, frame, time[frame], z, R, mount,
        ids if ids is not None and len(ids) and (ids >= 0).any() else None,
        None if known is None else known.id, None if known is None else known.xy,
        cartesian=locates and sensor.units[1] == "m", stamped=not r.time_is_index,
        kind=str(log.source.get(ODOMETRY_KIND, "velocities")), steps=_steps(log),
    )  # fmt: skip


def _steps(log: Log) -> Array | None:
    """Samples of velocities in each increment (N,); of unknown ones, as many as there are shortest frame intervals."""
    source = log.source
    if source.get(ODOMETRY_KIND, "velocities") != "velocities" or source.get(INTEGRATION, ARCS) != ARCS:
        return None
    gap = np.diff(log.recorded.time, prepend=log.recorded.time[0])
    usual = float(np.quantile(gap[1:], 0.1)) if len(gap) > 1 else 1.0
    period = float(cast("float", source.get(ODOMETRY_PERIOD, usual)))
    return np.maximum(np.round(gap / period), 1.0) if period > 0.0 else np.ones(len(gap))


ARCS = "unicycle"  # the motion model of arcs


@dataclass(frozen=True, eq=False)
class Samples:
    """Which rows each witness compares, chosen once for a log."""

    spans: tuple[tuple[IntArray, IntArray], ...]  # frames
    pairs: tuple[IntArray, IntArray]  # observations of one landmark
    near: tuple[IntArray, IntArray, IntArray]  # observations of two frames, and the first of those of one of the former
    some: IntArray  # observations
    together: tuple[IntArray, IntArray]  # observations in groups, and the first of each group
    soon: IntArray  # observations at the start


SPANS = (1.0, 4.0)  # s, over which two paths are compared: shorter than what odometry drifts, longer than its noise
LAGS = (1.0, 8.0)  # s between two observations of one landmark
SOON = 60  # Observations that are compared with the map from the prior


def samples(c: Case) -> Samples:
    """Rows of a case, evenly over the log."""
    n, m = len(c.time), len(c.z)
    step = float(np.median(np.diff(c.time))) if n > 1 else 1.0
    spans = []
    for span in SPANS:
        k = max(round(span / max(step, 1e-12)), 1) if span / max(step, 1e-12) < 1e6 else 1
        first = _evenly(np.arange(max(n - k, 0)), MOST)
        spans.append((first, first + k))
    return Samples(
        tuple(spans), _same_id(c), _near(c), _evenly(np.arange(m), MOST), _together(c), np.arange(min(SOON, m))
    )


def _evenly(rows: IntArray, most: int) -> IntArray:
    return rows if len(rows) <= most else rows[np.unique(np.linspace(0, len(rows) - 1, most).astype(int))]


def _same_id(c: Case) -> tuple[IntArray, IntArray]:
    """Pairs of observations with one id, the second the first of those that are at least a lag later."""
    none = np.zeros(0, np.int64)
    if c.id is None:
        return none, none
    by = np.lexsort((np.arange(len(c.id)), c.id))
    by = by[c.id[by] >= 0]
    step = float(np.median(np.diff(c.time))) if len(c.time) > 1 else 1.0
    lag = max(LAGS[0], 2.0 * step)
    span = float(c.time[-1] - c.time[0]) + 10.0 * lag
    line = c.id[by] * span + (c.at[by] - c.time[0])  # stamps of all ids on one line, each id behind the one before
    later = np.searchsorted(line, line + lag - 1e-9)
    fine = np.flatnonzero(later < len(by))
    fine = fine[line[later[fine]] - line[fine] <= max(LAGS[1], 8.0 * step)]
    fine = _evenly(fine[np.argsort(c.at[by[fine]], kind="stable")], 2 * MOST)
    return by[fine].astype(np.int64), by[later[fine]].astype(np.int64)


PAIRS = 80  # Pairs of frames whose observations are compared without ids
MANY = 20_000  # Most pairs of observations of them


def _near(c: Case) -> tuple[IntArray, IntArray, IntArray]:
    """All pairs of observations of frames a lag apart, by the first, and where those of each first begin."""
    none = np.zeros(0, np.int64)
    frames, start = np.unique(c.frame, return_index=True)
    if len(frames) < 2:
        return none, none, none
    stop = np.append(start[1:], len(c.frame))
    step = float(np.median(np.diff(c.time[frames])))
    later = np.searchsorted(c.time[frames], c.time[frames] + max(LAGS[0], step) - 1e-9)
    fine = _evenly(np.flatnonzero(later < len(frames)), PAIRS)
    first, second, total = [], [], 0
    for i in fine.tolist():
        j = int(later[i])
        a, b = np.arange(start[i], stop[i]), np.arange(start[j], stop[j])
        total += len(a) * len(b)
        if c.time[frames[j]] - c.time[frames[i]] > max(LAGS[1], 8.0 * step) or total > MANY:
            continue
        first.append(np.repeat(a, len(b)))
        second.append(np.tile(b, len(a)))
    if not first:
        return none, none, none
    a = np.concatenate(first)
    return a, np.concatenate(second), np.flatnonzero(np.append(True, a[1:] != a[:-1]))


GROUP, GROUPS, WINDOW = 4, 60, 5.0  # Landmarks of a group that is laid onto the map; most groups; s of odometry in one


def _together(c: Case) -> tuple[IntArray, IntArray]:
    """Observations in groups of a short time, each with several landmarks."""
    rows, first = list[int](), list[int]()
    if c.id is None or c.names is None:
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    ids, at = c.id.tolist(), c.at.tolist()
    i, groups = 0, list[list[int]]()
    while i < len(ids):
        own, seen, j = list[int](), set[int](), i
        while j < len(ids) and at[j] - at[i] <= WINDOW and (len(seen) < GROUP or at[j] == at[j - 1]):
            if ids[j] >= 0:
                own.append(j)
                seen.add(ids[j])
            j += 1
        if len(seen) >= GROUP:
            groups.append(own)
        i = max(j, i + 1)
    for k in _evenly(np.arange(len(groups)), GROUPS).tolist():
        first.append(len(rows))
        rows += groups[k]
    return np.array(rows, np.int64), np.array(first, np.int64)


def truth_and_odometry(c: Case, s: Samples) -> list[Fit | None]:
    """Motions and turns of the true path and of the odometry, over spans."""
    if c.truth is None or not c.u.any():
        return []
    found: list[Fit | None] = []
    true = c.truth
    if c.truth_time is not c.time:
        moved = _poses_at(c.time, c.truth_time, c.truth)
        if moved is None:
            return []
        true = np.where(moved[1][:, None], moved[0], np.nan)
    total = np.cumsum(c.spread, axis=0)
    for i, j in s.spans:
        a, b = between(true[i], true[j]), between(c.odometry[i], c.odometry[j])
        fine = np.isfinite(a).all(axis=1)
        a, b, variance = a[fine], b[fine], (total[j] - total[i])[fine]
        size, turn = 0.5 * (np.hypot(*a[:, :2].T) + np.hypot(*b[:, :2].T)), 0.5 * (np.abs(a[:, 2]) + np.abs(b[:, 2]))
        of_motion = variance[:, 0] + variance[:, 1] + variance[:, 2] * size**2 / 3.0
        turned = np.asarray(wrap_angle(a[:, 2:] - b[:, 2:]))
        for off, large, noise in (((a - b)[:, :2], size, of_motion), (turned, turn, 2.0 * variance[:, 2])):
            rows = large > np.quantile(large, 0.3) if len(large) else np.zeros(0, bool)
            found.append(fit_of(off[rows], large[rows], noise[rows]))
    return found


ALIKE, GROW, SURE = 1.3, 2.0, 5.0
"""Largest ratio of shares of parts of a way, which noise and drifting headings make unlike; least growth of a part from
a quarter to the whole, smaller of noise and circles; least length over its noise."""


def way_share(moved: Increments, frame: IntArray, place: Array, sigma: float) -> float | None:
    """How far apart places (F, 2) at frames (F,), with errors of `sigma` [m], are of what increments say; None where
    parts of the way tell different shares, or one between half and twice.
    """
    path, shares = dead_reckoned(np.zeros(3), moved.mean)[frame, :2], list[float]()
    spread = np.trace(moved.covariance[:, :2, :2], axis1=1, axis2=2).cumsum()[frame]
    way = np.append(0.0, np.hypot(*np.diff(path, axis=0).T).cumsum())
    for most in (8, 16, 32, 64, 128) if len(path) else ():
        rows = [(i, later[i]) for n in (1, 2, 4) for later in [np.searchsorted(way, way + (way[-1] or 1.0) / most / n)]
                for i in [np.flatnonzero(later < len(path))] if len(i) >= FEWEST]  # fmt: skip
        own, said = ([float(np.median(np.hypot(*(p[j] - p[i]).T))) for i, j in rows] for p in (place, path))
        sure = all(d > SURE * math.sqrt(np.median(spread[j] - spread[i])) for d, (i, j) in zip(said, rows, strict=True))
        if len(rows) < 3 or not sure or said[0] <= GROW * said[2] or (own[0] > said[0] and own[0] <= SURE * sigma):
            continue
        shares = [max(a, 1e-9) / b for a, b in zip(own, said, strict=True)]
        if max(shares) < ALIKE * min(shares):
            return shares[0] if abs(math.log(shares[0])) > math.log(2.0) else None
    return None


def observations_and_map(c: Case, s: Samples) -> list[Fit | None]:
    """How groups of observations lie on the map, wherever the robot is; and from the prior on."""
    if c.places is None or c.along is None:
        return []
    rows, first = s.together
    # a wrong prior is no contradiction: from it only a map that nothing else reads is judged
    found = [] if c.truth is not None or c.id is not None else [placed_at(c, s.soon, c.along, drift=True)]
    if c.id is None or c.names is None or not len(first):
        return found
    place = place_of(c, c.id[rows])
    pose, inside = c.along
    group = np.repeat(np.arange(len(first)), np.diff(np.append(first, len(rows))))
    known = np.isfinite(place).all(axis=1) & inside[rows]
    rows, place, group = rows[known], place[known], group[known]
    if len(rows) < FEWEST:
        return found
    group = np.unique(group, return_inverse=True)[1]
    begin = np.flatnonzero(np.append(True, group[1:] != group[:-1]))
    local = transform_points(between(pose[rows[begin]][group], pose[rows]), c.points(rows, pose[rows, 2]))
    count = np.diff(np.append(begin, len(rows)))[:, None]
    x, y = (p - (np.add.reduceat(p, begin) / count)[group] for p in (local, place))
    turn = np.arctan2(*(np.add.reduceat(v, begin) for v in (x[:, 0] * y[:, 1] - x[:, 1] * y[:, 0], np.sum(x * y, 1))))
    return [*found, fit_of(rotated(turn[group], x) - y, 0.5 * (np.hypot(*x.T) + np.hypot(*y.T)), _of_noise(c, rows))]


BY_TRUTH = "truth and odometry"
WITNESSES: Mapping[str, Callable[[Case, Samples], list[Fit | None]]] = {
    BY_TRUTH: truth_and_odometry,
    # how observed landmarks move in the body frame as the odometry moves, or the true path; where they are by the map
    "observations and odometry": lambda c, s: (
        [_moved(c, s, c.along, c.spread)] if c.u.any() and c.along is not None else []
    ),
    "observations and truth": lambda c, s: (
        [] if c.seen_from is None else [_moved(c, s, c.seen_from, 0.0 * c.spread), placed_at(c, s.some, c.seen_from)]
    ),
    "observations and map": observations_and_map,
}


def _of_noise(c: Case, rows: IntArray) -> Array:
    """Variances (n,) of observed points by the sensor's noise."""
    return np.asarray(c.R[rows, 0] + c.z[rows, 0] ** 2 * c.R[rows, 1])


def place_of(c: Case, ids: IntArray) -> Array:
    """Places (n, 2) of ids by the map, NaN where it has none."""
    assert c.names is not None
    assert c.places is not None  # names and places are of one map
    row = np.clip(np.searchsorted(c.names, ids), 0, len(c.names) - 1)
    return np.where((c.names[row] == ids)[:, None], c.places[row], np.nan)


def _moved(c: Case, s: Samples, path: tuple[Array, BoolArray], spread: Array) -> Fit | None:
    """Changes of observed points in the body frame against those that a path predicts; without ids of the nearest."""
    found = changes(c, s, path, spread)
    return None if found is None else fit_of(found[0], found[1], found[2][:, 0], HALF if by_nearest(c, s) else KEPT)


def by_nearest(c: Case, s: Samples) -> bool:
    """Whether too few observations have ids, so that the nearest are compared."""
    return c.id is None or len(s.pairs[0]) < FEWEST


def changes(c: Case, s: Samples, path: tuple[Array, BoolArray], spread: Array) -> tuple[Array, ...] | None:
    """The differences (n, 2) of the same, sizes (n,), variances (n, 2), and what a displaced sensor adds (n, 2, 2)."""
    alone, first = by_nearest(c, s), s.near[2]
    a, b = s.near[:2] if alone else s.pairs
    if len(a) < FEWEST:
        return None
    pose, inside = path
    rows = np.unique(np.concatenate([a, b]))
    at = np.full(len(c.z), -1)
    at[rows] = np.arange(len(rows))
    points = c.points(rows, pose[rows, 2])
    p, q = points[at[a]], points[at[b]]
    motion = between(pose[a], pose[b])
    predicted = transform_points(inverse(motion), p)
    off = q - predicted
    size = 0.5 * (np.hypot(*(q - p).T) + np.hypot(*(predicted - p).T))
    total = np.cumsum(spread, axis=0)
    grown = total[c.frame[b]] - total[c.frame[a]]
    variance = _of_noise(c, a) + _of_noise(c, b) + grown[:, 0] + grown[:, 1] + grown[:, 2] * np.sum(q**2, axis=1)
    if c.world:  # what is seen is turned by headings that have drifted since the start
        variance = variance + total[c.frame[a], 2] * np.sum((q - p) ** 2, axis=1)
    kept = np.flatnonzero(inside[a] & inside[b])
    if alone:
        d = np.where(inside[a] & inside[b], np.hypot(*off.T), np.inf)
        # the nearest of several is nearer than the same one: what is predicted without noise is compared with chance
        count = np.diff(np.append(first, len(a)))
        # by chance: how far apart they lie, over their number
        size = np.repeat(np.sqrt(np.add.reduceat(np.sum(q**2, axis=1), first)) / count, count)
        nearest = np.flatnonzero(d == np.repeat(np.minimum.reduceat(d, first), count))
        near = nearest[np.searchsorted(nearest, first)]
        kept = near[np.isfinite(d[near])]
    aside = se2.worlds_from_bodies(-motion[kept, 2])[:, :2, :2] - np.eye(2)
    return off[kept], size[kept], np.column_stack([variance, variance])[kept], aside


def placed_at(c: Case, rows: IntArray, path: tuple[Array, BoolArray], *, drift: bool = False) -> Fit | None:
    """Vectors from the robot to landmarks as observed, against those to their places on the map, or to the nearest."""
    if c.places is None or c.names is None or not len(rows):
        return None
    pose, inside = path
    if c.id is not None:
        rows = rows[c.id[rows] >= 0]
    rows = rows[inside[rows]]
    if len(rows) < FEWEST:
        return None
    from_robot = rotated(pose[rows, 2], c.points(rows, pose[rows, 2]))
    variance = _of_noise(c, rows)
    if drift:
        total = np.cumsum(c.spread, axis=0)[c.frame[rows]]
        variance = variance + total[:, 0] + total[:, 1] + total[:, 2] * np.sum(pose[rows, :2] ** 2, axis=1)
    if c.id is not None:
        expected = place_of(c, c.id[rows]) - pose[rows, :2]
        fine = np.isfinite(expected).all(axis=1)
        size = 0.5 * (np.hypot(*from_robot.T) + np.hypot(*expected.T))
        return fit_of((from_robot - expected)[fine], size[fine], variance[fine])
    points = pose[rows, :2] + from_robot
    nearest = np.asarray(scipy.spatial.cKDTree(c.places).query(points)[0])
    # of a map that is far larger than what is seen, one landmark is the nearest of all points
    extent = min(np.mean(np.var(p, axis=0)) for p in (c.places, points))
    spread = math.sqrt(extent / len(c.places)) if len(c.places) > 1 else 1.0
    return fit_of(nearest[:, None], np.full(len(rows), spread), variance)


def rotated(heading: Array, p: Array) -> Array:
    """Points (n, 2), each turned by its heading [rad]."""
    c, s = np.cos(heading), np.sin(heading)
    return np.stack([c * p[:, 0] - s * p[:, 1], s * p[:, 0] + c * p[:, 1]], axis=1)

"""Loop closures of the newest key pose: candidates by uncertainty, search, verification, and acceptance in pairs."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import takewhile

import numpy as np

from data.inputs import Scanner
from data.se2 import Array, between, compose, inverse, pose_error, transform_points, wrap_angle
from wings.laser.scans.constraints import Loops
from wings.laser.scans.matching import MotionPrior, NearestGrid, Pyramid, best_pose, match, pyramid
from wings.laser.scans.occupancy import contradiction
from wings.laser.scans.points import Points, joined
from wings.laser.scans.uncertainty import PoseEdges, compose_covariances, inverse_covariance, nearest_first
from wings.laser.slam.parameters import LaserParameters

NO_PRIOR = np.diag([1.0, 1.0, 1.0])  # Information [1/m^2, 1/rad^2] to keep a match in a corridor solvable: 1 m, 1 rad


@dataclass
class Closure:
    """A loop closure candidate; `believed` as in `Loops`; `refused`: it did not fit, or not precisely."""

    key1: int
    key2: int
    relative: Array
    covariance: Array
    score: float
    believed: int = -1
    refused: bool = False


class LoopCloser:
    """Finds loop closures of each new key pose, and accepts them."""

    def __init__(self, parameters: LaserParameters, scanner: Scanner) -> None:
        self.parameters, self.scanner = parameters, scanner
        self.sigma = parameters.distance_sigma(scanner.sigma)
        self.edges = PoseEdges()
        self.candidates: list[Closure] = []
        self._ranges: list[Array] = []  # of each key scan, as its points in the body frame
        self._points: list[Points] = []
        self._motion: list[Array] = []
        self._grid = NearestGrid(parameters.max_range + 2.0)
        self._pyramids: dict[int, Pyramid] = {}
        self._poses = np.zeros((0, 3))
        self._centres: list[Array] = []  # of each key scan's points, body frame
        self._places = np.zeros((0, 2))  # the same in the world

    def add_key(self, ranges: Array, points: Points, motion: Array, covariance: Array) -> None:
        """Add a key pose: its scan, and the motion from the key pose before (unused for the first)."""
        new = len(self._points)
        if new:
            self.edges.add(new - 1, new, motion, covariance)
        near = np.hypot(points.xy[:, 0], points.xy[:, 1]) < 5.0
        self._centres.append(points.xy[near].mean(axis=0) if near.any() else np.zeros(2))
        self._ranges.append(ranges)
        self._points.append(points)
        self._motion.append(motion)

    def ranges(self, key: int) -> Array:
        """The scan (B,) [m] of a key pose."""
        return self._ranges[key]

    def moved(self, poses: Array) -> None:
        """All key poses (K, 3) are estimated anew."""
        self._places = transform_points(poses[: len(self._points)], np.array(self._centres))

    def find(self, poses: Array) -> list[Closure]:
        """Loop closures accepted now, given all key poses (K, 3); after a new estimate `moved` comes first."""
        p = self.parameters
        self._poses = poses
        newest, there = len(self._points) - 1, len(self._places)
        new = transform_points(poses[there : newest + 1], np.array(self._centres[there:]).reshape(-1, 2))
        self._places = np.concatenate([self._places, new])
        last = newest - p.loop_gap
        if last < 0 or len(self._points[newest].xy) < 10:
            return []
        apart = np.hypot(*(self._places[: last + 1] - self._places[newest]).T)
        old = np.flatnonzero(apart <= p.loop_distance + 2.0 * p.widest)
        apart = apart[old]
        # candidates, whatever their uncertainty: the nearest, if these are enough; others follow from it
        chosen = nearest_first(old, np.where(apart <= p.loop_distance, apart, np.inf), p.loop_apart, p.loops_per_key)
        enough = len(chosen) == p.loops_per_key
        wanted = np.concatenate([chosen if enough else old, np.arange(max(newest - p.wait, 0), newest + 1)])
        known = self.edges.project(newest, wanted)
        if not enough:
            spread = np.sqrt(known[: len(old), 0, 0] + known[: len(old), 1, 1])
            distance = np.where(apart <= p.loop_distance + 2.0 * spread, apart, np.inf)
            chosen = nearest_first(old, distance, p.loop_apart, p.loops_per_key)
        covariance = dict(zip(wanted.tolist(), known, strict=True))
        found: list[Closure] = []
        for key in chosen:
            closure = self._close(int(key), newest, poses, covariance[int(key)])
            (self.candidates if closure.refused else found).append(closure)
        return self._believe(found, covariance)

    def _close(self, key1: int, key2: int, poses: Array, inverted: Array) -> Closure:
        p = self.parameters
        expected = between(poses[key1], poses[key2])
        expected[2] = wrap_angle(float(expected[2]))
        covariance = inverse_covariance(between(poses[key2], poses[key1]), inverted)
        new = self._points[key2]
        around = self._around(key1)
        start = expected
        window = 3.0 * np.sqrt(np.diag(covariance))
        if max(window[0], window[1]) > p.direct_distance or window[2] > p.direct_angle:
            window = np.clip(window, [0.2, 0.2, 0.1], [p.widest, p.widest, math.pi])
            if key1 not in self._pyramids:
                self._pyramids[key1] = pyramid(around.xy, 12.0)
                if len(self._pyramids) > 64:
                    del self._pyramids[next(iter(self._pyramids))]
            xy = new.xy
            xy = xy[np.hypot(xy[:, 0], xy[:, 1]) < 10.0]
            xy = xy[:: max(len(xy) // 90, 1)]
            start, score = best_pose(xy, self._pyramids[key1], expected, window, p.least_correlation)
            if score == 0.0:  # nowhere in the window: only the expectation is known
                return Closure(key1, key2, expected, covariance, 0.0, refused=True)
        reference = self._grid.reference(around.xy, around.normal)
        result = match(new, reference, start, MotionPrior(start, NO_PRIOR), self.sigma, 1e3)
        against = contradiction(self._ranges[key1], self._ranges[key2], result.pose, self.scanner, p.max_range)
        error = pose_error(result.pose, expected)
        d2 = error @ np.linalg.solve(covariance + result.covariance, error)
        loose = np.linalg.eigvalsh(result.covariance[:2, :2])[1] > p.variance_scale * p.loosest**2
        misfit = result.share < p.loop_share or against > p.most_contradiction or d2 > p.gate
        return Closure(key1, key2, result.pose, result.covariance, result.share, refused=bool(loose or misfit))

    def _around(self, key: int) -> Points:
        """Points of the key scans within two of `key`, in its frame, along the chain."""
        parts = [self._points[key]]
        for way in (-1, 1):
            pose = np.zeros(3)
            k = key
            for _ in range(self.parameters.loop_around):
                k += way
                if k < 0 or k >= len(self._points) - self.parameters.loop_gap // 2:
                    break
                pose = compose(pose, inverse(self._motion[k + 1]) if way < 0 else self._motion[k])
                parts.append(self._points[k].seen_from(pose))
        return joined(parts)

    def _believe(self, found: list[Closure], from_newest: Mapping[int, Array]) -> list[Closure]:
        """Accept new and waiting closures that agree in pairs (Olson 2009)."""
        p = self.parameters
        newest = len(self._points) - 1
        believed: list[Closure] = []
        for new in found:
            from_key1 = None
            for old in reversed(self.candidates):
                if newest - old.key2 > p.wait:
                    break
                if old.refused or old.key2 == new.key2 or (old.believed >= 0 and new.believed >= 0):
                    continue
                if from_key1 is None:
                    late = takewhile(lambda c: newest - c.key2 <= p.wait, reversed(self.candidates))
                    first = np.unique([c.key1 for c in late])
                    from_key1 = dict(zip(first.tolist(), self.edges.project(new.key1, first), strict=True))
                if self._disagreement(new, old, from_key1[old.key1], from_newest[old.key2]) < p.pair_gate:
                    for c in (old, new):
                        if c.believed < 0:
                            c.believed = newest
                            believed.append(c)
            self.candidates.append(new)
        for c in believed:
            self.edges.add(c.key1, c.key2, c.relative, c.covariance)
        return believed

    def _disagreement(self, new: Closure, old: Closure, between_first: Array, between_second: Array) -> float:
        """Chi-square of the circle through two closures, given the uncertainty between their ends."""
        # new.key1 -> new.key2 by the one closure; new.key1 -> old.key1 -> old.key2 -> new.key2 by the other
        there = between(self._poses[new.key1], self._poses[old.key1])
        last = between(self._poses[old.key2], self._poses[new.key2])
        way = compose(there, old.relative)
        covariance = compose_covariances(there, between_first, old.relative, old.covariance)
        step = inverse_covariance(inverse(last), between_second)
        covariance = compose_covariances(way, covariance, last, step) + new.covariance
        error = pose_error(compose(way, last), new.relative)
        return float(error @ np.linalg.solve(covariance, error))

    def loops(self) -> Loops:
        """All closures in the order in which they were found."""
        c = self.candidates
        return Loops(
            np.array([x.key1 for x in c], np.int64), np.array([x.key2 for x in c], np.int64),
            np.array([x.relative for x in c]).reshape(-1, 3), np.array([x.covariance for x in c]).reshape(-1, 3, 3),
            np.array([x.score for x in c]), np.array([x.believed for x in c], np.int64),
        )  # fmt: skip

"""Corners of walls in a scan as point landmarks with covariances: the intersection of two fitted straight lines.

A scan is cut where it is not continuous, then at the points farthest from chords (iterative end-point fit; Nguyen,
Gächter, Martinelli, Tomatis, Siegwart, "A comparison of line extraction algorithms using 2D range data for indoor
mobile robotics", Autonomous Robots 23, 2007). Lines are fitted with the range noise along their normals, and their
covariance is propagated to the intersection. The intersection is stable even where one line ends before the other.
"""

import math
from typing import NamedTuple

import numpy as np

from data.compiled import njit
from data.inputs import UNLABELLED, IntArray, Observations, Scanner, Scans
from data.se2 import Array, transform_points
from wings.laser.scans.points import beams_of

LONGEST_STEP, STEP_SPACINGS = 0.3, 4.0  # m, and in beam spacings: points further apart than both are not on one surface
SPLIT, SPLIT_SIGMAS = 0.05, 5.0
"""m, and sigmas of the range: a chord is cut at a point further off than both; 5 sigma of the range are 3 of the
difference of three noisy points."""
TRIM = 0.1
"""m about a corner and the other end of a line, whose points are ignored: noise decides which line they seem to be on.
NEES / 2 of simulated corners is 1.01, with 0.05 m 1.19."""
SHORTEST, FEWEST = 0.25, 5  # m and points that a line needs; with 0.5 m and 6 points a quarter of the corners is lost
STEEPEST = math.sin(math.radians(45.0))  # sine of the least angle between two lines
REACH = 0.25  # m from the corner to the nearest point of each line, at most, besides two of their spacings
WORST_FIT = 3.0  # largest mean squared residual of a line in sigmas; a straight wall of 5 points passes in 97 %


def corners(ranges: Array, scanner: Scanner) -> tuple[Array, Array]:
    """Corners of one scan: xy (m, 2) in the body frame [m], and their covariances R (m, 2, 2), in the order of beams.
    `ranges` (B,) m; 0, NaN or max_range and beyond: no return. R is proportional to the scanner's range variance.
    """
    direction, step, origin = beams_of(scanner, len(ranges))
    r = np.array(ranges, np.float64, order="C")
    seen = (r > 0.0) & (r < scanner.max_range)
    p = origin + np.where(seen, r, 0.0)[:, None] * direction
    gap, near = np.hypot(*(p[1:] - p[:-1]).T), np.minimum(r[1:], r[:-1])
    apart = ~(seen[1:] & seen[:-1]) | (gap > np.maximum(LONGEST_STEP, STEP_SPACINGS * step * near))
    xy, R = list[Array](), list[Array]()
    for surface in np.split(np.arange(len(r)), np.flatnonzero(apart) + 1):
        if not seen[surface[0]]:
            continue
        vertex = _vertices(p, r, step, max(SPLIT, SPLIT_SIGMAS * scanner.sigma), surface[0], surface[-1])
        for before, at, after in zip(vertex, vertex[1:], vertex[2:], strict=False):
            c, middle, found = p[at], at, None
            # about the farthest point, then about the intersection, without the noise of a single point
            for _ in range(2):
                one, two = (_line(p, direction, outer, middle, c, scanner.sigma) for outer in (before, after))
                found = _meet(one, two) if one is not None and two is not None else None
                if found is None:
                    break
                c = found[0]
                middle = before + int(np.argmax(direction[before : after + 1] @ (c - origin)))  # its beam
            # a line that does not come near the corner could not be recognized
            if found is not None and all(
                math.hypot(*(p[line.near] - c)) <= REACH + 2.0 * step * r[line.near] for line in (one, two) if line
            ):
                xy.append(found[0])
                R.append(found[1])
    return np.array(xy).reshape(-1, 2), np.array(R).reshape(-1, 2, 2)


@njit
def _farthest(p: Array, a: int, b: int) -> tuple[int, float]:
    """The point between two that is farthest from their chord, and its distance."""
    ex, ey = p[b, 0] - p[a, 0], p[b, 1] - p[a, 1]
    length = max(math.hypot(ex, ey), 1e-9)
    worst, where = -1.0, a
    for i in range(a + 1, b):
        off = abs((p[i, 0] - p[a, 0]) * ey - (p[i, 1] - p[a, 1]) * ex) / length
        if off > worst:
            worst, where = off, i
    return where, worst


def _vertices(p: Array, ranges: Array, step: float, tolerance: float, first: int, last: int) -> list[int]:
    """The vertices of a polyline that fits the points, ends included: split at the farthest point from a chord,
    repeatedly; then each is removed if its neighbours' chord is near enough, or moved to the farthest point from that.
    Two that are too close for a line between them become one corner.
    """
    vertex, v = [int(first), int(last)], 0
    while v < len(vertex) - 1:
        where, worst = _farthest(p, vertex[v], vertex[v + 1])
        if worst <= tolerance:
            v += 1
        else:
            vertex.insert(v + 1, where)
    v = 1
    while v < len(vertex) - 1:
        where, worst = _farthest(p, vertex[v - 1], vertex[v + 1])
        if worst > tolerance:
            vertex[v] = where
            v += 1
        else:
            del vertex[v]
            v = max(v - 1, 1)
    v = 1
    while v < len(vertex) - 2:
        a, b = vertex[v], vertex[v + 1]
        if math.hypot(p[b, 0] - p[a, 0], p[b, 1] - p[a, 1]) > max(TRIM, STEP_SPACINGS * step * ranges[a]):
            v += 1
        else:
            vertex[v : v + 2] = [_farthest(p, vertex[v - 1], vertex[v + 2])[0]]
    return vertex


class _Line(NamedTuple):
    """A straight line."""

    normal: Array  # (2,)
    centroid: Array  # (2,) m, weighted
    angle: float  # its variance
    offset: float  # variance of the offset at the centroid, independent of the angle
    near: int  # number of the point nearest to the corner


def _line(p: Array, direction: Array, outer: int, middle: int, c: Array, sigma: float) -> _Line | None:
    """The line through the points between a vertex and the beam of corner c; None if they make no good one."""
    towards = 1 if outer > middle else -1
    row = np.arange(middle, outer, towards)
    fine = row[(np.hypot(*(p[row] - c).T) > TRIM) & (np.hypot(*(p[row] - p[outer]).T) > TRIM)]
    if len(fine) < FEWEST:
        return None
    near, far = int(fine[0]), int(fine[-1])
    way = p[far] - p[near]
    if math.hypot(*way) < SHORTEST:
        return None
    row = np.arange(near, far + towards, towards)
    angle = math.atan2(way[1], way[0]) + 0.5 * math.pi
    for _ in range(3):  # Gauss-Newton; the third step is rounding
        normal = np.array([math.cos(angle), math.sin(angle)])
        w = 1.0 / np.square(np.maximum(np.abs(direction[row] @ normal), 0.02) * sigma)
        centroid = w @ p[row] / w.sum()
        off, along = (p[row] - centroid) @ normal, (p[row] - centroid) @ (-normal[1], normal[0])
        precision = float(w @ along**2)
        angle -= float(w @ (along * off)) / precision
    if float(w @ off**2) > WORST_FIT * (abs(far - near) - 1):
        return None
    return _Line(np.array([math.cos(angle), math.sin(angle)]), centroid, 1.0 / precision, 1.0 / float(w.sum()), near)


def _meet(one: _Line, two: _Line) -> tuple[Array, Array] | None:
    """The intersection (2,) of two lines with its covariance (2, 2); None if they are too parallel.

    N c = (n1 m1, n2 m2), rows of N the normals; S = N^-1 diag(v) N^-T with v = var(offset) + (n' (c - m))^2 var(angle)
    of either line, n' along the line.
    """
    N = np.array([one.normal, two.normal])
    if abs(N[0, 0] * N[1, 1] - N[0, 1] * N[1, 0]) < STEEPEST:
        return None
    back = np.linalg.inv(N)
    c = back @ [one.normal @ one.centroid, two.normal @ two.centroid]
    t = [(c - line.centroid) @ (-line.normal[1], line.normal[0]) for line in (one, two)]
    return c, (back * np.array([line.offset + t[i] ** 2 * line.angle for i, line in enumerate((one, two))])) @ back.T


def corners_at(scans: Scans, frames: IntArray) -> Observations:
    """Corners (body frame) of the scans at key poses (K,), which are numbered from 0; a key without a scan has none."""
    seen = [(k, *corners(r, scans.scanner)) for k, f in enumerate(frames) if (r := scans.of(int(f))) is not None]
    z = np.concatenate([np.empty((0, 2)), *(xy for _, xy, _ in seen)])
    R = np.concatenate([np.empty((0, 2, 2)), *(R for _, _, R in seen)])
    return Observations(np.repeat(np.array([k for k, _, _ in seen], np.int64), [len(xy) for _, xy, _ in seen]), z, R)


SAME = 0.05
"""m between corners of two scans that are one corner: three times their spread, half a wall's thickness. Up to twice as
far apart it is unclear."""


def corner_labels(seen: Observations, pose: Array) -> IntArray:
    """Which corners (M,) are the same by the poses (K, 3) of their frames: numbers from 0, `UNLABELLED` where unclear.
    Frame by frame each takes the nearest corner so far within `SAME` that no other of its scan has taken.
    """
    place, count = np.empty((0, 2)), np.empty(0)
    label = np.full(len(seen.frame), UNLABELLED, np.int64)
    for frame in np.unique(seen.frame).tolist():
        rows = np.flatnonzero(seen.frame == frame)
        world = transform_points(pose[frame], seen.z[rows])
        apart = np.full((len(rows), 1), np.inf)
        if len(place):
            apart = np.hypot(*(world[:, None] - place[None]).transpose(2, 0, 1))
        nearest, least = apart.argmin(axis=1), apart.min(axis=1)
        taken: set[int] = set()
        for i in np.argsort(least, kind="stable").tolist():
            k = int(nearest[i])
            if least[i] <= SAME and k not in taken:
                taken.add(k)
                label[rows[i]] = k
                count[k] += 1.0
                place[k] += (world[i] - place[k]) / count[k]
            elif least[i] > 2.0 * SAME:
                label[rows[i]] = len(place)
                place, count = np.concatenate([place, world[i : i + 1]]), np.append(count, 1.0)
    return label

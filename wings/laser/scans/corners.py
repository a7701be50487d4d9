"""Corners of walls in a scan as point landmarks with covariances: the intersection of two fitted straight lines.

A scan is cut where it is not continuous, then at the points farthest from chords (iterative end-point fit; Nguyen,
Gächter, Martinelli, Tomatis, Siegwart, "A comparison of line extraction algorithms using 2D range data for indoor
mobile robotics", Autonomous Robots 23, 2007). Lines are fitted with the range noise along their normals, and their
covariance is propagated to the intersection. The intersection is stable even where one line ends before the other.
"""

from __future__ import annotations

import math

import numpy as np

from data.compiled import njit
from data.inputs import UNLABELLED, IntArray, Observations, Scanner, Scans
from data.se2 import Array, transform_points
from wings.laser.scans.points import Beams, beams_of

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
    n = len(ranges)
    beams = beams_of(scanner, n)
    xy, R = np.empty((n, 2)), np.empty((n, 2, 2))
    m = _corners(np.array(ranges, np.float64, order="C"), beams, scanner.max_range, scanner.sigma, xy, R)
    return xy[:m].copy(), R[:m].copy()


@njit
def _corners(ranges: Array, beams: Beams, max_range: float, sigma: float, xy: Array, R: Array) -> int:
    """Fill xy and R; returns the number of corners."""
    direction, origin, step = beams.direction, beams.origin, beams.step
    n, count = len(ranges), 0
    p = np.empty((n, 2))
    for i in range(n):
        p[i, 0] = origin[0] + ranges[i] * direction[i, 0]
        p[i, 1] = origin[1] + ranges[i] * direction[i, 1]
    vertex = np.empty(n, np.int64)
    one, two, c, S = np.empty(8), np.empty(8), np.empty(2), np.empty((2, 2))
    begin = 0
    while begin < n:
        if not 0.0 < ranges[begin] < max_range:
            begin += 1
            continue
        end = begin + 1
        while end < n and 0.0 < ranges[end] < max_range:
            gap = math.hypot(p[end, 0] - p[end - 1, 0], p[end, 1] - p[end - 1, 1])
            if gap > max(LONGEST_STEP, STEP_SPACINGS * step * min(ranges[end], ranges[end - 1])):
                break
            end += 1
        vertex[0], vertex[1] = begin, end - 1
        vertices = _vertices(p, ranges, step, max(SPLIT, SPLIT_SIGMAS * sigma), vertex)
        for v in range(1, vertices - 1):
            before, at, after = vertex[v - 1], vertex[v], vertex[v + 1]
            c[0], c[1] = p[at, 0], p[at, 1]
            middle, met = at, True
            # about the farthest point, then about the intersection, without the noise of a single point
            for _ in range(2):
                met = met and _line(p, direction, before, middle, c, sigma, one)
                met = met and _line(p, direction, after, middle, c, sigma, two)
                met = met and _meet(one, two, c, S)
                middle = _beam_of(c, origin, direction, before, after)
            if met and _ends_near(p, one, c, step, ranges) and _ends_near(p, two, c, step, ranges):
                for i in range(2):
                    xy[count, i], R[count, i, 0], R[count, i, 1] = c[i], S[i, 0], S[i, 1]
                count += 1
        begin = end
    return count


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


@njit
def _vertices(p: Array, ranges: Array, step: float, tolerance: float, vertex: IntArray) -> int:
    """Fill `vertex` with the vertices of a polyline that fits the points from vertex[0] to vertex[1], ends included;
    returns their number.

    Split at the farthest point from a chord, repeatedly. Then remove each vertex whose neighbours' chord is near
    enough, or move it to the farthest point from that chord. Two vertices too close for a line between them become one
    corner.
    """
    count, v = 2, 0
    while v < count - 1:
        where, worst = _farthest(p, vertex[v], vertex[v + 1])
        if worst <= tolerance:
            v += 1
            continue
        for k in range(count, v + 1, -1):
            vertex[k] = vertex[k - 1]
        vertex[v + 1] = where
        count += 1
    v = 1
    while v < count - 1:
        where, worst = _farthest(p, vertex[v - 1], vertex[v + 1])
        if worst > tolerance:
            vertex[v] = where
            v += 1
            continue
        for k in range(v, count - 1):
            vertex[k] = vertex[k + 1]
        count -= 1
        v = max(v - 1, 1)
    v = 1
    while v < count - 2:
        a, b = vertex[v], vertex[v + 1]
        if math.hypot(p[b, 0] - p[a, 0], p[b, 1] - p[a, 1]) > max(TRIM, STEP_SPACINGS * step * ranges[a]):
            v += 1
            continue
        vertex[v], _ = _farthest(p, vertex[v - 1], vertex[v + 2])
        for k in range(v + 1, count - 1):
            vertex[k] = vertex[k + 1]
        count -= 1
    return count


@njit
def _line(p: Array, direction: Array, outer: int, middle: int, c: Array, sigma: float, line: Array) -> bool:
    """Fit the points between a vertex and the beam of the corner c; false if they make no good line.

    Fills line: normal (2), centroid (2), variances of its angle and its offset there, first and last point's number
    from the corner. The residual of a point is its offset n (p - m); its sigma that of the range times |n d|. The
    centroid is weighted, so that angle and offset are independent.
    """
    towards = 1 if outer > middle else -1
    near, far, k = -1, -1, 0
    for j in range(abs(outer - middle)):
        i = middle + towards * j
        from_corner = math.hypot(p[i, 0] - c[0], p[i, 1] - c[1])
        if from_corner > TRIM and math.hypot(p[i, 0] - p[outer, 0], p[i, 1] - p[outer, 1]) > TRIM:
            near, far = i if near < 0 else near, i
            k += 1
    if k < FEWEST or math.hypot(p[far, 0] - p[near, 0], p[far, 1] - p[near, 1]) < SHORTEST:
        return False
    angle = math.atan2(p[far, 1] - p[near, 1], p[far, 0] - p[near, 0]) + 0.5 * math.pi
    mx, my, sw, stt, square = 0.0, 0.0, 0.0, 0.0, 0.0
    for _ in range(3):  # Gauss-Newton; the third step is rounding
        nx, ny = math.cos(angle), math.sin(angle)
        sw, mx, my = 0.0, 0.0, 0.0
        for i in range(near, far + towards, towards):
            seen = max(abs(nx * direction[i, 0] + ny * direction[i, 1]), 0.02) * sigma
            w = 1.0 / (seen * seen)
            sw += w
            mx += w * p[i, 0]
            my += w * p[i, 1]
        mx /= sw
        my /= sw
        stt, stn, square = 0.0, 0.0, 0.0
        for i in range(near, far + towards, towards):
            seen = max(abs(nx * direction[i, 0] + ny * direction[i, 1]), 0.02) * sigma
            w = 1.0 / (seen * seen)
            x, y = p[i, 0] - mx, p[i, 1] - my
            t, off = -ny * x + nx * y, nx * x + ny * y
            stt += w * t * t
            stn += w * t * off
            square += w * off * off
        angle -= stn / stt
    if square > WORST_FIT * (abs(far - near) - 1):
        return False
    line[0], line[1], line[2], line[3] = math.cos(angle), math.sin(angle), mx, my
    line[4], line[5], line[6], line[7] = 1.0 / stt, 1.0 / sw, near, far
    return True


@njit
def _meet(one: Array, two: Array, c: Array, S: Array) -> bool:
    """Fill c (2,) with the intersection of two lines and S (2, 2) with its covariance; false if they are too parallel.

    N c = (n1 m1, n2 m2), rows of N the normals; S = N^-1 diag(v) N^-T with v = var(offset) + (n' (c - m))^2 var(angle)
    of either line, n' along the line.
    """
    det = one[0] * two[1] - one[1] * two[0]
    if abs(det) < STEEPEST:
        return False
    b1, b2 = one[0] * one[2] + one[1] * one[3], two[0] * two[2] + two[1] * two[3]
    c[0], c[1] = (two[1] * b1 - one[1] * b2) / det, (one[0] * b2 - two[0] * b1) / det
    t1 = -one[1] * (c[0] - one[2]) + one[0] * (c[1] - one[3])
    t2 = -two[1] * (c[0] - two[2]) + two[0] * (c[1] - two[3])
    v1, v2 = one[5] + t1 * t1 * one[4], two[5] + t2 * t2 * two[4]
    S[0, 0] = (two[1] * two[1] * v1 + one[1] * one[1] * v2) / (det * det)
    S[1, 1] = (two[0] * two[0] * v1 + one[0] * one[0] * v2) / (det * det)
    S[0, 1] = S[1, 0] = -(two[0] * two[1] * v1 + one[0] * one[1] * v2) / (det * det)
    return True


@njit
def _beam_of(c: Array, origin: Array, direction: Array, first: int, last: int) -> int:
    """The beam between two whose direction is nearest to that of a point."""
    best, where = -2.0, first
    x, y = c[0] - origin[0], c[1] - origin[1]
    for i in range(first, last + 1):
        along = x * direction[i, 0] + y * direction[i, 1]
        if along > best or i == first:
            best, where = along, i
    return where


@njit
def _ends_near(p: Array, line: Array, c: Array, step: float, ranges: Array) -> bool:
    """Whether a line comes near the corner; otherwise it cannot be recognized."""
    i = int(line[6])
    return bool(math.hypot(p[i, 0] - c[0], p[i, 1] - c[1]) <= REACH + 2.0 * step * ranges[i])


def corners_at(scans: Scans, frames: IntArray) -> Observations:
    """Corners (body frame) of the scans at key poses (K,), which are numbered from 0; a key without a scan has none."""
    seen = [(k, *corners(r, scans.scanner)) for k, f in enumerate(frames) if (r := scans.of(int(f))) is not None]
    z = np.concatenate([np.empty((0, 2)), *(xy for _, xy, _ in seen)])
    R = np.concatenate([np.empty((0, 2, 2)), *(R for _, _, R in seen)])
    frame = np.repeat(np.array([k for k, _, _ in seen], np.int64), [len(xy) for _, xy, _ in seen])
    return Observations(frame, z, R)


SAME = 0.05
"""m between corners of two scans that are one corner: three times their spread, half a wall's thickness. Up to twice as
far apart it is unclear."""


def corner_labels(seen: Observations, pose: Array) -> IntArray:
    """Which corners (M,) are the same by the poses (K, 3) of their frames: numbers from 0, `UNLABELLED` where unclear.

    In the order of the frames each takes the nearest corner so far within `SAME`, the nearest first, where no other of
    its scan has taken it.
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

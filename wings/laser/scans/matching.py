"""Scan matching: multi-resolution correlative matching over a window, then point-to-line matching.

Correlative matching gives the best pose of a whole window (Olson 2009b; Hess et al. 2016). Point-to-line matching has
robust residuals and a robust motion prior (Censi 2008; Cauchy weights by IRLS), with a grid of the nearest reference
point of each cell instead of a search. Along walls that nothing crosses the prior alone counts (Zhang et al. 2016).
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from data.compiled import njit
from data.inputs import IntArray
from data.se2 import Array, wrap_angle
from wings.laser.scans.points import Points

CELL = 0.1  # m, of the finest grid; point-to-line matching converges from there
SPREAD = 0.1  # m, standard deviation of the score around each reference point
LEVELS = 6  # grids, each pooled over twice the cells of the one before: the coarsest covers 3.2 m
HIGHEST = 100  # score of a cell at a reference point


class Pyramid(NamedTuple):
    """Scores (LEVELS, n, n) uint8 about the frame's origin; at (h, i, j) the maximum of the 2^h cells from there."""

    grid: NDArray[np.uint8]
    half: float


def pyramid(xy: Array, half: float) -> Pyramid:
    """Score grids of reference points (P, 2) inside a square of -half .. half metres."""
    side = 2 * math.ceil(half / CELL)
    return Pyramid(_pyramid(xy, side), 0.5 * side * CELL)


def best_pose(points: Array, reference: Pyramid, centre: Array, window: Array, least: float) -> tuple[Array, float]:
    """The pose (3,) of the points (n, 2) within centre (3,) +- window (3,) [m, m, rad] of highest score, and its score.

    The score is the mean value of the cells the points fall on, 0 to 1; below `least` it is returned as 0. Branch and
    bound: exact on its grid of poses (cells of `CELL`; angles by which the farthest points move one cell).
    """
    step = CELL / max(math.sqrt(float((points**2).sum(axis=1).max(initial=1.0))), 1.0)
    turns = math.ceil(window[2] / step)
    angles = centre[2] + step * np.arange(-turns, turns + 1)
    reach = np.ceil(window[:2] / CELL).astype(np.int64)
    floor = least * len(points) * HIGHEST
    points = np.ascontiguousarray(points)  # one compiled version for all layouts
    best, score = _search(points, reference.grid, reference.half, centre, angles, reach, floor)
    return best, score / max(len(points) * HIGHEST, 1)


@njit
def _pyramid(xy: Array, side: int) -> NDArray[np.uint8]:
    grid = np.zeros((LEVELS, side, side), np.uint8)
    half = 0.5 * side * CELL
    r = math.ceil(2.0 * SPREAD / CELL)
    for k in range(len(xy)):
        x, y = xy[k, 0] + half, xy[k, 1] + half
        ci, cj = math.floor(x / CELL), math.floor(y / CELL)
        for i in range(max(ci - r, 0), min(ci + r + 1, side)):
            for j in range(max(cj - r, 0), min(cj + r + 1, side)):
                dx, dy = (i + 0.5) * CELL - x, (j + 0.5) * CELL - y
                value = int(HIGHEST * math.exp(-0.5 * (dx * dx + dy * dy) / (SPREAD * SPREAD)))
                if value > grid[0, i, j]:
                    grid[0, i, j] = value
    for h in range(1, LEVELS):
        jump = 1 << (h - 1)
        for i in range(side):
            i2 = min(i + jump, side - 1)
            for j in range(side):
                j2 = min(j + jump, side - 1)
                a = max(grid[h - 1, i, j], grid[h - 1, i2, j])
                b = max(grid[h - 1, i, j2], grid[h - 1, i2, j2])
                grid[h, i, j] = max(a, b)
    return grid


@njit
def _score(cells: IntArray, a: int, grid: NDArray[np.uint8], level: int, bx: int, by: int) -> int:
    side = grid.shape[1]
    reach = 1 << level
    total = np.int64(0)  # of a sum that begins with 0, numpy makes one of bytes, and it overflows
    for k in range(cells.shape[1]):
        i, j = cells[a, k, 0] + bx, cells[a, k, 1] + by
        if i <= -reach or j <= -reach or i >= side or j >= side:
            continue
        total += grid[level, max(i, 0), max(j, 0)]
    return int(total)


@njit
def _search(
    points: Array, grid: NDArray[np.uint8], half: float, centre: Array, angles: Array, reach: IntArray, floor: float
) -> tuple[Array, float]:
    reach_x, reach_y = reach[0], reach[1]
    n = len(points)
    top = 0
    while top < LEVELS - 1 and (1 << (top + 1)) <= 2 * max(reach_x, reach_y) + 1:
        top += 1
    size = 1 << top
    nx, ny = (2 * reach_x + size) // size, (2 * reach_y + size) // size
    cells = np.empty((len(angles), n, 2), np.int64)
    bound = np.empty(len(angles) * nx * ny, np.int64)
    for a in range(len(angles)):
        c, s = math.cos(angles[a]), math.sin(angles[a])
        for k in range(n):
            x = c * points[k, 0] - s * points[k, 1] + centre[0] + half
            y = s * points[k, 0] + c * points[k, 1] + centre[1] + half
            cells[a, k, 0], cells[a, k, 1] = math.floor(x / CELL), math.floor(y / CELL)
        for p in range(nx):
            for q in range(ny):
                bound[(a * nx + p) * ny + q] = _score(cells, a, grid, top, p * size - reach_x, q * size - reach_y)
    # the highest bound first, equal ones as they come: a score is a whole number
    begin, order = np.zeros(HIGHEST * n + 2, np.int64), np.empty(len(bound), np.int64)
    for i in range(len(bound)):
        begin[HIGHEST * n - bound[i] + 1] += 1
    for v in range(HIGHEST * n):
        begin[v + 1] += begin[v]
    for i in range(len(bound)):
        v = HIGHEST * n - bound[i]
        order[begin[v]] = i
        begin[v] += 1
    best, pose, found = floor, np.empty(3), False
    for i in range(3):
        pose[i] = centre[i]
    stack = np.empty((4 * LEVELS + 4, 4), np.int64)
    four = np.empty((4, 3), np.int64)
    for o in order:
        if bound[o] <= best:
            break
        a, p, q = o // (nx * ny), (o // ny) % nx, o % ny
        stack[0, 0], stack[0, 1], stack[0, 2], stack[0, 3] = top, p * size - reach_x, q * size - reach_y, bound[o]
        depth = 1
        while depth > 0:
            depth -= 1
            level, bx, by, value = stack[depth, 0], stack[depth, 1], stack[depth, 2], stack[depth, 3]
            if value <= best:
                continue
            if level == 0:
                best = value
                found = True
                pose[0], pose[1], pose[2] = centre[0] + bx * CELL, centre[1] + by * CELL, angles[a]
                continue
            jump = 1 << (level - 1)
            m = 0
            for i in range(2):
                for j in range(2):
                    x, y = bx + i * jump, by + j * jump
                    if x > reach_x or y > reach_y:
                        continue
                    v = _score(cells, a, grid, level - 1, x, y)
                    t = m
                    while t > 0 and four[t - 1, 0] > v:
                        four[t, 0], four[t, 1], four[t, 2] = four[t - 1, 0], four[t - 1, 1], four[t - 1, 2]
                        t -= 1
                    four[t, 0], four[t, 1], four[t, 2] = v, x, y
                    m += 1
            for t in range(m):
                stack[depth, 0], stack[depth, 1], stack[depth, 2] = level - 1, four[t, 1], four[t, 2]
                stack[depth, 3] = four[t, 0]
                depth += 1
    return pose, (best if found else 0)


LOOKUP_CELL = 0.05  # m; the nearest point is that of the cell's centre, half a cell off at most
REACH = 0.3  # m, the farthest partner of a point


class Reference(NamedTuple):
    """Points (P, 2) with normals (P, 2) in one frame, and a grid of -half .. half metres about the frame's origin."""

    xy: Array
    normal: Array
    nearest: NDArray[np.int32]  # (n, n) number of the point nearest to the cell's centre, -1 beyond `REACH`
    half: float


class NearestGrid:
    """Makes a `Reference` on one reused grid; it is valid until the next is made."""

    def __init__(self, half: float) -> None:
        side = 2 * int(np.ceil(half / LOOKUP_CELL))
        self.half = 0.5 * side * LOOKUP_CELL
        self._index = np.full((side, side), -1, np.int32)
        self._distance = np.full((side, side), np.inf, np.float32)
        self._drawn = np.zeros((0, 2))

    def reference(self, xy: Array, normal: Array) -> Reference:
        """Index points (P, 2) with normals (P, 2); those outside the grid are never found."""
        for points, clear in ((self._drawn, True), (xy, False)):
            _draw(self._index, self._distance, points, self.half, clear)
        self._drawn = xy
        return Reference(xy, normal, self._index, self.half)


@njit
def _draw(index: NDArray[np.int32], distance: NDArray[np.float32], xy: Array, half: float, clear: bool) -> None:
    """Enter points (P, 2) into the cells within `REACH`, or `clear` these."""
    cell = LOOKUP_CELL
    side, r = len(index), int(np.ceil(REACH / cell))
    for k in range(len(xy)):
        x, y = xy[k, 0] + half, xy[k, 1] + half
        ci, cj = int(np.floor(x / cell)), int(np.floor(y / cell))
        for i in range(max(ci - r, 0), min(ci + r + 1, side)):
            dx = (i + 0.5) * cell - x
            for j in range(max(cj - r, 0), min(cj + r + 1, side)):
                if clear:
                    index[i, j], distance[i, j] = -1, np.inf
                    continue
                dy = (j + 0.5) * cell - y
                d = np.float32(dx * dx + dy * dy)
                if d <= REACH * REACH and d < distance[i, j]:
                    distance[i, j] = d
                    index[i, j] = k


SAME_SIDE = 0.5  # smallest cosine between normals of one surface (60 degrees), which excludes the other side of a wall
WIDE, NARROW = 0.3, 0.03  # m, Cauchy scale of the first and of later iterations: converge, then weight good pairs
ITERATIONS = 30
FIXED = 0.01
"""Mean of the squared parts of the normals along a direction, below which they do not fix it: they are noise, or parts
of the robot in its own view. Simulated bare walls have 0.0001 to 0.0024 (ranges noisy by 1 to 3 cm), a real corridor
0.004 to 0.008, far end walls 0.024 and more, rooms 0.03 to 0.5. With half and twice as much a recorded path of 31.9 m
becomes 32.0 and 32.1 m (29.7 without), and the mean error of the Intel log is 0.0185 m alike.
"""
SMALL_STEP = 1e-5  # m and rad: a smaller step ends the iterations; a hundredth of the standard deviation of a match


class MotionPrior(NamedTuple):
    """Prior of the pose before matching: mean (3,), information (3, 3), in the reference's frame."""

    mean: Array
    information: Array


class Match(NamedTuple):
    """Pose of a scan in the frame of the reference."""

    pose: Array  # (3,) of the body
    covariance: Array  # (3, 3) of its additive error, unscaled: from the Hessian, points independent with `sigma`
    cost: float  # robust cost of the points alone per point, at most 1; smaller is better
    share: float  # of the scan's points, those with a partner nearer than twice `NARROW` across its surface
    least: float = 1.0  # mean square of the points' normals along the direction that they fix least


def match(
    points: Points, reference: Reference, start: Array, prior: MotionPrior, sigma: float, prior_scale: float,
    least: float = FIXED,
) -> Match:  # fmt: skip
    """Match a scan's points to a reference from a start pose (3,): the least sum of Cauchy losses of point-to-line
    distances (`sigma` [m]) and of the prior's Mahalanobis distance (scale `prior_scale` sigmas). Along a direction that
    the points fix less than by `least` the prior alone counts.
    """
    pose, hessian, cost, share, fixed = _match(points, reference, start, prior, sigma, prior_scale, least)
    pose[2] = wrap_angle(float(pose[2]))
    return Match(pose, np.asarray(np.linalg.inv(hessian), np.float64), cost, share, fixed)


@njit
def _match(
    points: Points, reference: Reference, start: Array, prior: MotionPrior, sigma: float, prior_scale: float,
    least: float,
) -> tuple[Array, Array, float, float, float]:  # fmt: skip
    xy, normal = points
    r_xy, r_normal, index, half = reference
    mean, information = prior
    x, y, theta = start[0], start[1], start[2]
    side = len(index)
    H, b, d, J, step = np.zeros((3, 3)), np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3)
    cost, inliers, fixed = 0.0, 0, 0.0
    scale = WIDE
    for iteration in range(ITERATIONS + 1):
        c, s = math.cos(theta), math.sin(theta)
        for p in range(3):
            b[p] = 0.0
            for q in range(3):
                H[p, q] = 0.0
        cost, inliers = 0.0, 0
        for k in range(len(xy)):
            rx, ry = c * xy[k, 0] - s * xy[k, 1], s * xy[k, 0] + c * xy[k, 1]
            qx, qy = rx + x, ry + y
            i, j = math.floor((qx + half) / LOOKUP_CELL), math.floor((qy + half) / LOOKUP_CELL)
            if i < 0 or j < 0 or i >= side or j >= side or index[i, j] < 0:
                cost += 1.0
                continue
            m = index[i, j]
            nx, ny = r_normal[m, 0], r_normal[m, 1]
            mx, my = c * normal[k, 0] - s * normal[k, 1], s * normal[k, 0] + c * normal[k, 1]
            same = mx * nx + my * ny
            if same < SAME_SIDE:
                cost += 1.0
                continue
            norm = math.sqrt(2.0 + 2.0 * same)
            nx, ny = (nx + mx) / norm, (ny + my) / norm
            e = nx * (qx - r_xy[m, 0]) + ny * (qy - r_xy[m, 1])
            u = e / scale
            w = 1.0 / (1.0 + u * u)
            f = e / NARROW
            cost += f * f / (1.0 + f * f)
            if abs(e) < 2.0 * NARROW:
                inliers += 1
            J[0], J[1], J[2] = nx, ny, -nx * ry + ny * rx
            w /= sigma * sigma
            for p in range(3):
                b[p] -= w * e * J[p]
                for q in range(3):
                    H[p, q] += w * J[p] * J[q]
        fixed = _loosened(H, b, least)
        d[0], d[1] = x - mean[0], y - mean[1]
        d[2] = theta - mean[2]
        d[2] -= 2.0 * math.pi * math.ceil((d[2] - math.pi) / (2.0 * math.pi))
        for p in range(3):
            step[p] = information[p, 0] * d[0] + information[p, 1] * d[1] + information[p, 2] * d[2]
        w = 1.0 / (1.0 + (d[0] * step[0] + d[1] * step[1] + d[2] * step[2]) / (prior_scale * prior_scale))
        for p in range(3):
            b[p] -= w * step[p]
            for q in range(3):
                H[p, q] += w * information[p, q]
        if iteration == ITERATIONS:
            break
        _solve(H, b, step)
        x += step[0]
        y += step[1]
        theta += step[2]
        size = max(abs(step[0]), abs(step[1]), abs(step[2]))
        if scale > NARROW:
            if size < 0.1 * scale:
                scale = max(0.3 * scale, NARROW)
        elif size < SMALL_STEP:
            break
    step[0], step[1], step[2] = x, y, theta
    return step, H, cost / max(len(xy), 1), inliers / max(len(xy), 1), fixed


@njit
def _loosened(H: Array, b: Array, least: float) -> float:
    """Of H x = b of points, the mean square of normals along the direction of translation that they fix least, with the
    turn that fits best: its eigenvalue. Below `least` what H and b say along it is taken from them.
    """
    total, turn = max(H[0, 0] + H[1, 1], 1e-300), max(H[2, 2], 1e-300)
    kx, ky = H[0, 2] / turn, H[1, 2] / turn
    xx, xy, yy = H[0, 0] - kx * H[0, 2], H[0, 1] - kx * H[1, 2], H[1, 1] - ky * H[1, 2]
    low = 0.5 * (xx + yy) - math.sqrt(0.25 * (xx - yy) ** 2 + xy * xy)
    if low < least * total:
        along = 0.5 * math.atan2(-2.0 * xy, yy - xx)
        v = (math.cos(along), math.sin(along))
        told = v[0] * (b[0] - kx * b[2]) + v[1] * (b[1] - ky * b[2])
        for p in range(2):
            b[p] -= told * v[p]
            for q in range(2):
                H[p, q] -= low * v[p] * v[q]
    return float(low / total)


@njit
def _solve(H: Array, b: Array, x: Array) -> None:
    """Solve H x = b for a positive definite H (3, 3), of which the lower triangle is read, by H = L D L'."""
    l10, l20 = H[1, 0] / H[0, 0], H[2, 0] / H[0, 0]
    d1 = H[1, 1] - l10 * H[1, 0]
    l21 = (H[2, 1] - l20 * H[1, 0]) / d1
    d2 = H[2, 2] - l20 * H[2, 0] - l21 * l21 * d1
    y1 = b[1] - l10 * b[0]
    x[2] = (b[2] - l20 * b[0] - l21 * y1) / d2
    x[1] = y1 / d1 - l21 * x[2]
    x[0] = b[0] / H[0, 0] - l10 * x[1] - l20 * x[2]

"""Multi-resolution correlative scan matching: the best pose of a whole window (Olson 2009b; Hess et al. 2016)."""

from __future__ import annotations

import math
from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from data.se2 import Array

CELL = 0.1
"""m, of the finest grid; point-to-line matching converges from there."""
SPREAD = 0.1
"""m, standard deviation of the bell around each reference point: what the grid and the scans differ by."""
LEVELS = 6
"""Grids, each pooled over twice the cells of the one before: the coarsest looks at 3.2 m at once."""
HIGHEST = 100
"""A reference point's value on the grid."""


class Pyramid(NamedTuple):
    """Scores (LEVELS, n, n) uint8 about the frame's origin; at (h, i, j) the most of the 2^h cells on from there."""

    grid: NDArray[np.uint8]
    half: float


def pyramid(xy: Array, half: float) -> Pyramid:
    """Score grids of reference points (P, 2) inside a square of -half .. half metres."""
    side = 2 * math.ceil(half / CELL)
    return Pyramid(_pyramid(xy, side), 0.5 * side * CELL)


def best_pose(points: Array, reference: Pyramid, centre: Array, window: Array, least: float) -> tuple[Array, float]:
    """The pose (3,) of the points (n, 2) within centre (3,) +- window (3,) [m, m, rad] that scores most, and its score.

    The score is the mean value of the cells the points fall on, 0 to 1; where none reaches `least` it comes back as 0.
    Branch and bound: exact on its grid of poses (cells of `CELL`; angles by which the farthest points move one cell).
    """
    far = math.sqrt(float((points**2).sum(axis=1).max(initial=1.0)))
    step = CELL / max(far, 1.0)
    turns = math.ceil(window[2] / step)
    angles = centre[2] + step * np.arange(-turns, turns + 1)
    reach = np.ceil(window[:2] / CELL).astype(np.int64)
    floor = least * len(points) * HIGHEST
    points = np.ascontiguousarray(points)  # one compiled version, whatever was sliced
    best, score = _search(points, reference.grid, reference.half, centre, angles, reach[0], reach[1], floor)
    return best, score / max(len(points) * HIGHEST, 1)


@numba.njit(cache=True)
def _pyramid(xy, side):  # type: ignore[no-untyped-def]
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


@numba.njit(cache=True)
def _score(cells, grid, level, bx, by):  # type: ignore[no-untyped-def]
    side = grid.shape[1]
    reach = 1 << level
    total = 0
    for k in range(len(cells)):
        i, j = cells[k, 0] + bx, cells[k, 1] + by
        if i <= -reach or j <= -reach or i >= side or j >= side:
            continue
        total += grid[level, max(i, 0), max(j, 0)]
    return total


@numba.njit(cache=True)
def _search(points, grid, half, centre, angles, reach_x, reach_y, floor):  # type: ignore[no-untyped-def]
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
                bound[(a * nx + p) * ny + q] = _score(cells[a], grid, top, p * size - reach_x, q * size - reach_y)
    order = np.argsort(-bound, kind="mergesort")
    best = floor
    pose = centre.copy()
    found = False
    stack = np.empty((4 * LEVELS + 4, 4), np.int64)
    four = np.empty((4, 3), np.int64)
    for o in order:
        if bound[o] <= best:
            break
        a, p, q = o // (nx * ny), (o // ny) % nx, o % ny
        stack[0] = top, p * size - reach_x, q * size - reach_y, bound[o]
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
                    v = _score(cells[a], grid, level - 1, x, y)
                    t = m
                    while t > 0 and four[t - 1, 0] > v:
                        four[t] = four[t - 1]
                        t -= 1
                    four[t, 0], four[t, 1], four[t, 2] = v, x, y
                    m += 1
            for t in range(m):
                stack[depth, 0], stack[depth, 1], stack[depth, 2] = level - 1, four[t, 1], four[t, 2]
                stack[depth, 3] = four[t, 0]
                depth += 1
    return pose, (best if found else 0)

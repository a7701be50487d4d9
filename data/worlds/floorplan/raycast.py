"""What a scanner measures among walls (line segments) and people (discs): the nearest hit along each beam."""

from __future__ import annotations

import math

import numba
import numpy as np

from data.inputs import Scanner
from data.se2 import Array, BoolArray, compose, inverse

NOTHING = -1
"""Index of what a beam hit that hit nothing."""


@numba.njit(cache=True)
def _cast(poses, angle_min, angle_step, walls, discs, ranges, hit):  # type: ignore[no-untyped-def]
    """Fill ranges (S, B) [m], inf where nothing is met, and hit (S, B): the segment's row, len(walls) for a disc.

    Each segment is tried against the beams between the bearings of its ends only, and one more on either side.
    """
    beams = ranges.shape[1]
    dx, dy = np.empty(beams), np.empty(beams)
    for k in range(len(poses)):
        x, y, first = poses[k, 0], poses[k, 1], poses[k, 2] + angle_min
        for b in range(beams):
            dx[b], dy[b] = math.cos(first + b * angle_step), math.sin(first + b * angle_step)
        best, what = ranges[k], hit[k]
        best[:] = np.inf
        what[:] = -1
        for s in range(len(walls)):
            ax, ay, bx, by = walls[s, 0] - x, walls[s, 1] - y, walls[s, 2] - x, walls[s, 3] - y
            ex, ey = bx - ax, by - ay
            # r d = a + u e: r = (a x e) / (d x e), u = (a x d) / (d x e), 0 <= u <= 1
            a_cross_e = ax * ey - ay * ex
            seen_under = math.atan2(ax * by - ay * bx, ax * bx + ay * by)
            bearing = (math.atan2(ay, ax) if seen_under >= 0.0 else math.atan2(by, bx)) - first
            bearing -= 2.0 * math.pi * math.floor(bearing / (2.0 * math.pi))
            for turn in range(-1, 1):
                low = bearing + 2.0 * math.pi * turn
                begin = max(math.floor(low / angle_step) - 1, 0)
                end = min(math.ceil((low + abs(seen_under)) / angle_step) + 2, beams)
                for b in range(begin, end):
                    den, u = dx[b] * ey - dy[b] * ex, ax * dy[b] - ay * dx[b]
                    num = a_cross_e
                    if den < 0.0:
                        den, num, u = -den, -num, -u
                    if den > 0.0 and u >= 0.0 and u <= den and num > 0.0 and num < best[b] * den:
                        best[b], what[b] = num / den, s
        for j in range(discs.shape[1]):
            cx, cy, radius = discs[k, j, 0] - x, discs[k, j, 1] - y, discs[k, j, 2]
            for b in range(beams):
                along, across = cx * dx[b] + cy * dy[b], cx * dy[b] - cy * dx[b]
                inside = radius * radius - across * across
                if inside > 0.0:
                    r = along - math.sqrt(inside)
                    if r > 0.0 and r < best[b]:
                        best[b], what[b] = r, len(walls)


def scan_ranges(
    poses: Array,
    scanner: Scanner,
    beams: int,
    walls: Array,
    *,
    glass: BoolArray | None = None,
    discs: Array | None = None,
) -> Array:
    """Exact ranges (S, B) [m] from poses (S, 3) of the body in the world, inf where nothing comes back.

    Args:
        poses: world frame; the scanner's own are found with its extrinsic.
        scanner: its angles, extrinsic and max_range, which is not met either.
        beams: B.
        walls: (W, 4) segments x0, y0, x1, y1 [m], world frame.
        glass: (W,) true where a wall returns nothing, though it hides what is behind.
        discs: (S, D, 3) x, y, radius [m] of round things at each of the poses; one about the scanner is not seen.
    """
    extrinsic = np.array([*scanner.translation, scanner.rotation])
    at = compose(np.asarray(poses, float), inverse(extrinsic))
    ranges = np.empty((len(at), beams))
    hit = np.empty((len(at), beams), np.int64)
    moving = np.zeros((len(at), 0, 3)) if discs is None else discs
    _cast(at, scanner.angle_min, scanner.angle_step, walls, moving, ranges, hit)
    ranges[ranges >= scanner.max_range] = np.inf
    if glass is not None:
        ranges[np.append(glass, False)[hit] & (hit != NOTHING)] = np.inf
    return ranges

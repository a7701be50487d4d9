"""Whether two scans contradict each other: a surface of the one where the other looked through."""

from __future__ import annotations

import math

import numba

from data.inputs import Scanner
from data.se2 import Array

TOLERANCE = 0.3
"""m, by which a surface must lie before another, besides ..."""
TOLERANCE_SHARE = 0.05
"""... this share of its range, to contradict it: what a heading error and a grazing wall make."""


def contradiction(ranges: Array, others: Array, relative: Array, scanner: Scanner, max_range: float) -> float:
    """Share of the shared beams of two scans (B,) that contradict, 0 where none is shared.

    `relative` (3,) is the body's pose at the second scan in its frame at the first. Each end point of either scan is
    looked up in the other: nearer than that beam's surface (and its neighbours') it contradicts, at the same range it
    agrees, behind it nothing is known.
    """
    seen, against = _compare(
        ranges, others, relative, scanner.angle_min, scanner.angle_step, scanner.rotation,
        scanner.translation[0], scanner.translation[1], max_range,
    )  # fmt: skip
    return float(against / max(seen, 1))


@numba.njit(cache=True)
def _compare(ranges, others, relative, first, step, rotation, tx, ty, max_range):  # type: ignore[no-untyped-def]
    seen = against = 0
    n = len(ranges)
    for way in range(2):
        mine, theirs = (others, ranges) if way == 0 else (ranges, others)
        c, s = math.cos(relative[2]), math.sin(relative[2])
        for k in range(n):
            if not 0.0 < mine[k] < max_range:
                continue
            angle = first + k * step - rotation
            c0, s0 = math.cos(rotation), math.sin(rotation)
            x = mine[k] * math.cos(angle) - c0 * tx - s0 * ty
            y = mine[k] * math.sin(angle) + s0 * tx - c0 * ty
            if way == 0:
                x, y = c * x - s * y + relative[0], s * x + c * y + relative[1]
            else:
                dx, dy = x - relative[0], y - relative[1]
                x, y = c * dx + s * dy, -s * dx + c * dy
            x, y = c0 * x - s0 * y + tx, s0 * x + c0 * y + ty
            bearing = math.atan2(y, x) - first
            bearing -= 2.0 * math.pi * math.floor(bearing / (2.0 * math.pi)) if step > 0.0 else 0.0
            i = math.floor(bearing / step + 0.5)
            if i < 1 or i > n - 2:
                continue
            r = math.sqrt(x * x + y * y)
            low, high = max_range, 0.0
            unknown = False
            for j in range(i - 1, i + 2):
                if not 0.0 < theirs[j] < max_range:
                    unknown = True
                low, high = min(low, theirs[j]), max(high, theirs[j])
            if unknown:
                continue
            tolerance = TOLERANCE + TOLERANCE_SHARE * r
            if r < low - tolerance:
                seen += 1
                against += 1
            elif r < high + tolerance:
                seen += 1
    return seen, against

"""Range scans as points of surfaces with normals."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from data.compiled import njit
from data.inputs import Scanner
from data.se2 import Array, transform_points

NEIGHBOUR_RADIUS = 0.2  # m, half the length of surface over which a normal is fitted: ten times a scanner's noise
LEAST_NEIGHBOURS, MOST_NEIGHBOURS = 2, 12  # beams on either side that may be beyond that radius, and at most
GAP_SPACINGS = 6.0
"""Widest gap in a run of neighbours, in beam spacings at the point's range: surfaces up to 80 degrees oblique are not
split. With half as much the Intel log loses the far walls of corridors: path without loop closures 0.9 m off, not 0.2.
"""
FEWEST_BEAMS = 16
"""Fewest beams of a scan that is matched. Odometry of floorplan:0 is 5.30 m off; of scans thinned to 8 and 12 beams
matched paths are 5.45 and 5.57 m off, to 16 beams 2.17 m.
"""
FLATNESS = 0.25  # largest ratio of standard deviations across and along a surface; else a corner or clutter


class Points(NamedTuple):
    """Surface points of one scan in the body frame: xy (n, 2) [m], normal (n, 2), unit length, towards the scanner."""

    xy: Array
    normal: Array

    def seen_from(self, pose: Array) -> "Points":
        """The same in the frame in which theirs has a pose (3,)."""
        c, s = math.cos(pose[2]), math.sin(pose[2])
        return Points(transform_points(pose, self.xy), self.normal @ np.array([[c, s], [-s, c]]))


def joined(parts: Sequence[Points]) -> Points:
    """Points of several scans in one frame."""
    return Points(np.concatenate([p.xy for p in parts]), np.concatenate([p.normal for p in parts]))


class Beams(NamedTuple):
    """Unit directions (B, 2) of the beams, their spacing [rad], and the scanner's position (2,) [m]; body frame."""

    direction: Array
    step: float
    origin: Array


def beams_of(scanner: Scanner, number: int) -> Beams:
    """The `number` beams of a scanner in the body frame, its extrinsic p_scanner = R p_body + T inverted."""
    angle = scanner.angle_min + scanner.angle_step * np.arange(number) - scanner.rotation
    c, s = math.cos(scanner.rotation), math.sin(scanner.rotation)
    tx, ty = scanner.translation
    origin = np.array([-c * tx - s * ty, s * tx - c * ty])
    return Beams(np.stack([np.cos(angle), np.sin(angle)], axis=-1), abs(scanner.angle_step), origin)


def scan_points(ranges: Array, beams: Beams, max_range: float) -> Points:
    """Points and normals of a scan (B,) [m], without returns beyond `max_range` and points off flat surfaces.

    The normal is the smaller principal axis of the unbroken run of neighbours. The point is projected onto the line
    through them, which reduces the heading noise of matching by a third.
    """
    xy, normal = _points(ranges, beams, max_range)
    return Points(xy, normal)


@njit
def _points(ranges: Array, beams: Beams, max_range: float) -> tuple[Array, Array]:
    direction, step, origin = beams.direction, beams.step, beams.origin
    n = len(ranges)
    all_xy = np.empty((n, 2))
    valid = np.zeros(n, np.bool_)
    for i in range(n):
        if 0.0 < ranges[i] < max_range:
            valid[i] = True
            all_xy[i, 0] = origin[0] + ranges[i] * direction[i, 0]
            all_xy[i, 1] = origin[1] + ranges[i] * direction[i, 1]
    xy = np.empty((n, 2))
    normal = np.empty((n, 2))
    count = 0
    for i in range(n):
        if not valid[i]:
            continue
        gap = max(NEIGHBOUR_RADIUS, GAP_SPACINGS * step * ranges[i])
        px, py = all_xy[i, 0], all_xy[i, 1]
        m, sx, sy, sxx, sxy, syy = 1, 0.0, 0.0, 0.0, 0.0, 0.0
        for side in (-1, 1):
            before = i
            for k in range(1, MOST_NEIGHBOURS + 1):
                j = i + side * k
                if j < 0 or j >= n or not valid[j]:
                    break
                dx, dy = all_xy[j, 0] - px, all_xy[j, 1] - py
                if k > LEAST_NEIGHBOURS and dx * dx + dy * dy > NEIGHBOUR_RADIUS * NEIGHBOUR_RADIUS:
                    break
                gx, gy = all_xy[j, 0] - all_xy[before, 0], all_xy[j, 1] - all_xy[before, 1]
                if gx * gx + gy * gy > gap * gap:
                    break
                before = j
                m += 1
                sx += dx
                sy += dy
                sxx += dx * dx
                sxy += dx * dy
                syy += dy * dy
        if m < 3:
            continue
        cxx, cxy, cyy = sxx / m - sx * sx / m / m, sxy / m - sx * sy / m / m, syy / m - sy * sy / m / m
        half, mean = 0.5 * (cxx - cyy), 0.5 * (cxx + cyy)
        root = math.sqrt(half * half + cxy * cxy)
        if mean - root > FLATNESS * FLATNESS * (mean + root):
            continue
        along = 0.5 * math.atan2(2.0 * cxy, cxx - cyy)
        nx, ny = -math.sin(along), math.cos(along)
        if nx * direction[i, 0] + ny * direction[i, 1] > 0.0:
            nx, ny = -nx, -ny
        off = (nx * sx + ny * sy) / m
        xy[count, 0], xy[count, 1] = px + off * nx, py + off * ny
        normal[count, 0], normal[count, 1] = nx, ny
        count += 1
    return xy[:count].copy(), normal[:count].copy()

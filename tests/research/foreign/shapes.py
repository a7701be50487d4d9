"""Worlds of another kind than those of `data.worlds`: ten paths in plane curves, and what stands beside them.

A path is a curve by arc length; the robot follows it with a speed that swings. Nothing here is integrated: a pose is
looked up at any time, so that readings can be late and odometry early by any amount. All sizes are in m, rad and s.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from data.se2 import Array, wrap_angle

Generator = np.random.Generator
DENSE = 6000  # Points of a curve: on the car's 1 km one each 0.2 m, with cubic smoothing between
SWING = 0.35  # Share of the mean speed by which it swings


@dataclass(frozen=True)
class Shape:
    curve: Callable[[Generator], Array]  # draws the points (K, 2) of a path; their ends are left straight on
    speed: float  # speed: m/s on average. seconds, rate: s, Hz of the frames
    seconds: float
    rate: float
    sigma: tuple[float, float]  # sigma: of both coordinates of a reading. reach: m. view: rad, full opening angle
    reach: float
    landmarks: int  # landmarks: their number; near, far: m, distance from the path; spacing: m, the least between two
    near: float
    far: float
    spacing: float
    pair: float  # m, distance of the close neighbour that one landmark in eight has
    along: float = 0.02  # along, across: m per sqrt(m) of odometry; turn: rad per sqrt(s)
    across: float = 0.01
    turn: float = 0.01
    polar: bool = True  # range and bearing, else the relative point
    view: float = 2.0 * math.pi
    unit: float = 1.0  # m; a "metre" of the faults that are lengths, smaller on the table
    mount: float = 0.0  # m, how far the sensor is ahead of the robot's centre, as stated
    # free: the heading does not follow the path. sway: rad and rad/s by which it swings about the path's
    free: bool = False
    sway: tuple[float, float] = (0.0, 0.0)
    shelves: bool = False  # landmarks stand in rows


def _parameter(laps: float) -> Array:
    return np.linspace(0.0, 2.0 * math.pi * laps, DENSE)


def _eight(rng: Generator) -> Array:
    u, (a, b) = _parameter(3.0) + rng.uniform(0.0, 2.0 * math.pi), rng.uniform(0.85, 1.15, 2)
    return np.stack([6.0 * a * np.sin(u), 3.5 * b * np.sin(2.0 * u)], 1)


def _lines(corners: Array, radius: float) -> Array:
    """A path along straight lines between corners (K, 2), rounded over about `radius`."""
    length = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(corners, axis=0).T))])
    at = np.linspace(0.0, length[-1], DENSE)
    xy = np.stack([np.interp(at, length, corners[:, i]) for i in (0, 1)], 1)
    half = max(int(radius / (at[1] - at[0])), 1)
    for _ in range(2):
        ends = [np.repeat(xy[:1], half, 0), xy, np.repeat(xy[-1:], half, 0)]
        total = np.cumsum(np.concatenate([np.zeros((1, 2)), *ends]), axis=0)
        xy = (total[2 * half + 1 :] - total[: -2 * half - 1]) / (2 * half + 1)
    return xy[2 * half : -2 * half]


def _snake(rows: int, long: float, wide: float, back: bool) -> Array:
    """Corners of `rows` lines of a length, a width apart, there and optionally back."""
    corners = [(x, r * wide) for r in range(rows) for x in ((0.0, long) if r % 2 == 0 else (long, 0.0))]
    if back:
        corners += [(-wide, corners[-1][1]), (-wide, 0.0), *corners[: len(corners) // 2]]
    return np.array(corners)


def _aisles(rng: Generator) -> Array:
    return _lines(_snake(4, rng.uniform(11.0, 15.0), 3.0, back=True), 0.6)


def _stripes(rng: Generator) -> Array:
    return _lines(_snake(14, rng.uniform(9.0, 12.0), 0.9, back=False), 0.35)


def _table(rng: Generator) -> Array:
    """Past ten places on a table of 0.9 m by 0.6 m, each at least 0.25 m from the last."""
    corners = [rng.uniform((0.0, 0.0), (0.9, 0.6))]
    while len(corners) < 12:
        new = rng.uniform((0.0, 0.0), (0.9, 0.6))
        if np.hypot(*(new - corners[-1])) > 0.25:
            corners.append(new)
    return _lines(np.array(corners), 0.05)


def _loop(rng: Generator) -> Array:
    """A closed road of 1 km, driven a little more than once."""
    u, (a, b) = _parameter(1.3), rng.uniform(0.0, 2.0 * math.pi, 2)
    r = 1.0 + 0.22 * np.sin(2.0 * u + a) + 0.1 * np.sin(3.0 * u + b)
    xy = r[:, None] * np.stack([np.cos(u), np.sin(u)], 1)
    return np.asarray(xy * 1000.0 / np.hypot(*np.diff(xy[: int(DENSE / 1.3)], axis=0).T).sum())


def _three_to_two(rng: Generator) -> Array:
    u, a = _parameter(2.0), rng.uniform(0.0, 2.0 * math.pi)
    return np.stack([7.0 * np.sin(2.0 * u + a), 5.0 * np.sin(3.0 * u)], 1)


def _petals(rng: Generator) -> Array:
    u, a = _parameter(3.0), rng.uniform(0.0, 2.0 * math.pi)
    r = 2.2 + 0.9 * np.cos(5.0 * u / 3.0 + a)
    return np.asarray(r[:, None] * np.stack([np.cos(u), np.sin(u)], 1))


def _ward(rng: Generator) -> Array:
    return _lines(_snake(3, rng.uniform(5.0, 7.0), 2.0, back=True), 0.5)


def _pond(rng: Generator) -> Array:
    u, (a, b) = _parameter(2.2), rng.uniform(0.0, 2.0 * math.pi, 2)
    r = 12.0 * (1.0 + 0.25 * np.sin(2.0 * u + a) + 0.1 * np.sin(5.0 * u + b))
    return np.asarray(r[:, None] * np.stack([np.cos(u), np.sin(u)], 1))


def _stroll(rng: Generator) -> Array:
    return 14.0 * _table(rng)


DEGREE = math.pi / 180.0
SHAPES: Mapping[str, Shape] = {
    "eight": Shape(_eight, 0.9, 50.0, 10.0, (0.06, 1.2 * DEGREE), 6.0, 26, 0.6, 3.0, 1.4, 0.7),
    "warehouse": Shape(
        *(_aisles, 0.9, 110.0, 5.0, (0.05, 0.8 * DEGREE), 5.0, 44, 0.0, 0.0, 0.0, 0.6), view=1.5 * math.pi, shelves=True
    ),
    "table": Shape(
        *(_table, 0.12, 25.0, 20.0, (0.004, 0.004), 0.35, 18, 0.05, 0.25, 0.1, 0.05, 0.004, 0.002, 0.03),
        polar=False,
        view=math.pi,
        unit=0.1,
    ),
    "car": Shape(
        *(_loop, 10.0, 110.0, 5.0, (0.25, 0.6 * DEGREE), 40.0, 110, 4.0, 14.0, 9.0, 4.0, 0.03, 0.02, 0.003),
        view=1.2 * math.pi,
        mount=1.2,
    ),
    "narrow": Shape(_three_to_two, 0.8, 60.0, 10.0, (0.08, DEGREE), 9.0, 36, 0.7, 4.0, 1.6, 0.8, view=math.pi / 3.0),
    "holonomic": Shape(
        *(_petals, 0.5, 45.0, 12.5, (0.04, 0.04), 4.5, 16, 0.5, 2.5, 1.1, 0.5, 0.02, 0.02, 0.015),
        polar=False,
        free=True,
    ),
    "mower": Shape(
        *(_stripes, 0.6, 115.0, 5.0, (0.07, DEGREE), 8.0, 14, 0.4, 3.0, 2.0, 0.9, 0.03, 0.015, 0.015), mount=0.3
    ),
    # a trolley on three casters goes sideways as it is pushed; its scanner is at the back
    "trolley": Shape(
        *(_ward, 0.7, 45.0, 5.0, (0.03, 0.7 * DEGREE), 5.0, 22, 0.4, 2.0, 0.8, 0.4, 0.03, 0.03, 0.02),
        view=1.6 * math.pi,
        mount=-0.3,
        sway=(0.5, 0.3),
    ),
    # a boat drifts: course and heading differ, no wheel counts its way; radar and buoys
    "boat": Shape(
        *(_pond, 2.0, 60.0, 4.0, (0.3, 1.5 * DEGREE), 25.0, 20, 1.5, 9.0, 4.0, 2.0, 0.06, 0.06, 0.01),
        unit=2.0,
        sway=(0.3, 0.17),
    ),
    # a person walks: the phone turns with each second step, and sees points in a narrow view
    "walker": Shape(
        *(_stroll, 1.2, 40.0, 6.0, (0.06, 0.06), 7.0, 30, 0.6, 3.5, 1.2, 0.7, 0.05, 0.04, 0.015),
        polar=False,
        view=0.4 * math.pi,
        sway=(0.12, 5.5),
    ),
}
"""By name. Densities are those of trees, posts, racks and markers: a pair is 3 to 15 sigmas apart at half the reach."""


class Drive:
    """A robot on a curve: its pose at any time, the same for the same seed."""

    def __init__(self, shape: Shape, rng: Generator) -> None:
        xy = shape.curve(rng)
        self.s = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(xy, axis=0).T))])
        self.xy = xy
        self.heading = np.unwrap(np.arctan2(*np.gradient(xy, axis=0).T[::-1]))
        self.speed = shape.speed * rng.uniform(0.9, 1.1)
        self.cycle, self.phase = rng.uniform(5.0, 9.0), rng.uniform(0.0, 2.0 * math.pi)
        self.free, self.sway = shape.free, shape.sway
        self.lead = 1.0
        """s of path before time 0."""
        longest = (self.s[-1] / self.speed) - 2.0 * self.lead - self.cycle
        self.seconds = float(np.clip(shape.seconds * rng.uniform(0.85, 1.1), 20.0, min(120.0, longest)))

    def at(self, time: Array) -> Array:
        """Poses (n, 3) at times (n,), headings wrapped."""
        w = 2.0 * math.pi / self.cycle
        t = time + self.lead
        s = self.speed * (t + SWING / w * (np.sin(w * t + self.phase) - math.sin(self.phase)))
        x, y = (np.interp(s, self.s, self.xy[:, i]) for i in (0, 1))
        theta = np.interp(s, self.s, self.heading) + self.sway[0] * np.sin(self.sway[1] * t + self.phase)
        if self.free:  # it looks about, whichever way it goes
            theta = 0.9 * np.sin(0.35 * t + self.phase) + 0.06 * t
        return np.stack([x, y, wrap_angle(theta)], 1)


def places(shape: Shape, driven: Array, rng: Generator) -> Array:
    """Landmarks (L, 2) beside the driven path (n, 3): apart from each other, then close pairs."""
    count = shape.landmarks - shape.landmarks // 8
    found = _shelves(driven, count, rng) if shape.shelves else _scattered(shape, driven, count, rng)
    chosen = rng.choice(len(found), shape.landmarks // 8, replace=False)
    angle = rng.uniform(0.0, 2.0 * math.pi, len(chosen))
    distance = shape.pair * rng.uniform(0.6, 1.5, len(chosen))
    beside = found[chosen] + distance[:, None] * np.stack([np.cos(angle), np.sin(angle)], 1)
    return np.concatenate([found, beside])


def _scattered(shape: Shape, driven: Array, count: int, rng: Generator) -> Array:
    """Landmarks at random, of which none is nearer to the path than `near`."""
    spacing, found = shape.spacing, np.empty((0, 2))
    for attempt in range(100 * count):
        if len(found) == count:
            break
        foot, angle = driven[rng.integers(len(driven)), :2], rng.uniform(0.0, 2.0 * math.pi)
        new = foot + rng.uniform(shape.near, shape.far) * np.array([math.cos(angle), math.sin(angle)])
        free = np.hypot(*(driven[:, :2] - new).T).min() >= shape.near
        if free and (not len(found) or np.hypot(*(found - new).T).min() >= spacing * (1.0 - attempt / (100 * count))):
            found = np.concatenate([found, new[None]])
    return found


def _shelves(driven: Array, count: int, rng: Generator) -> Array:
    """Landmarks on racks beside aisles that lie 3 m apart along x."""
    long = float(driven[:, 0].max())
    rows = np.array([-1.2, 1.2, 1.8, 4.2, 4.8, 7.2, 7.8, 10.2])
    each = -(-count // len(rows))
    x = (np.arange(each) + 0.5) * long / each
    grid = np.stack([np.tile(x, len(rows)), np.repeat(rows, each)], 1)
    grid[:, 0] += rng.uniform(-0.5, 0.5, len(grid))
    grid[:, 1] += rng.normal(0.0, 0.05, len(grid))
    return grid[np.sort(rng.choice(len(grid), count, replace=False))]

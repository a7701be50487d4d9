"""A drive through a building: places where it has been least, now and then others, in straight lines and arcs."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from data.se2 import Array, wrap_angle
from data.worlds.floorplan.ways import Ways

RADIUS = 0.5
"""m, of a turn where there is room for it."""
ABOUT = math.radians(135.0)
"""A sharper turn is made in place."""
WANDER = 0.1
"""m, by how much a place is missed in x and in y, at most; so no way is driven twice along the same line."""

AGAIN = 0.3
"""Probability that the next target is one where it has been before."""


def drive(ways: Ways, rng: np.random.Generator, time: Array, speed: float, turn_rate: float) -> Array:
    """Exact poses (N, 3) at stamps (N,) [s] from 0 up, of one who never rests.

    Speed is that of straight lines [m/s]; in turns it is less, so as to stay below the turn rate [rad/s].
    """
    moves = list[tuple[float, float, float]]()  # s, m/s, rad/s
    points = tour(ways, rng)
    a, b = next(points), next(points)
    start = np.array([*a, math.atan2(b[1] - a[1], b[0] - a[0])])
    lasted, straight = 0.0, float(np.hypot(*(b - a)))
    while lasted <= time[-1]:
        c = next(points)
        onward = float(np.hypot(*(c - b)))
        turn = float(wrap_angle(math.atan2(c[1] - b[1], c[0] - b[0]) - math.atan2(b[1] - a[1], b[0] - a[0])))
        # a turn begins at most half a way before its corner, so that the turn before has room for its end
        half = math.tan(0.5 * abs(turn)) if abs(turn) < ABOUT else 0.0
        cut = min(RADIUS * half, 0.45 * onward, 0.45 * float(np.hypot(*(b - a))))
        radius = cut / half if half > 0.0 else 0.0
        slow = min(speed, turn_rate * radius)
        arc = radius * abs(turn) / slow if slow > 0.0 else abs(turn) / turn_rate
        new = [((straight - cut) / speed, speed, 0.0)]
        if arc > 0.0:
            new.append((arc, slow, turn / arc))
        lasted += sum(m[0] for m in new)
        moves += new
        a, b, straight = b, c, onward - cut
    return _poses(start, np.array(moves), time)


def tour(ways: Ways, rng: np.random.Generator) -> Iterator[Array]:
    """Points (2,) to drive through, without end: to the nearest of three targets, new ones or old."""
    been = np.zeros(len(ways.place), int)
    here = int(rng.choice(ways.target))
    been[here] = 1
    yield _about(ways, here, rng)
    while True:
        times = been[ways.target]
        among = ways.target[times == times.min()] if rng.random() > AGAIN or not times.any() else ways.target[times > 0]
        some = rng.choice(among, size=min(3, len(among)), replace=False)
        nearest = np.argmin(np.linalg.norm(ways.place[some] - ways.place[here], axis=1))
        # the same two places are not always joined by the same way
        route = ways.route(here, int(some[nearest]), ways.length * rng.uniform(1.0, 2.0, len(ways.edge)))
        for place in route[1:]:
            been[place] += 1
            yield _about(ways, place, rng)
        if len(route) == 1:
            been[here] += 1
        here = route[-1]


def _about(ways: Ways, place: int, rng: np.random.Generator) -> Array:
    point: Array = ways.place[place] + rng.uniform(-WANDER, WANDER, 2)
    return point


def _poses(start: Array, moves: Array, time: Array) -> Array:
    """Poses (N, 3) along moves (K, 3) of s, m/s, rad/s, each a line, an arc or a turn in place."""
    begins = np.concatenate([[0.0], np.cumsum(moves[:-1, 0])])
    pose = np.zeros((len(moves), 3))
    heading = start[2] + np.concatenate([[0.0], np.cumsum(moves[:-1, 0] * moves[:-1, 2])])
    steps = _arc(heading, moves[:, 1], moves[:, 2], moves[:, 0])
    pose[:, :2] = start[:2] + np.concatenate([np.zeros((1, 2)), np.cumsum(steps[:-1], axis=0)])
    pose[:, 2] = heading
    k = np.searchsorted(begins, time, side="right") - 1
    into = time - begins[k]
    at = pose[k]
    at[:, :2] += _arc(at[:, 2], moves[k, 1], moves[k, 2], into)
    at[:, 2] = wrap_angle(at[:, 2] + moves[k, 2] * into)
    return at


def _arc(heading: Array, v: Array, omega: Array, lasts: Array) -> Array:
    """How far (n, 2) one comes from a heading with v and omega in a time: the chord of the arc."""
    half = 0.5 * omega * lasts
    chord = v * lasts * np.sinc(half / math.pi)
    return np.stack([chord * np.cos(heading + half), chord * np.sin(heading + half)], 1)

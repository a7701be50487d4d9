"""The floor plan world: scans of rooms and corridors by a robot with an exactly known path and poor odometry.

It drives in lines and arcs, mostly to where it has been least. The scanner measures the nearest hit of each beam among
walls (segments) and people (discs).

Building, route, odometry noise, range noise, glass, people and the prior's error come from independent streams of the
seed, so changing one parameter leaves the others' draws alone.

A building by seed: crossing corridors, rooms with doors, furniture, and a graph of paths to drive.

Corridors end at outer walls or other corridors; the blocks between are cut into rooms. Every room has a door to a
corridor or to a room that has one. Walls have two faces, doors have jambs. Paths run along the middle of corridors,
through doors, and inside rooms.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import scipy

from data import se2
from data.compiled import njit
from data.errors import UsageError
from data.inputs import Increments, Inputs, IntArray, Observations, Scanner, Scans
from data.locked import Locked
from data.log import Log
from data.motion.velocity import floor_covariances
from data.se2 import Array, BoolArray, compose, inverse, wrap_angle
from data.sensors import RangeBearing
from data.truth import Truth
from data.worlds.parameters import check_parameters, drawn_prior, in_degrees, streams, told

INSIDE = 0.7  # m from the wall to the first place behind a door
CLEARANCE = 0.5  # m, smallest distance of objects from every path: half a robot and its deviation


class Door(NamedTuple):
    """An opening in a wall of constant x (axis 0) or y (axis 1), from low to high, between a room and another side."""

    axis: int
    at: float
    low: float
    high: float
    room: int
    other: int


@dataclass(frozen=True, eq=False)
class Ways(Locked):
    """A connected graph of places."""

    place: Array  # (V, 2) [m]
    edge: IntArray  # (E, 2) places joined by a straight path
    target: IntArray  # (T,) destinations: all in rooms, and the ends of corridors

    def trace(self) -> Array:
        """Points (P, 2) of every path, at most 0.1 m apart."""
        a, b = self.place[self.edge[:, 0]], self.place[self.edge[:, 1]]
        n = np.maximum(np.ceil(self.length / 0.1), 1.0).astype(int)
        share = np.concatenate([np.linspace(0.0, 1.0, k + 1) for k in n])[:, None]
        return np.asarray(np.repeat(a, n + 1, axis=0) * (1.0 - share) + np.repeat(b, n + 1, axis=0) * share)

    @property
    def length(self) -> Array:
        """(E,) m of each path."""
        return np.asarray(np.linalg.norm(self.place[self.edge[:, 0]] - self.place[self.edge[:, 1]], axis=1))

    def route(self, start: int, goal: int, cost: Array) -> list[int]:
        """Places on the cheapest route from start to goal, both included, by costs (E,)."""
        (i, j), n = self.edge.T.astype(np.int32), len(self.place)  # int32: before SciPy 1.12
        graph = scipy.sparse.csr_array((np.tile(cost, 2), np.block([[i, j], [j, i]])), shape=(n, n))
        _, before = scipy.sparse.csgraph.dijkstra(graph, indices=[start], return_predecessors=True)
        path = [goal]
        while path[-1] != start:
            path.append(int(before[0, path[-1]]))
        return path[::-1]


def clear_of(trace: Array, outline: Array) -> bool:
    """Whether a convex outline (c, 2), counterclockwise, is farther than `CLEARANCE` from all points (P, 2)."""
    low, high = outline.min(axis=0) - CLEARANCE, outline.max(axis=0) + CLEARANCE
    near = trace[((trace > low) & (trace < high)).all(axis=1)]
    if not len(near):
        return True
    e = np.roll(outline, -1, axis=0) - outline
    from_corner = near[:, None] - outline
    u = np.clip((from_corner * e).sum(2) / (e * e).sum(1), 0.0, 1.0)
    outside = (e[:, 0] * from_corner[:, :, 1] - e[:, 1] * from_corner[:, :, 0] < 0.0).any(axis=1)
    return bool(np.linalg.norm(from_corner - u[:, :, None] * e, axis=2).min() > CLEARANCE and outside.all())


def ways_of(rng: np.random.Generator, corridors: Sequence[Rect], rooms: Sequence[Rect], doors: Sequence[Door]) -> Ways:
    """Paths through rooms and corridors by all doors."""
    place, edge, target = list[tuple[float, float]](), list[tuple[int, int]](), list[int]()

    def add(at: float, along: float, axis: int = 0) -> int:
        """A place of x (axis 0) or y (axis 1) `at`, and the other coordinate."""
        place.append((at, along) if axis == 0 else (along, at))
        return len(place) - 1

    stops: list[list[tuple[float, int]]] = [[] for _ in corridors]  # along each corridor: where, and which place
    upright = [c[3] - c[1] > c[2] - c[0] for c in corridors]
    middle = [0.5 * (c[0] + c[2]) if up else 0.5 * (c[1] + c[3]) for c, up in zip(corridors, upright, strict=True)]
    for i, a in enumerate(corridors):
        for j in range(len(corridors)):
            if upright[i] and not upright[j]:
                here = add(middle[i], middle[j])
                stops[i].append((middle[j], here))
                stops[j].append((middle[i], here))
        o = 1 if upright[i] else 0
        crossed = [middle[j] for j in range(len(corridors)) if upright[j] != upright[i]]
        for end in (a[o] + 1.0, a[o + 2] - 1.0):
            if end < min(crossed) - 1.0 or end > max(crossed) + 1.0:
                here = add(middle[i], end, 0 if upright[i] else 1)
                stops[i].append((end, here))
                target.append(here)
    centre = list[int]()
    for x0, y0, x1, y1 in rooms:
        w, h = x1 - x0, y1 - y0
        share = rng.uniform(0.4, 0.6, 2)
        centre.append(add(float(x0 + share[0] * w), float(y0 + share[1] * h)))
        target.append(centre[-1])
        if min(w, h) > 4.0:  # room enough to drive round
            at = [(x0 + (0.25 + 0.5 * (c % 2)) * w, y0 + (0.25 + 0.5 * (c // 2)) * h) for c in rng.permutation(4)[:2]]
            round_it = [add(float(x), float(y)) for x, y in at]
            edge += [(centre[-1], round_it[0]), (round_it[0], round_it[1]), (round_it[1], centre[-1])]
            target += round_it
    for d in doors:
        along = 0.5 * (d.low + d.high)
        sides = list[int]()
        for side in (d.room, d.other):
            if side >= len(rooms):
                c = side - len(rooms)
                if upright[c] == (d.axis == 0):  # a door in the corridor's long side
                    here = add(middle[c], along, d.axis)
                    stops[c].append((along, here))
                else:  # at its end
                    o = d.axis
                    far = d.at + (1.0 if corridors[c][o] + corridors[c][o + 2] > 2.0 * d.at else -1.0)
                    here = add(far, middle[c], d.axis)
                    stops[c].append((far, here))
                    near = add(far, along, d.axis)
                    edge.append((here, near))
                    here = near
            else:
                r = rooms[side]
                to = INSIDE if r[d.axis] + r[d.axis + 2] > 2.0 * d.at else -INSIDE
                here = add(d.at + to, along, d.axis)
                edge.append((here, centre[side]))
            sides.append(here)
        edge.append((sides[0], sides[1]))
    for along_it in stops:
        edge += [(a, b) for (_, a), (_, b) in pairwise(sorted(along_it))]
    return Ways(np.array(place), np.array(edge), np.array(target))


HALF_WALL = 0.06  # m, half of a wall's thickness
NARROW, ROOMY = 3.2, 6.5  # m, smallest width of a cut room, and longest side of one left uncut
BESIDE_DOOR = 0.3  # m, smallest distance from a door to the end of its wall
EPS = 1e-6  # m, tolerance of equal coordinates


class Rect(NamedTuple):
    """An axis-aligned rectangle [m]."""

    x0: float
    y0: float
    x1: float
    y1: float

    def inset(self, by: float) -> Rect:
        """The rectangle, smaller by that much on every side."""
        return Rect(self.x0 + by, self.y0 + by, self.x1 - by, self.y1 - by)

    def holds(self, x: float, y: float) -> bool:
        """Whether a point lies inside, edges included."""
        return self.x0 <= x <= self.x1 and self.y0 <= y <= self.y1


class Face(NamedTuple):
    """A segment of constant x (axis 0) or y (axis 1): the constant, and both ends."""

    axis: int
    at: float
    low: float
    high: float


@dataclass(frozen=True, eq=False)
class Building(Locked):
    """A building."""

    walls: Array  # (W, 4) segments x0, y0, x1, y1 [m]: walls, jambs, furniture
    faces: int  # number of leading segments that are faces of walls (and may be of glass)
    ways: Ways  # paths of robots and people


def build(rng: np.random.Generator) -> Building:
    """A building of 25 to 30 m a side."""
    corridors, rooms = _layout(rng)
    doors = _doors(rng, corridors, rooms)
    faces = [cut for face in _faces(corridors, rooms) for cut in _cut(face, doors)]
    ways = ways_of(rng, corridors, rooms, doors)
    jambs = [Face(1 - d.axis, end, d.at - HALF_WALL, d.at + HALF_WALL) for d in doors for end in (d.low, d.high)]
    ends = [(f.at, f.low, f.at, f.high) if f.axis == 0 else (f.low, f.at, f.high, f.at) for f in [*faces, *jambs]]
    return Building(np.concatenate([np.array(ends), _furniture(rng, corridors, rooms, ways.trace())]), len(faces), ways)


def _layout(rng: np.random.Generator) -> tuple[list[Rect], list[Rect]]:
    """Corridors, which overlap where they cross, and disjoint rooms; both up to the middle of the walls."""
    size = rng.uniform(25.0, 30.0, 2)
    across, along = ((2, 2), (3, 2), (2, 3))[int(rng.integers(3))]
    xs, ys = _strips(rng, size[0], across), _strips(rng, size[1], along)
    # a corridor ends at the outermost one it crosses, or at the outer wall
    to_wall_x, to_wall_y = rng.random((across, 2)) < 0.5, rng.random((along, 2)) < 0.5
    corridors, blocks = list[Rect](), list[Rect]()
    for (a, b), wall in zip(xs, to_wall_x, strict=True):
        corridors.append(Rect(a, 0.0 if wall[0] else ys[0][0], b, size[1] if wall[1] else ys[-1][1]))
    for (a, b), wall in zip(ys, to_wall_y, strict=True):
        corridors.append(Rect(0.0 if wall[0] else xs[0][0], a, size[0] if wall[1] else xs[-1][1], b))
    blocks += [Rect(a[1], c[1], b[0], d[0]) for a, b in pairwise(xs) for c, d in pairwise(ys)]
    for end, (low, high) in enumerate(((0.0, ys[0][0]), (ys[-1][1], size[1]))):
        for a, b in _between(0.0, size[0], [s for s, w in zip(xs, to_wall_x[:, end], strict=True) if w]):
            blocks.append(Rect(a, low, b, high))
    for end, (low, high) in enumerate(((0.0, xs[0][0]), (xs[-1][1], size[0]))):
        for a, b in _between(ys[0][0], ys[-1][1], [s for s, w in zip(ys, to_wall_y[:, end], strict=True) if w]):
            blocks.append(Rect(low, a, high, b))
    return corridors, [room for block in blocks for room in _rooms(rng, block)]


def _strips(rng: np.random.Generator, size: float, count: int) -> list[tuple[float, float]]:
    """Low and high side of parallel corridors, with rooms outside the first and the last."""
    width = rng.uniform(1.8, 2.4, count)
    outer = rng.uniform(4.2, 5.8, 2)
    inner = rng.uniform(0.8, 1.2, count - 1)
    inner *= (size - outer.sum() - width.sum()) / inner.sum()
    low = outer[0] + np.concatenate([[0.0], np.cumsum(width[:-1] + inner)])
    return [(float(a), float(a + w)) for a, w in zip(low, width, strict=True)]


def _between(low: float, high: float, cuts: list[tuple[float, float]]) -> Iterator[tuple[float, float]]:
    """The rest of an interval without some cuts, ascending."""
    for a, b in cuts:
        if a > low + EPS:
            yield low, a
        low = b
    if high > low + EPS:
        yield low, high


def _rooms(rng: np.random.Generator, block: Rect) -> list[Rect]:
    w, h = block.x1 - block.x0, block.y1 - block.y0
    part = float(rng.uniform(0.35, 0.65)) * max(w, h)
    if max(w, h) <= ROOMY or not NARROW <= part <= max(w, h) - NARROW:
        return [block]
    if w > h:
        two = block._replace(x1=block.x0 + part), block._replace(x0=block.x0 + part)
    else:
        two = block._replace(y1=block.y0 + part), block._replace(y0=block.y0 + part)
    return [room for half in two for room in _rooms(rng, half)]


def _shared(a: Rect, b: Rect) -> Face | None:
    """The wall between two rectangles that touch along a side, or None."""
    for axis in (0, 1):
        o = 1 - axis
        low, high = max(a[o], b[o]), min(a[o + 2], b[o + 2])
        for at, other in ((a[axis], b[axis + 2]), (a[axis + 2], b[axis])):
            if abs(at - other) < EPS and high > low + EPS:
                return Face(axis, at, low, high)
    return None


def _doors(rng: np.random.Generator, corridors: list[Rect], rooms: list[Rect]) -> list[Door]:
    """A door for every room, then some more; sides are room numbers, and corridor numbers after the rooms'."""
    doors = list[Door]()
    n = len(rooms)

    def open_door(room: int, other: int) -> bool:
        wall = _shared(rooms[room], rooms[other] if other < n else corridors[other - n])
        width = float(rng.uniform(0.9, 1.2))
        if wall is None or wall.high - wall.low < width + 2.0 * (BESIDE_DOOR + HALF_WALL):
            return False
        slack = 0.5 * width + BESIDE_DOOR + HALF_WALL
        middle = float(rng.uniform(wall.low + slack, wall.high - slack))
        beside = [d for d in doors if d.axis == wall.axis and abs(d.at - wall.at) < EPS]
        if any(d.low - slack < middle < d.high + slack for d in beside):
            return False
        doors.append(Door(wall.axis, wall.at, middle - 0.5 * width, middle + 0.5 * width, room, other))
        return True

    reached = set[int]()
    for room in range(n):
        open_to = 0
        for c in rng.permutation(len(corridors)).tolist():
            if (not open_to or rng.random() < 0.4) and open_to < 2 and open_door(room, n + c):
                open_to += 1
        if open_to:
            reached.add(room)
    for a in range(n):
        for b in range(a):
            if a in reached and b in reached and rng.random() < 0.15:
                open_door(a, b)
    waiting = [room for room in range(n) if room not in reached]
    for _ in range(n):
        for room in waiting:
            if room not in reached and any(open_door(room, other) for other in sorted(reached)):
                reached.add(room)
    return doors


def _faces(corridors: list[Rect], rooms: list[Rect]) -> list[Face]:
    """Faces of the walls of all rooms, and of the union of corridors, before doors are cut."""
    faces = [f for room in rooms for f, _ in _sides(room.inset(HALF_WALL))]
    inner = [c.inset(HALF_WALL) for c in corridors]
    found = dict[Face, None]()
    for i, c in enumerate(inner):
        others = [r for j, r in enumerate(inner) if j != i]
        for face, outward in _sides(c):
            o = 1 - face.axis
            stops = {v for r in others for v in (r[o], r[o + 2]) if face.low < v < face.high}
            for low, high in pairwise(sorted({face.low, face.high, *stops})):
                beyond = (face.at + 1e-3 * outward, 0.5 * (low + high))
                x, y = beyond if face.axis == 0 else beyond[::-1]
                if not any(r.holds(x, y) for r in others):
                    found[Face(face.axis, face.at, low, high)] = None  # once, where two corridors end together
    return faces + list(found)


def _sides(r: Rect) -> Iterator[tuple[Face, float]]:
    """The four sides, and the outward direction of each."""
    yield Face(0, r.x0, r.y0, r.y1), -1.0
    yield Face(0, r.x1, r.y0, r.y1), 1.0
    yield Face(1, r.y0, r.x0, r.x1), -1.0
    yield Face(1, r.y1, r.x0, r.x1), 1.0


def _cut(face: Face, doors: list[Door]) -> Iterator[Face]:
    near = [d for d in doors if d.axis == face.axis and abs(abs(d.at - face.at) - HALF_WALL) < EPS]
    # a wall may consist of several faces, and a door lie in two
    gaps = sorted((d.low, min(d.high, face.high)) for d in near if d.low < face.high and d.high > face.low)
    for low, high in _between(face.low, face.high, gaps):
        yield Face(face.axis, face.at, low, high)


def _furniture(rng: np.random.Generator, corridors: list[Rect], rooms: list[Rect], ways: Array) -> Array:
    """Segments (F, 4): boxes in any direction and pillars in rooms, shallow boxes at corridor walls."""
    found = list[Array]()
    for room in rooms:
        for _ in range(int(rng.integers(3, 8))):
            pillar = rng.random() < 0.25
            half = np.full(2, rng.uniform(0.1, 0.25)) if pillar else 0.5 * rng.uniform((0.5, 0.4), (1.8, 0.9))
            inside = room.inset(HALF_WALL + float(np.hypot(*half)))
            middle = rng.uniform((inside.x0, inside.y0), (inside.x1, inside.y1))
            turned = float(rng.uniform(0.0, 0.5 * math.pi)) if rng.random() < 0.5 else 0.0
            _stand(found, _outline(middle, half, turned, 8 if pillar else 4), ways)
    for c in corridors:
        upright = c.y1 - c.y0 > c.x1 - c.x0
        for _ in range(int(rng.integers(3, 7))):
            half = 0.5 * rng.uniform((0.5, 0.15), (1.6, 0.35))
            inside = c.inset(HALF_WALL)
            half = half[::-1] if upright else half
            low, high = np.array(inside[:2]) + half, np.array(inside[2:]) - half
            middle = low + rng.random(2) * (high - low)
            across = 0 if upright else 1
            middle[across] = (low if rng.random() < 0.5 else high)[across]
            _stand(found, _outline(middle, half, 0.0, 4), ways)
    return np.concatenate(found) if found else np.empty((0, 4))


def _outline(middle: Array, half: Array, turned: float, corners: int) -> Array:
    """Corners (c, 2) of a box or, with more than four, of a regular polygon of radius half[0]."""
    if corners == 4:
        own = half * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    else:
        angle = 2.0 * math.pi * np.arange(corners) / corners
        own = half[0] * np.stack([np.cos(angle), np.sin(angle)], 1)
    c, s = math.cos(turned), math.sin(turned)
    return np.asarray(middle + own @ np.array([[c, s], [-s, c]]))


def _stand(found: list[Array], outline: Array, ways: Array) -> None:
    """Add an object, unless it blocks a path."""
    if clear_of(ways, outline):
        found.append(np.concatenate([outline, np.roll(outline, -1, axis=0)], axis=1))


RADIUS = 0.5  # m, radius of a turn where there is space
ABOUT = math.radians(135.0)  # rad; a sharper turn is made in place
WANDER = 0.1  # m, largest deviation from a place in x and in y, so that lines do not repeat
AGAIN = 0.3  # Probability that the next target was visited before


def drive(ways: Ways, rng: np.random.Generator, time: Array, speed: float, turn_rate: float) -> Array:
    """Poses (N, 3) at stamps (N,) [s] without rests, straight at `speed`, slower in turns by `turn_rate` [rad/s]."""
    moves = list[tuple[float, float, float]]()  # s, m/s, rad/s
    points = tour(ways, rng)
    a, b = next(points), next(points)
    start = np.array([*a, math.atan2(b[1] - a[1], b[0] - a[0])])
    lasted, straight = 0.0, float(np.hypot(*(b - a)))
    while lasted <= time[-1]:
        c = next(points)
        onward = float(np.hypot(*(c - b)))
        turn = float(wrap_angle(math.atan2(c[1] - b[1], c[0] - b[0]) - math.atan2(b[1] - a[1], b[0] - a[0])))
        # a turn begins at most half a path before its corner, which leaves space for the turn before
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
    """Endless points (2,) to drive through, each time to the nearest of three new or old targets."""
    been = np.zeros(len(ways.place), int)
    here = int(rng.choice(ways.target))
    been[here] = 1
    yield _about(ways, here, rng)
    while True:
        times = been[ways.target]
        among = ways.target[times == times.min()] if rng.random() > AGAIN or not times.any() else ways.target[times > 0]
        some = rng.choice(among, size=min(3, len(among)), replace=False)
        nearest = np.argmin(np.linalg.norm(ways.place[some] - ways.place[here], axis=1))
        # the route between two places varies
        route = ways.route(here, int(some[nearest]), ways.length * rng.uniform(1.0, 2.0, len(ways.edge)))
        for place in route[1:]:
            been[place] += 1
            yield _about(ways, place, rng)
        if len(route) == 1:
            been[here] += 1
        here = route[-1]


def _about(ways: Ways, place: int, rng: np.random.Generator) -> Array:
    return np.asarray(ways.place[place] + rng.uniform(-WANDER, WANDER, 2))


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
    """Displacement (n, 2) from a heading with v and omega during a time: the chord of the arc."""
    half = 0.5 * omega * lasts
    chord = v * lasts * np.sinc(half / math.pi)
    return np.stack([chord * np.cos(heading + half), chord * np.sin(heading + half)], 1)


NOTHING = -1  # Index of a beam without a hit


@njit
def _cast(
    poses: Array, angle_min: float, angle_step: float, walls: Array, discs: Array, ranges: Array, hit: IntArray
) -> None:
    """Fill ranges (S, B) [m], inf: none, and hit (S, B): the segment's row, or len(walls) for a disc."""
    beams = ranges.shape[1]
    dx, dy = np.empty(beams), np.empty(beams)
    for k in range(len(poses)):
        x, y, first = poses[k, 0], poses[k, 1], poses[k, 2] + angle_min
        for b in range(beams):
            dx[b], dy[b] = math.cos(first + b * angle_step), math.sin(first + b * angle_step)
        best, what = ranges[k], hit[k]
        for b in range(beams):
            best[b], what[b] = np.inf, -1
        for s in range(len(walls)):
            ax, ay, bx, by = walls[s, 0] - x, walls[s, 1] - y, walls[s, 2] - x, walls[s, 3] - y
            ex, ey = bx - ax, by - ay
            a_cross_e = ax * ey - ay * ex  # r d = a + u e: r = (a x e) / (d x e), u = (a x d) / (d x e), 0 <= u <= 1
            seen_under = math.atan2(ax * by - ay * bx, ax * bx + ay * by)
            bearing = (math.atan2(ay, ax) if seen_under >= 0.0 else math.atan2(by, bx)) - first
            bearing -= 2.0 * math.pi * math.floor(bearing / (2.0 * math.pi))
            for turn in range(-1, 1):
                low = bearing + 2.0 * math.pi * turn
                begin = max(math.floor(low / angle_step) - 1, 0)
                for b in range(begin, min(math.ceil((low + abs(seen_under)) / angle_step) + 2, beams)):
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
    poses: Array, scanner: Scanner, beams: int, walls: Array, *, glass: BoolArray | None = None,
    discs: Array | None = None,
) -> Array:  # fmt: skip
    """Exact ranges (S, B) [m] from body poses (S, 3), inf for no return. walls (W, 4): x0, y0, x1, y1 [m]; glass (W,):
    it returns nothing, but occludes; discs (S, D, 3): x, y, radius [m] at each pose, none is seen from inside.
    """
    at = compose(np.asarray(poses, float), inverse(np.array([*scanner.translation, scanner.rotation])))
    ranges = np.empty((len(at), beams))
    hit = np.empty((len(at), beams), np.int64)
    moving = np.zeros((len(at), 0, 3)) if discs is None else discs
    _cast(at, scanner.angle_min, scanner.angle_step, walls, moving, ranges, hit)
    ranges[ranges >= scanner.max_range] = np.inf
    if glass is not None:
        ranges[np.append(glass, False)[hit] & (hit != NOTHING)] = np.inf
    return ranges


FLOOR = 1e-10  # m^2, rad^2; smallest eigenvalue of an increment's covariance
SLIP = (0.04, 0.01, 0.04)  # m, m, rad; standard deviation of a slip's contribution to an increment, at steps of 0.1 m
PANE = 1.5  # m, longest piece of a wall that is wholly of glass or not
PERSON, MANNERS = 0.22, 0.6  # m, radius of a person, and smallest distance of people from the scanner


@dataclass(frozen=True)
class Floorplan:
    """Parameters of the world. Angles: radians here, degrees in names and flags. UsageError for an invalid value."""

    glass: bool = told(False, "some pieces of the walls return nothing", hint="its share of the walls is panes=SHARE")
    people: bool = told(False, "people walk about and occlude walls", hint="their number is crowd=N")
    frames: int = told(3000, "number of frames")
    period: float = told(0.2, "s between frames")
    thin: int = told(1, "one of this many frames has a scan, the first included")
    speed: float = told(0.5, "m/s, along straight lines")
    turn_rate: float = told(0.6, "rad/s, at most")
    sigma_along: float = told(0.02, "m per sqrt(s), odometry noise density along the motion")
    sigma_across: float = told(0.007, "m per sqrt(s), the same across the motion")
    sigma_turn: float = told(0.02, "rad per sqrt(s), the same of the heading")
    slip: float = told(0.01, "probability that the wheels slip in a frame", most="share of 1")
    beams: int = told(180, "in a scan")
    field_of_view: float = in_degrees(180.0, "deg, from the first beam to one after the last")
    max_range: float = told(30.0, "m; longer ranges are no return")
    sigma_range: float = told(0.015, "m, standard deviation of a range")
    rotation: float = in_degrees(0.0, "deg, of the scanner: p_scanner = R p_body + T")
    translation_x: float = told(0.0, "m, T")
    translation_y: float = told(0.0, "m, T")
    panes: float = told(0.15, "share of the walls that is of glass, where there is glass", most="share of 1")
    crowd: int = told(15, "number of people, where there are people")
    prior_sigma: float = told(0.0, "m")
    prior_sigma_heading: float = told(0.0, "rad; the prior mean is drawn with them (0: it is exact)")

    def __post_init__(self) -> None:
        scans = ("beams", "field_of_view", "max_range", "sigma_range")
        positive = ("frames", "period", "thin", "speed", "turn_rate", *scans)
        check_parameters("floorplan", self, positive=positive, signed=("rotation", "translation_x", "translation_y"))
        if self.field_of_view > 2.0 * math.pi + 1e-12:
            raise UsageError(f"floorplan: field_of_view = {math.degrees(self.field_of_view):g}; at most 360 deg")

    def scanner(self) -> Scanner:
        """The scanner, with beams from right to left, symmetric except for one step."""
        step, place = self.field_of_view / self.beams, (self.translation_x, self.translation_y)
        return Scanner(-0.5 * self.field_of_view, step, self.max_range, self.sigma_range, self.rotation, place)


def plan_of(seed: int) -> Building:
    """The building of a seed; no parameter changes it."""
    return build(streams(seed, 1)[0])


def simulate(floorplan: Floorplan, seed: int, name: str | None = None) -> Log:
    """One log of the floor plan. Same parameters and seed: same bytes."""
    _, route_rng, odometry_rng, range_rng, glass_rng, people_rng, prior_rng = streams(seed, 7)
    building = plan_of(seed)
    time = floorplan.period * np.arange(floorplan.frames, dtype=np.float64)
    truth = drive(building.ways, route_rng, time, floorplan.speed, floorplan.turn_rate)
    increments, floored = _odometry(floorplan, truth, odometry_rng)
    frame = np.arange(0, floorplan.frames, floorplan.thin)
    walls, of_glass = _panes(building, floorplan.panes if floorplan.glass else 0.0, glass_rng)
    crowd = _people(floorplan, building, time, people_rng)[frame] if floorplan.people else None
    scanner = floorplan.scanner()
    if crowd is not None:  # people too near the scanner are absent: radius zero
        at = compose(truth[frame], inverse(np.array([*scanner.translation, scanner.rotation])))
        crowd[np.hypot(crowd[..., 0] - at[:, None, 0], crowd[..., 1] - at[:, None, 1]) < MANNERS, 2] = 0.0
    ranges = scan_ranges(truth[frame], scanner, floorplan.beams, walls, glass=of_glass, discs=crowd)
    ranges = np.maximum(ranges + floorplan.sigma_range * range_rng.standard_normal(ranges.shape), 1e-3)
    ranges[ranges >= floorplan.max_range] = 0.0
    inputs = Inputs(
        drawn_prior(truth[0], floorplan.prior_sigma, floorplan.prior_sigma_heading, prior_rng), time, increments,
        Observations(np.empty(0, np.int64), np.empty((0, 2)), np.empty((0, 2, 2))),
        RangeBearing(max_range=floorplan.max_range), floored=floored, scans=Scans(scanner, frame, ranges),
    )  # fmt: skip
    return Log(name or f"floorplan:{seed}", inputs, Truth(truth), source={"kind": "floorplan", "seed": seed})


def _odometry(floorplan: Floorplan, truth: Array, rng: np.random.Generator) -> tuple[Increments, int]:
    """Noisy increments, their covariance that of steady noise and rare slips: the same for all, it tells no motion."""
    exact = se2.between(truth[:-1], truth[1:])
    density = np.array([floorplan.sigma_along, floorplan.sigma_across, floorplan.sigma_turn])
    steady = density * math.sqrt(floorplan.period) * rng.standard_normal(exact.shape)
    slipped = (rng.random((len(exact), 1)) < floorplan.slip) * np.array(SLIP) * rng.standard_normal(exact.shape)
    mean, covariance = np.zeros_like(truth), np.zeros((len(truth), 3, 3))
    mean[1:] = exact + steady + slipped
    covariance[1:] = np.diag(np.square(density) * floorplan.period + floorplan.slip * np.square(SLIP))
    covariance, floored = floor_covariances(covariance, FLOOR)
    return Increments(mean, covariance), floored


def _panes(building: Building, share: float, rng: np.random.Generator) -> tuple[Array, BoolArray]:
    """All walls (W, 4) with their faces cut into panes, and which of them (W,) are of glass."""
    faces = building.walls[: building.faces]
    count = np.maximum(np.ceil(np.linalg.norm(faces[:, 2:] - faces[:, :2], axis=1) / PANE), 1.0).astype(int)
    part = np.concatenate([np.arange(n) / n for n in count])[:, None]
    a, way = np.repeat(faces[:, :2], count, axis=0), np.repeat(faces[:, 2:] - faces[:, :2], count, axis=0)
    step = way / np.repeat(count, count)[:, None]
    glass = rng.random(len(a)) < share
    if not share:
        return building.walls, np.zeros(len(building.walls), bool)
    cut = np.concatenate([a + part * way, a + part * way + step], axis=1)
    rest = building.walls[building.faces :]
    return np.concatenate([cut, rest]), np.concatenate([glass, np.zeros(len(rest), bool)])


def _people(floorplan: Floorplan, building: Building, time: Array, rng: np.random.Generator) -> Array:
    discs = np.full((len(time), floorplan.crowd, 3), PERSON)
    for i, own in enumerate(rng.spawn(floorplan.crowd)):
        discs[:, i, :2] = drive(building.ways, own, time, float(own.uniform(0.6, 1.3)), math.pi)[:, :2]
    return discs

"""A building by seed: crossing corridors, rooms with doors, furniture, and a graph of paths to drive.

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

from data.inputs import IntArray
from data.locked import Locked
from data.se2 import Array

INSIDE = 0.7
"""m from the wall to the first place behind a door."""
CLEARANCE = 0.5
"""m, smallest distance of objects from every path: half a robot and its deviation."""


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
    """A connected graph of places.

    Attributes:
        place: (V, 2) [m].
        edge: (E, 2) places joined by a straight path.
        target: (T,) destinations: all in rooms, and the ends of corridors.
    """

    place: Array
    edge: IntArray
    target: IntArray

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
        both = np.concatenate([i, j]), np.concatenate([j, i])
        graph = scipy.sparse.csr_array((np.tile(cost, 2), both), shape=(n, n))
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
    distance = np.linalg.norm(from_corner - u[:, :, None] * e, axis=2).min()
    outside = (e[:, 0] * from_corner[:, :, 1] - e[:, 1] * from_corner[:, :, 0] < 0.0).any(axis=1)
    return bool(distance > CLEARANCE and outside.all())


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
            corner = rng.permutation(4)[:2]
            at = [(x0 + (0.25 + 0.5 * (c % 2)) * w, y0 + (0.25 + 0.5 * (c // 2)) * h) for c in corner]
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


HALF_WALL = 0.06
"""m, half of a wall's thickness."""
NARROW, ROOMY = 3.2, 6.5
"""m, smallest width of a cut room, and longest side of one left uncut."""
BESIDE_DOOR = 0.3
"""m, smallest distance from a door to the end of its wall."""
EPS = 1e-6
"""m, tolerance of equal coordinates."""


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
    """A building.

    Attributes:
        walls: (W, 4) segments x0, y0, x1, y1 [m]: walls, jambs, furniture.
        faces: number of leading segments that are faces of walls (and may be of glass).
        ways: paths of robots and people.
    """

    walls: Array
    faces: int
    ways: Ways


def build(rng: np.random.Generator) -> Building:
    """A building of 25 to 30 m a side."""
    corridors, rooms = _layout(rng)
    doors = _doors(rng, corridors, rooms)
    faces = [cut for face in _faces(corridors, rooms) for cut in _cut(face, doors)]
    ways = ways_of(rng, corridors, rooms, doors)
    jambs = [Face(1 - d.axis, end, d.at - HALF_WALL, d.at + HALF_WALL) for d in doors for end in (d.low, d.high)]
    solid = [_segment(f) for f in [*faces, *jambs]]
    standing = _furniture(rng, corridors, rooms, ways.trace())
    return Building(np.concatenate([np.array(solid), standing]), len(faces), ways)


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
    """A block cut across its longer side repeatedly."""
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
    """A face without its door openings."""
    near = [d for d in doors if d.axis == face.axis and abs(abs(d.at - face.at) - HALF_WALL) < EPS]
    # a wall may consist of several faces, and a door lie in two
    gaps = sorted((d.low, min(d.high, face.high)) for d in near if d.low < face.high and d.high > face.low)
    for low, high in _between(face.low, face.high, gaps):
        yield Face(face.axis, face.at, low, high)


def _segment(face: Face) -> tuple[float, float, float, float]:
    _, at, low, high = face
    return (at, low, at, high) if face.axis == 0 else (low, at, high, at)


def _furniture(rng: np.random.Generator, corridors: list[Rect], rooms: list[Rect], ways: Array) -> Array:
    """Segments (F, 4): boxes in any direction and pillars in rooms, shallow boxes at corridor walls."""
    found = list[Array]()
    for room in rooms:
        for _ in range(int(rng.integers(3, 8))):
            pillar = rng.random() < 0.25
            half = np.full(2, rng.uniform(0.1, 0.25)) if pillar else 0.5 * rng.uniform((0.5, 0.4), (1.8, 0.9))
            margin = HALF_WALL + float(np.hypot(*half))
            inside = room.inset(margin)
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

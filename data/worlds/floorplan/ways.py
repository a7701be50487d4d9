"""Ways through a building, a graph of points: along the middle of corridors, through doors, about in rooms."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from data.inputs import IntArray, read_only
from data.se2 import Array

INSIDE = 0.7
"""m from the wall at which one who came through a door turns."""
CLEARANCE = 0.5
"""m from every way to the nearest thing that stands: half a robot, and its wandering."""
Rectangle = tuple[float, float, float, float]


class Door(NamedTuple):
    """An opening in a wall of constant x (axis 0) or y (axis 1), from low to high, between a room and another side."""

    axis: int
    at: float
    low: float
    high: float
    room: int
    other: int


@dataclass(frozen=True, eq=False)
class Ways:
    """A connected graph of places.

    Attributes:
        place: (V, 2) [m].
        edge: (E, 2) places joined by a straight way.
        target: (T,) places worth going to: all in rooms, and the ends of corridors.
    """

    place: Array
    edge: IntArray
    target: IntArray

    def __post_init__(self) -> None:
        read_only(self)

    def trace(self) -> Array:
        """Points (P, 2) of every way, at most 0.1 m apart."""
        a, b = self.place[self.edge[:, 0]], self.place[self.edge[:, 1]]
        n = np.maximum(np.ceil(self.length / 0.1), 1.0).astype(int)
        share = np.concatenate([np.linspace(0.0, 1.0, k + 1) for k in n])[:, None]
        points: Array = np.repeat(a, n + 1, axis=0) * (1.0 - share) + np.repeat(b, n + 1, axis=0) * share
        return points

    def routes(self, cost: Array) -> csr_array:
        """The graph with a cost (E,) of each way, for shortest paths."""
        i, j = self.edge.T
        n = len(self.place)
        return csr_array((np.tile(cost, 2), (np.concatenate([i, j]), np.concatenate([j, i]))), shape=(n, n))

    @property
    def length(self) -> Array:
        """(E,) m of each way."""
        lengths: Array = np.linalg.norm(self.place[self.edge[:, 0]] - self.place[self.edge[:, 1]], axis=1)
        return lengths

    def route(self, start: int, goal: int, cost: Array) -> list[int]:
        """Places from start to goal, both included, by the cheapest way."""
        _, before = dijkstra(self.routes(cost), indices=[start], return_predecessors=True)
        path = [goal]
        while path[-1] != start:
            path.append(int(before[0, path[-1]]))
        return path[::-1]


def clear_of(trace: Array, outline: Array) -> bool:
    """Whether a convex outline (c, 2), counterclockwise, is farther than `CLEARANCE` from all points (P, 2) of ways."""
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


def ways_of(
    rng: np.random.Generator, corridors: Sequence[Rectangle], rooms: Sequence[Rectangle], doors: Sequence[Door]
) -> Ways:
    """Ways through rooms and corridors, rectangles (x0, y0, x1, y1), by all doors."""
    place, edge, target = list[tuple[float, float]](), list[tuple[int, int]](), list[int]()

    def add(x: float, y: float) -> int:
        place.append((x, y))
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
                here = add(middle[i], end) if upright[i] else add(end, middle[i])
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
            round_it = [
                add(float(x0 + (0.25 + 0.5 * (c % 2)) * w), float(y0 + (0.25 + 0.5 * (c // 2)) * h)) for c in corner
            ]
            edge += [(centre[-1], round_it[0]), (round_it[0], round_it[1]), (round_it[1], centre[-1])]
            target += round_it
    for d in doors:
        along = 0.5 * (d.low + d.high)
        sides = list[int]()
        for side in (d.room, d.other):
            if side >= len(rooms):
                c = side - len(rooms)
                if upright[c] == (d.axis == 0):  # a door in the corridor's long side
                    here = add(middle[c], along) if d.axis == 0 else add(along, middle[c])
                    stops[c].append((along, here))
                else:  # at its end
                    o = d.axis
                    far = d.at + (1.0 if corridors[c][o] + corridors[c][o + 2] > 2.0 * d.at else -1.0)
                    here = add(far, middle[c]) if d.axis == 0 else add(middle[c], far)
                    stops[c].append((far, here))
                    near = add(far, along) if d.axis == 0 else add(along, far)
                    edge.append((here, near))
                    here = near
            else:
                r = rooms[side]
                to = INSIDE if r[d.axis] + r[d.axis + 2] > 2.0 * d.at else -INSIDE
                here = add(d.at + to, along) if d.axis == 0 else add(along, d.at + to)
                edge.append((here, centre[side]))
            sides.append(here)
        edge.append((sides[0], sides[1]))
    for along_it in stops:
        edge += [(a, b) for (_, a), (_, b) in pairwise(sorted(along_it))]
    return Ways(np.array(place), np.array(edge), np.array(target))

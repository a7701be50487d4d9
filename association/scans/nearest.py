"""A grid that knows for each of its cells the nearest reference point: a look-up instead of a search."""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from data.se2 import Array

CELL = 0.05
"""m; the nearest point is that of the cell's centre, half a cell off at most: no error along a line."""


class Reference(NamedTuple):
    """Points (P, 2) with normals (P, 2) in one frame, and the grid over them.

    `nearest` (n, n) int32 holds the number of the point nearest to the cell's centre, -1 beyond `reach`; the grid spans
    -half .. half metres about the frame's origin.
    """

    xy: Array
    normal: Array
    nearest: NDArray[np.int32]
    half: float
    cell: float


class NearestGrid:
    """Makes `Reference`s on one grid that is used again and again: a reference is good until the next is made."""

    def __init__(self, half: float, reach: float, cell: float = CELL) -> None:
        side = 2 * int(np.ceil(half / cell))
        self.half, self.reach, self.cell = 0.5 * side * cell, reach, cell
        self._index = np.full((side, side), -1, np.int32)
        self._distance = np.full((side, side), np.inf, np.float32)
        self._drawn = np.zeros((0, 2))

    def reference(self, xy: Array, normal: Array) -> Reference:
        """Index points (P, 2) with normals (P, 2); those outside the grid are never found."""
        _clear(self._index, self._distance, self._drawn, self.half, self.cell, self.reach)
        _draw(self._index, self._distance, xy, self.half, self.cell, self.reach)
        self._drawn = xy
        return Reference(xy, normal, self._index, self.half, self.cell)


@numba.njit(cache=True)
def _clear(index, distance, xy, half, cell, reach):  # type: ignore[no-untyped-def]
    side, r = len(index), int(np.ceil(reach / cell))
    for k in range(len(xy)):
        ci, cj = int(np.floor((xy[k, 0] + half) / cell)), int(np.floor((xy[k, 1] + half) / cell))
        for i in range(max(ci - r, 0), min(ci + r + 1, side)):
            for j in range(max(cj - r, 0), min(cj + r + 1, side)):
                index[i, j] = -1
                distance[i, j] = np.inf


@numba.njit(cache=True)
def _draw(index, distance, xy, half, cell, reach):  # type: ignore[no-untyped-def]
    side, r = len(index), int(np.ceil(reach / cell))
    for k in range(len(xy)):
        x, y = xy[k, 0] + half, xy[k, 1] + half
        ci, cj = int(np.floor(x / cell)), int(np.floor(y / cell))
        for i in range(max(ci - r, 0), min(ci + r + 1, side)):
            dx = (i + 0.5) * cell - x
            for j in range(max(cj - r, 0), min(cj + r + 1, side)):
                dy = (j + 0.5) * cell - y
                d = np.float32(dx * dx + dy * dy)
                if d <= reach * reach and d < distance[i, j]:
                    distance[i, j] = d
                    index[i, j] = k

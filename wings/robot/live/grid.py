"""The occupancy grid of the page: drawn anew every few seconds from the key scans, a few of them in each period.

So the work of a period is bounded. The picture is a PNG of one colour whose opacity is the probability of a wall, so it
fits a light and a dark page; unknown cells are transparent. Equal scans and poses give equal bytes.
"""

from __future__ import annotations

import base64
import json
import struct
import zlib
from collections.abc import Callable

import numpy as np

from data.inputs import Scanner
from data.se2 import Array
from wings.laser.scans.occupancy import Grid, GridInParts

EVERY = 5.0  # s of the robot's time from one grid to the next
SCANS = 10  # in a period
RESOLUTION, MOST_CELLS = 0.05, 2_000_000  # m, 70 m a side
COLOUR, FREE = 112, 24  # grey of all cells, and opacity of free ones

Keys = tuple[Array, Array, Scanner]  # poses (n, 3), scans (n, B), of one scanner


class GridPainter:
    """Draws the grid, a part in each period."""

    def __init__(self, keys: Callable[[], Keys | None], show: Callable[[bytes], None]) -> None:
        """`keys` gives the present key scans, None before the first; `show` gets each finished grid (`as_json`)."""
        self._keys, self._show = keys, show
        self._begun = -EVERY
        self._drawing: GridInParts | None = None
        self._left: list[tuple[Array, Array]] = []

    def work(self, t: float, scans: int = SCANS) -> None:
        """Draw so many more scans at robot time t [s], or begin where a grid is due."""
        if self._drawing is None:
            found = self._keys() if t - self._begun >= EVERY else None
            if found is None:
                return
            poses, ranges, scanner = found
            self._begun = t
            self._drawing = GridInParts(poses, scanner, RESOLUTION, MOST_CELLS)
            self._left = list(zip(poses, ranges, strict=True))
            return
        now, self._left = self._left[:scans], self._left[scans:]
        self._drawing.add(*(np.array(part) for part in zip(*now, strict=True)))
        if not self._left:
            self._show(as_json(self._drawing.grid()))
            self._drawing = None

    def finish(self, t: float) -> None:
        """Draw the last grid whole."""
        self._drawing, self._begun = None, -EVERY
        self.work(t)
        if self._drawing is not None:
            self.work(t, len(self._left))


def as_json(grid: Grid) -> bytes:
    """A grid for the page: its lower left corner and size [m], and the picture."""
    rows, columns = grid.log_odds.shape
    place = {
        "west": float(grid.origin[0]), "south": float(grid.origin[1]),
        "wide": columns * grid.resolution, "high": rows * grid.resolution,
    }  # fmt: skip
    return json.dumps({**place, "png": base64.b64encode(picture(grid)).decode()}).encode()


def picture(grid: Grid) -> bytes:
    """A PNG of a grid, the northernmost row first."""
    p = grid.probability
    opacity = np.where(grid.log_odds == 0.0, 0.0, FREE + (255 - FREE) * np.clip(2.0 * p - 1.0, 0.0, 1.0))
    alpha = np.round(opacity[::-1]).astype(np.uint8)
    rows, columns = alpha.shape
    # each row: filter 0, then grey and opacity of each cell
    lines = np.zeros((rows, 1 + 2 * columns), np.uint8)
    lines[:, 1::2], lines[:, 2::2] = COLOUR, alpha
    header = struct.pack(">IIBBBBB", columns, rows, 8, 4, 0, 0, 0)  # 8 bits, grey with opacity
    parts = ((b"IHDR", header), (b"IDAT", zlib.compress(lines.tobytes(), 1)), (b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(_chunk(kind, data) for kind, data in parts)


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

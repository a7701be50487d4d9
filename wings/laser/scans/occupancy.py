"""Occupancy grid of laser scans from known poses, and a test whether two scans contradict each other.

Moravec and Elfes, "High resolution maps from wide angle sonar", ICRA 1985; Probabilistic Robotics, Table 9.1. Cells
along a beam: Amanatides and Woo, "A fast voxel traversal algorithm for ray tracing", Eurographics 1987. Two scans
contradict each other where one has a surface and a beam of the other passes through it.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from data.compiled import njit
from data.inputs import Scanner
from data.locked import Locked
from data.se2 import Array, BoolArray, compose, inverse, transform_points
from wings.laser.scans.points import beams_of

HIT, MISS = 0.85, -0.41
"""Log odds of a cell in which a beam ends (0.70) and of one that it crosses (0.40): Hornung et al., "OctoMap",
Autonomous Robots 34, 2013, section 5.2."""
LEAST, MOST = -2.0, 3.5  # bounds of the log odds (0.12 and 0.97; same source), so that a changed place is updated soon
MARGIN = 0.5  # m of unknown cells around the observed area
MOST_CELLS = 100_000_000  # largest grid: 500 m a side at 5 cm, 1.2 GB while it is computed
_FREE, _ENDS = 1, 2


@dataclass(frozen=True, eq=False)
class Grid(Locked):
    """An occupancy grid, axes along those of the world."""

    origin: Array  # (2,) m, the lower left corner of cell [0, 0] in the world
    resolution: float  # m, side of a cell
    log_odds: Array  # (H, W) of occupancy, row by y and column by x; 0 where unknown

    @property
    def probability(self) -> Array:
        """Probability of occupancy (H, W), 0.5 where unknown."""
        return np.asarray(1.0 / (1.0 + np.exp(-self.log_odds)))

    @property
    def extent(self) -> tuple[float, float, float, float]:
        """West, east, south and north edge in the world [m]."""
        h, w = self.log_odds.shape
        x, y = float(self.origin[0]), float(self.origin[1])
        return x, x + w * self.resolution, y, y + h * self.resolution


@njit
def _add_scans(origins: Array, ends: Array, returned: BoolArray, log_odds: Array, touched: NDArray[np.int32]) -> None:
    """Add scans with ends (K, B, 2) from origins (K, 2) to log_odds (H, W); a cell changes once per scan."""
    for k in range(len(ends)):
        for b in range(ends.shape[1]):
            if returned[k, b]:
                column, row = math.floor(ends[k, b, 0]), math.floor(ends[k, b, 1])
                if touched[row, column] != 3 * k + _ENDS:
                    touched[row, column] = 3 * k + _ENDS
                    log_odds[row, column] = min(log_odds[row, column] + HIT, MOST)
        x, y = origins[k, 0], origins[k, 1]
        for b in range(ends.shape[1]):
            if not returned[k, b]:
                continue
            column, row = math.floor(x), math.floor(y)
            dx, dy = ends[k, b, 0] - x, ends[k, b, 1] - y
            right, up = (1 if dx > 0.0 else -1), (1 if dy > 0.0 else -1)
            # share of the beam to the next boundary of columns, or rows, and between boundaries
            across = 1.0 / abs(dx) if dx != 0.0 else np.inf
            along = 1.0 / abs(dy) if dy != 0.0 else np.inf
            next_column = ((column + 1 - x) if dx > 0.0 else (x - column)) * across if dx != 0.0 else np.inf
            next_row = ((row + 1 - y) if dy > 0.0 else (y - row)) * along if dy != 0.0 else np.inf
            # as many steps as boundaries between the two cells, so rounding cannot miss the end
            for _ in range(abs(math.floor(ends[k, b, 0]) - column) + abs(math.floor(ends[k, b, 1]) - row)):
                if touched[row, column] < 3 * k + _FREE:
                    touched[row, column] = 3 * k + _FREE
                    log_odds[row, column] = max(log_odds[row, column] + MISS, LEAST)
                if next_column < next_row:
                    next_column += across
                    column += right
                else:
                    next_row += along
                    row += up


def occupancy_grid(
    poses: Array, ranges: Array, scanner: Scanner, *, resolution: float = 0.05, most_cells: int = MOST_CELLS
) -> Grid:
    """The occupancy grid of scans (K, B) [m] from poses (K, 3), finite ones, in cells of `resolution` [m], doubled
    while there are more than `most_cells`. A range of 0, NaN, or max_range and beyond tells nothing: it may be glass.
    """
    poses, ranges = np.asarray(poses, float), np.asarray(ranges, float)
    sure = np.isfinite(poses).all(axis=1)
    poses, ranges = poses[sure], ranges[sure]
    returned = (ranges > 0.0) & (ranges < scanner.max_range)
    length = np.where(returned, ranges, 0.0)
    at = compose(poses, inverse(np.array([*scanner.translation, scanner.rotation])))
    angle = at[:, 2:] + scanner.angle_min + scanner.angle_step * np.arange(ranges.shape[1])
    ends = at[:, None, :2] + length[:, :, None] * np.stack([np.cos(angle), np.sin(angle)], axis=2)
    seen = np.concatenate([ends.reshape(-1, 2), at[:, :2]]) if len(at) else np.zeros((1, 2))
    while True:
        # whole cells from the world's origin, so that grids of the same place have the same cells
        low = np.floor((seen.min(axis=0) - MARGIN) / resolution)
        width, height = (np.ceil((seen.max(axis=0) + MARGIN) / resolution) - low).tolist()
        if width * height <= most_cells:
            break
        resolution *= 2.0
    log_odds = np.zeros((int(height), int(width)))
    touched = np.full(log_odds.shape, -1, np.int32)
    _add_scans(at[:, :2] / resolution - low, ends / resolution - low, returned, log_odds, touched)
    return Grid(np.round(low * resolution, 9), resolution, log_odds)  # rounded for files: 1.15, not 1.1500000000000001


TOLERANCE = 0.3  # m, by which a surface must lie before another, besides ...
TOLERANCE_SHARE = 0.05  # ... this share of its range, to contradict it: the effect of a heading error at a grazing wall


def contradiction(
    ranges: Array, others: Array, relative: Array, scanner: Scanner, max_range: float,
    tolerance: tuple[float, float] = (TOLERANCE, TOLERANCE_SHARE),
) -> float:  # fmt: skip
    """Share of the shared beams of two scans (B,) that contradict, 0 where none is shared.

    `relative` (3,) is the body's pose at the second scan in its frame at the first. Each end point of either scan is
    compared with the other scan: nearer than that beam's surface (and its neighbours') it contradicts, at the same
    range it agrees, behind it nothing is known. `tolerance`: in m, and as a share of the range.
    """
    beams = beams_of(scanner, len(ranges))
    on_scanner, step = np.array([*scanner.translation, scanner.rotation]), scanner.angle_step
    seen = against = 0
    for mine, theirs, way in ((others, ranges, relative), (ranges, others, inverse(relative))):
        r = mine[(mine > 0.0) & (mine < max_range)]
        ends = beams.origin + r[:, None] * beams.direction[(mine > 0.0) & (mine < max_range)]
        x, y = transform_points(compose(on_scanner, way), ends).T
        bearing = np.arctan2(y, x) - scanner.angle_min
        bearing = np.remainder(bearing, 2.0 * math.pi) if step > 0.0 else bearing
        i = np.floor(bearing / step + 0.5).astype(np.int64)
        inside = (i >= 1) & (i <= len(theirs) - 2)
        around = theirs[i[inside, None] + [-1, 0, 1]]
        known = ((around > 0.0) & (around < max_range)).all(axis=1)
        distance, around = np.hypot(x, y)[inside][known], around[known]
        slack = tolerance[0] + tolerance[1] * distance
        nearer = distance < around.min(axis=1) - slack
        seen += int((nearer | (distance < around.max(axis=1) + slack)).sum())
        against += int(nearer.sum())
    return against / max(seen, 1)

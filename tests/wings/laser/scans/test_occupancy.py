"""The occupancy grid: cells known on paper, and a reference that cuts every beam with every cell."""

import math

import numpy as np
import pytest

from data.inputs import Scanner
from data.se2 import compose, inverse
from wings.laser.scans.occupancy import HIT, LEAST, MISS, MOST, occupancy_grid

AHEAD = Scanner(0.0, 0.1, 30.0, 0.01)


def crosses(a, b, box):
    begin, end = 0.0, 1.0
    for axis in (0, 1):
        d = b[axis] - a[axis]
        if abs(d) < 1e-15:
            if not box[0][axis] <= a[axis] <= box[1][axis]:
                return False
            continue
        t = sorted(((box[0][axis] - a[axis]) / d, (box[1][axis] - a[axis]) / d))
        begin, end = max(begin, t[0]), min(end, t[1])
    return end - begin > 1e-9


def reference(grid, poses, ranges, scanner):
    """Log odds of every cell by the definition: a scan's ends are occupied, what its beams cross else is free."""
    log_odds, res = np.zeros(grid.log_odds.shape), grid.resolution
    rows, columns = log_odds.shape
    for pose, scan in zip(poses, ranges):
        at = compose(pose, inverse(np.array([*scanner.translation, scanner.rotation])))
        angle = at[2] + scanner.angle_min + scanner.angle_step * np.arange(len(scan))
        ends = at[:2] + scan[:, None] * np.stack([np.cos(angle), np.sin(angle)], 1)
        ends = ends[(scan > 0) & (scan < scanner.max_range)]
        ended = {tuple(np.floor((e - grid.origin) / res).astype(int)[::-1]) for e in ends}
        for r in range(rows):
            for c in range(columns):
                low = grid.origin + res * np.array([c, r])
                if (r, c) in ended:
                    log_odds[r, c] = min(log_odds[r, c] + HIT, MOST)
                elif any(crosses(at[:2], e, (low, low + res)) for e in ends):
                    log_odds[r, c] = max(log_odds[r, c] + MISS, LEAST)
    return log_odds


@pytest.mark.parametrize("seed", range(3))
def test_every_cell_is_what_the_definition_says(seed):
    rng = np.random.default_rng(seed)
    poses = np.column_stack([rng.uniform(-0.5, 0.5, (5, 2)), rng.uniform(-4, 4, 5)])
    fan = Scanner(-1.5, 0.5, 2.5, 0.01, rotation=0.4, translation=(0.1, -0.2))
    ranges = rng.uniform(0.2, 3.0, (5, 7))
    ranges[rng.random(ranges.shape) < 0.1] = 0.0
    grid = occupancy_grid(poses, ranges, fan, resolution=0.25)
    np.testing.assert_allclose(grid.log_odds, reference(grid, poses, ranges, fan), atol=1e-12)
    assert (grid.log_odds > 0).any()
    assert (grid.log_odds < MISS).any()


def test_where_poses_run_away_cells_are_larger_and_missing_ones_are_left_out():
    scan = np.full((2, 3), 1.0)
    far = occupancy_grid(np.array([[0.0, 0, 0], [1e6, 1e6, 0]]), scan, AHEAD, most_cells=10**6)
    assert far.log_odds.size <= 10**6
    assert far.resolution == 0.05 * 2**15
    lost = occupancy_grid(np.array([[0.0, 0, 0], [math.nan, 0, 0]]), scan, AHEAD)
    np.testing.assert_array_equal(lost.log_odds, occupancy_grid(np.zeros((1, 3)), scan[:1], AHEAD).log_odds)

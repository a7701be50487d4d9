"""Corners of a scan: known rooms, where there is none, and a covariance that is that of their errors.

The occupancy grid: cells known on paper, and a reference that cuts every beam with every cell.
"""

import math

import numpy as np
import pytest
from scipy.spatial import cKDTree

from data.inputs import Scanner
from data.se2 import compose, inverse
from wings.laser.floorplan.world import scan_ranges
from wings.laser.scans.corners import corners
from wings.laser.scans.occupancy import HIT, LEAST, MISS, MOST, occupancy_grid

ROUND = Scanner(-math.pi, math.radians(1.0), 20.0, 0.01)
HALF = Scanner(-0.5 * math.pi, math.radians(1.0), 20.0, 0.01)
ROOM = np.array([[-2, -1.5, 3, -1.5], [3, -1.5, 3, 2.5], [3, 2.5, -2, 2.5], [-2, 2.5, -2, -1.5]])


def scan(scanner, walls, pose=(0.0, 0.0, 0.0), beams=360):
    r = scan_ranges(np.array([pose]), scanner, beams, np.asarray(walls, float))[0]
    return np.where(np.isfinite(r), r, 0.0)


@pytest.mark.parametrize("walls", [
    [[2.0, -5, 2, 5]],  # a wall
    [[2.0, -5, 2, 0], [4, 0, 4, 5]],  # one before another
    [[2.0, -5, 2, 0], [2, 0, 2.6, 5]],  # a bend of 7 degrees
    [[2.0, -5, 2, 0.1], [2, 0.1, 2.2, 0.1]],  # too short an end
    [],
])  # fmt: skip
def test_what_is_no_corner(walls):
    xy, R = corners(scan(HALF, np.reshape(walls, (-1, 4)), beams=180), HALF)
    assert (xy.shape, R.shape) == ((0, 2), (0, 2, 2))


@pytest.mark.parametrize("nothing", [0.0, np.nan, 81.83])
def test_beams_without_return_are_no_points(nothing):
    ranges = scan(ROUND, ROOM)
    ranges[:90] = nothing
    xy, _ = corners(ranges, ROUND)
    assert len(xy) == 3
    assert len(corners(np.full(360, nothing), ROUND)[0]) == 0


def test_stated_covariance_is_that_of_many_noisy_scans():
    exact, rng = scan(ROUND, ROOM, (0.7, 0.3, 0.2)), np.random.default_rng(0)
    truth = corners(exact, ROUND)[0]
    errors, stated = [[] for _ in truth], [[] for _ in truth]
    for _ in range(400):
        xy, R = corners(exact + ROUND.sigma * rng.standard_normal(360), ROUND)
        distance, which = cKDTree(truth).query(xy)
        for i, w in enumerate(which):
            assert distance[i] < 0.1
            errors[w].append(xy[i] - truth[w])
            stated[w].append(R[i])
    for e, R in zip(errors, stated):
        assert len(e) > 270  # noise may cut a wall near its corner; then there is none, rather than a bad one
        mean = np.mean(R, axis=0)
        # a sample covariance of 400 has standard errors of 7 % of its diagonal
        white = np.linalg.solve(np.linalg.cholesky(mean), np.transpose(e))
        np.testing.assert_allclose(white @ white.T / len(e), np.eye(2), atol=0.3)


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

"""Corners of a scan: known rooms, where there is none, and a covariance that is that of their errors."""

import math

import numpy as np
import pytest
from scipy.spatial import cKDTree

from data.inputs import Scanner
from wings.laser.floorplan.world import scan_ranges
from wings.laser.scans.corners import corners

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

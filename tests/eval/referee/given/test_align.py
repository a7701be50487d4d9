"""Alignment moves poses, covariances and maps together."""

from __future__ import annotations

import numpy as np
import pytest

from data import se2
from data.result import MapEstimate, Trajectory
from eval.referee.consistency import nees
from eval.referee.given.runs import alignment, moved, moved_map, moved_walls

RNG = np.random.default_rng(2)
TRUTH = np.column_stack([np.cumsum(RNG.uniform(0.1, 1.0, 40)), np.sin(np.arange(40)), RNG.uniform(-3, 3, 40)])
MOTION = np.array([4.0, -2.0, 2.5])


def covariances(n=40):
    root = RNG.normal(size=(n, 3, 3)) * 0.1
    return root @ root.transpose(0, 2, 1)


@pytest.mark.parametrize("how", ["first", "se2"])
def test_a_path_that_is_the_truth_elsewhere_comes_back(how):
    T = alignment(se2.compose(MOTION, TRUTH), TRUTH, how)
    assert np.allclose(T, se2.inverse(MOTION), atol=1e-9)


def test_nothing_is_moved_unless_asked_or_where_nothing_is_known():
    assert alignment(TRUTH, TRUTH, "none") is None
    assert alignment(TRUTH, np.full_like(TRUTH, np.nan), "se2") is None


def test_the_first_known_pose_is_the_one_that_is_matched():
    truth = TRUTH.copy()
    truth[:3] = np.nan
    estimate = se2.compose(MOTION, TRUTH) + np.linspace(0, 1, 40)[:, None]
    T = alignment(estimate, truth, "first")
    assert se2.compose(T, estimate)[3] == pytest.approx(truth[3], abs=1e-9)


def test_truth_and_estimate_moved_alike_have_the_nees_they_had():
    path = Trajectory(TRUTH + 0.1 * RNG.normal(size=TRUTH.shape), covariances())
    elsewhere = moved(MOTION, path)
    before = nees(path.pose, path.covariance, TRUTH, "pose")
    after = nees(elsewhere.pose, elsewhere.covariance, se2.compose(MOTION, TRUTH), "pose")
    assert after == pytest.approx(before, rel=1e-9)


def test_a_map_is_moved_with_its_path():
    C = covariances(5)[:, :2, :2]
    number = np.arange(5)
    m = moved_map(MOTION, MapEstimate(number, TRUTH[:5, :2], C, number, number))
    assert m.xy == pytest.approx(se2.compose(MOTION, TRUTH[:5])[:, :2])
    R = se2.rotation(2.5)
    assert m.covariance[3] == pytest.approx(R @ C[3] @ R.T)


def test_a_map_of_walls_is_moved_as_the_points_on_them():
    number, walls = np.arange(3), np.array([[2.0, 0.3], [-1.0, 2.0], [0.0, -3.0]])
    C = 1e-4 * np.tile(np.array([[4.0, 1.0], [1.0, 2.0]]), (3, 1, 1))
    m = moved_walls(MOTION, MapEstimate(number, walls, C, number, number))
    for (rho, alpha), (rho2, alpha2) in zip(walls, m.xy, strict=True):
        normal = np.array([np.cos(alpha), np.sin(alpha)])
        points = rho * normal + np.outer([-3.0, 5.0], [-normal[1], normal[0]])
        there = se2.transform_points(MOTION, points)
        assert there @ [np.cos(alpha2), np.sin(alpha2)] == pytest.approx(rho2)
    drawn = walls[1] + np.random.default_rng(0).multivariate_normal(np.zeros(2), C[1], 20000)
    many = np.arange(len(drawn))
    elsewhere = moved_walls(MOTION, MapEstimate(many, drawn, np.tile(C[1], (len(drawn), 1, 1)), many, many))
    assert np.cov(elsewhere.xy.T) == pytest.approx(m.covariance[1], rel=0.05)

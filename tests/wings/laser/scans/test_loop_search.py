"""What loop closures are found with: uncertainty along the graph, correlative search, free space, and the scale."""

import math

import numpy as np
import pytest

from data.se2 import Array, between, compose, inverse
from tests.wings.laser.scans.rooms import ROOM, SCANNER, scan
from wings.laser.scans import uncertainty
from wings.laser.scans.matching import CELL, best_pose, pyramid
from wings.laser.scans.occupancy import contradiction
from wings.laser.scans.points import beams_of, scan_points

RNG = np.random.default_rng(11)


def _spread(rng: np.random.Generator, size: float = 0.01) -> Array:
    A = rng.standard_normal((3, 3))
    return np.asarray(size**2 * (A @ A.T + np.eye(3)), float)


def _slope(f, x: Array) -> Array:  # type: ignore[no-untyped-def]
    h = 1e-6
    return np.stack([(f(x + h * e) - f(x - h * e)) / (2.0 * h) for e in np.eye(3)], axis=1)


def test_covariances_of_composed_and_inverted_poses_are_those_of_numerical_jacobians() -> None:
    rng = np.random.default_rng(2)
    a, b = rng.standard_normal(3), rng.standard_normal(3)
    A, B = _spread(rng), _spread(rng)
    Ja, Jb, Ji = _slope(lambda x: compose(x, b), a), _slope(lambda x: compose(a, x), b), _slope(inverse, a)
    np.testing.assert_allclose(uncertainty.compose_covariances(a, A, b, B), Ja @ A @ Ja.T + Jb @ B @ Jb.T, atol=1e-10)
    np.testing.assert_allclose(uncertainty.inverse_covariance(a, A), Ji @ A @ Ji.T, atol=1e-10)


def test_uncertainty_follows_the_surest_path_whichever_way_its_edges_point() -> None:
    rng = np.random.default_rng(4)
    edges = uncertainty.PoseEdges()
    relative, covariance = rng.standard_normal((99, 3)), np.array([_spread(rng, 0.02) for _ in range(99)])
    for k in range(99):
        edges.add(k, k + 1, relative[k], covariance[k])
    pose, C = np.zeros(3), np.zeros((3, 3))
    for k in range(99):
        C, pose = uncertainty.compose_covariances(pose, C, relative[k], covariance[k]), compose(pose, relative[k])
    np.testing.assert_allclose(edges.project(0, np.array([99]))[0], C, rtol=1e-9)
    np.testing.assert_allclose(
        edges.project(99, np.array([0]))[0], uncertainty.inverse_covariance(pose, C), rtol=1e-6, atol=1e-9
    )
    edges.add(0, 99, pose, 1e4 * np.eye(3))
    np.testing.assert_allclose(edges.project(0, np.array([99]))[0], C, rtol=1e-9)
    short = 1e-6 * np.eye(3)
    edges.add(2, 90, np.array([1.0, 2.0, 0.5]), short)
    expected = uncertainty.inverse_covariance(np.array([1.0, 2.0, 0.5]), short)
    np.testing.assert_allclose(edges.project(90, np.array([2]))[0], expected, rtol=1e-9, atol=1e-15)
    assert np.isinf(edges.project(0, np.array([100]))[0]).all()


def test_candidates_are_the_nearest_ones_apart_from_each_other() -> None:
    distance = np.array([0.3, 0.1, 0.2, np.inf, 5.0, 0.4])
    np.testing.assert_array_equal(uncertainty.nearest_first(np.arange(len(distance)), distance, 2, 3), [1, 5])
    np.testing.assert_array_equal(uncertainty.nearest_first(np.arange(len(distance)), distance, 1, 2), [1, 2])


def test_search_finds_the_best_pose_of_its_window() -> None:
    rng = np.random.default_rng(6)
    xy = scan_points(scan(np.array([0.3, -0.2, 0.1]), ROOM), beams_of(SCANNER, 180), 9.0).xy
    points = scan_points(scan(np.array([0.9, 0.1, 0.5]), ROOM), beams_of(SCANNER, 180), 9.0).xy[::9]
    reference = pyramid(xy, 10.0)
    centre, window = np.array([0.35, 0.6, 0.3]) + 0.05 * rng.standard_normal(3), np.array([0.5, 0.6, 0.2])
    pose, score = best_pose(points, reference, centre, window, 0.1)
    step = CELL / np.linalg.norm(points, axis=1).max()
    turns, cells = math.ceil(window[2] / step), np.ceil(window[:2] / CELL).astype(int)
    best = 0.0
    for turn in centre[2] + step * np.arange(-turns, turns + 1):
        c, s = math.cos(turn), math.sin(turn)
        at = points @ np.array([[c, s], [-s, c]]) + centre[:2] + reference.half
        for i in range(-cells[0], cells[0] + 1):
            for j in range(-cells[1], cells[1] + 1):
                cell = np.floor(at / CELL).astype(int) + [i, j]
                inside = ((cell >= 0) & (cell < reference.grid.shape[1])).all(axis=1)
                best = max(best, reference.grid[0, cell[inside, 0], cell[inside, 1]].sum() / (100.0 * len(points)))
    assert score == pytest.approx(best)
    np.testing.assert_allclose(pose, between(np.array([0.3, -0.2, 0.1]), np.array([0.9, 0.1, 0.5])), atol=0.1)
    assert best_pose(points, reference, centre + 6.0, window, 0.9)[1] == 0.0


def test_a_surface_before_another_contradicts_it_beyond_half_a_metre_at_four() -> None:
    near = np.full(180, 4.0)
    assert contradiction(near, np.full(180, 4.4), np.zeros(3), SCANNER, 25.0) == 0.0
    # what lies before is seen through from the other side: one way against, nothing known the other way
    assert contradiction(near, np.full(180, 4.7), np.zeros(3), SCANNER, 25.0) == 1.0
    assert contradiction(np.full(180, 4.7), near, np.zeros(3), SCANNER, 25.0) == 1.0


def test_scale_is_found_from_gaussian_and_from_heavy_tailed_residuals() -> None:
    normal = RNG.standard_normal((4000, 3))
    for scale, nu in ((1.0, None), (6.0, None), (3.0, 5.0)):
        e = math.sqrt(scale) * normal
        if nu is not None:
            e = e / np.sqrt(RNG.chisquare(nu, 4000) / nu)[:, None]
        covariance = scale * (1.0 if nu is None else nu / (nu - 2.0))
        # three quarters of what there was: a graph whose optimum ate the rest
        found, error = uncertainty.learned_scale(0.75 * (e**2).sum(axis=1), 3000)
        assert 0.0 < error < 0.1 * found
        assert abs(found - covariance) < 0.15 * covariance
    with pytest.raises(ValueError, match="loop closures"):
        uncertainty.learned_scale(np.ones(5), 0)

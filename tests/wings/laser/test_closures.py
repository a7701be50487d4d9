"""Loop closures: what they are found with, that they are believed in pairs, and their outcomes, counted by hand."""

import math
from dataclasses import fields
from types import SimpleNamespace

import numpy as np
import pytest

from association.names import SCAN
from data.se2 import Array, between, compose, inverse, transform_points
from tests.eval.handmade import run_with_error
from tests.wings.laser.scans.rooms import ROOM, SCANNER, scan
from wings.laser.scans import uncertainty
from wings.laser.scans.constraints import Chain, LaserRun, Loops
from wings.laser.scans.matching import CELL, best_pose, pyramid
from wings.laser.scans.occupancy import contradiction
from wings.laser.scans.points import beams_of, scan_points
from wings.laser.score import closure_counts, fits, knowable
from wings.laser.slam.closures import LoopCloser
from wings.laser.slam.parameters import LaserParameters

GAP = LaserParameters().loop_gap
SEEN = scan(np.zeros(3), ROOM)
USUAL = 1e-4 * np.eye(3)


def closer_at(keys, last=SEEN, covariance=USUAL):
    """A robot that stands in a room for some key poses; `last` is what it sees from the newest."""
    found = LoopCloser(LaserParameters(), SCANNER)
    for key in range(keys):
        ranges = last if key == keys - 1 else SEEN
        found.add_key(ranges, scan_points(ranges, beams_of(SCANNER, 180), 20.0), np.zeros(3), covariance)
    return found


def candidates(found, poses):
    assert found.find(poses) == []  # one alone is never believed
    return [(c.key1, c.key2) for c in found.candidates]


def test_of_many_candidates_two_are_looked_at_the_nearest_one_and_the_next_that_is_not_beside_it():
    keys = GAP + 18
    poses = np.zeros((keys, 3))
    poses[:-1, 0] = 0.05 * np.abs(np.arange(keys - 1) - 16)  # where the robot is now it was at key pose 16
    assert sorted(candidates(closer_at(keys), poses)) == [(8, keys - 1), (16, keys - 1)]


@pytest.mark.parametrize("off", [0.0, 0.5])
def test_closures_of_two_key_poses_that_agree_are_believed_at_the_second_unless_one_is_refused(off):
    found = closer_at(GAP + 1)
    assert candidates(found, np.zeros((GAP + 1, 3))) == [(0, GAP)]
    found.add_key(SEEN, found._points[-1], np.zeros(3), USUAL)
    poses = np.zeros((GAP + 2, 3))
    poses[-1, 0] = off  # of the second pose the path says what the scan does not
    ends = [(c.key1, c.key2, c.believed) for c in found.find(poses)]
    assert ends == ([] if off else [(0, GAP, GAP + 1), (0, GAP + 1, GAP + 1)])
    assert len(found.loops().key1) == 2


@pytest.mark.parametrize(("steps", "most"), [(1e-9, 2.0), (1.0, 2.3098), (4.0, 2.6197)])
def test_key_poses_farther_apart_than_the_path_between_allows_are_not_looked_at(steps, most):
    """The middles of what is seen may be 2 m apart, and twice the root of the variances in x and y of 12 steps: those
    of one are 0.0005 and 0.0015 m^2, times `steps`, so that the root is 0.1549 m for `steps` of 1."""
    assert GAP == 12
    for away, expected in ((most - 0.002, [(0, GAP)]), (most + 0.002, [])):
        poses = np.zeros((GAP + 1, 3))
        poses[-1, 0] = away
        found = closer_at(GAP + 1, covariance=steps * np.diag([0.0005, 0.0015, 1e-6]))
        assert candidates(found, poses) == expected


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


TRUTH = np.array([[0.0, 0.0, 0.0], [4.0, 0.0, 1.5], [4.0, 4.0, 3.0], [0.0, 4.0, -1.6], [0.5, 0.0, 0.1]])


def loops(errors, believed, sigma=0.01):
    """Loop closures 0-4 with these errors (L, 3)."""
    n = len(errors)
    relative = between(TRUTH[[0] * n], TRUTH[[4] * n]) + np.array(errors)
    C = np.tile(np.diag(np.broadcast_to(sigma, 3) ** 2), (n, 1, 1))
    zero = np.zeros(n, np.int64)
    return Loops(zero, zero + 4, relative, C, np.ones(n), np.array(believed))


def outcomes(found):
    made, zero = run_with_error(np.zeros(3), association=SCAN, mapped=False), np.zeros((5, 3))
    chain = Chain(np.arange(5), zero, np.zeros((5, 3, 3)), np.arange(5), zero, np.zeros((5, 3, 3)))
    run = LaserRun(**{f.name: getattr(made, f.name) for f in fields(made)}, chain=chain, loops=found)
    log = SimpleNamespace(truth=SimpleNamespace(pose=TRUTH), recorded=SimpleNamespace(scans=None))
    return closure_counts(run, log, "online")


def test_four_kinds():
    near, far = [0.1, 0.0, 0.0], [1.0, 0.0, 0.0]
    counts = outcomes(loops([near, near, far, far, far, [0.0, 0.0, 6.28]], [4, -1, 4, -1, -1, 4]))
    assert [counts[name] for name in ("tp", "fn", "fp", "tn")] == [2, 1, 1, 2]
    assert counts["precision"] == counts["recall"] == pytest.approx(2 / 3)
    none = outcomes(loops([[0.0, 0.0, 0.0]], [-1]))
    assert math.isnan(none["precision"])
    assert none["recall"] == 0.0


def test_a_closure_can_be_known_only_where_the_scans_overlap():
    wall = np.stack([np.linspace(-3.0, 3.0, 60), np.full(60, 2.0)], 1)
    for last, known in ((wall, True), (wall + [0.0, 5.0], False)):
        points = [wall] * 4 + [transform_points(inverse(TRUTH[4]), last)]
        assert knowable(loops([[0.0, 0.0, 0.0]], [-1]), TRUTH, points).tolist() == [known]


def test_scans_overlap_only_if_each_matches_the_other():
    wall = np.stack([np.linspace(0, 5, 101), np.ones(101)], 1)
    both = np.concatenate([wall, wall + [0.0, 3.0], wall - [0.0, 4.0]])
    assert fits(wall, wall, np.zeros(3))
    assert not fits(wall, both, np.zeros(3))
    assert not fits(both, wall, np.zeros(3))
    assert not fits(wall, np.empty((0, 2)), np.zeros(3))

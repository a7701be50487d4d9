"""Relocalization from accumulated scans: the place, its covariance, and silence where there is no one answer."""

import numpy as np
import pytest
from scipy.stats import chi2

from data import se2
from data.inputs import FrameObservations, Increment, LandmarkMap
from data.sensors import RangeBearing, RelativePoint
from eval.replay.hindsight.relocalize import EMPTY, Scan, extended, moved, relocalize

SIGMA = 0.05


def scene(seed, seen=8, landmarks=25, side=24.0, clutter=0, ahead=False):
    """A map, a pose, and a scan of the landmarks nearest to it (or those farthest ahead), with clutter behind them."""
    rng = np.random.default_rng(seed)
    known = LandmarkMap(np.arange(landmarks) * 3 + 5, rng.uniform(-side / 2, side / 2, (landmarks, 2)))
    pose = np.array([*rng.uniform(-6, 6, 2), rng.uniform(-np.pi, np.pi)])
    body = se2.transform_points(se2.inverse(pose), known.xy)
    near = np.argsort(-body[:, 0] if ahead else np.hypot(*body.T))[:seen]
    xy = body[near] + SIGMA * rng.standard_normal((seen, 2))
    xy = np.concatenate([xy, rng.uniform(-6, 6, (clutter, 2))])
    n = len(xy)
    truth = np.concatenate([known.id[near], np.full(clutter, -1)])
    return known, pose, Scan(xy, SIGMA**2 * np.eye(2 * n), tuple((i,) for i in range(n))), truth


@pytest.mark.parametrize("clutter", [0, 2])
def test_place_and_pairings_are_found_without_a_prior(clutter):
    for seed in range(10):
        known, pose, scan, truth = scene(seed, clutter=clutter)
        place = relocalize(scan, known)
        assert place is not None
        assert np.hypot(*(place.pose - pose)[:2]) < 6 * SIGMA
        assert (place.pairings[truth >= 0] == truth[truth >= 0]).mean() > 0.85


def test_its_covariance_is_that_of_its_errors():
    d2 = []
    for seed in range(150):
        known, pose, scan, _ = scene(seed, ahead=True)
        place = relocalize(scan, known)
        assert place is not None
        e = se2.pose_error(place.pose, pose)
        d2.append(e @ np.linalg.solve(place.covariance, e))
    # the joint gate leaves out the one scan in a hundred that fits worst, pairing by pairing
    assert chi2.ppf(0.001, 450) < np.sum(d2) < chi2.ppf(0.999, 450)


def test_two_equal_places_give_no_answer():
    known, _, scan, _ = scene(3, seen=6)
    twice = LandmarkMap(np.arange(50), np.concatenate([known.xy, known.xy + [100.0, 0.0]]))
    assert relocalize(scan, known) is not None
    assert relocalize(scan, twice) is None


def test_a_regular_grid_gives_no_answer_and_does_not_take_for_ever():
    grid = np.stack(np.meshgrid(np.arange(12.0), np.arange(12.0)), -1).reshape(-1, 2)
    scan = Scan(grid[:16] - 3.0, 1e-4 * np.eye(32), tuple((i,) for i in range(16)))
    assert relocalize(scan, LandmarkMap(np.arange(144), grid)) is None


def test_a_mirror_image_is_no_match():
    known, _, scan, _ = scene(0)
    mirrored = Scan(scan.xy * [1.0, -1.0], scan.covariance, scan.rows)
    assert relocalize(scan, known) is not None
    assert relocalize(mirrored, known) is None


@pytest.mark.parametrize("points", [0, 1, 2])
def test_two_points_are_no_place(points):
    known, _, scan, _ = scene(0)
    few = Scan(scan.xy[:points], scan.covariance[: 2 * points, : 2 * points], scan.rows[:points])
    assert relocalize(few, known) is None


@pytest.mark.parametrize("sensor", [RangeBearing(rotation=0.3, translation=(0.2, -0.1)), RelativePoint()])
def test_a_scan_over_several_frames_is_consistent_in_the_newest_body_frame(sensor):
    root = np.array([[0.03, 0.0, 0.0], [0.01, 0.03, 0.0], [0.0, 0.03, 0.015]])
    M = root @ root.T
    R = np.diag([0.05, 0.01]) ** 2 if sensor.kind == 0 else np.diag([0.05, 0.05]) ** 2
    d2, dof = 0.0, 0
    for seed in range(60):
        rng = np.random.default_rng(seed)
        world = np.array([[4.0, 1.0], [3.0, -2.0], [-1.0, 5.0], [6.0, 6.0], [7.0, 0.0]])
        pose, scan, row = np.zeros(3), EMPTY, 0
        for k in range(6):
            if k:
                step = np.array([0.5, 0.05, 0.1])
                pose = se2.compose(pose, step)
                scan = moved(scan, Increment(step + root @ rng.standard_normal(3), M))
            seen = np.array([0, 1, 2]) if k < 3 else np.array([1, 3, 4])
            z = sensor.predict(pose, world[seen]) + np.sqrt(np.diag(R)) * rng.standard_normal((3, 2))
            scan = extended(scan, sensor, FrameObservations(z, np.tile(R, (3, 1, 1))), row + np.arange(3))
            row += 3
        if len(scan) != 5:
            continue  # an observation outside its gate made a second point
        e = (scan.xy - se2.transform_points(se2.inverse(pose), world)).ravel()
        d2, dof = d2 + e @ np.linalg.solve(scan.covariance, e), dof + 10
        assert sorted(r for rows in scan.rows for r in rows) == list(range(row))
    assert dof > 400
    assert chi2.ppf(0.0005, dof) < d2 < chi2.ppf(0.9995, dof)

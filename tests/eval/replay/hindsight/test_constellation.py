"""Landmarks initialized twice are recognized by how they stand to each other, and not where that could be chance."""

import numpy as np
import pytest

from data import se2
from eval.replay.hindsight.duplicates import Landmarks, recognize, squared_distances

FREE = 3.0
DENSITY = 48 / 60.0**2
"""Landmarks per square metre."""


def block(n, sigma):
    return sigma**2 * np.eye(2 * n)


def twice(seed, *, common=8, others=40, new=0, sigma=0.2, turn=0.1, shift=(3.0, -2.0), size=60.0, heading=0.1):
    """An old map, and some of it initialized again from a pose with that error, whose uncertainty is honest."""
    rng = np.random.default_rng(seed)
    old = rng.uniform(0.0, size, (common + others, 2))
    near = np.argsort(np.hypot(*(old - old[0]).T))[:common]
    true = np.concatenate([old[near], rng.uniform(0.0, size, (new, 2))])
    centre = true.mean(axis=0)
    again = (true - centre) @ se2.rotation(turn).T + centre + shift + rng.normal(0.0, sigma, true.shape)
    noisy = old + rng.normal(0.0, sigma, old.shape)
    lever = (true - centre)[:, None, :] * np.array([-1.0, 1.0])
    pose = np.zeros((2 * len(true), 3))
    pose[0::2, 0], pose[1::2, 1] = 1.0, 1.0
    pose[:, 2] = lever[:, 0, ::-1].ravel()
    P = pose @ np.diag([3.0, 3.0, heading]) ** 2 @ pose.T + block(len(true), sigma)
    cross = np.zeros((2 * len(true), 2 * len(old)))
    return Landmarks(again, P), Landmarks(noisy, block(len(old), sigma)), cross, near


def found_in(new, old, cross):
    d2, _ = squared_distances(new, old, cross)
    return recognize(new, old, cross, d2 < 13.8, DENSITY, FREE, 1.0)


@pytest.mark.parametrize("seed", range(12))
def test_what_was_initialized_again_is_recognized(seed):
    new, old, cross, near = twice(seed)
    found = found_in(new, old, cross)
    assert len(found) >= 6
    assert all(near[i] == j for i, j in found)


def test_distances_that_are_better_than_stated_tell_places_apart_that_the_stated_ones_cannot():
    """Landmarks 1.5 m apart with 0.9 m stated: as they stand to each other they are as good as 0.03 m."""
    taken = {1.0: 0, 0.03**2 / 0.9**2: 0}
    for seed in range(6):
        new, old, cross, near = twice(seed, size=10.0, sigma=0.03, turn=0.02, shift=(0.4, -0.3))
        loose = [Landmarks(x.xy, x.covariance + block(len(x.xy), 0.9)) for x in (new, old)]
        allowed = squared_distances(*loose, cross)[0] < 13.8
        for scale in taken:
            found = recognize(*loose, cross, allowed, 48 / 10.0**2, FREE, scale)
            assert all(near[i] == j for i, j in found)
            taken[scale] += len(found) >= 6
    assert list(taken.values()) == [0, 6]


def test_landmarks_that_are_new_are_left_out():
    """Of three new ones that stand anywhere, one in twenty has an old one within three sigmas."""
    right = wrong = places = 0
    for seed in range(12):
        new, old, cross, near = twice(seed, new=3)
        found = found_in(new, old, cross)
        places += len(found) >= 5
        right += sum(i < len(near) and near[i] == j for i, j in found)
        wrong += sum(i >= len(near) or near[i] != j for i, j in found)
    assert places >= 10
    assert wrong <= 0.06 * right


def test_nothing_is_recognized_where_nothing_is_the_same():
    wrong = 0
    for seed in range(60):
        rng = np.random.default_rng([5, seed])
        new, old, cross, _ = twice(seed, common=6)
        elsewhere = Landmarks(rng.uniform(20.0, 40.0, (6, 2)), new.covariance)
        wrong += bool(found_in(elsewhere, old, cross))
    assert wrong <= 1


def test_a_row_of_points_at_equal_distances_fits_in_more_than_one_way_and_is_left_alone():
    old = Landmarks(np.stack([2.0 * np.arange(20), np.zeros(20)], 1), block(20, 0.05))
    common = np.tile(np.eye(2), (6, 1))
    new = Landmarks(old.xy[5:11] + (0.9, 0.0), block(6, 0.05) + 9.0 * common @ common.T)
    assert found_in(new, old, np.zeros((12, 40))) == []


def test_a_place_that_the_joint_covariance_excludes_is_not_taken():
    new, old, cross, _ = twice(3)
    known = Landmarks(new.xy, block(len(new.xy), 0.2))  # the same shift, and a pose that is certain
    everything = np.ones((len(new.xy), len(old.xy)), bool)
    assert recognize(new, old, cross, everything, DENSITY, FREE, 1.0)
    assert recognize(known, old, cross, everything, DENSITY, FREE, 1.0) == []


def test_pairs_that_are_each_likely_and_all_together_are_not_are_not_taken():
    rng = np.random.default_rng(4)
    old = Landmarks(rng.uniform(0.0, 60.0, (40, 2)), block(40, 0.2))
    direction = rng.uniform(0.0, 2.0 * np.pi, 8)
    off = 0.2 * np.sqrt(2.0) * np.stack([np.cos(direction), np.sin(direction)], 1)
    for sigmas, taken in ((1.5, True), (2.8, False)):
        new = Landmarks(old.xy[:8] + sigmas * off, block(8, 0.2))
        assert bool(found_in(new, old, np.zeros((16, 80)))) is taken


def test_three_landmarks_are_too_few():
    new, old, cross, _ = twice(1, common=3)
    assert found_in(new, old, cross) == []


def test_a_turn_that_the_heading_does_not_allow_is_not_tried():
    new, old, cross, _ = twice(2, turn=0.15)
    near = squared_distances(new, old, cross)[0] < 13.8
    assert recognize(new, old, cross, near, DENSITY, 0.6, 1.0)
    assert recognize(new, old, cross, near, DENSITY, 0.01, 1.0) == []


@pytest.mark.parametrize("seed", range(3))
def test_squared_distances_are_those_of_the_differences(seed):
    rng = np.random.default_rng(seed)
    m, n = 3, 4
    A = rng.normal(size=(2 * (m + n), 2 * (m + n)))
    P, x = A @ A.T, rng.normal(size=(m + n, 2))
    d2, det = squared_distances(
        Landmarks(x[:m], P[: 2 * m, : 2 * m]), Landmarks(x[m:], P[2 * m :, 2 * m :]), P[: 2 * m, 2 * m :]
    )
    for i in range(m):
        for j in range(n):
            H = np.zeros((2, 2 * (m + n)))
            H[:, 2 * i : 2 * i + 2], H[:, 2 * (m + j) : 2 * (m + j) + 2] = np.eye(2), -np.eye(2)
            nu, S = H @ x.ravel(), H @ P @ H.T
            assert d2[i, j] == pytest.approx(nu @ np.linalg.inv(S) @ nu)
            assert det[i, j] == pytest.approx(np.linalg.det(S))

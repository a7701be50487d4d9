"""Landmarks initialized twice: which are looked at and when, and how they are recognized and not by chance."""

from types import SimpleNamespace

import numpy as np
import pytest

from association.appearance import Looks
from data import se2
from eval.replay.hindsight.duplicates import Landmarks, comparable, recognize, single, squared_distances


def test_what_is_far_for_its_variance_is_left_out_and_nothing_is_compared_with_itself():
    xy, variance = np.array([[0.0, 0.0], [1.0, 0.0], [100.0, 0.0]]), np.full(3, 0.5)
    slam = SimpleNamespace(places=lambda numbers: (xy[numbers], variance[numbers]))
    assert comparable(slam, [0, 2], [0, 1, 2], 9.2) == ([0], [1])
    assert comparable(slam, [2], [2], 9.2) == ([], [])


class Map:
    """Landmarks that are known with a standard deviation of 0.1 m each, independently."""

    def __init__(self, xy, together=()):
        self.xy = np.array(xy, float)
        records = {n: SimpleNamespace(covisible=set()) for n in range(len(xy))}
        self.ledger = SimpleNamespace(records=records, looks=Looks())
        for a, b in together:
            self.ledger.records[a].covisible.add(b)
            self.ledger.records[b].covisible.add(a)

    def places(self, numbers):
        return self.xy[numbers], np.full(len(numbers), 0.02)

    def position(self, numbers):
        return self.xy[numbers].ravel(), 0.01 * np.eye(2 * len(numbers))

    def single(self, window, others, area=10.0, scale=1.0):
        return single(self, self.ledger, window, others, area, scale)


def test_two_that_stand_where_one_does_are_one_and_the_older_one_stays():
    apart = Map([[0.0, 0.0], [9.0, 0.0], [0.2, 0.0], [30.0, 0.0]])
    assert apart.single([2, 3], [0, 1]) == [(2, 0)]
    assert apart.single([3], [0, 1]) == []
    assert apart.single([2], []) == []
    assert apart.single([0, 2], [0, 2]) == [(2, 0)], "nothing is compared with itself"


def test_two_that_were_seen_together_are_two():
    assert Map([[0.0, 0.0], [9.0, 0.0], [0.2, 0.0]], together=[(0, 2)]).single([2], [0, 1]) == []


def test_where_a_gate_is_so_large_that_others_fall_in_by_chance_nothing_is_one():
    """The gate of a difference with a variance of 0.02 m^2 in both directions: pi * 9.21 * 0.02 = 0.58 m^2."""
    assert Map([[0.0, 0.0], [0.2, 0.0]]).single([1], [0], area=0.60) == [(1, 0)]
    assert Map([[0.0, 0.0], [0.2, 0.0]]).single([1], [0], area=0.56) == []


def test_where_a_third_one_may_be_one_of_them_but_not_both_nothing_is_one():
    assert Map([[0.0, 0.0], [0.55, 0.0], [0.2, 0.0]]).single([2], [0, 1]) == []
    assert Map([[0.0, 0.0], [0.1, 0.1], [0.2, 0.0]]).single([2], [0, 1]) == [(2, 0)], "all three may be one"


def test_less_noise_than_stated_makes_the_gate_smaller():
    for off, area, scale, expected in ((0.23, 0.3, 0.25, []), (0.23, 0.3, 0.5, [(1, 0)]), (0.1, 0.28, 0.5, [])):
        assert Map([[0.0, 0.0], [off, 0.0]]).single([1], [0], area, scale) == expected


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


def test_nothing_is_recognized_where_nothing_is_the_same():
    wrong = 0
    for seed in range(60):
        rng = np.random.default_rng([5, seed])
        new, old, cross, _ = twice(seed, common=6)
        wrong += bool(found_in(Landmarks(rng.uniform(20.0, 40.0, (6, 2)), new.covariance), old, cross))
    assert wrong <= 1


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

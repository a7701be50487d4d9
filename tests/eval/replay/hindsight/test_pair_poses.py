"""Pairings of a frame that a pose from two of its points makes, where a motion allows that pose."""

from __future__ import annotations

import numpy as np
import pytest

from association.expectation import Expectation
from data import se2
from data.sensors import RelativePoint
from eval.replay.hindsight.placement import candidates

SIGMA = 0.02
SENSOR = RelativePoint(max_range=20.0)
THERE = np.array([[2.0, 1.0], [5.0, -1.5], [3.0, 4.0], [7.0, 2.5], [1.0, -4.0], [9.0, -3.0], [6.0, 6.5]])
"""Landmarks as expected, no two pairs of them equally far apart."""


def pairings(pose, off=(), wide=0.5):
    """Of a frame that sees all landmarks from `pose` in the expected body frame, some of them moved by `off`."""
    z = se2.transform_points(se2.inverse(np.asarray(pose, float)), THERE)
    for k, by in off:
        z[k] += by
    n = len(THERE)
    e = Expectation.from_arrays(
        z, THERE, SIGMA**2 * np.eye(2 * n), np.tile(SIGMA**2 * np.eye(2), (n, 1, 1)), number=np.arange(n)
    )
    return candidates(e, SENSOR, wide**2 * np.eye(3))


@pytest.mark.parametrize("pose", [(0.0, 0.0, 0.0), (0.4, -0.3, 0.2), (-0.5, 0.2, -0.4)])
def test_the_best_one_pairs_all_and_is_as_far_as_the_pose_is(pose):
    d2, best = pairings(pose)[0]
    assert best.tolist() == list(range(len(THERE)))
    assert d2 == pytest.approx(np.sum(np.square(pose)) / 0.5**2, abs=0.05)


def test_an_observation_far_from_every_landmark_by_its_own_noise_stays_unpaired():
    for off, paired in (((0.03, 0.0), True), ((0.4, 0.0), False)):
        best = pairings((0.3, 0.1, 0.1), off=[(2, np.array(off))])[0][1]
        assert (best[2] == 2) == paired
        assert best[[0, 1, 3, 4, 5, 6]].tolist() == [0, 1, 3, 4, 5, 6]


def test_a_pose_that_the_motion_does_not_allow_is_none():
    found = pairings((0.4, -0.3, 0.2), wide=0.05)
    assert all((paired >= 0).sum() < len(THERE) for _, paired in found)


@pytest.mark.parametrize(("seen", "there"), [(0.02, 0.02), (0.04, 0.001), (0.001, 0.04)])
@pytest.mark.parametrize(("sigmas", "paired"), [(2.85, True), (3.1, False)])
def test_two_points_give_a_pose_where_their_distances_agree_by_the_noise_of_both(seen, there, sigmas, paired):
    """A triangle that is read too large, so that its shortest side is off by so many standard deviations."""
    triangle = THERE[:3]
    sides = np.hypot(*(triangle - np.roll(triangle, 1, axis=0)).T)
    larger = 1.0 + sigmas * np.sqrt(2.0 * (seen**2 + there**2)) / sides.min()
    z = (triangle - triangle.mean(axis=0)) * larger + triangle.mean(axis=0)
    e = Expectation.from_arrays(z, triangle, there**2 * np.eye(6), np.tile(seen**2 * np.eye(2), (3, 1, 1)))
    found = candidates(e, SENSOR, 0.25 * np.eye(3))
    assert [best.tolist() for _, best in found] == ([[0, 1, 2]] if paired else [])

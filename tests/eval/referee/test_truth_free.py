"""The filter-smoother test: computed by hand, and exact in a linear world."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from data.result import Trajectory
from data.worlds.linear import LinearWorld, simulate
from eval.referee import truth_free
from eval.referee.truth_free import difference, filter_smoother
from eval.replay.run import compare

I3 = np.eye(3)


def path(*poses, covariance=I3):
    return Trajectory(np.array(poses, float), np.tile(np.asarray(covariance, float), (len(poses), 1, 1)))


def test_the_square_of_the_difference_is_taken_under_the_difference_of_the_covariances():
    found = difference(path([3.0, 0.0, 0.0], covariance=4 * I3), path([0.0, 0.0, 0.0]))
    assert found.square == pytest.approx([3.0])  # 3^2 / (4 - 1)
    assert found.dof.tolist() == [3]
    assert found.sigma[0] == pytest.approx(3 * [math.sqrt(3.0)])
    assert found.semidefinite.tolist() == [True]


def test_headings_are_subtracted_the_short_way_round():
    found = difference(path([0.0, 0.0, math.pi - 0.1], covariance=2 * I3), path([0.0, 0.0, 0.1 - math.pi]))
    assert found.d[0, 2] == pytest.approx(-0.2)


def test_directions_are_those_of_the_covariances_and_not_of_the_axes():
    turn = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    P_f, P_s = turn @ np.diag([5.0, 4.0, 3.0]) @ turn.T, turn @ np.diag([1.0, 4.0, 3.0]) @ turn.T
    found = difference(path(2.0 * turn[:, 0], covariance=P_f), path([0, 0, 0], covariance=P_s))
    assert found.dof.tolist() == [1]
    assert found.square == pytest.approx([1.0])


@given(st.integers(0, 2**32 - 1))
def test_units_do_not_matter(seed):
    rng = np.random.default_rng(seed)
    A, B, d = rng.normal(size=(3, 3)), rng.normal(size=(3, 3)), 0.1 * rng.normal(size=3)
    P_s = B @ B.T + 0.1 * I3
    P_f, D = P_s + A @ A.T, np.diag([1000.0, 1.0, 1.0])
    one = difference(path(d, covariance=P_f), path([0, 0, 0], covariance=P_s))
    other = difference(path(D @ d, covariance=D @ P_f @ D), path([0, 0, 0], covariance=D @ P_s @ D))
    assert other.dof == one.dof
    assert other.square == pytest.approx(one.square, rel=1e-6)


def test_the_expected_median_is_that_of_the_frames_degrees_of_freedom_mixed():
    assert truth_free._median(np.full(4, 3.0)) == pytest.approx(2.36597, abs=1e-4)
    draws = np.concatenate([stats.chi2(k).rvs(200_000, random_state=k) for k in (1, 3)])
    assert truth_free._median(np.array([1.0, 3.0])) == pytest.approx(np.median(draws), abs=0.01)


def test_the_largest_excursion_comes_with_its_frame_and_the_share_inside_three_sigma():
    online = path([0, 0, 0], [0, -8.0, 0], [0, 0, 0], [1.0, 0, 0], covariance=2 * I3)
    said = filter_smoother(difference(online, path(*np.zeros((4, 3)))))
    assert (said["filter_smoother_largest"].value, said["filter_smoother_largest"].frame) == (8.0, 1)
    assert said["filter_smoother_inside_y"].value == 0.75
    assert said["filter_smoother_inside_x"].value == 1.0
    assert said["filter_smoother_rms_x"].value == pytest.approx(0.5)
    assert said["filter_smoother_mean"].value == pytest.approx((64.0 + 1.0) / 4)


def test_without_a_single_comparable_frame_there_is_no_number():
    assert filter_smoother(difference(path([0, 0, 0], covariance=0 * I3), path([0, 0, 0], covariance=0 * I3))) == {}


def drives(runs, frames=20):
    for seed in range(runs):
        inputs = simulate(LinearWorld(frames=frames), seed).inputs(labels=True)
        yield inputs, compare(inputs, "localization", ("ekf", "batch"))


@pytest.mark.slow
def test_the_size_of_the_filter_smoother_test_is_exact_in_a_linear_world():
    squares = np.array([difference(ekf.online, batch.final).square[[5, 10, 15]] for _, (ekf, batch) in drives(2000)])
    share = np.mean(squares > stats.chi2(3).ppf(0.95), axis=0)
    assert np.all(np.abs(share - 0.05) < 0.01), share

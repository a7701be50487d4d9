"""The filter-smoother test: by hand, in a linear world, and its statistics with their expected values."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from data.result import Trajectory
from data.worlds.linear import LinearWorld, simulate
from eval.referee import truth_free
from eval.referee.truth_free import difference, filter_smoother, regular
from eval.replay.run import compare

I3 = np.eye(3)


def path_of(*poses, covariance=I3):
    return Trajectory(np.array(poses, float), np.tile(np.asarray(covariance, float), (len(poses), 1, 1)))


def test_the_square_of_the_difference_is_taken_under_that_of_the_covariances():
    found = difference(path_of([3.0, 0.0, 0.0], covariance=4 * I3), path_of([0.0, 0.0, 0.0]))
    assert found.square == pytest.approx([3.0])  # 3^2 / (4 - 1)
    assert found.dof.tolist() == [3]
    assert found.sigma[0] == pytest.approx(3 * [math.sqrt(3.0)])
    assert found.semidefinite.tolist() == [True]
    found = difference(path_of([0.0, 0.0, math.pi - 0.1], covariance=2 * I3), path_of([0.0, 0.0, 0.1 - math.pi]))
    assert found.d[0, 2] == pytest.approx(-0.2)
    turn = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    P_f, P_s = turn @ np.diag([5.0, 4.0, 3.0]) @ turn.T, turn @ np.diag([1.0, 4.0, 3.0]) @ turn.T
    found = difference(path_of(2.0 * turn[:, 0], covariance=P_f), path_of([0, 0, 0], covariance=P_s))
    assert found.dof.tolist() == [1]
    assert found.square == pytest.approx([1.0])
    assert truth_free._median(np.full(4, 3.0)) == pytest.approx(2.36597, abs=1e-4)
    draws = np.concatenate([stats.chi2(k).rvs(200_000, random_state=k) for k in (1, 3)])
    assert truth_free._median(np.array([1.0, 3.0])) == pytest.approx(np.median(draws), abs=0.01)


def drives(runs, frames=20):
    for seed in range(runs):
        inputs = simulate(LinearWorld(frames=frames), seed).inputs(labels=True)
        yield inputs, compare(inputs, "localization", ("ekf", "batch"))


@pytest.mark.slow
def test_the_size_of_the_filter_smoother_test_is_exact_in_a_linear_world():
    squares = np.array([difference(ekf.online, batch.final).square[[5, 10, 15]] for _, (ekf, batch) in drives(2000)])
    share = np.mean(squares > stats.chi2(3).ppf(0.95), axis=0)
    assert np.all(np.abs(share - 0.05) < 0.01), share


def path(poses, covariance=I3):
    poses = np.asarray(poses, float)
    return Trajectory(poses, np.broadcast_to(covariance, (len(poses), 3, 3)).copy())


@pytest.fixture(scope="module")
def linear():
    inputs = simulate(LinearWorld(frames=20), 3).inputs(labels=True)
    return inputs, *compare(inputs, "localization", ("ekf", "isam2", "batch"))


def test_every_statistic_of_the_difference_has_its_expected_value():
    online = path([[3.0, 0.5, -0.5], [-1.0, 2.0, 0.1]], 2 * I3)
    found = filter_smoother(difference(online, path(np.zeros((2, 3)))), "there")
    assert found["there_mean"] == (pytest.approx((9.5 + 5.01) / 2), 3.0, pytest.approx(math.nan, nan_ok=True), -1)
    assert found["there_median"].expected == pytest.approx(stats.chi2(3).median(), abs=1e-6)
    assert found["there_semidefinite"][:2] == (1.0, 1.0)
    assert found["there_rms_x"][:2] == (pytest.approx(math.sqrt(5.0)), 1.0)
    assert found["there_inside_x"][:2] == (1.0, pytest.approx(0.9973, abs=1e-4))  # three sigma exactly are inside
    assert found["there_largest"].value == 3.0
    assert math.isnan(found["there_largest"].expected)
    assert found["there_largest"].frame == 0


def test_a_direction_counts_from_a_hundredth_on_and_a_less_sure_smoother_is_not_semidefinite():
    later = np.diag([0.989, 0.991, 0.5])
    found = difference(path([[0.0, 0.0, 0.0]]), path([[0.0, 0.0, 0.0]], later))
    assert found.dof.tolist() == [2]
    assert np.isfinite(found.sigma).tolist() == [[True, False, True]]
    assert found.sigma[0, [0, 2]] == pytest.approx(np.sqrt([0.011, 0.5]))
    less_sure = np.diag([0.5, 0.5, 1.001])
    found = difference(path(np.zeros((3, 3))), Trajectory(np.zeros((3, 3)), np.stack([0.5 * I3, less_sure, 0.5 * I3])))
    assert found.semidefinite.tolist() == [True, False, True]
    assert filter_smoother(found)["filter_smoother_semidefinite"].value == pytest.approx(2 / 3)


@pytest.mark.parametrize(("covariance", "is_regular"), [
    (I3, True),
    (np.diag([1e8, 1e-8, 1.0]), True),  # units do not matter
    (np.diag([1.0, 0.0, 1.0]), False),
    (np.array([[1.0, 1.0, 0.0], [1.0, 1.0, 0.0], [0.0, 0.0, 1.0]]), False),
    (np.array([[1.0, 1.0 - 1e-9, 0.0], [1.0 - 1e-9, 1.0, 0.0], [0.0, 0.0, 1.0]]), True),
])  # fmt: skip
def test_a_covariance_is_regular_in_any_unit(covariance, is_regular):
    assert regular(covariance[None]).tolist() == [is_regular]


def test_statistics_without_a_smoother_or_innovations_are_missing_and_nis_is_per_degree_of_freedom(linear):
    inputs, ekf, _, batch = linear
    alone = truth_free.of_online(ekf, None, inputs)
    assert set(alone) == {"nis", "innovation_lag1"}
    assert set(truth_free.of_online(ekf, replace(batch, final=None), inputs)) == set(alone)
    silent = truth_free.of_online(replace(ekf, innovations=None), batch, inputs)
    assert not {"nis", "innovation_lag1"} & set(silent)
    assert truth_free.of_online(replace(ekf, innovations=None, online=None), batch, inputs) == {}
    inputs, ekf, _, batch = linear
    nis = truth_free.of_online(ekf, batch, inputs)["nis"]
    known = ekf.innovations.dof > 0
    assert nis.value == pytest.approx(ekf.innovations.nis[known].sum() / ekf.innovations.dof.sum())
    assert nis.expected == ekf.gated[0]
    lag = truth_free.of_online(ekf, batch, inputs)["innovation_lag1"]
    assert lag.expected == 0.0
    assert 0.0 < lag.se < 1.0

"""Our inputs as gtsam factors: units, order, frames, and what is refused."""

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import L, X

from data import se2
from data.errors import DataError
from data.inputs import Prior
from data.sensors import RangeBearing, RelativePoint
from graph.factors import (
    between_factors,
    graph_of,
    known_landmark_factors,
    landmark_factors,
    name_of,
    pose2,
    prior_factor,
    root_information,
)
from tests.graph.worlds import every_sensor

POSE, LANDMARK = np.array([1.5, -2.0, 2.6]), np.array([3.0, 1.0])
R = np.array([[0.04, 0.006], [0.006, 0.0025]])
ONE = np.array([0])


def values(pose=POSE, landmark=LANDMARK):
    v = gtsam.Values()
    v.insert(X(0), pose2(pose))
    v.insert(L(0), landmark)
    return v


def slam_factors(sensor, z):
    return landmark_factors(sensor, z[None], R[None], ONE, ONE)[0].measured


def known_factors(sensor, z):
    return known_landmark_factors(sensor, z[None], R[None], ONE, ONE, LANDMARK[None], 0)[0].measured


@every_sensor
@pytest.mark.parametrize("factors", [slam_factors, known_factors])
def test_the_cost_of_a_small_innovation_is_its_mahalanobis_distance(sensor, factors):
    """In the sensor's own coordinates and order, with its full covariance."""
    predicted = sensor.predict(POSE, LANDMARK[None])[0]
    exact = isinstance(sensor, RelativePoint) or sensor.translation == (0.0, 0.0)
    for nu in np.array([[0.3, 0.05], [-0.2, 0.1], [0.0, -0.04]]) * (1.0 if exact else 1e-4):
        cost = 2.0 * graph_of(factors(sensor, predicted + nu)).error(values())
        assert cost == pytest.approx(nu @ np.linalg.solve(R, nu), rel=2e-4 if exact else 2e-3)


@every_sensor
@pytest.mark.parametrize("factors", [slam_factors, known_factors])
def test_the_information_is_that_of_our_jacobians(sensor, factors):
    z, Hx, Hl = (a[0] for a in sensor.linearize(POSE, LANDMARK[None]))
    H = np.hstack([Hl, Hx @ se2.world_from_body(POSE[2])])  # gtsam: landmarks first, poses in their tangent space
    information = graph_of(factors(sensor, z)).linearize(values()).hessian()[0]
    if len(information) == 3:  # a factor of the pose alone
        H = H[:, 2:]
    expected = H.T @ np.linalg.solve(R, H)
    np.testing.assert_allclose(information, expected, atol=2e-6 * np.abs(expected).max())


def test_a_bearing_across_the_seam_costs_its_short_way():
    sensor = RangeBearing()
    z = sensor.predict(np.zeros(3), np.array([[-4.0, 1e-3]]))[0] + [0.0, 2e-3]
    assert z[1] > np.pi
    factors = landmark_factors(sensor, z[None], np.diag([1.0, 1e-6])[None], ONE, ONE)[0].measured
    assert 2.0 * graph_of(factors).error(values(np.zeros(3), np.array([-4.0, 1e-3]))) == pytest.approx(4.0, rel=1e-6)


def test_root_information_is_upper_triangular_and_right_where_the_covariance_is_nearly_singular():
    U = np.triu(np.random.default_rng(0).normal(size=(3, 3))) + 2.0 * np.eye(3)
    R, pivot = root_information((U @ U.T)[None])
    np.testing.assert_allclose(R[0], np.linalg.inv(U), atol=1e-14)
    assert pivot[0] == pytest.approx(min(np.diag(U) ** 2))
    assert root_information(np.diag([1.0, -1.0])[None])[1][0] < 0.0
    assert np.isnan(root_information(np.full((1, 2, 2), np.nan))[1][0])


def test_a_rank_one_prior_keeps_its_sigma_along_the_free_direction():
    """gtsam's own inversion of such a covariance is wrong by a factor of 76 here."""
    factor = prior_factor(Prior(np.zeros(3), 0.01 * np.ones((3, 3))))
    v = gtsam.Values()
    v.insert(X(0), gtsam.Pose2.Expmap(0.1 * np.ones(3)))  # one sigma along (1, 1, 1)
    assert 2.0 * factor.error(v) == pytest.approx(1.0, rel=1e-3)
    v.update(X(0), gtsam.Pose2.Expmap(np.array([1e-4, -1e-4, 0.0])))
    assert 2.0 * factor.error(v) > 1e3


def test_a_singular_increment_is_refused_by_frame():
    covariance = np.tile(np.eye(3), (4, 1, 1))
    covariance[2] = np.diag([1.0, 0.0, 1.0])
    with pytest.raises(DataError, match=r"increment into frame 7: .*singular.*covariance_floor"):
        between_factors(5, np.zeros((4, 3)), covariance)


@every_sensor
def test_a_measurement_covariance_that_is_not_definite_is_refused_by_frame(sensor):
    with pytest.raises(DataError, match=r"frame 9: measurement covariance .* not positive definite"):
        landmark_factors(sensor, np.ones((1, 2)), np.zeros((1, 2, 2)), np.array([9]), ONE)


def test_variables_are_named_in_plain_words():
    assert (name_of(X(12)), name_of(L(3))) == ("pose of frame 12", "landmark 3")


@pytest.mark.parametrize("task", ["localization", "slam"])
def test_readings_nearer_than_three_sigma_are_points_and_all_others_range_and_bearing(task):
    sensor, R = RangeBearing(), np.tile(np.diag([0.01, 0.0004]), (3, 1, 1))
    z, rows = np.array([[0.29, 0.5], [0.31, 0.5], [5.0, -1.0]]), np.arange(3)
    seen = landmark_factors(sensor, z, R, rows, rows)
    if task != "slam":
        seen = known_landmark_factors(sensor, z, R, rows, rows, z, 0)
    kinds = [type(s.measured[0]) for s in seen]
    assert kinds[1:] == [gtsam.BearingRangeFactor2D] * 2
    assert kinds[0] is not gtsam.BearingRangeFactor2D

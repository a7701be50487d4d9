"""Errors of odometry and sensor estimated in the graph: factors on paper, and online as in batch."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from gtsam import symbolIndex
from gtsam.symbol_shorthand import X

from data import se2
from data.inputs import FrameObservations, Increment, LandmarkMap, Prior, Systematic
from data.result import DISCARD
from data.sensors import RangeBearing, RelativePoint
from graph.factors import pose2, root_information
from graph.fixed_lag import FixedLagSmoother
from graph.incremental import Isam2Smoother
from graph.open_end import PINNED, OpenEnd, increment_factor, knot_factor, linear_factor, pinned_landmark_factors
from graph.systematic import CONSTANTS, drift_key, errors_of
from tests.graph.calibrating import as_sensed, erring
from tests.graph.worlds import TIGHT, drive

OFF_CENTRE = {"rotation": 0.6, "translation": (0.3, -0.2)}
ODOMETRY = ("scale", "curvature", "left", "right")
ALL = ("scale", "curvature", "left", "right", "drift", "range", "bearing")
SIGMA = {"scale": 0.05, "curvature": 0.05, "left": 0.05, "right": 0.05, "drift": 0.02, "range": 0.05, "bearing": 0.05}
POLAR = RangeBearing(max_range=8.0)
POLAR_OFF, CARTESIAN_OFF = RangeBearing(max_range=8.0, **OFF_CENTRE), RelativePoint(max_range=8.0, **OFF_CENTRE)
P0 = np.array([[0.0004, 0.0001, 0.0], [0.0001, 0.0002, 0.0], [0.0, 0.0, 0.0001]])


def to_estimate(*names):
    """Errors with the world's sigmas; a drift with knots every 1.6 m."""
    return Systematic(names, np.array([SIGMA[n] for n in names]), 8.0)


START = np.array([2.0, -1.0, 0.4])


@pytest.mark.parametrize("rows", [1, 2, 3])
def test_a_linear_factor_is_its_residual_counted_from_its_point(rows):
    rng = np.random.default_rng(rows)
    sizes = {4: 2, 7: 1, 8: 3, 9: 2}
    terms = [(key, rng.normal(size=(rows, n))) for key, n in sizes.items()]
    b, point, values = rng.normal(size=rows), gtsam.Values(), gtsam.Values()
    residual = -b
    for key, A in terms:
        at, x = rng.normal(size=(2, sizes[key]))
        point.insert(key, at)
        values.insert(key, x)
        residual = residual + A @ (x - at)
    factor = linear_factor(terms, b, point)
    assert list(factor.keys()) == [*sizes]
    assert factor.error(point) == pytest.approx(0.5 * b @ b, rel=1e-12)
    assert factor.error(values) == pytest.approx(0.5 * residual @ residual, rel=1e-12)
    A, rest = factor.linearize(values).jacobian()
    assert pytest.approx(np.hstack([A for _, A in terms]), rel=1e-12) == A
    assert rest == pytest.approx(-residual, rel=1e-9)


def test_a_drift_is_forgotten_over_its_length():
    factor = knot_factor(errors_of(to_estimate("scale", "drift"), POLAR, Prior(START, P0)), 3, 2.0)
    assert list(factor.keys()) == [drift_key(3), drift_key(4)]
    values, stays = gtsam.Values(), np.exp(-2.0 / 8.0)  # its length is 8 m
    values.insert(drift_key(3), np.array([1.5]))
    values.insert(drift_key(4), np.array([-0.5]))
    assert factor.error(values) == pytest.approx(0.5 * (-0.5 - 1.5 * stays) ** 2 / (1.0 - stays**2), rel=1e-12)


def test_a_known_landmark_is_held_where_the_range_error_puts_it():
    names = ("scale", "drift", "range")
    prior, now = Prior(START, P0), np.array([0.01, -0.02, 0.03])
    errors = errors_of(to_estimate(*names), CARTESIAN_OFF, prior)
    xy = np.array([[4.0, 1.0], [-2.0, 3.0]])
    seen = FrameObservations(np.array([[1.0, 0.5], [2.0, -0.5]]), np.tile(0.01 * np.eye(2), (2, 1, 1)))
    sensor = errors.frame.sensor(CARTESIAN_OFF)
    found = pinned_landmark_factors(errors, sensor, seen, np.array([5, 6]), np.array([11, 12]), xy, 40, now)
    origin = se2.compose(START, se2.inverse(np.array([0.3, -0.2, 0.6])))[:2]
    assert [(s.frame, s.number) for s in found] == [(5, 11), (6, 12)]
    for s, place in zip(found, xy):
        assert s.xy == pytest.approx(origin + 1.03 * (place - origin), abs=1e-12)
        values = gtsam.Values()
        values.insert(CONSTANTS, np.array([0.4, 0.6]))  # sigmas of scale and range
        there = origin + (1.0 + 0.6 * 0.05) * (place - origin)
        values.insert(s.key, there)
        assert s.pin.error(values) == pytest.approx(0.0, abs=1e-12)
        values.update(s.key, there + [3.0 * PINNED, -2.0 * PINNED])
        assert s.pin.error(values) == pytest.approx(0.5 * (9.0 + 4.0), rel=1e-6)


CASES = pytest.mark.parametrize(
    ("names", "sensor"), [(ODOMETRY, POLAR), (("drift",), POLAR), (ALL, CARTESIAN_OFF)], ids=["some", "drift", "all"]
)
MOVED = np.array([0.4, 0.03, 0.17])


def factor_of(names, sensor):
    """(errors, factor, values, now): of one increment far from the origin, with errors of a tenth of their sigmas."""
    errors = errors_of(to_estimate(*names), sensor, Prior(np.zeros(3), P0))
    M = np.diag([0.04, 0.02, 0.015]) ** 2
    now = np.linspace(-0.1, 0.1, len(errors.constant))
    factor = increment_factor(errors, 1, Increment(MOVED, M), root_information(M[None])[0][0], 2, now)
    before, values = np.array([300.0, -200.0, 2.0]), gtsam.Values()
    values.insert(X(0), pose2(before))
    values.insert(X(1), pose2(se2.compose(before, MOVED + [0.02, -0.01, 0.01])))
    if len(now):
        values.insert(CONSTANTS, now.copy())
    if errors.drift >= 0:
        values.insert(drift_key(2), np.array([0.3]))
    return errors, factor, values, now


@CASES
def test_jacobians_are_those_of_the_residual(names, sensor):
    _, factor, values, now = factor_of(names, sensor)
    size = {X(0): 3, X(1): 3, CONSTANTS: len(now), drift_key(2): 1}
    sizes = {key: n for key, n in size.items() if values.exists(key)}
    stated, known = factor.linearize(values).jacobian()[0], now.copy()

    def residual(move, key):
        change = gtsam.VectorValues()
        for other, n in sizes.items():
            change.insert(other, move if other == key else np.zeros(n))
        now[:] = known + move if key == CONSTANTS else known
        return -factor.linearize(values.retract(change)).jacobian()[1]

    found = {
        key: np.array([residual(d, key) - residual(-d, key) for d in 1e-5 * np.eye(n)]).T / 2e-5
        for key, n in sizes.items()
    }
    np.testing.assert_allclose(stated, np.hstack([found[key] for key in sizes]), rtol=1e-6, atol=1e-5)


def test_a_knot_leaves_with_the_last_increment_that_has_its_drift_and_once():
    prior = Prior(np.zeros(3), P0)
    end = OpenEnd(prior, errors_of(to_estimate("scale", "drift"), POLAR, prior))
    end._knots, end._knot = [0, 0, 0, 5, 5, 5, 9], 9
    assert [end._knot_of(frame) for frame in (0, 1, 3, 4, 7)] == [0, 0, 0, 5, 9]
    left = {oldest: [symbolIndex(key) for key in end.forget(oldest)] for oldest in (2, 4, 5, 7)}
    assert left == {2: [], 4: [0, 1, 2, 3, 4], 5: [], 7: [5, 6, 7, 8]}
    assert end._knot_of(7) == 9


def calibrated(inputs, **options):
    return Isam2Smoother(inputs.prior, inputs.sensor, inputs.map, systematic=inputs.systematic, **options)


@pytest.mark.parametrize(
    ("names", "task"), [pytest.param(ALL, "slam", marks=pytest.mark.slow), (("scale", "drift"), "localization")]
)
def test_with_an_infinite_lag_the_fixed_lag_smoother_is_isam2_and_with_a_short_one_near_it(names, task):
    inputs, decisions, *_ = erring(POLAR, task, to_estimate(*names), frames=40)
    _, poses, covariances, _ = drive(inputs, decisions, smoother=calibrated(inputs))
    given = (inputs.prior, inputs.sensor, inputs.map)
    endless = FixedLagSmoother(*given, lag=np.inf, systematic=inputs.systematic)
    np.testing.assert_array_equal(drive(inputs, decisions, smoother=endless)[1], poses)
    short = FixedLagSmoother(*given, lag=8.0, systematic=inputs.systematic)
    _, near, *_ = drive(inputs, decisions, smoother=short)
    sigma = np.sqrt(np.diagonal(covariances, axis1=1, axis2=2))
    assert (np.abs(se2.pose_error(near, poses)) < 1.0 * sigma).all()
    finished = short.finish()
    assert len(finished.final.pose) == len(finished.systematic.mean) == len(inputs)
    np.testing.assert_allclose(finished.systematic.mean[-1], short.errors[0], atol=1e-12)
    np.testing.assert_allclose(finished.systematic.sigma[-1], np.sqrt(np.diag(short.errors[1])), rtol=1e-6)
    np.testing.assert_allclose(finished.final.pose[-1], short.estimate().mean)
    np.testing.assert_allclose(finished.final.covariance[-1], short.estimate().covariance, atol=1e-9)


@pytest.mark.parametrize("sensor", [POLAR, POLAR_OFF], ids=["polar", "polar, off"])
def test_in_a_known_map_that_is_expected_which_is_in_view_whatever_the_range_error_scales(sensor):
    """There all is scaled by the range error: the robot is looked for in the world, and so far around it."""
    what = to_estimate("curvature", "range", "bearing")
    inputs, decisions, *_ = erring(sensor, "localization", what, frames=24, noise=0.0, size=-1.0)
    everywhere = np.vstack([inputs.map.xy, np.random.default_rng(3).uniform(-40.0, 40.0, (400, 2))])
    inputs = replace(inputs, map=LandmarkMap(np.arange(len(everywhere)), everywhere))
    s, *_ = drive(inputs, decisions, smoother=calibrated(inputs))
    share = 1.0 + s.errors[0][1]
    assert share > 1.03
    at = sensor.inverse(s.estimate().mean, np.zeros((1, 2)))[0][0]  # what is at range zero: the sensor's own place
    place, radius = s._end.reach(8.0)
    np.testing.assert_allclose(place, at, atol=1e-9)
    assert radius == pytest.approx(8.0 / share)
    e = s.expect(inputs.frame_observations(len(inputs) - 1))
    expected = set(e.number.tolist())
    # the sensor reads up to 8 m, which is less in the world; its uncertainty lets it expect a little more
    away = np.hypot(*(everywhere - at).T)
    assert set(np.flatnonzero(away < 8.0 / share).tolist()) <= expected
    assert away[sorted(expected)].max() < 8.0 / share + 1.0
    assert 5 < len(expected) < 60
    # and each is expected as the sensor, with its errors, would read it
    read = as_sensed(sensor, sensor.predict(s.estimate().mean, everywhere[e.number]), *s.errors[0][1:])
    np.testing.assert_allclose(sensor.residual(e.z_hat, read), 0.0, atol=1e-9)


def test_landmarks_go_and_are_joined_and_a_motion_is_doubted_with_errors_as_without():
    inputs, decisions, *_ = erring(POLAR, "slam", to_estimate(*ALL), frames=40)
    s, *_ = drive(inputs, decisions, smoother=calibrated(inputs))
    s.remove(np.array([2]))
    s.merge(np.array([4]), np.array([0]))
    assert s.numbers.tolist() == s.landmarks().number.tolist() == [0, 1, 3, 5, 6, 7]
    np.testing.assert_allclose(s.positions(s.numbers), s.landmarks().xy)
    before = s.estimate().covariance
    s.predict(Increment(np.zeros(3), 1e-6 * np.eye(3)))
    s.inflate(np.eye(3))
    added = s.estimate().covariance - before
    np.testing.assert_allclose(np.diag(added)[2], 1.0, rtol=1e-4)
    assert added[0, 0] > 0.9
    elsewhere = s.estimate().mean + [0.3, -0.2, 0.1]
    e = s.expect(inputs.frame_observations(len(inputs) - 1))
    np.testing.assert_allclose(e.elsewhere(s.estimate().mean).z_hat, e.z_hat, atol=1e-9)
    done = s.update(inputs.frame_observations(len(inputs) - 1), np.full(len(e.z), DISCARD), at=elsewhere)
    assert not done.used.any()


def test_an_update_may_start_at_any_pose_of_the_robot():
    """In the world, not in that of the graph: at its own pose nothing changes, and from elsewhere it comes back."""
    inputs, decisions, *_ = erring(POLAR_OFF, "localization", to_estimate(*ALL), frames=20)
    last = inputs.observations.frame == 19
    nis, found = [], []
    for off in (None, np.zeros(3), np.array([0.4, -0.3, 0.2])):
        s = drive(inputs, np.where(last, DISCARD, decisions), smoother=calibrated(inputs, **TIGHT))[0]
        at = None if off is None else s.estimate().mean + off
        nis.append(s.update(inputs.frame_observations(19), decisions[last], at=at, innovations=True).nis)
        s.refine()
        s.refine()
        found.append(np.concatenate([s.estimate().mean, s.errors[0]]))
    assert nis[1] == pytest.approx(nis[0], rel=1e-9)
    np.testing.assert_allclose(found[1:], [found[0]] * 2, atol=1e-6)

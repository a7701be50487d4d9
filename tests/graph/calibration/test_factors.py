"""The first pose and the errors as factors: what they say together is what the prior says in the sensor's frame."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest
from gtsam import symbolIndex
from gtsam.symbol_shorthand import X

from data import se2
from data.inputs import FrameObservations, Increment, Prior
from graph.factors import pose2, root_information
from graph.open_end import (
    PINNED,
    OpenEnd,
    increment_factor,
    knot_factor,
    linear_factor,
    pinned_landmark_factors,
)
from graph.systematic import CONSTANTS, drift_key, errors_of
from tests.graph.calibration.worlds import ALL, CARTESIAN_OFF, ODOMETRY, P0, POLAR, to_estimate

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
    errors = errors_of(to_estimate("scale", "drift"), POLAR, Prior(START, P0))
    factor = knot_factor(errors, 3, 2.0)
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

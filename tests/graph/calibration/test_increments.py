"""An increment with systematic errors as a factor: its tangent, and where errors known since put it."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest
from gtsam import symbolIndex
from gtsam.symbol_shorthand import X

from data import se2
from data.inputs import Increment, Prior
from graph.factors import pose2, root_information
from graph.open_end import OpenEnd, increment_factor
from graph.systematic import CONSTANTS, drift_key, errors_of
from tests.graph.calibration.worlds import ALL, CARTESIAN_OFF, ODOMETRY, P0, POLAR, to_estimate

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

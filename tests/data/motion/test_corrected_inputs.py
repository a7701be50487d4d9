"""A log less its errors is the log that a robot without them would have recorded."""

from __future__ import annotations

import numpy as np
import pytest

from data.motion.systematic import corrected_inputs
from data.se2 import pose_error
from data.worlds.registry import named_log

ERRORS = "scale=-0.1+curvature=0.03+left=0.05+drift=0.002+bearing_error=0.04"


@pytest.mark.parametrize("sensor", ["range_bearing", "relative_point"])
def test_less_its_true_errors_odometry_and_readings_are_those_of_the_world_without(sensor):
    plain = named_log(f"arena:2:frames=60+sensor={sensor}").inputs()
    off = named_log(f"arena:2:frames=60+sensor={sensor}+{ERRORS}")
    found = corrected_inputs(off.inputs(), off.truth.errors)
    assert np.abs(pose_error(found.increments.mean, plain.increments.mean)).max() < 1e-12
    if sensor == "range_bearing":
        np.testing.assert_allclose(found.observations.z, plain.observations.z, atol=1e-12)
        np.testing.assert_allclose(found.observations.R, plain.observations.R)
    else:  # the noise is turned along with the point
        off_by = np.linalg.norm(found.observations.z - plain.observations.z, axis=1)
        assert off_by.max() < 0.04 * 5 * 0.1
        np.testing.assert_allclose(found.observations.R, plain.observations.R, atol=1e-12)


def test_the_odometrys_noise_grows_with_what_its_errors_make_of_it():
    off = named_log("arena:2:frames=60+scale=0.25+left=0.5")
    stated, found = off.inputs().increments, corrected_inputs(off.inputs(), off.truth.errors).increments
    left = np.where(stated.mean[1:, 2] > 0.0, 1.5, 1.0)
    np.testing.assert_allclose(found.covariance[1:, 2, 2], left**2 * stated.covariance[1:, 2, 2])
    right = left == 1.0
    D = np.diag([1.25, 1.25, 1.0])
    np.testing.assert_allclose(found.covariance[1:][right], D @ stated.covariance[1:][right] @ D, atol=1e-15)


def test_ranges_shrink_with_their_noise():
    off = named_log("arena:2:frames=60+range_error=0.25")
    found = corrected_inputs(off.inputs(), off.truth.errors).observations
    o = off.inputs().observations
    np.testing.assert_allclose(found.z[:, 0] * 1.25, o.z[:, 0])
    np.testing.assert_allclose(found.R[:, 0, 0] * 1.25**2, o.R[:, 0, 0])
    np.testing.assert_array_equal(found.R[:, 1, 1], o.R[:, 1, 1])

"""A log less its errors is the log that a robot without them would have recorded."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from data.log import Log
from data.se2 import pose_error
from data.worlds.registry import named_log
from eval.plan.calibrate.battery import with_systematic
from eval.plan.calibrate.corrected import less_errors
from eval.replay.run import compare

ERRORS = "scale=-0.1+curvature=0.03+left=0.05+drift=0.002+bearing_error=0.04"


def with_truth_as_estimate(log: Log):
    (run,) = compare(log.inputs(labels=True), "localization", ("dead-reckoning",))
    return replace(run, errors_final=log.truth.errors)


@pytest.mark.parametrize("sensor", ["range_bearing", "relative_point"])
def test_less_its_true_errors_odometry_and_readings_are_those_of_the_world_without(sensor):
    plain = named_log(f"arena:2:frames=60+sensor={sensor}").inputs()
    off = named_log(f"arena:2:frames=60+sensor={sensor}+{ERRORS}")
    found = less_errors(off, [with_truth_as_estimate(off)]).inputs()
    assert np.abs(pose_error(found.increments.mean, plain.increments.mean)).max() < 1e-12
    np.testing.assert_allclose(found.increments.covariance, plain.increments.covariance, atol=1e-15)
    if sensor == "range_bearing":
        np.testing.assert_allclose(found.observations.z, plain.observations.z, atol=1e-12)
        np.testing.assert_allclose(found.observations.R, plain.observations.R)
    else:  # the noise is turned along with the point
        off_by = np.linalg.norm(found.observations.z - plain.observations.z, axis=1)
        assert off_by.max() < 0.04 * 5 * 0.1
        np.testing.assert_allclose(found.observations.R, plain.observations.R, atol=1e-12)


def test_ranges_shrink_with_their_noise():
    off = named_log("arena:2:frames=60+range_error=0.25")
    found = less_errors(off, [with_truth_as_estimate(off)]).inputs().observations
    o = off.inputs().observations
    np.testing.assert_allclose(found.z[:, 0] * 1.25, o.z[:, 0])
    np.testing.assert_allclose(found.R[:, 0, 0] * 1.25**2, o.R[:, 0, 0])
    np.testing.assert_array_equal(found.R[:, 1, 1], o.R[:, 1, 1])


def test_without_an_estimate_the_log_stays_as_it_is():
    log = named_log("arena:2:frames=20")
    assert less_errors(log, ()) is log
    assert with_systematic(log, None).recorded.systematic is None

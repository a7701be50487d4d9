"""Worlds that err systematically: corrected by their errors the odometry is what it was, and so are the readings."""

from __future__ import annotations

import numpy as np
import pytest

from data.errors import UsageError
from data.inputs import ERRORS
from data.motion.systematic import correct
from data.se2 import pose_error
from data.worlds.registry import named_log
from tests.data.worlds.samples import agrees

ODOMETRY = "scale=-0.1+curvature=0.03+left=0.04+right=-0.05+drift=0.004"
WORLDS = ("arena:5", "park:5", "corridor:5")


def with_keys(name, keys):
    return named_log(f"{name}:{keys}")


@pytest.mark.parametrize("name", WORLDS)
def test_odometry_corrected_by_its_errors_is_that_of_the_same_world_without(name):
    plain, off = named_log(name).inputs(), with_keys(name, ODOMETRY)
    told = off.truth.errors
    assert told.names == ("scale", "curvature", "left", "right", "drift")
    for k in range(1, len(plain)):
        every = np.zeros(len(ERRORS))
        every[:5] = told.mean[k]
        mean, motion = np.zeros(3), off.inputs().increments.mean[k]
        correct(motion, every, np.zeros(3), mean, np.zeros((3, 7)), np.zeros((3, 3)))
        assert np.abs(pose_error(mean, plain.increments.mean[k])).max() < 1e-12
    assert np.abs(off.inputs().increments.mean - plain.increments.mean).max() > 0.01
    for a, b in ((off.inputs().observations.z, plain.observations.z), (off.truth.pose, named_log(name).truth.pose)):
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize(
    ("name", "sigma"),
    [("arena:5", (0.1, 0.02)), ("park:5", (0.1, 0.02)), ("arena:5:sensor=relative_point", (0.1, 0.1))],
)
def test_readings_have_the_sensors_errors_and_the_noise_as_stated(name, sigma):
    off = named_log(f"{name}{'+' if name.count(':') > 1 else ':'}range_error=0.05+bearing_error=-0.03")
    o, sensor = off.inputs().observations, off.inputs().sensor
    exact = sensor.predict(off.truth.pose[o.frame], off.inputs().map.xy[off.truth.landmark_of])
    polar = sensor.polar(exact) * [1.05, 1.0] + [0.0, -0.03]
    read = sensor.polar(o.z)
    far = polar[:, 0] > 4.0
    across = (read[far, 1] - polar[far, 1] + np.pi) % (2 * np.pi) - np.pi
    assert agrees(read[far, 0] - polar[far, 0], sigma[0], 0.0)
    assert agrees(across / (1.0 / polar[far, 0] if "point" in name else 1.0), sigma[1], 0.0)
    assert off.truth.errors.names == ("range", "bearing")


def test_a_world_without_errors_says_so_and_its_source_stays_as_it_was():
    log = named_log("corridor:5")
    assert log.truth.errors is None
    assert not {"scale", "range_error"} & set(log.source["corridor"])
    assert named_log("corridor:5:scale=0.1").source["corridor"]["scale"] == 0.1


@pytest.mark.parametrize("world", ["arena", "park", "corridor"])
def test_every_world_refuses_the_same_errors_and_names_itself(world):
    for error, said in (
        ("scale=0.9", "scale = 0.9; an error from -0.5 to 0.5 is needed"),
        ("left=-0.51", "left = -0.51; an error from"),
        ("right=0.51", "right = 0.51; an error from"),
        ("range_error=1.1", "range_error = 1.1; an error from"),
        ("drift=-0.01", "drift = -0.01; must not be negative"),
    ):
        with pytest.raises(UsageError, match=f"^{world}: {said}"):
            named_log(f"{world}:0:{error}")

"""Worlds that err systematically: corrected by their errors the odometry is what it was, and so are the readings."""

import numpy as np
import pytest

from data.errors import UsageError
from data.worlds.registry import named_log
from tests.data.worlds.samples import agrees


@pytest.mark.parametrize(("name", "sigma"), [
    ("arena:5", (0.1, 0.02)), ("park:5", (0.1, 0.02)), ("arena:5:sensor=relative_point", (0.1, 0.1)),
])  # fmt: skip
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
        ("left=-0.51", "left = -0.51; an error from"), ("right=0.51", "right = 0.51; an error from"),
        ("range_error=1.1", "range_error = 1.1; an error from"), ("drift=-0.01", "drift = -0.01; must not be negative"),
    ):  # fmt: skip
        with pytest.raises(UsageError, match=f"^{world}: {said}"):
            named_log(f"{world}:0:{error}")

"""A log exported in another program's way of writing comes back as the same log, within the digits written."""

import numpy as np
import pytest

from data import se2
from data.worlds.arena import Arena, simulate
from tests.data.formats.tables.foreign import FLAGS, START, export, table

SMALL = Arena(frames=40, landmarks=12)
LENGTH, ANGLE, TIME = 2e-6, 4e-8, 3e-7
"""m, rad, s: what is lost by three digits of a millimetre, six of a degree, and a double of 1.7e9 s."""


@pytest.fixture
def arena():
    return simulate(SMALL, 0)


@pytest.fixture
def convert(convert):
    return lambda *words: convert({}, "table", *words, "out")[0]


def test_an_arena_log_exported_in_mm_degrees_and_ns_comes_back(arena, convert, tmp_path):
    back = convert(*export(arena, tmp_path), *FLAGS)
    a, b = arena.recorded, back.recorded
    assert b.time - START == pytest.approx(a.time, abs=TIME)
    assert b.increments.mean == pytest.approx(a.increments.mean, abs=2 * LENGTH)
    assert (b.observations.frame == a.observations.frame).all()
    assert b.observations.z[:, 0] == pytest.approx(a.observations.z[:, 0], abs=LENGTH)
    assert np.abs(se2.wrap_angle(b.observations.z[:, 1] - a.observations.z[:, 1])).max() < ANGLE
    assert b.observations.R[0] == pytest.approx(a.observations.R[0])
    assert (b.map.id == a.map.id).all()
    assert b.map.xy == pytest.approx(a.map.xy, abs=LENGTH)
    assert back.truth.pose == pytest.approx(arena.truth.pose, abs=LENGTH)
    assert (back.truth.landmark_of == arena.truth.landmark_of).all()
    assert b.prior.mean == pytest.approx(arena.truth.pose[0], abs=LENGTH)
    assert b.prior.covariance == pytest.approx(a.prior.covariance)
    assert b.sensor == a.sensor


def test_wheel_ticks_make_the_circle_that_they_roll(convert, tmp_path):
    # wheels 0.5 m apart, 1 mm a tick: 100 and 150 ticks a row are 0.125 m along an arc of 0.1 rad (radius 1.25 m)
    rows = [[k, (65500 + 100 * k) % 65536, 150 * k, 1 + k, 0.1] for k in range(10)]
    wheels = table(tmp_path / "w.csv", "t,encL,encR,range,bearing", rows, ",")
    back = convert(
        wheels, "--columns", "left=encL,right=encR", "--track-width", "0.5", "--metres-per-tick", "1mm",
        "--tick-wrap", "65536", "--odometry-sigma", "0.05,0.05,0.075,0.045", "--observation-sigma", "0.1,2deg",
    )  # fmt: skip
    along, across = 1.25 * np.sin(0.1), 1.25 * (1.0 - np.cos(0.1))
    assert back.recorded.increments.mean[1:] == pytest.approx(np.tile([along, across, 0.1], (9, 1)))
    turned = 0.075**2 * np.hypot(along, across) + 0.045**2 * 0.1
    assert back.recorded.increments.covariance[1][2, 2] == pytest.approx(turned)
    each = [[k, 100, 150, 1 + k, 0.1] for k in range(10)]
    again = convert(
        table(tmp_path / "e.csv", "t,left,right,range,bearing", each, ","), "--track-width", "50cm",
        "--metres-per-tick", "0.001,0.001", "--ticks", "each", "--odometry-sigma", "0.05,0.05,0.075,0.045",
        "--observation-sigma", "0.1,2deg",
    )  # fmt: skip
    assert again.recorded.increments.mean == pytest.approx(back.recorded.increments.mean)


def test_the_map_is_turned_first_and_then_shifted(convert, tmp_path):
    odometry = table(tmp_path / "o.csv", "t,v,omega,range,bearing", [[0, 1, 0, 2, 0], [1, 1, 0, 1, 0]], ",")
    survey = table(tmp_path / "m.csv", "x,y,sx,sy", [[1, 0, 5, 20], [0, 2, "", 0]], ",")
    flags = (
        "--prior", "0,0,0", "--prior-sigma", "0,0,0", "--odometry-sigma", "0.1,0.1", "--observation-sigma", "0.1,0.1",
        "--unit", "sx=cm,sy=cm",
    )  # fmt: skip
    back = convert(odometry, "--map", survey, "--map-transform", "10,20,90deg", *flags)
    assert back.recorded.map.sigma == pytest.approx(np.array([[0.2, 0.05], [0.0, 0.0]]))
    with pytest.raises(AssertionError, match=r"m.csv:2: column sx: .* needs both equal"):
        convert(odometry, "--map", survey, "--map-transform", "10,20,80deg", *flags)
    assert back.recorded.map.xy == pytest.approx(np.array([[10.0, 21.0], [8.0, 20.0]]))
    assert back.recorded.map.id.tolist() == [0, 1]

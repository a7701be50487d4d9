"""Motion priors: what they state, scaled and placed as said; a folder states them, and nonsense is named."""

from __future__ import annotations

import math

import numpy as np
import pytest

from data.errors import DataError
from data.formats.open_log.reader import load_folder
from data.formats.open_log.writer import write_folder
from data.motion.motion_prior import ConstantVelocityPrior, ForwardPrior

TIMES = np.array([0.0, 0.5, 1.25, 2.0])
FORWARD = """[motion]
prior = "forward"
step_mean = 0.5
step_sigma = 0.4
lateral_sigma = 0.1
turn_sigma = 1.0
"""
STEADY = """[motion]
prior = "constant_velocity"
velocity = 0.8
velocity_sigma = 0.2
lateral_sigma = 0.1
turn_rate = 0.0
turn_rate_sigma = 0.5
"""


def primed(small_log_files, motion):
    """A small folder without odometry: frames.csv has times alone, the motion is stated."""
    files = small_log_files("frames", "relative_point")
    assert "[prior]" in files["log.toml"]
    stamps = [line.split(",")[0] for line in files["frames.csv"].splitlines()]
    return files | {
        "frames.csv": "\n".join(stamps) + "\n",
        "log.toml": files["log.toml"].replace("[prior]", motion + "[prior]"),
    }


def test_forward_states_the_same_step_whatever_the_time():
    got = ForwardPrior(0.5, 0.4, 0.1, 1.0).increments(TIMES)
    assert got.mean.tolist() == [[0, 0, 0], *[[0.5, 0, 0]] * 3]
    assert not got.covariance[0].any()
    for k in (1, 2, 3):
        assert got.covariance[k] == pytest.approx(np.diag([0.16, 0.01, 1.0]))


def test_constant_velocity_straight_ahead_scales_with_the_time():
    got = ConstantVelocityPrior(2.0, 0.3, 0.1, 0.0, 0.4).increments(TIMES)
    assert got.mean.tolist() == [[0, 0, 0], [1.0, 0, 0], [1.5, 0, 0], [1.5, 0, 0]]
    # sigmas in proportion to the time, and a turn shifts the end sideways by half of it times the way
    dt, way = 0.75, 1.5
    turn = (0.4 * dt) ** 2
    expected = [
        [(0.3 * dt) ** 2, 0, 0],
        [0, (0.1 * dt) ** 2 + turn * way**2 / 4, turn * way / 2],
        [0, turn * way / 2, turn],
    ]
    assert got.covariance[2] == pytest.approx(np.array(expected))


def test_constant_velocity_on_an_arc_is_what_samples_of_its_velocity_give():
    """Monte Carlo of velocity, sideways drift and turn rate about the stated ones."""
    prior, dt = ConstantVelocityPrior(1.0, 0.02, 0.01, 1.2, 0.03), 0.8
    rng = np.random.default_rng(5)
    v, w = 1.0 + 0.02 * rng.standard_normal(100_000), 1.2 + 0.03 * rng.standard_normal(100_000)
    drift = 0.01 * dt * rng.standard_normal(100_000)
    x = v / w * np.sin(w * dt) - drift * math.sin(0.6 * dt)
    y = v / w * (1.0 - np.cos(w * dt)) + drift * math.cos(0.6 * dt)
    samples = np.stack([x, y, w * dt])
    got = prior.increments(np.array([0.0, dt]))
    assert got.mean[1] == pytest.approx(samples.mean(axis=1), abs=5e-4)
    assert got.covariance[1] == pytest.approx(np.cov(samples), abs=0.03 * np.cov(samples).max())


@pytest.mark.parametrize(
    ("motion", "prior"),
    [(FORWARD, ForwardPrior(0.5, 0.4, 0.1, 1.0)), (STEADY, ConstantVelocityPrior(0.8, 0.2, 0.1, 0.0, 0.5))],
)
def test_a_folder_states_a_prior_in_place_of_increments(small_log_files, save, tmp_path, motion, prior):
    log = load_folder(save(tmp_path / "in", primed(small_log_files, motion)))
    expected = prior.increments(TIMES)
    assert np.array_equal(log.recorded.increments.mean, expected.mean)
    assert log.recorded.increments.covariance == pytest.approx(expected.covariance, abs=1e-8)
    assert any("motion prior" in note for note in log.notes)
    assert log.recorded.observations.frame.tolist() == [0, 1, 1, 3]
    # written, the increments stand in frames.csv
    write_folder(log, tmp_path / "out")
    again = load_folder(tmp_path / "out")
    assert np.array_equal(again.recorded.increments.mean, log.recorded.increments.mean)
    assert np.array_equal(again.recorded.increments.covariance, log.recorded.increments.covariance)
    assert again.notes == log.notes


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('"forward"', '"backward"', r"\[motion\] prior = 'backward': unknown; known: forward, constant_velocity"),
        (
            '"forward"',
            '"constant_velocity"',
            r"\[motion\] step_mean = 0.5: prior = 'constant_velocity' takes velocity,",
        ),
        ("step_mean = 0.5", "", r"\[motion\] step_mean: missing; a number is needed"),
        ("step_sigma = 0.4", "step_sigma = -0.4", r"\[motion\] step_sigma = -0.4: a number >= 0"),
    ],
)
def test_a_bad_prior_is_named_with_key_and_value(small_log_files, save, tmp_path, old, new, message):
    files = primed(small_log_files, FORWARD.replace(old, new, 1))
    with pytest.raises(DataError, match=rf"log\.toml: {message}"):
        load_folder(save(tmp_path, files))


def test_a_prior_stands_beside_neither_increments_nor_odometry(small_log_files, save, tmp_path):
    files = small_log_files("frames", "relative_point")
    stated = files["log.toml"].replace("[prior]", FORWARD + "[prior]")
    with pytest.raises(DataError, match=r"frames\.csv:1: column dx: \[motion\] prior in log\.toml states"):
        load_folder(save(tmp_path / "both", files | {"log.toml": stated}))
    driven = small_log_files("odometry", "relative_point")
    begin, end = driven["log.toml"].index("[motion]"), driven["log.toml"].index("[prior]")
    driven["log.toml"] = driven["log.toml"][:begin] + FORWARD + driven["log.toml"][end:]
    with pytest.raises(DataError, match=r"odometry\.csv: log\.toml states a \[motion\] prior instead"):
        load_folder(save(tmp_path / "driven", driven))

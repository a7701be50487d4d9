"""Every systematic error is said with its side and in a person's unit: a log states the truth plus size x regressor."""

from __future__ import annotations

import math
import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from eval.referee.effects import effects
from eval.referee.residuals import Used
from eval.report.diagnosis import Explanation, Terms, terms_of
from eval.report.words import say
from tests.eval.handmade import LANDMARKS, circle_log, true_path

POLAR, POINTS = Terms(), Terms(polar=False)
COMMON = (
    *(f"odometry_{name}" for name in ("x_distance", "x_turn", "y_distance", "y_turn", "integration", "latency")),
    *(f"odometry_theta_{name}" for name in ("distance", "turn", "time")),
    *(f"z{i}_{name}" for i in (1, 2) for name in ("constant", "range")),
    *("latency", "latency_growth", "mount_x", "mount_y", "map_scale"),
)


def phrase(name, terms, size, error):
    """A systematic error of a size in SI units, in words."""
    unit, factor = terms.unit(name)
    e = Explanation("systematic", name, factor * size, factor * error, unit)
    return say("effects#systematic", e=e, terms=terms)


def noise(name, factor, terms=POLAR):
    return say("effects#noise", name=name, factor=factor, terms=terms)


@pytest.mark.parametrize(
    ("name", "size", "error", "text"),
    [
        ("odometry_theta_turn", -0.0492, 0.0012, "odometry turns 4.92 % ± 0.12 % less than the robot did"),
        ("odometry_x_distance", 0.05, 0.004, "odometry states distances 5.0 % ± 0.4 % too long"),
        ("odometry_theta_distance", -0.0018, 4e-5, "odometry curves 0.00180 rad/m ± 0.00004 rad/m more to the right"),
        ("odometry_theta_time", 0.001, 2e-4, "the odometry's heading drifts 0.0010 rad/s ± 0.0002 rad/s to the left"),
        ("odometry_y_distance", math.radians(2.0), math.radians(0.3), "odometry points 2.0° ± 0.3° to the left of"),
        ("odometry_y_turn", 0.136, 0.023, "odometry is that of a point 0.14 m ± 0.02 m ahead of the robot's own"),
        ("odometry_x_turn", 0.2, 0.03, "odometry is that of a point 0.20 m ± 0.03 m to the right of the robot's own"),
        ("z1_constant", 0.12, 0.02, "ranges are 0.12 m ± 0.02 m too long"),
        ("z2_constant", math.radians(-1.0), math.radians(0.2), "bearings are 1.0° ± 0.2° too far to the right"),
        ("z1_range", 0.03, 0.002, "ranges grow 3.0 % ± 0.2 % too fast"),
        ("latency", 0.3, 0.03, "observations are 0.30 s ± 0.03 s older than stamped"),
        ("latency_growth", -0.003, 3e-4, "the clock of the observations falls 3.0 ms/s ± 0.3 ms/s ahead"),
        ("odometry_latency", -0.3, 0.03, "odometry is 0.30 s ± 0.03 s newer than stamped"),
        ("mount_x", 0.1, 0.02, "the sensor is mounted 0.10 m ± 0.02 m too far ahead of its stated place"),
        ("mount_y", -0.1, 0.02, "the sensor is mounted 0.10 m ± 0.02 m to the right of its stated place"),
        ("map_scale", 0.02, 0.002, "the map is 2.0 % ± 0.2 % too large"),
        ("odometry_integration", 1.0, 0.1, "odometry applies 100 % ± 10 % of half of each step's turn too early"),
    ],
)
def test_a_systematic_error_has_its_side_and_its_unit(name, size, error, text):
    assert phrase(name, POLAR, size, error).startswith(text)


def test_points_are_spoken_of_as_points():
    assert phrase("z1_constant", POINTS, -0.1, 0.02) == "the observations' x is 0.10 m ± 0.02 m too small"
    assert phrase("z2_range", POINTS, 0.01, math.nan) == "observations are rotated 0.573° counter-clockwise"
    assert phrase("z1_range", POINTS, -0.1, math.nan) == "observed distances grow 10.0 % too slowly"


def test_a_point_ahead_of_the_robot_moves_to_the_left_in_a_left_turn():
    """The sentences on points beside and ahead, by the motion of a rigid body: v = omega x r."""
    log = circle_log()
    path = true_path()
    used = Used(np.zeros(4, np.int64), LANDMARKS.xy[:1], np.array([0]))
    motion = {e.name: e.motion for e in effects(log.recorded, path, used)}
    turn = motion["odometry_theta_turn"][1, 2]
    assert turn > 0.0
    ahead, right = np.array([1.0, 0.0]), np.array([0.0, -1.0])
    for r, name in ((ahead, "odometry_y_turn"), (right, "odometry_x_turn")):
        assert motion[name][1, :2] == pytest.approx(turn * np.array([-r[1], r[0]]))


def test_every_systematic_error_that_is_sought_can_be_said():
    log = circle_log()
    used = Used(np.zeros(4, np.int64), LANDMARKS.xy[:1], np.array([0]))
    sought = {e.name for e in effects(log.recorded, true_path(), used)}
    assert sought <= set(COMMON)
    assert terms_of(log.recorded) == POLAR


@given(
    st.sampled_from(COMMON), st.builds(Terms), st.floats(-1e6, 1e6).filter(bool), st.floats(0, 1e6) | st.just(math.nan)
)
def test_no_sentence_has_a_number_that_is_none(name, terms, size, error):
    text = phrase(name, terms, size, error)
    assert not re.search(r"\b(nan|inf|None)\b", text, re.IGNORECASE)
    assert "{" not in text


def test_a_noise_is_stated_too_large_if_it_is_smaller():
    assert noise("z1", 0.2186).endswith("4.6 times too large")
    assert noise("z1", 1.34).endswith("1.34 times too small")
    assert noise("z2", 0.5) == "the noise (σ) of the bearings is stated 2.0 times too large"
    assert noise("odometry_theta", 2.0, POINTS).startswith("the noise (σ) of the odometry's heading")


def test_a_log_without_stamps_has_frames_for_seconds():
    unstamped = Terms(stamped=False)
    assert phrase("latency", unstamped, 0.7, 0.03).startswith("observations are 0.70 frames ± 0.03 frames older")
    assert "0.020 rad/frame" in phrase("odometry_theta_time", unstamped, 0.02, 0.002)
    log = circle_log()
    assert terms_of(replace(log.recorded, time_is_index=True)) == unstamped

"""Which errors a log names by its residuals, and whether a curvature comes and goes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from data.notice import stopped
from data.result import Failure
from data.worlds.registry import named_log
from eval.plan.calibrate import every, hypotheses, named, names_of, plainly, turned, wanders
from eval.referee.attribution import NOISE, Finding
from eval.referee.residuals import used_by
from eval.replay.run import compare
from eval.replay.settings import Setup


def found(*names, other=()):
    return [Finding(NOISE, "systematic", name, 0.1, other=other) for name in names]


@pytest.fixture(scope="module")
def inputs():
    return named_log("arena:0:frames=20").inputs()


@pytest.mark.parametrize(
    ("names", "expected"),
    [
        (("odometry_x_scale",), ("scale",)),
        (("odometry_theta_left", "odometry_theta_curvature"), ("curvature", "left", "right")),
        (("odometry_y_distance",), ("bearing",)),
        (("z2_constant", "z1_range"), ("range", "bearing")),
        (("z2_range", "odometry_theta_time", "z1_speed"), ()),
    ],
)
def test_findings_stand_for_errors_in_their_order(inputs, names, expected):
    assert named(found(*names), wandering=False, inputs=inputs) == expected


def test_of_points_it_is_the_slope_across_that_a_turned_sensor_has():
    points = named_log("arena:0:frames=20+sensor=relative_point").inputs()
    assert named(found("z2_range"), wandering=False, inputs=points) == ("bearing",)
    assert named(found("z2_constant"), wandering=False, inputs=points) == ()


def test_what_cannot_be_told_apart_is_named_by_the_first_that_has_a_name(inputs):
    like = found("odometry_theta_time", other=("z1_speed", "odometry_theta_curvature", "odometry_x_scale"))
    assert named(like, wandering=False, inputs=inputs) == ("curvature",)


def test_in_slam_the_ranges_scale_is_the_odometrys(inputs):
    slam = inputs.without_map()
    assert named(found("z1_range"), wandering=True, inputs=slam) == ("scale", "drift")
    assert "range" in every(inputs)
    assert "range" not in every(slam)


def test_a_unit_of_an_error_adds_to_the_odometry_what_a_world_with_that_error_reports():
    plain, small = named_log("arena:3:frames=60"), 1e-6
    (run,) = compare(plain.inputs(labels=True), "localization", ("dead-reckoning",))
    motion = plain.inputs().increments.mean
    # where the odometry has no noise
    path = [plain.inputs().prior.mean]
    for m in motion[1:]:
        c, s = np.cos(path[-1][2]), np.sin(path[-1][2])
        path.append(path[-1] + np.array([c * m[0] - s * m[1], s * m[0] + c * m[1], m[2]]))
    columns = {e.name: e.motion for e in hypotheses(plain.inputs(), np.array(path), used_by(run, plain.inputs()))}
    for name, error in (("x_scale", "scale"), ("theta_curvature", "curvature"), ("theta_left", "left")):
        there = named_log(f"arena:3:frames=60+{error}={small}").inputs().increments.mean
        np.testing.assert_allclose(columns[f"odometry_{name}"], (there - motion) / small, atol=2e-5)


@pytest.mark.parametrize(
    ("keys", "expected"),
    [
        ("", ()),
        (":curvature=0.03+scale=-0.1", ("scale", "curvature")),
        pytest.param(":bearing_error=0.05", ("bearing",), marks=pytest.mark.slow),
    ],
)
def test_a_log_names_its_errors_without_any_twin(keys, expected):
    assert plainly(named_log(f"arena:1{keys}"), "localization", "known", Setup())[1] == expected


def test_what_one_log_in_twenty_shows_by_chance_is_not_named(monkeypatch):
    log = named_log("arena:115")  # its turns to the left err by 3.2 standard errors
    names = []
    for share in (0.05, 0.01):
        monkeypatch.setattr("eval.plan.calibrate.WRONGLY", share)
        names.append(plainly(log, "localization", "known", Setup())[1])
    assert names == [("left", "right"), ()]


def test_without_a_smoother_nothing_is_named():
    log = named_log("arena:0:frames=20")
    (run,) = compare(log.inputs(labels=True), "localization", ("dead-reckoning",))
    assert names_of(log.inputs(), replace(run, failure=Failure("diverged", 3, stopped("no")))) == ()


def test_nothing_is_asked_of_turns_that_are_noise():
    park, arena = (named_log(name).inputs() for name in ("park:0:frames=1000", "arena:0"))
    assert [turned(park, n) for n in ("left", "right", "scale")] == [True, False, True]
    assert turned(arena, "left")
    assert turned(arena, "right")
    assert "right" not in every(park)
    assert "right" not in plainly(named_log("park:0:frames=400+left=-0.2"), "localization", "known", Setup())[1]


@pytest.mark.parametrize("seed", range(3))
def test_a_curvature_wanders_that_comes_and_goes_and_none_that_stays(seed):
    def says(keys):
        log = named_log(f"park:{seed}:frames=1500{keys}")
        return wanders(log.inputs(), log.truth.pose)

    assert says("+drift=0.004")
    assert not says("+curvature=0.01+scale=0.05")
    assert not says("")


def test_a_robot_that_went_nowhere_does_not_wander(inputs):
    assert not wanders(inputs, named_log("arena:0:frames=20").truth.pose)

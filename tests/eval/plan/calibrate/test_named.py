"""Which errors a battery's findings stand for, and whether a curvature comes and goes."""

from __future__ import annotations

import pytest

from data.worlds.registry import named_log
from eval.plan.calibrate.named import every, named, wanders
from eval.referee.attribution import NOISE, Finding


def found(*names, other=()):
    return [Finding(NOISE, "systematic", name, 0.1, other=other) for name in names]


@pytest.fixture(scope="module")
def inputs():
    return named_log("arena:0:frames=20").inputs()


@pytest.mark.parametrize(
    ("names", "expected"),
    [
        (("odometry_x_distance",), ("scale",)),
        (("odometry_theta_turn", "odometry_theta_distance"), ("curvature", "left", "right")),
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
    like = found("odometry_theta_time", other=("z1_speed", "odometry_theta_distance", "odometry_x_distance"))
    assert named(like, wandering=False, inputs=inputs) == ("curvature",)


def test_findings_of_another_kind_name_nothing(inputs):
    assert named([Finding(NOISE, "sigma", "odometry_x_distance", 2.0)], wandering=False, inputs=inputs) == ()


def test_in_slam_the_ranges_scale_is_the_odometrys(inputs):
    slam = inputs.without_map()
    assert named(found("z1_range"), wandering=True, inputs=slam) == ("scale", "drift")
    assert "range" in every(inputs)
    assert "range" not in every(slam)


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

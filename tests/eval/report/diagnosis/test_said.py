"""Facts of a log and of its twins: each number is the one it is said to be, and an unknown one is left out."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from eval.referee.truth_free import Statistic
from eval.report.diagnosis import Decided, Terms, facts_of
from eval.report.words import distance
from tests.eval.report.diagnosis.said_by_hand import said

POLAR, POINTS = Terms(), Terms(polar=False)


def with_apart(trust, **apart):
    return replace(trust, real=replace(trust.real, apart=apart))


def with_measured(trust, measured):
    return replace(trust, real=replace(trust.real, measured=measured))


@pytest.mark.parametrize(
    ("value", "text"), [(0.0, "0 m"), (0.0042, "4.2 mm"), (0.00999, "10 mm"), (0.01, "0.0100 m"), (13.0, "13.0 m")]
)
def test_a_length_below_a_centimetre_is_said_in_millimetres(value, text):
    assert distance(value) == text


def test_filters_come_first_then_our_smoothers_then_others_and_who_was_not_measured_is_not_there():
    trust = with_apart(said(), theirs=1.0, isam2=2.0, **{"ekf-iterated": 3.0}, ekf=4.0, batch=math.nan)
    found = facts_of(trust, POLAR).apart
    assert [(a["estimator"], a["filters"]) for a in found] == [
        ("ekf", True), ("ekf-iterated", True), ("isam2", False), ("theirs", False),
    ]  # fmt: skip


def test_twins_stand_beside_the_log_as_the_range_from_the_least_to_the_largest_that_are_known():
    def apart(trust):
        (a,) = facts_of(trust, POLAR).apart
        return a["rms"], a["twins"], a["beside_twins"]

    trust = said(twins=3)
    assert apart(trust) == (13.0, pytest.approx((0.5, 0.7)), True)
    lost = replace(trust.twins[0], apart={"ekf": math.nan})
    assert apart(replace(trust, twins=(lost, *trust.twins[1:]))) == (13.0, pytest.approx((0.6, 0.7)), True)
    assert apart(replace(trust, twins=(lost,))) == (13.0, (), True)
    assert apart(said()) == (13.0, (), False)


MEDIAN, SHARE = ("ekf", "filter_smoother_median"), ("ekf", "filter_smoother_semidefinite")


@pytest.mark.parametrize(
    ("measured", "median", "semidefinite"),
    [
        ({}, (), None),
        ({MEDIAN: Statistic(2, 1.5)}, (2, 1.5), None),
        ({MEDIAN: Statistic(math.nan, 1.5)}, (), None),
        ({MEDIAN: Statistic(2.0)}, (), None),
        ({SHARE: Statistic(0.25, 1.0)}, (), 0.25),
        ({SHARE: Statistic(math.nan, 1.0)}, (), None),
    ],
)
def test_of_the_difference_only_what_is_known_is_a_fact(measured, median, semidefinite):
    (a,) = facts_of(with_measured(said(), measured), POLAR).apart
    assert (a["median"], a["semidefinite"]) == (median, semidefinite)


def slopes(**sizes):
    return with_measured(said(), {("batch", f"slope_{name}"): Statistic(*m) for name, m in sizes.items()})


def test_systematic_errors_beyond_three_standard_errors_are_named_the_largest_first():
    trust = slopes(
        odometry_theta_turn=(0.0301, 0.0, 0.01), z1_range=(-0.2, 0.0, 0.01), odometry_x_distance=(0.03, 0.0, 0.01),
        z1_constant=(0.07, 0.0, 0.01), odometry_theta_distance=(5.0, 0.0, 0.0), z2_constant=(math.nan, 0.0, 0.01),
        z2_range=(5.0, 0.0, math.nan), odometry_theta_time=(0.01, 0.0, 0.01),
    )  # fmt: skip
    found = facts_of(trust, POLAR).asked
    assert [(t.name, round(t.sigmas, 1)) for t in found] == [
        ("z1_range", 20.0), ("z1_constant", 7.0), ("odometry_theta_turn", 3.0),
    ]  # fmt: skip
    assert (found[0].size, found[0].error, found[0].unit) == (pytest.approx(-20.0), pytest.approx(1.0), "%")
    other = with_measured(said(), {("batch", "residual_z1_mean"): Statistic(5.0, 0.0, 0.1)})
    assert facts_of(other, POLAR).asked == ()


def test_nees_on_twins_is_the_mean_of_those_that_have_one():
    key, other = ("ekf", "online"), ("batch", "final")
    trust = said(twins=4)
    values = ({key: 2.0, other: math.nan}, {key: 4.0}, {key: math.nan}, {key: 6.0, other: 3.5})
    twins = tuple(replace(t, nees=n) for t, n in zip(trust.twins, values, strict=True))
    assert facts_of(replace(trust, twins=twins), POLAR).nees == ((*key, 4.0), (*other, 3.5))
    assert facts_of(said(), POLAR).nees == facts_of(replace(trust, twins=twins[2:3]), POLAR).nees == ()


def test_decisions_on_twins_are_means_over_them_and_estimators_that_decide_alike_share_a_fact():
    trust = said(twins=2, association="nn")
    alike, other = (80.0, 10.0, 6.0, 4.0), (60.0, 20.0, 12.0, 8.0)
    counts = ({"ekf": alike, "isam2": alike, "theirs": other, "idle": (0, 0, 0, 0)}, {"ekf": alike, "isam2": alike})
    twins = tuple(replace(t, counts=c) for t, c in zip(trust.twins, counts, strict=True))
    assert facts_of(replace(trust, twins=twins), POLAR).deciding == (
        Decided(("ekf", "isam2"), 6.0, 4.0, 100.0, 0.9), Decided(("theirs",), 12.0, 8.0, 100.0, 0.8),
    )  # fmt: skip
    assert facts_of(replace(trust, association="known"), POLAR).deciding == ()
    assert facts_of(said(association="nn"), POLAR).deciding == ()

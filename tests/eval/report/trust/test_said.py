"""Numbers of a log and of its twins in sentences: each is the one it is said to be, and an unknown one is left out."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from eval.referee.trust import Measured
from eval.report import trust_facts as words
from eval.report.trust_facts import Terms
from tests.eval.report.trust.said_by_hand import DETECTABLE, blamed, said

POLAR, POINTS = Terms(), Terms(polar=False)


def with_apart(trust, **apart):
    return replace(trust, real=replace(trust.real, apart=apart))


def with_measured(trust, measured):
    return replace(trust, real=replace(trust.real, measured=measured))


@pytest.mark.parametrize(
    ("value", "text"), [(0.0, "0 m"), (0.0042, "4.2 mm"), (0.00999, "10 mm"), (0.01, "0.0100 m"), (13.0, "13.0 m")]
)
def test_a_length_below_a_centimetre_is_said_in_millimetres(value, text):
    assert words.length(value) == text


def test_filters_come_first_then_our_smoothers_then_others_and_who_was_not_measured_is_not_there():
    trust = with_apart(said(), theirs=1.0, isam2=2.0, **{"ekf-iterated": 3.0}, ekf=4.0, batch=math.nan)
    assert words.online(trust) == ["ekf", "ekf-iterated", "isam2", "theirs"]
    assert words.who("ekf") == "the filter (ekf)"
    assert words.who("isam2") == "the online path of isam2"


def test_twins_stand_beside_the_log_as_the_range_from_the_least_to_the_largest_that_are_known():
    trust = said(twins=3)
    assert words.apart(trust, "ekf").endswith("13.0 m RMS apart, on the twins 0.500 m to 0.700 m")
    lost = replace(trust.twins[0], apart={"ekf": math.nan})
    assert words.apart(replace(trust, twins=(lost, *trust.twins[1:])), "ekf").endswith("0.600 m to 0.700 m")
    assert words.apart(replace(trust, twins=(lost,)), "ekf").endswith("apart; ekf was not run on the twins")
    assert words.apart(said(), "ekf").endswith("RMS apart")


MEDIAN, SHARE = ("ekf", "filter_smoother_median"), ("ekf", "filter_smoother_semidefinite")


@pytest.mark.parametrize(
    ("measured", "text"),
    [
        ({}, ""),
        ({MEDIAN: Measured(2, 1.5)}, "their difference d has a median dᵀ(P_f − P_s)⁻¹d of 2.00 where 1.50 is expected"),
        ({MEDIAN: Measured(math.nan, 1.5)}, ""),
        ({MEDIAN: Measured(2.0)}, ""),
        ({SHARE: Measured(0.25, 1.0)}, "P_f − P_s is positive semidefinite in 25 % of the frames"),
        ({SHARE: Measured(math.nan, 1.0)}, ""),
    ],
)  # fmt: skip
def test_of_the_difference_only_what_is_known_is_said(measured, text):
    assert words.quadratic(with_measured(said(), measured), "ekf") == text


def test_both_statistics_of_the_difference_stand_in_one_sentence():
    text = words.quadratic(said(), "ekf")
    assert ", and P_f − P_s is positive semidefinite in 9 % of the frames" in text


def test_before_and_after_a_calibration_are_told_if_both_are_known():
    before, after = said(), with_measured(said(), {MEDIAN: Measured(1.6, 1.4)})
    now, was = words.median_before_and_after(before, after, "ekf")
    assert (now.endswith("of 1.60 where 1.40 is expected"), was) == (True, "30.3")
    bare = with_measured(said(), {})
    assert words.median_before_and_after(before, bare, "ekf") == words.median_before_and_after(bare, after, "ekf")
    assert words.median_before_and_after(before, bare, "ekf") == ("", "")


def slopes(**sizes):
    return with_measured(said(), {("batch", f"slope_{name}"): Measured(*m) for name, m in sizes.items()})


def test_systematic_errors_beyond_three_standard_errors_are_named_the_largest_first():
    trust = slopes(
        odometry_theta_turn=(0.0301, 0.0, 0.01), z1_range=(-0.2, 0.0, 0.01), odometry_x_distance=(0.03, 0.0, 0.01),
        z1_constant=(0.07, 0.0, 0.01), odometry_theta_distance=(5.0, 0.0, 0.0), z2_constant=(math.nan, 0.0, 0.01),
        z2_range=(5.0, 0.0, math.nan), odometry_theta_time=(0.01, 0.0, 0.01),
    )  # fmt: skip
    found = words.standing_out(trust, POLAR, 5)
    assert [text.rsplit(" (", 1)[1] for text in found] == [
        "20 standard errors)", "7 standard errors)", "3 standard errors)",
    ]  # fmt: skip
    assert found[0].startswith("ranges grow 20.0 % ± 1.0 % too slowly")
    assert words.standing_out(trust, POLAR, 2) == found[:2]
    other = with_measured(said(), {("batch", "residual_z1_mean"): Measured(5.0, 0.0, 0.1)})
    assert words.standing_out(other, POLAR, 5) == []


@pytest.mark.parametrize(
    ("objected", "text"),
    [
        (0, "none of 9 statistics lies outside what 20 twins show (smallest family-wise p 0.60)"),
        (1, "1 of 9 statistics lies outside what 20 twins show (family-wise p 0.048)"),
        (2, "2 of 9 statistics lie outside what 20 twins show (family-wise p 0.048)"),
    ],
)
def test_how_many_statistics_are_outside_is_counted(objected, text):
    assert words.outside(blamed(objected=objected).blame, 20) == text


def test_a_p_that_is_not_known_is_not_said():
    blame = replace(blamed().blame, p=math.nan)
    assert words.outside(blame, 20) == "none of 9 statistics lies outside what 20 twins show"


def power(terms=POLAR, *, brief=False, **detectable):
    return words.power(replace(blamed().blame, detectable=detectable or DETECTABLE), terms, brief=brief)


def test_in_brief_three_sizes_are_told_that_would_have_been_seen():
    assert power(brief=True) == (
        "With 90 % probability it would have shown a wrong scale of the odometry's turns of 5.0 %, a bias of the"
        " bearings of 0.40° or a wrong scale of the ranges of 3.7 %"
    )


def test_sizes_of_points_and_noises_are_told_in_their_own_terms_and_unknown_ones_not():
    text = power(POINTS)
    assert "a sensor turned on its mount of 0.23°" in text
    assert text.endswith(
        "a noise of the readings' x 1.12 times as large as stated or a noise of the odometry's heading at least 1.45"
        " times as large as stated"
    )
    one = power(odometry_x_distance=0.037, z1_range=math.nan, residual_z1_spread=math.nan)
    assert one.endswith("shown a wrong scale of the odometry's distances of 3.7 %")
    assert power(z1_range=math.nan) == ""


def test_nees_on_twins_is_the_mean_of_those_that_have_one():
    key, other = ("ekf", "online"), ("batch", "final")
    trust = said(twins=4)
    values = ({key: 2.0, other: math.nan}, {key: 4.0}, {key: math.nan}, {key: 6.0, other: 3.5})
    twins = tuple(replace(t, nees=n) for t, n in zip(trust.twins, values, strict=True))
    text = words.nees_on_twins(replace(trust, twins=twins))
    assert text == (
        "The twins have a truth: mean pose NEES over them is 4.00 for ekf (online) and 3.50 for batch (final),"
        " where 3 is expected"
    )
    assert words.nees_on_twins(said()) == ""
    assert words.nees_on_twins(replace(trust, twins=twins[2:3])) == ""


def test_decisions_on_twins_are_means_over_them_and_estimators_that_decide_alike_share_a_clause():
    trust = said(twins=2, association="nn")
    alike, other = (80.0, 10.0, 6.0, 4.0), (60.0, 20.0, 12.0, 8.0)
    counts = ({"ekf": alike, "isam2": alike, "theirs": other, "idle": (0, 0, 0, 0)}, {"ekf": alike, "isam2": alike})
    twins = tuple(replace(t, counts=c) for t, c in zip(trust.twins, counts, strict=True))
    assert words.deciding_on_twins(replace(trust, twins=twins)) == (
        "Expected of `nn` on this geometry (mean over the twins): 6.0 wrong pairings (FP) and 4.0 missed (FN) in 100"
        " decisions, 90.0 % as batch paired them (ekf, isam2); 12 wrong pairings (FP) and 8.0 missed (FN) in 100"
        " decisions, 80.0 % as batch paired them (theirs)"
    )
    assert words.deciding_on_twins(replace(trust, association="known")) == ""
    assert words.deciding_on_twins(said(association="nn")) == ""

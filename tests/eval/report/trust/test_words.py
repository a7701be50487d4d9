"""What is said of a log: the cause, what was found, what to do, and no number where something failed."""

from __future__ import annotations

import math
import re
from dataclasses import replace

import pytest

from eval.referee.attribution import ASSOCIATIONS, ESTIMATOR, NOISE, Finding
from eval.report.trust import advice, first_words, groups_of, paragraphs, sentences
from eval.report.trust_facts import Terms
from tests.eval.report.trust.said_by_hand import TURN, blamed, said

POLAR, POINTS = Terms(), Terms(polar=False)
SIGMA = Finding(NOISE, "sigma", "z2", 0.2, gain=1000.0)
TAILS = Finding(NOISE, "tails", "readings", 38, gain=50.0)
PAIRINGS = Finding(ASSOCIATIONS, "pairings", "readings", 8, gain=300.0)
LINEAR = Finding(ESTIMATOR, "linearization", "ekf", 1.3, 0.02)


def told(trust, *, terms=POLAR, labels=True) -> str:
    return paragraphs(trust, terms=terms, labels=labels)


def sentence_count(text: str) -> int:
    return len(re.findall(r"\.(?= |$)", text))


def test_a_wrong_noise_model_is_named_with_how_far_filter_and_smoother_are_apart():
    text = first_words(blamed(SIGMA, TURN, cause=NOISE, objected=5), terms=POLAR)
    assert text == (
        "By its own data **the noise model** is not to be trusted: 5 of 9 statistics lie outside what 20 twins show"
        " (family-wise p 0.048). The filter (ekf) and the smoother are 13.0 m RMS apart, on the twins 0.500 m to"
        " 2.40 m. The noise (σ) of the bearings is stated 5.0 times too large; odometry turns 5.00 % ± 0.10 % less than"
        " the robot did."
    )


def test_nothing_to_object_to_comes_with_what_would_have_been_seen():
    text = first_words(blamed(), terms=POLAR)
    assert (
        "**nothing to object to**: none of 9 statistics lies outside what 20 twins show (smallest family-wise p 0.60)"
        in text
    )
    assert (
        "With 90 % probability it would have shown a wrong scale of the odometry's turns of 5.0 %, a bias of the"
        in text
    )
    whole = told(blamed())
    assert "a curvature of the odometry of 0.013 rad/m" in whole
    assert "a noise of the odometry's heading at least 1.45 times as large as stated" in whole
    assert "What to do" not in whole


@pytest.mark.parametrize("cause", [NOISE, ASSOCIATIONS, ESTIMATOR])
def test_the_first_words_are_two_to_four_sentences(cause):
    for trust in (said(), blamed(), blamed(SIGMA, TURN, cause=cause, objected=3)):
        assert 2 <= sentence_count(first_words(trust, terms=POLAR)) <= 4
    beside_truth = first_words(blamed(SIGMA, TURN, cause=cause, objected=3), terms=POLAR, measured=True)
    assert sentence_count(beside_truth) == 2


def test_without_twins_the_difference_is_told_and_how_to_get_p_values():
    text = first_words(said(), terms=POLAR)
    assert text.startswith("The filter (ekf) and the smoother are 13.0 m RMS apart; their difference d has a median")
    assert "of 30.3 where 1.46 is expected, and P_f − P_s is positive semidefinite in 9 % of the frames" in text
    assert "odometry turns 5.00 % ± 0.10 % less than the robot did (50 standard errors)" in text
    assert "`--twins 100`" in text
    assert "anges grow" not in told(said())  # one standard error is nothing


def test_each_kind_of_finding_has_its_sentence():
    white = Finding(ESTIMATOR, "innovations", "ekf", 1.1)
    assert sentences([white], POLAR) == [
        "on the twins, where all is as stated, ekf's NIS is 1.10 times what is expected"
    ]
    wrong = Finding(ASSOCIATIONS, "decisions", "ekf", 0.034)
    assert "3.4 % of the decisions of ekf are wrong pairings" in sentences([wrong], POLAR)[0]
    assert "jcbb-hindsight" in advice([wrong], POLAR, labels=False)[0]
    twice = replace(LINEAR, size=1.6)
    assert sentences([SIGMA, TAILS, PAIRINGS, LINEAR, twice], POLAR)[1:] == [
        "38 readings fit no landmark where the path puts them: outliers of the sensor",
        "8 readings fit another landmark than the one paired with: wrong pairings",
        "on the twins, where all is as stated, ekf's NEES is 1.60 times what its covariance claims: it claims less"
        " error than it makes",
    ]
    assert "it claims more error than it makes" in sentences([replace(LINEAR, size=0.5)], POLAR)[0]
    alike = replace(TURN, other=("odometry_theta_time",))
    assert sentences([alike], POLAR)[0].endswith(
        "(or, which this log cannot tell apart, a drift of the odometry's heading)"
    )


def test_what_to_do_names_the_parameters_that_can_be_fitted():
    motion = Finding(NOISE, "sigma", "odometry_x", 2.0)
    bias, late = (Finding(NOISE, "systematic", n, 0.1, 0.01) for n in ("z2_constant", "z1_speed"))
    askew = Finding(NOISE, "systematic", "odometry_y_distance", 0.1, 0.01)
    assert groups_of([bias, SIGMA, motion, TURN]) == ("motion", "sensor", "bias", "odometry")
    said_so = " ".join(advice([TURN, SIGMA, late, askew], POLAR, labels=True))
    assert "`python -m eval.tune LOG OUT --fit sensor,odometry`" in said_so
    assert "`--fit latency`" in said_so
    assert "no parameter stands for it: odometry askew to the way driven" in said_so
    assert "if the log had labels" in " ".join(advice([SIGMA], POLAR, labels=False))
    assert "--gate-known 0.9999" in " ".join(advice([PAIRINGS], POLAR, labels=True))
    assert "--gate-known" not in " ".join(advice([PAIRINGS, TAILS], POLAR, labels=False))
    assert "`batch-huber` or `gnc`" in " ".join(advice([TAILS], POLAR, labels=True))
    assert "`ekf-iterated`" in advice([LINEAR], POLAR, labels=True)[0]
    assert "covariances of batch" in advice([replace(LINEAR, name="batch")], POLAR, labels=True)[0]


def test_a_calibration_is_told_with_what_it_left():
    after = replace(blamed(TURN, cause=NOISE, objected=1), real=replace(said().real, apart={"ekf": 1.2}))
    done = {"odometry_theta_turn": -0.05, "sigma_z1": 0.5}
    text = told(replace(blamed(TURN, cause=NOISE, objected=5), after=after, done=done))
    assert "Odometry turns 5.00 % less than the robot did." in text
    assert "The noise (σ) of the ranges is stated 2.0 times too large." in text
    assert "1 of 9 statistics lies outside what 20 twins show (family-wise p 0.048); before, 5 of 9 did." in text
    assert "are 1.20 m RMS apart, on the twins" in text
    assert "; before, 13.0 m." in text
    assert "Their difference d then has a median" in text
    assert "Cause now: the noise model" in text


def test_a_calibration_that_came_to_nothing_says_so_without_a_number():
    after = replace(said(notes=["batch failed (singular), so nothing is measured of it"]), real=said().real)
    text = told(replace(blamed(TURN, cause=NOISE, objected=5), after=after, done={"sigma_z1": 0.5}))
    assert "What is left cannot be told." in text
    assert "Batch failed (singular), so nothing is measured of it." in text


def test_an_objection_without_a_name_is_admitted():
    assert "None of the errors that have a name explains them" in told(blamed(cause=NOISE, objected=2))


def test_a_way_of_deciding_is_told_what_to_expect_of_it():
    assert (
        "Expected of `jcbb` on this geometry (mean over the twins): 1.0 wrong pairings (FP) and 1.0 missed (FN) in"
        in (told(blamed(association="jcbb")))
    )
    assert "Expected of" not in told(blamed())


def test_the_blind_spot_of_twins_is_in_the_section_and_not_on_the_first_page():
    assert "What twins cannot see" in told(blamed())
    assert "cannot see" not in first_words(blamed(), terms=POLAR)


def test_why_there_are_no_twins_is_a_sentence():
    assert told(said(notes=["no twins of home: it has 3 frames"])).endswith("* No twins of home: it has 3 frames.")


def test_what_failed_has_no_number():
    unknown = {key: m._replace(value=math.nan, se=math.nan) for key, m in said().real.measured.items()}
    trust = said()
    lost = replace(trust, real=replace(trust.real, measured=unknown, apart={"ekf": math.nan}))
    assert first_words(lost, terms=POLAR) == ""
    broken = [replace(f, size=math.nan, error=math.nan) for f in (TURN, SIGMA, TAILS, LINEAR)]
    for t in (
        lost,
        replace(lost, twins=(lost.real,) * 20, blame=replace(blamed(*broken, cause=NOISE).blame, p=math.nan)),
        replace(blamed(TURN, cause=NOISE, objected=2), twins=(lost.real,) * 20),
        replace(blamed(TURN, cause=NOISE), after=lost, done={"sigma_z1": math.nan, "z1_range": 0.0}),
    ):
        for text in (first_words(t, terms=POLAR), told(t, terms=POINTS)):
            assert not re.search(r"\b([Nn]an|NaN|inf|None(?! of))\b", text)
            assert "* \n" not in text

"""What is said of a log: the cause, what was found, what to do, and no number where something failed."""

from __future__ import annotations

import math
import re
from dataclasses import replace

import pytest

from data.notice import Code, notice
from eval.referee.attribution import ASSOCIATIONS, ESTIMATOR, NOISE, Finding
from eval.report.diagnosis import Step, Terms, advice, explanations, facts_of, first_words, groups_of
from eval.report.words import say
from tests.eval.report.diagnosis.said_by_hand import TURN, blamed, said

POLAR, POINTS = Terms(), Terms(polar=False)
SIGMA = Finding(NOISE, "sigma", "z2", 0.2, gain=1000.0)
TAILS = Finding(NOISE, "tails", "readings", 38, gain=50.0)
PAIRINGS = Finding(ASSOCIATIONS, "pairings", "readings", 8, gain=300.0)
LINEAR = Finding(ESTIMATOR, "linearization", "ekf", 1.3, 0.02)


def text_of(trust, *, terms=POLAR, labels=True) -> str:
    return say("diagnosis#paragraphs", trust=facts_of(trust, terms, labels=labels))


def test_a_wrong_noise_model_is_named_with_how_far_filter_and_smoother_are_apart():
    text = first_words(blamed(SIGMA, TURN, cause=NOISE, objected=5), terms=POLAR)
    assert text == (
        "The violated assumption is **the noise model**: 5 of 9 statistics lie outside the range "
        "of 20 bootstrap replicates (family-wise p 0.048). The filter (ekf) and the smoother are "
        "13.0 m RMS apart (replicates: 0.500 m to 2.40 m). The noise (σ) of the bearings is "
        "stated 5.0 times too large; odometry turns 5.00 % ± 0.10 % less than the robot did."
    )


def test_without_twins_the_difference_is_told_and_how_to_get_p_values():
    text = first_words(said(), terms=POLAR)
    assert text.startswith("The filter (ekf) and the smoother are 13.0 m RMS apart; their difference d has a median")
    assert "of 30.3 (expected 1.46), and P_f − P_s is positive semidefinite in 9 % of the frames" in text
    assert "odometry turns 5.00 % ± 0.10 % less than the robot did (50 standard errors)" in text
    assert "`--twins`" in text
    assert "anges grow" not in text_of(said())  # one standard error is nothing


def test_each_kind_of_finding_has_its_words():
    white = Finding(ESTIMATOR, "innovations", "ekf", 1.1)
    wrong = Finding(ASSOCIATIONS, "decisions", "ekf", 0.034)
    alike = replace(TURN, other=("odometry_theta_time",))
    for f, text in (
        (white, "ekf's NIS is 1.10 times its expected"),
        (wrong, "3.4 % of the decisions of ekf are wrong pairings"),
        (TAILS, "heavy tails"),
        (replace(TAILS, kind="jump", size=1.5, frames=((7, 7),)), "a motion of 1.50 m at frame 7"),
        (replace(TAILS, kind="burst", size=0.6, frames=((7, 9),)), "60 % more way than was driven in frames 7 to 9"),
        (replace(TAILS, kind="change", size=3, frames=((7, 9),)), "3.0 times as large in frames 7 to 9 as elsewhere"),
        (replace(TAILS, kind="mirrored"), "bearings point to the other side"),
        (replace(TAILS, kind="correlation", size=0.9), "are correlated (0.90)"),
        (replace(TAILS, kind="displaced", name="12", size=0.5), "landmark 12 is 0.500 m off its place"),
        (replace(TAILS, kind="landmark", name="12", size=4), "landmark 12 fit 4.0 times as badly"),
        (replace(PAIRINGS, size=1), "observation fits another landmark"),
        (LINEAR, "its covariance is too small"),
        (replace(LINEAR, size=0.5), "its covariance is too large"),
        (alike, "(or, not distinguishable on this log, a drift of the odometry's heading)"),
    ):
        assert text in say("diagnosis#finding", f=explanations([f], POLAR)[0], terms=POLAR)


def test_phases_of_an_estimator_share_the_finding_that_is_furthest_off():
    found = explanations([SIGMA, TAILS, LINEAR, replace(LINEAR, size=1.6), replace(LINEAR, size=1.5)], POLAR)
    assert [(t.kind, t.size) for t in found] == [("sigma", 0.2), ("tails", 38), ("linearization", 1.6)]


def test_what_to_do_names_the_parameters_that_can_be_fitted():
    motion = Finding(NOISE, "sigma", "odometry_x", 2.0)
    bias, late = (Finding(NOISE, "systematic", n, 0.1, 0.01) for n in ("z2_constant", "latency"))
    askew = Finding(NOISE, "systematic", "odometry_y_distance", 0.1, 0.01)
    assert groups_of([bias, SIGMA, motion, TURN]) == ("motion", "sensor", "bias", "odometry")
    todo = advice([TURN, SIGMA, late, askew], labels=True)
    assert todo.steps == (Step.FIT, Step.SHIFT, Step.BY_HAND)
    assert (todo.groups, todo.by_hand) == (("sensor", "odometry"), ("odometry_y_distance",))
    assert advice([SIGMA], labels=False).steps == (Step.CORRECT,)
    assert advice([PAIRINGS, TAILS], labels=True).steps == (Step.REVISE, Step.ROBUST)
    assert advice([Finding(ASSOCIATIONS, "decisions", "ekf", 0.034)], labels=False).steps == (Step.DECIDE_OTHERWISE,)
    assert advice([LINEAR], labels=True).steps == (Step.RELINEARIZE,)
    assert advice([bias], labels=True).steps == (Step.FIT, Step.MOUNT)
    off = advice([replace(LINEAR, name="batch")], labels=True)
    assert (off.steps, off.off) == ((Step.DISTRUST,), ("batch",))


def test_what_runs_already_is_never_advised():
    decisions = Finding(ASSOCIATIONS, "decisions", "ekf", 0.034)
    for labels in (True, False):
        todo = advice([PAIRINGS, decisions], labels=labels, association="jcbb-hindsight")
        assert "jcbb-hindsight" not in say("diagnosis#advice", todo=todo, terms=POLAR)
        assert bool(todo.steps) == labels
    todo = advice([replace(LINEAR, name="ekf-iterated")], labels=True)
    assert "ekf-iterated" not in say("diagnosis#advice", todo=todo, terms=POLAR)


@pytest.mark.parametrize("step", Step)
@pytest.mark.parametrize("labels", [True, False])
def test_every_step_has_a_sentence_and_no_gate_is_advised_without_labels(step, labels):
    todo = replace(advice([TURN, LINEAR], labels=labels), steps=(step,))
    text = say("diagnosis#advice", todo=todo, terms=POLAR)
    assert text.endswith(".")
    assert labels or "--gate-known" not in text


def test_a_calibration_is_told_with_what_it_left():
    after = replace(blamed(TURN, cause=NOISE, objected=1), real=replace(said().real, apart={"ekf": 1.2}))
    done = {"odometry_theta_turn": -0.05, "sigma_z1": 0.5, "sigma_z2": math.nan}
    trust = replace(blamed(TURN, cause=NOISE, objected=5), after=after, done=done)
    facts = facts_of(trust, POLAR)
    assert [(t.kind, t.name, t.size) for t in facts.done] == [
        ("systematic", "odometry_theta_turn", -5.0), ("sigma", "z1", 0.5),
    ]  # fmt: skip
    assert (facts.after.judged["objected"], facts.after.apart[0]["rms"]) == (1, 1.2)
    text = text_of(trust)
    assert (
        "1 of 9 statistics lies outside the range of 20 bootstrap replicates (family-wise p 0.048); before, 5 of 9 did."
    ) in text
    assert "; before, 13.0 m." in text
    assert "Their difference d then has a median" in text
    assert "Cause now: the noise model; first: odometry turns" in text


def test_a_calibration_that_came_to_nothing_says_so_without_a_number():
    failed = notice(Code.NOT_MEASURED, why="singular").about(estimator="batch")
    after = replace(said(notices=[failed]), real=said().real)
    text = text_of(replace(blamed(TURN, cause=NOISE, objected=5), after=after, done={"sigma_z1": 0.5}))
    assert "No diagnosis of the rest is possible." in text
    assert "Batch failed (singular) and is not measured." in text


def test_an_objection_without_a_name_is_admitted():
    assert facts_of(blamed(cause=NOISE, objected=2), POLAR).judged["unexplained"]
    assert "No modelled error explains them" in text_of(blamed(cause=NOISE, objected=2))


def test_why_there_are_no_twins_is_a_sentence():
    none = notice(Code.NO_TWINS, why="no twins of home: it has 3 frames")
    assert text_of(said(notices=[none])).endswith("* No twins of home: it has 3 frames.")


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
        for text in (first_words(t, terms=POLAR), text_of(t, terms=POINTS)):
            assert not re.search(r"\b([Nn]an|NaN|inf|None(?! of))\b", text)
            assert "* \n" not in text

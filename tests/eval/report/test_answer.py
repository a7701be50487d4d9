"""The answer on one log: filter and smoother compared, differences with intervals, the word on innovations."""

import math
from dataclasses import replace

import numpy as np
import pytest

from data.words import number
from eval.judgement.judgement import difference_of
from eval.judgement.runs import RunJudgement, judged_runs
from eval.referee.consistency import innovations_word
from eval.referee.truth_free import Statistic
from eval.report.terminal import Group, lines
from eval.report.words import environment, one_line, paragraph
from eval.report.writing import answer
from eval.studies.diagnosis import Trust
from eval.studies.twins import Sample
from tests.eval.judged import judgement, run_of

FILTER = {
    "log": "arena", "task": "slam", "estimator": "ekf", "association": "known", "phase": "online", "status": "ok",
    "rejected": 0, "rmse_position_m": 0.12, "nees_pose": 4.1, "nis": 1.0, "nis_lower": 0.97, "nis_upper": 1.03,
    "rms_from_batch_m": 0.05, "nees_pose_median": 2.5, "nees_left_out": 0, "nis_expected": 1.0,
}  # fmt: skip
SMOOTHER = FILTER | {"estimator": "batch", "phase": "final", "rmse_position_m": 0.1, "nees_pose": 2.9, "nis": None}


def answered(*rows, trust="") -> str:
    return answer(judgement(*rows), trust)


def test_the_answer_prefers_the_smoother_only_where_it_is_better_and_credits_later_data():
    text = answered(FILTER, SMOOTHER)
    assert "position RMSE of 0.120 m" in text
    assert "has one of 0.100 m: the filter's is 1.20 times the smoother's" in text
    assert "is 4.10 (median 2.50), the smoother's 2.90 (median 2.50); expected are a mean of 3" in text
    assert "so one run is no verdict" in text
    assert "Offline, use the smoother" in text
    assert [line.split(".**")[0] for line in text.splitlines()] == ["* **Accuracy", "* **NEES", "* **NIS"]
    newest = FILTER | {"estimator": "isam2", "rmse_position_m": 0.1201}
    assert "comes from later data" in answered(FILTER, newest, SMOOTHER)
    better = newest | {"rmse_position_m": 0.105}
    assert "isam2 has 0.105 m" in answered(FILTER, better, SMOOTHER)
    assert "comes from later data" not in answered(FILTER, better, SMOOTHER)
    assert "equally accurate here" in answered(FILTER, SMOOTHER | {"rmse_position_m": 0.1199})
    worse = answered(FILTER, SMOOTHER | {"rmse_position_m": 0.2})
    assert "although it used less" in worse
    assert "Offline, use the smoother" not in worse
    newest = FILTER | {"estimator": "isam2", "rmse_position_m": 0.02}  # Seen: 4.75 m beside 0.02 m, without a word.
    text = answered(FILTER | {"rmse_position_m": 4.75}, newest, SMOOTHER | {"rmse_position_m": 0.01})
    assert "the difference is the filter's linearization" in text
    assert "ekf-iterated" in text


def test_what_failed_is_named_instead_of_compared_and_known_association_comes_first():
    text = answered(FILTER | {"status": "diverged", "rmse_position_m": None}, SMOOTHER)
    assert text == "There is no comparison: ekf (diverged) stopped before the end of the log."
    jcbb = {"association": "jcbb", "rmse_position_m": 9.0}
    assert "0.120 m" in answered(FILTER | jcbb, SMOOTHER | jcbb, FILTER, SMOOTHER)
    assert "Wrong pairings that fit each other do not show in it;" in answered(FILTER | jcbb, SMOOTHER | jcbb)
    blank = {"rmse_position_m": None, "nees_pose": None}
    own = "The violated assumption is **the noise model**."
    text = answered(FILTER | blank, SMOOTHER | blank, trust=own)
    unknown = "The log has no ground truth, so the errors of the filter (ekf) and the smoother (batch) are not known."
    assert text == f"{own} {unknown}"
    assert answered(FILTER, SMOOTHER, trust=own).endswith(f"* **Diagnosis.** {own}")
    gone = {"lost_frame": 12, "lost_why": "0 of 35 observations were used"}
    assert answered(FILTER | blank | gone, SMOOTHER | blank, trust=own).startswith("Lost: ")


OUTCOMES = {"log": "arena", "task": "slam", "estimator": "ekf", "association": "nn", "phase": "online"}


def decided(metrics, outcomes, labelled=None) -> str:
    j = judgement(*metrics, outcomes=outcomes)
    return answer(replace(j, methods=j.methods and replace(j.methods, labelled=labelled)))


def counted(association, tp, tn, fp, fn, estimator="ekf", phase="online"):
    counts = {"tp": tp, "tn": tn, "fp": fp, "fn": fn}
    return OUTCOMES | counts | {"association": association, "estimator": estimator, "phase": phase}


def test_the_best_and_the_worst_way_of_deciding_are_named_if_any_pairs_rightly():
    rows = [FILTER | {"association": a} for a in ("known", "nn", "singles", "jcbb")]
    # F1: 2 TP / (2 TP + FP + FN)
    outcomes = [
        counted("known", 90, 10, 0, 0), counted("nn", 60, 10, 20, 10), counted("singles", 30, 10, 0, 60),
        counted("jcbb", 88, 10, 0, 2),
    ]  # fmt: skip
    text = decided([*rows, SMOOTHER], outcomes)
    assert text.endswith(
        "Without labels, jcbb (ekf: 0 FP and 2 FN in 100 decisions, F1 0.99) has the highest F1 (path 0.120 m) and"
        " singles (ekf: 0 FP and 60 FN in 100 decisions, F1 0.50) the lowest."
    )
    assert decided([FILTER, SMOOTHER], outcomes[:1]) == answered(FILTER, SMOOTHER)
    rows = [FILTER | {"association": a} for a in ("nn", "singles")]
    assert "method made a correct pairing" in decided(
        rows, [counted("nn", 0, 9, 80, 2), counted("singles", 0, 90, 0, 1)]
    )
    text = decided(rows, [counted("nn", 5, 5, 80, 10), counted("singles", 0, 60, 1, 39)])
    assert "nn (ekf: 80 FP and 10 FN in 100 decisions, F1 0.10) has the highest F1" in text
    assert text.endswith("even the highest is mostly wrong.")
    blank = {"rmse_position_m": None, "nees_pose": None}
    own = FILTER | blank | {"estimator": "isam2", "association": "jcbb", "phase": "final", "landmarks": 120}
    outcomes = [counted("jcbb", 700, 50, 200, 50, "isam2", p) for p in ("online", "final")]
    text = decided([FILTER | blank, SMOOTHER | blank, own], outcomes, 100)
    assert text.endswith(
        "Without labels, isam2 with jcbb agrees with the log's labels in 750 of 1000 decisions (75 %); its map has 120"
        " landmarks, the labels name 100."
    )


def test_the_best_by_its_decisions_is_no_good_with_a_path_worse_than_dead_reckoning():
    """Seen: best by F1 with 16.9 m where dead reckoning has 9.2 m."""
    reckoned = FILTER | {"estimator": "dead-reckoning", "association": "none", "rmse_position_m": 9.2}
    rows = [
        FILTER | {"association": "jcbb", "rmse_position_m": 16.9},
        FILTER | {"association": "nn", "rmse_position_m": 12},
    ]
    outcomes = [counted("jcbb", 88, 10, 0, 2), counted("nn", 60, 10, 20, 10)]
    text = decided([reckoned, *rows], outcomes)
    assert "association method gives a usable path" in text
    assert "(path 16.9 m where dead reckoning has 9.20 m)" in text
    assert "has the highest F1" not in text
    rows[1] |= {"rmse_position_m": 3.0}  # one of them is usable: it is the best, whatever the other's F1
    text = decided([reckoned, *rows], outcomes)
    best = "Without labels, nn (ekf: 20 FP and 10 FN in 100 decisions, F1 0.80) has the highest F1"
    assert f"{best} of those with a usable path (path 3.00 m" in text
    rows[0] |= {"rmse_position_m": 5.0}  # both are: the one with the better path is named, too
    text = decided([reckoned, *rows], outcomes)
    assert "jcbb (ekf: 0 FP and 2 FN in 100 decisions, F1 0.99) has the highest F1 (path 5.00 m" in text
    assert "; nn (ekf: 20 FP and 10 FN in 100 decisions, F1 0.80) has the more accurate path" in text


def test_who_is_lost_is_said_first_and_by_its_linearization_where_the_smoother_fits():
    gone = {"lost_frame": 12, "lost_why": "0 of 35 observations were used in frames 12 to 21"}
    text = answered(FILTER | gone, SMOOTHER)
    assert text.startswith("Lost: the filter (ekf) has lost its pose from frame 12 on (0 of 35 observations were")
    assert "Do not use its path from there on" in text
    assert "Do not use either path" in answered(FILTER | gone, SMOOTHER | gone)
    assert "Offline, use the smoother" not in text
    assert "as large as claimed" not in text
    blank = {"rmse_position_m": None, "nees_pose": None}
    assert answered(FILTER | gone | blank, SMOOTHER | blank).startswith("Lost: the filter")
    gone = {"lost_frame": 37, "lost_why": "3 innovations in a row are more than 10 sigma large at frame 37"}
    fits, torn = SMOOTHER | {"nis": 1.0}, SMOOTHER | {"nis": 2.8}
    text = answered(FILTER | gone, fits)
    assert "reason is the filter's linearization" in text
    assert "ekf-iterated" in text
    assert "on. Check the frame of map and prior" in answered(FILTER | gone, torn)
    assert "reason is the filter's linearization" in answered(FILTER | gone | {"nis": 2000.0}, torn)


ROW = {
    "log": "arena", "task": "slam", "association": "known", "a": "ekf", "b": "batch", "phase_a": "online",
    "phase_b": "final", "rmse_position_m": 0.02, "rmse_position_lower": 0.0031, "rmse_position_upper": 0.0412,
    "rmse_position_p": 0.013, "nees_pose": -0.4, "nees_pose_lower": -0.9, "nees_pose_upper": 0.12, "nees_pose_p": 0.12,
    "block_frames": 14.2, "rmse_position_why": None, "nees_pose_why": None,
}  # fmt: skip
SILENT = dict.fromkeys(c for c in ROW if c.endswith(("_lower", "_upper", "_p"))) | {
    "rmse_position_why": "40 frames are too few", "nees_pose_why": "40 frames are too few",
}  # fmt: skip


def difference(**changed):
    return difference_of([ROW | changed], run_of(FILTER), run_of(SMOOTHER))


def sentence(**changed) -> str:
    return paragraph("comparison#difference", d=difference(**changed))


def test_the_sentence_says_by_how_much_with_interval_p_and_what_it_rests_on():
    assert sentence() == (
        "The smoother's aligned RMSE is lower by 0.0200 m, 95 % interval 0.0031 to 0.0412 m, p = 0.013. "
        "This holds for one log, with errors correlated over about 14 frames and one map."
    )
    assert sentence(task="localization").endswith("correlated over about 14 frames.")
    text = sentence(rmse_position_m=-0.02, rmse_position_lower=-0.0412, rmse_position_upper=0.0031, rmse_position_p=0.2)
    assert "is higher by 0.0200 m, 95 % interval −0.0031 to 0.0412 m, p = 0.200," in text
    assert text.endswith("frames and one map.")
    assert not difference().chance
    assert difference(rmse_position_p=0.06).chance
    assert difference(rmse_position_lower=-0.001).chance
    text = sentence(**SILENT)
    assert text == "This log is too short to test whether the difference is chance: 40 frames are too few."
    assert difference(b="isam2") is difference(association="jcbb") is None
    assert difference_of([], run_of(FILTER), run_of(SMOOTHER)) is None


BATCH = SMOOTHER | {"nis": 1.0}
CORRELATED = {"innovation_lag1": 0.72, "innovation_lag1_se": 0.06}


@pytest.mark.parametrize(("changed", "word"), [
    ({}, "innovations fit"), ({"nees_pose": 46.0}, "overconfident"), ({"nees_pose": 46.0, "nis": 0.1}, "overconfident"),
    ({"nees_pose": 6.5, "nees_pose_lower": 4.2, "nis": 0.1}, "overconfident"),
    ({"nees_pose": 8.4, **CORRELATED}, "correlated"), ({"nees_pose": 8.4, "nis": 0.1, **CORRELATED}, "correlated"),
    ({"nis": 1.9}, "NIS too large"), ({"nis": None}, ""), ({"status": "diverged", "nees_pose": 46.0}, "diverged"),
])  # fmt: skip
def test_nees_speaks_before_correlation_and_this_before_nis(changed, word):
    assert run_of(FILTER | changed).verdict == word


def test_a_smoother_has_the_correlated_innovations_of_its_filter():
    """Seen: batch with NEES 8.4 "conservative", after a fit "consistent", lag-1 +0.72 ± 0.06 beside it."""
    rows = judged_runs([FILTER | CORRELATED, BATCH, BATCH | {"association": "jcbb"}])
    assert [r.verdict for r in rows] == ["correlated", "correlated", "innovations fit"]
    lost = FILTER | CORRELATED | {"lost_why": "0 used", "lost_frame": 3}
    assert judged_runs([lost, BATCH])[1].verdict == "innovations fit", "the filter's fault"


def replicates(nis, lag1=0.0) -> Trust:
    rng = np.random.default_rng(0)
    drawn = [
        Sample({
            ("ekf", "nis"): Statistic(nis + 0.03 * rng.standard_normal()),
            ("batch", "nis"): Statistic(nis - 0.1 + 0.03 * rng.standard_normal()),
            ("ekf", "innovation_lag1"): Statistic(lag1 + 0.02 * rng.standard_normal()),
        })
        for _ in range(60)
    ]  # fmt: skip
    return Trust("arena", "slam", "known", Sample({}), tuple(drawn), ())


def test_replicates_decide_where_there_are_some_and_correlation_they_have_too_is_the_geometrys():
    # On strongly nonlinear logs NIS of a right filter is above 1: 7 of 84 sound logs were rejected by chi-square.
    rows = [FILTER | {"nis": 1.2}, BATCH | {"nis": 1.2}]
    assert [r.verdict for r in judged_runs(rows)] == ["NIS too large"] * 2
    filtered, smoothed = judged_runs(rows, diagnoses=[replicates(1.2)])
    assert (filtered.verdict, smoothed.verdict) == ("innovations fit", "NIS too large")
    assert (filtered.twins, filtered.nis_expected) == (60, pytest.approx(1.2, abs=0.02))
    assert judged_runs(rows, diagnoses=[replicates(1.4)])[0].verdict == "NIS too small"
    assert judged_runs([rows[0] | {"association": "jcbb"}], diagnoses=[replicates(1.2)])[0].verdict == "NIS too large"
    rows = [FILTER | CORRELATED]
    assert judged_runs(rows, diagnoses=[replicates(1.0, lag1=0.7)])[0].verdict == "innovations fit"
    assert judged_runs(rows, diagnoses=[replicates(1.0, lag1=0.2)])[0].verdict == "correlated"


def test_the_answer_says_what_the_bounds_are_of_and_correlation_first():
    def said(rows, *trust):
        return answer(judgement(*rows, trust=next(iter(trust), None)))

    assert "assume independent innovations and nearly linear models" in said([FILTER, SMOOTHER])
    twins = said([FILTER, SMOOTHER], replicates(1.0))
    assert "of 60 bootstrap replicates): innovations fit" in twins
    assert "assume" not in twins
    text = said([FILTER | CORRELATED | {"nis": 0.1}, SMOOTHER])
    assert text.index("correlated: lag-1 +0.72 ± 0.06") < text.index("NIS per dof is")
    assert "is not to be believed" in text
    assert "noise model, which is too large" not in text
    assert "Overconfident: ekf." in said([FILTER | {"nees_pose": 46.0}, SMOOTHER])


def row(name: str, nis: float, word: str, expected: float) -> RunJudgement:
    return RunJudgement(name, "jcbb", "online", word, nis=nis, nis_expected=expected)


def shown(*rows: RunJudgement) -> str:
    return "\n".join(lines([Group("park", "slam", rows, 0)]))


def test_the_terminal_prints_the_nis_that_is_expected_behind_the_gate():
    """Seen: NIS 0.764 "overconfident" under 0.886 "conservative", "expected 1"."""
    differing = shown(row("ekf", 0.764, "NIS too large", 0.712), row("batch", 0.886, "NIS too small", 0.9535))
    assert "0.764 (0.71)  NIS too large" in differing
    assert "0.886 (0.95)  NIS too small" in differing
    assert "(NIS: of innovations, expected in brackets)" in differing
    assert "innovations, expected 0.954)" in shown(*[row("ekf", 0.764, "NIS too small", 0.9535)] * 2)
    assert "innovations, expected 1)" in shown(row("ekf", 1.0, "innovations fit", 1.0))


def innovations(**changed) -> str:
    row = run_of(FILTER | {"nis_lower": 0.97, "nis_upper": 1.03} | changed)
    return one_line(environment().get_template("answer.md.j2").make_module(EMPTY).innovations(row))


EMPTY = {
    "association": "known", "several": False, "outcome": "none ran", "filtered": None, "smoothed": None,
    "trust": "", "methods": None, "linearized": False, "verdict": "nothing ran", "assumed": (),
}  # fmt: skip


@pytest.mark.parametrize(("value", "text"), [
    (0.09912, "0.0991"), (3.0, "3.00"), (12.345, "12.3"), (1234.5, "1234"), (2e7, "2.00e+07"), (0.0, "0"),
    (-0.5, "-0.500"), (99.96, "100"), (9.996, "10.0"), (-0.09996, "-0.100"),
])  # fmt: skip
def test_numbers_have_three_significant_digits(value, text):
    assert number(value) == text


@pytest.mark.parametrize(("nis", "word"), [(1.9, "NIS too large"), (0.1, "NIS too small"), (1.0, "innovations fit")])
def test_nis_is_judged_by_its_bounds(nis, word):
    assert innovations_word(nis, 0.97, 1.03) == word
    assert run_of(FILTER | {"nis": nis}).nis_verdict == word
    assert f"bounds 0.97–1.03): {word}. The bounds assume independent" in innovations(nis=nis)


def test_gates_and_whatever_else_weakens_the_nis_test_are_said():
    text = innovations(nis=0.95, nis_lower=0.91, nis_upper=0.99, nis_expected=0.9535)
    assert "NIS per dof is 0.950 (expected 0.954 behind the gates, 95 % bounds 0.91–0.99)" in text
    text = innovations(rejected=28, association="jcbb")
    assert "28 observations were left out" in text
    assert "Wrong pairings that fit each other do not show in it;" in text
    assert innovations(nis=math.nan) == ""

"""The answer on one log compares filter and smoother, and says which to trust, as far as the numbers go."""

from __future__ import annotations

from dataclasses import replace

from eval.report.log_sections import answer
from tests.eval.judged import judgement

FILTER = {
    "log": "arena", "task": "slam", "estimator": "ekf", "association": "known", "phase": "online", "status": "ok",
    "rejected": 0, "rmse_position_m": 0.12, "nees_pose": 4.1, "nis": 1.0, "nis_lower": 0.97, "nis_upper": 1.03,
    "rms_from_batch_m": 0.05, "nees_pose_median": 2.5, "nees_left_out": 0, "nis_expected": 1.0,
}  # fmt: skip
SMOOTHER = FILTER | {"estimator": "batch", "phase": "final", "rmse_position_m": 0.1, "nees_pose": 2.9, "nis": None}


def answered(*rows, trust="") -> str:
    return answer(judgement(*rows), trust)


def test_the_answer_compares_filter_and_smoother_in_at_most_five_sentences():
    text = answered(FILTER, SMOOTHER)
    assert "position RMSE of 0.120 m" in text
    assert "has one of 0.100 m: the filter's is 1.20 times the smoother's" in text
    assert "is 4.10 (median 2.50), the smoother's 2.90 (median 2.50); expected are a mean of 3" in text
    assert "so one run is no verdict" in text
    assert "Offline, use the smoother" in text
    assert [line.split(".**")[0] for line in text.splitlines()] == ["* **Accuracy", "* **NEES", "* **NIS"]


def test_the_answer_credits_later_data_only_if_the_online_smoother_equals_the_filter():
    newest = FILTER | {"estimator": "isam2", "rmse_position_m": 0.1201}
    assert "comes from later data" in answered(FILTER, newest, SMOOTHER)
    better = newest | {"rmse_position_m": 0.105}
    assert "isam2 has 0.105 m" in answered(FILTER, better, SMOOTHER)
    assert "comes from later data" not in answered(FILTER, better, SMOOTHER)


def test_the_answer_does_not_prefer_the_smoother_where_it_is_no_better():
    assert "equally accurate here" in answered(FILTER, SMOOTHER | {"rmse_position_m": 0.1199})
    worse = answered(FILTER, SMOOTHER | {"rmse_position_m": 0.2})
    assert "although it used less" in worse
    assert "Offline, use the smoother" not in worse


def test_what_a_log_without_truth_says_of_itself_comes_first_and_replaces_what_innovations_say():
    blank = {"rmse_position_m": None, "nees_pose": None}
    own = "The violated assumption is **the noise model**."
    text = answered(FILTER | blank, SMOOTHER | blank, trust=own)
    unknown = "The log has no ground truth, so the errors of the filter (ekf) and the smoother (batch) are not known."
    assert text == f"{own} {unknown}"
    assert answered(FILTER, SMOOTHER, trust=own).endswith(f"* **Diagnosis.** {own}")
    gone = {"lost_frame": 12, "lost_why": "0 of 35 observations were used"}
    assert answered(FILTER | blank | gone, SMOOTHER | blank, trust=own).startswith("Lost: ")


def test_a_failure_is_named_instead_of_compared():
    text = answered(FILTER | {"status": "diverged", "rmse_position_m": None}, SMOOTHER)
    assert text == "There is no comparison: ekf (diverged) stopped before the end of the log."


def test_known_association_is_compared_first_and_wrong_pairings_of_other_methods_are_said_not_to_show():
    jcbb = {"association": "jcbb", "rmse_position_m": 9.0}
    assert "0.120 m" in answered(FILTER | jcbb, SMOOTHER | jcbb, FILTER, SMOOTHER)
    assert "Wrong pairings that fit each other do not show in it;" in answered(FILTER | jcbb, SMOOTHER | jcbb)


OUTCOMES = {"log": "arena", "task": "slam", "estimator": "ekf", "association": "nn", "phase": "online"}


def decided(metrics, outcomes, labelled=None) -> str:
    j = judgement(*metrics, outcomes=outcomes)
    return answer(replace(j, methods=j.methods and replace(j.methods, labelled=labelled)))


def counted(association, tp, tn, fp, fn, estimator="ekf", phase="online"):
    counts = {"tp": tp, "tn": tn, "fp": fp, "fn": fn}
    return OUTCOMES | counts | {"association": association, "estimator": estimator, "phase": phase}


def test_the_answer_names_the_best_and_the_worst_way_of_deciding():
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
    # one of them is usable: it is the best, whatever the other's F1
    rows[1] |= {"rmse_position_m": 3.0}
    text = decided([reckoned, *rows], outcomes)
    best = "Without labels, nn (ekf: 20 FP and 10 FN in 100 decisions, F1 0.80) has the highest F1"
    assert f"{best} of those with a usable path (path 3.00 m" in text
    # both are: the one with the better path is named, too
    rows[0] |= {"rmse_position_m": 5.0}
    text = decided([reckoned, *rows], outcomes)
    assert "jcbb (ekf: 0 FP and 2 FN in 100 decisions, F1 0.99) has the highest F1 (path 5.00 m" in text
    assert "; nn (ekf: 20 FP and 10 FN in 100 decisions, F1 0.80) has the more accurate path" in text


def test_who_is_lost_is_said_first_and_nobody_is_trusted():
    gone = {"lost_frame": 12, "lost_why": "0 of 35 observations were used in frames 12 to 21"}
    text = answered(FILTER | gone, SMOOTHER)
    assert text.startswith("Lost: the filter (ekf) has lost its pose from frame 12 on (0 of 35 observations were")
    assert "Do not use its path from there on" in text
    assert "Do not use either path" in answered(FILTER | gone, SMOOTHER | gone)
    assert "Offline, use the smoother" not in text
    assert "as large as claimed" not in text
    blank = {"rmse_position_m": None, "nees_pose": None}
    assert answered(FILTER | gone | blank, SMOOTHER | blank).startswith("Lost: the filter")


def test_a_filter_far_behind_a_smoother_with_the_same_data_is_told_why():
    """Seen: 4.75 m beside 0.02 m, without a word."""
    newest = FILTER | {"estimator": "isam2", "rmse_position_m": 0.02}
    text = answered(FILTER | {"rmse_position_m": 4.75}, newest, SMOOTHER | {"rmse_position_m": 0.01})
    assert "the difference is the filter's linearization" in text
    assert "ekf-iterated" in text


def test_a_filter_that_is_lost_where_the_smoother_fits_is_lost_by_its_linearization():
    gone = {"lost_frame": 37, "lost_why": "3 innovations in a row are more than 10 sigma large at frame 37"}
    fits, torn = SMOOTHER | {"nis": 1.0}, SMOOTHER | {"nis": 2.8}
    text = answered(FILTER | gone, fits)
    assert "reason is the filter's linearization" in text
    assert "ekf-iterated" in text
    assert "on. Check the frame of map and prior" in answered(FILTER | gone, torn)
    assert "reason is the filter's linearization" in answered(FILTER | gone | {"nis": 2000.0}, torn)


def test_frames_of_nearly_singular_covariance_are_counted_beside_the_mean():
    text = answered(FILTER | {"nees_left_out": 1}, SMOOTHER)
    assert "4.10 (median 2.50, 1 frame of nearly singular covariance left out), the smoother" in text


def test_pairing_nothing_is_not_the_best_and_a_poor_best_is_called_poor():
    rows = [FILTER | {"association": a} for a in ("nn", "singles")]
    assert "method made a correct pairing" in decided(
        rows, [counted("nn", 0, 9, 80, 2), counted("singles", 0, 90, 0, 1)]
    )
    text = decided(rows, [counted("nn", 5, 5, 80, 10), counted("singles", 0, 60, 1, 39)])
    assert "nn (ekf: 80 FP and 10 FN in 100 decisions, F1 0.10) has the highest F1" in text
    assert text.endswith("even the highest is mostly wrong.")


def test_decisions_of_a_run_that_failed_or_was_taken_over_do_not_count():
    rows = [FILTER | {"association": "nn"}, FILTER | {"association": "jcbb", "status": "diverged"}]
    text = decided(rows, [counted("nn", 50, 10, 20, 20), counted("jcbb", 90, 10, 0, 0)])
    assert "jcbb" not in text.split("Without labels")[1]
    rows = [FILTER | {"association": "jcbb"}, SMOOTHER | {"association": "jcbb"}]
    same = [counted("jcbb", 90, 10, 0, 0, "batch", "final"), counted("jcbb", 90, 10, 0, 0)]
    assert "Without labels: jcbb (ekf: 0 FP" in decided(rows, same)


def test_without_a_true_path_decisions_are_counted_against_the_labels():
    blank = {"rmse_position_m": None, "nees_pose": None}
    own = FILTER | blank | {"estimator": "isam2", "association": "jcbb", "phase": "final", "landmarks": 120}
    outcomes = [counted("jcbb", 700, 50, 200, 50, "isam2", p) for p in ("online", "final")]
    text = decided([FILTER | blank, SMOOTHER | blank, own], outcomes, 100)
    assert text.endswith(
        "Without labels, isam2 with jcbb agrees with the log's labels in 750 of 1000 decisions (75 %); its map has 120"
        " landmarks, the labels name 100."
    )


def test_an_implausible_run_is_in_no_comparison_and_no_headline():
    doubtful = {"status": "implausible"}
    text = answered(FILTER, SMOOTHER | doubtful)
    assert text.startswith("There is no comparison: batch is implausible")
    assert "ekf and batch are implausible" in answered(FILTER | doubtful, SMOOTHER | doubtful)
    gone = doubtful | {"lost_frame": 12, "lost_why": "3 innovations"}
    lost = answered(FILTER, SMOOTHER | gone)
    assert ("Lost: the smoother (batch) has lost its pose from frame 12 on (3 innovations). Do not use its") in lost
    for said in (text, lost):
        assert "RMSE" not in said
        assert "0.1" not in said
    # another smoother takes its place, and its online path credits nobody
    robust = SMOOTHER | {"estimator": "batch-huber"}
    newest = FILTER | {"estimator": "isam2", "rmse_position_m": 0.1201} | doubtful
    text = answered(FILTER, newest, SMOOTHER | doubtful, robust)
    assert "The smoother (batch-huber, every pose" in text
    assert "isam2" not in text

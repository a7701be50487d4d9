"""The lab's questions are answered with the numbers of the runs, and turn round where the numbers do."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from data.worlds.corridor import Corridor, simulate
from eval.plan.lab import switched_on
from eval.referee.score import Trial, score
from eval.report.labs.corridor_facts import find_lab, furthest_from_start, look, run_of, true_against_stated
from eval.report.labs.corridor_questions import lab_sections
from tests.eval.handmade import circle_log, run_with_error
from tests.eval.handmade_lab import DISCARD, FOOLED, NEW, lab_log, lab_run

QUIET, BUSY, BLIND = lab_log(), lab_log(people=True), lab_log(odometry=False)
# the same mistakes in the log without people: rows 5 (point 2 taken for 1) and 6 (point 1 initialized twice)
CONFUSED = {5: 0, 6: NEW}
NN, MISSING = "Why does NN fail?", "Not answered"
PEOPLE = "Why do people break NN and SINGLES?"
JCBB = "Why does JCBB cope better?"
NO_ODOMETRY = "What happens without odometry?"
UPKEEP = "What does map maintenance change?"


def trial(log, *runs, **more) -> Trial:
    return Trial(log, "slam", runs, **more)


def answers(*trials) -> dict[str, str]:
    return {s.heading: s.blocks[0] for s in lab_sections(trials, score(trials))}


def test_a_run_is_looked_at_as_counted_by_hand():
    p = look(lab_run(BUSY, "nn", error=0.3, changes=FOOLED), BUSY)
    assert (p.counts.fp, p.counts.fn) == (5, 1)
    assert (p.neighbour, p.copy, p.ghost) == (1, 1, 1)
    assert (p.clutter, p.clutter_paired, p.clutter_initializing, p.clutter_again) == (3, 2, 1, 1)
    assert look(lab_run(BUSY, "nn"), BUSY).clutter_initializing == 0, "who is discarded initializes nothing"
    assert p.first_wrong == 2
    # frames 0 and 1 are off by 0 and 0.3 m
    assert p.before == pytest.approx(0.3 / math.sqrt(2.0))
    assert p.after == pytest.approx(0.3)
    assert p.apart == pytest.approx(0.5)
    assert p.off == pytest.approx(0.3), "placed from the pose predicted for the frame, off as the one before it"


def test_a_run_without_a_wrong_pairing_has_no_first_one():
    p = look(lab_run(QUIET, "nn", error=0.3), QUIET)
    assert p.first_wrong is None
    assert p.before == pytest.approx(0.3 * math.sqrt(0.8))
    assert math.isnan(p.after)
    assert math.isnan(p.apart)


def test_true_motions_are_measured_by_the_covariance_stated():
    blind = true_against_stated(simulate(Corridor(odometry=False), 0))
    # 1 m where sigma is 0.25 m, 90 deg where it is 5 deg
    assert (blind.moves, blind.turns) == (pytest.approx(4.0), pytest.approx(18.0))
    assert (blind.step_off, blind.step_sigma) == (pytest.approx(1.0), pytest.approx(0.25))
    assert (blind.within, blind.count) == (0, 43)
    read = true_against_stated(simulate(Corridor(), 0))
    assert read.within >= 41
    assert 1.0 < read.moves < 2.2  # a chi variable with three degrees of freedom has mean 1.6


def test_switches_are_read_from_the_data_and_seeds_are_not_mixed():
    assert [switched_on(log) for log in (QUIET, BUSY, BLIND)] == [(False, True), (True, True), (False, False)]
    kept = replace(BUSY, name=f"{BUSY.name}:maintain")
    tidied = lab_run(kept, "jcbb", removed={2: 4}, changes={4: NEW})
    other = trial(lab_log(people=True, seed=7))
    trials = [other, trial(QUIET), trial(BUSY), trial(kept, tidied, beside=BUSY.name), trial(circle_log())]
    lab = find_lab(trials)
    assert {k: t.log.name for k, t in lab.trials.items()} == {(False, True): "corridor:0", (True, True): BUSY.name}
    assert {k: t.log.name for k, t in lab.maintained.items()} == {(True, True): kept.name}
    assert find_lab([trial(circle_log())]) is None


def test_the_filter_answers_where_it_got_to_the_end_and_otherwise_the_smoother():
    both = trial(QUIET, lab_run(QUIET, "nn", estimator="isam2"), lab_run(QUIET, "nn"))
    assert run_of(both, "nn").estimator == "ekf"
    assert run_of(trial(QUIET, both.runs[0]), "nn").estimator == "isam2"
    assert run_of(both, "jcbb") is None


def test_why_nn_fails_is_told_with_counts_places_and_errors():
    text = answers(trial(QUIET, lab_run(QUIET, "known"), lab_run(QUIET, "nn", error=0.3, changes=CONFUSED)))[NN]
    assert "pairs 1 of 10 observations wrongly: 1 with the landmark of another point" in text
    assert "0.50 m apart (median)" in text
    assert "0.30 m off their own point: more than half that spacing" in text
    assert "first wrong pairing is in frame 2; the position error is 0.212 m RMS before and 0.300 m" in text
    assert "initializes 1 landmark on points that were in the map already" in text
    assert "ends with 3 landmarks where known association has 2" in text
    assert "0.268 m against 0.00894 m with known association, 30 times as large" in text


def test_nn_that_does_not_fail_is_not_said_to():
    known = lab_run(QUIET, "known")
    assert "does not fail: none of its 8 pairings" in answers(trial(QUIET, known, lab_run(QUIET, "nn")))[NN]
    slight = answers(trial(QUIET, known, lab_run(QUIET, "nn", changes=CONFUSED)))[NN]
    assert "cost little" in slight
    assert "the error of the pose alone does not explain them" in slight


def test_people_break_what_they_break():
    quiet = trial(QUIET, lab_run(QUIET, "nn"), lab_run(QUIET, "singles"))
    busy = [lab_run(BUSY, "nn", error=0.3, changes=FOOLED), lab_run(BUSY, "singles", changes={2: DISCARD})]
    text = answers(quiet, trial(BUSY, *busy))[PEOPLE]
    assert "3 of 13 observations show people" in text
    assert "**NN** pairs 2 of them, 1 with a landmark initialized on a person and 1 with one of a point" in text
    assert "FP go from 0 to 5" in text
    assert "rises from 0.00894 to 0.268 m" in text
    assert "**SINGLES** pairs 0 of them" in text
    assert "leaves 1 observations of points unpaired that were in the map (0 without people)" in text
    assert "People break NN here." in text
    calm = answers(quiet, trial(BUSY, lab_run(BUSY, "nn"), lab_run(BUSY, "singles")))[PEOPLE]
    assert "do not break them" in calm
    assert "People break" not in calm


def test_a_method_that_was_run_on_one_log_only_is_named():
    text = answers(trial(QUIET, lab_run(QUIET, "nn")), trial(BUSY, lab_run(BUSY, "nn")))[PEOPLE]
    assert text.endswith("SINGLES was not run on both logs.")


def test_jcbb_copes_better_only_where_it_does():
    good, bad = lab_run(BUSY, "jcbb", error=0.02), lab_run(BUSY, "nn", error=0.3, changes=FOOLED)
    text = answers(trial(BUSY, good, bad, lab_run(BUSY, "known")))[JCBB]
    assert "JCBB 0 / 0 / 0.0179 m; NN 5 / 1 / 0.268 m; known association 0 / 0 / 0.00894 m" in text
    assert "accepts only those that agree" in text
    assert "still worse than with known association (2.0 times the RMSE)" in text
    swapped = [replace(good, association="nn"), replace(bad, association="jcbb")]
    text = answers(trial(BUSY, *swapped))[JCBB]
    assert "does not cope better than NN here (6 wrong decisions against 0" in text
    assert "agree on it" not in text


def test_without_odometry_errors_and_reason_are_told():
    known = lab_run(BLIND, "known", error=0.5)
    jcbb = lab_run(BLIND, "jcbb", error=2.0, changes=dict.fromkeys(range(2, 10), 1))
    smoother = lab_run(BLIND, "known", estimator="batch")
    text = answers(trial(BLIND, known, jcbb, smoother))[NO_ODOMETRY]
    assert (
        "Of 4 motions 4 are inside the 99 % ellipsoid of what is stated, so the statement is not unreasonable" in text
    )
    assert "With JCBB ekf has a position RMSE of 1.79 m, is up to 2.00 m off and 2.00 m at the end" in text
    assert "batch smoother has 0.00894 m: the readings would suffice" in text
    assert "JCBB makes 4 wrong pairings and 4 right ones" not in text
    assert "still gets 4 pairings right and 4 wrong" in text
    far = replace(BLIND, truth=replace(BLIND.truth, pose=np.outer(np.arange(5.0), [1.0, 0.0, 0.0])))
    text = answers(trial(far, known))[NO_ODOMETRY]
    assert "on average 10 σ from that (moves): a step of 1.00 m where σ is 0.10 m" in text
    assert "Of 4 motions 0 are inside" in text
    assert "JCBB was not run" in text


def test_map_maintenance_is_told_by_size_entries_and_counts():
    kept = replace(BUSY, name=f"{BUSY.name}:maintain")
    plain = lab_run(BUSY, "jcbb", changes={4: NEW, 7: 2})
    tidy = lab_run(kept, "jcbb", changes={4: NEW}, removed={2: 3})
    text = answers(trial(BUSY, plain), trial(kept, tidy, beside=BUSY.name))[UPKEEP]
    assert "the map ends with 2 landmarks with maintenance and 3 without" in text
    assert "removed 1 landmark that had been seen only once, 1 of them initialized on people and 0 on points" in text
    # lengths 7, 9, 9, 9, 9 and with maintenance 7, 9, 9, 9, 7
    assert f"handles {100 * (2 * 49 + 3 * 81) / (49 + 4 * 81):.0f} % of the entries" in text
    assert "FP are 0 instead of 1" in text
    assert "fewer pairings are wrong" in text
    same = lab_run(kept, "jcbb", changes={4: NEW, 7: 2}, removed={})
    text = answers(trial(BUSY, plain), trial(kept, same, beside=BUSY.name))[UPKEEP]
    assert "It removed nothing." in text
    assert "made the map no smaller" in text


def test_a_question_without_its_runs_says_what_is_missing_and_the_others_are_answered():
    texts = answers(trial(QUIET, lab_run(QUIET, "known"), lab_run(QUIET, "nn")))
    assert not texts[NN].startswith(MISSING)
    assert texts[UPKEEP] == (
        "Not answered: this needs a corridor with people, with odometry, run with JCBB and once more with map"
        " maintenance; no such log was run."
    )
    assert texts[NO_ODOMETRY].startswith("Not answered: this needs a corridor without people, without odometry")
    assert texts["The lab's questions"].startswith("Answered from the runs on `corridor:0`")


def test_there_is_no_section_where_nothing_can_be_answered():
    assert answers(trial(QUIET, lab_run(QUIET, "known"))) == {}
    assert answers(trial(circle_log(), run_with_error(np.zeros(3)))) == {}


def test_seconds_change_nothing_in_the_text():
    def answered(seconds):
        runs = [lab_run(QUIET, m, seconds=seconds) for m in ("known", "nn", "jcbb", "singles")]
        busy = [lab_run(BUSY, m, seconds=seconds) for m in ("known", "nn", "jcbb", "singles")]
        blind = [lab_run(BLIND, m, seconds=seconds) for m in ("known", "jcbb")]
        kept = replace(BUSY, name=f"{BUSY.name}:maintain")
        tidy = lab_run(kept, "jcbb", changes={4: NEW}, removed={2: 3}, seconds=seconds)
        beside = trial(kept, tidy, beside=BUSY.name)
        return answers(trial(QUIET, *runs), trial(BUSY, *busy), trial(BLIND, *blind), beside)

    assert not any(text.startswith(MISSING) for text in answered(1.0).values())
    assert answered(1.0) == answered(3.7)


def test_the_distance_from_the_start_is_the_largest_on_the_way():
    path = np.array([[1.0, 0.0, 0.0], [4.0, 4.0, 0.0], [1.0, 1.0, 0.0]])
    assert furthest_from_start(path) == pytest.approx(5.0)

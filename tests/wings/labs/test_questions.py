"""The lab's questions are answered with the numbers of the runs, and turn round where the numbers do."""

import math
from dataclasses import replace

import numpy as np
import pytest

from eval.referee.score import Trial, score
from eval.report.words import paragraph
from tests.eval.handmade import circle_log
from tests.eval.handmade_lab import DISCARD, FOOLED, NEW, lab_log, lab_run
from wings.labs.corridor import ODOMETRY, find_lab, look
from wings.labs.plan import switched_on
from wings.labs.sections import QUESTIONS, TEMPLATE, Answers, answers

QUIET, BUSY, BLIND = lab_log(), lab_log(people=True), lab_log(odometry=False)
# the same mistakes in the log without people: rows 5 (point 2 taken for 1) and 6 (point 1 initialized twice)
CONFUSED = {5: 0, 6: NEW}
NN, PEOPLE, JCBB, NO_ODOMETRY, UPKEEP = "nn", "people", "jcbb", "blind", "maintenance"
RMS = math.sqrt(0.8)
"""Of an error of 1 m in four of five frames."""


def trial(log, *runs, **more) -> Trial:
    return Trial(log, "slam", runs, **more)


def words(*trials) -> dict[str, str]:
    of = facts(*trials).of
    return {name: paragraph(f"{TEMPLATE}#{name}", q=q) for name, q in of.items() if not q["lack"]}


def facts(*trials) -> Answers:
    return answers(find_lab(trials), score(trials))


def test_a_run_is_looked_at_as_counted_by_hand():
    p = look(lab_run(BUSY, "nn", error=0.3, changes=FOOLED), BUSY)
    assert (p.fp, p.fn) == (5, 1)
    assert (p.neighbour, p.copy, p.ghost) == (1, 1, 1)
    assert (p.clutter, p.clutter_paired, p.clutter_initializing, p.clutter_again) == (3, 2, 1, 1)
    assert look(lab_run(BUSY, "nn"), BUSY).clutter_initializing == 0, "who is discarded initializes nothing"
    assert p.first_wrong == 2
    assert p.before == pytest.approx(0.3 / math.sqrt(2.0))  # frames 0 and 1 are off by 0 and 0.3 m
    assert p.after == pytest.approx(0.3)
    assert p.apart == pytest.approx(0.5)
    assert p.off == pytest.approx(0.3), "placed from the pose predicted for the frame, off as the one before it"


def test_switches_are_read_from_the_data():
    assert [switched_on(log) for log in (QUIET, BUSY, BLIND)] == [(False, True), (True, True), (False, False)]
    kept = replace(BUSY, name=f"{BUSY.name}:maintain")
    tidied = lab_run(kept, "jcbb", removed={2: 4}, changes={4: NEW})
    lab = find_lab([trial(QUIET), trial(BUSY), trial(kept, tidied, variant_of=BUSY.name)])
    assert {k: t.log.name for k, t in lab.trials.items()} == {(False, True): "corridor:0", (True, True): BUSY.name}
    assert {k: t.log.name for k, t in lab.maintained.items()} == {(True, True): kept.name}
    assert find_lab([Trial(QUIET, "localization", ()), trial(circle_log(truth=False))]) is None


def test_the_filter_answers_where_it_got_to_the_end_and_otherwise_the_smoother():
    both = trial(QUIET, lab_run(QUIET, "nn", estimator="isam2"), lab_run(QUIET, "nn"))
    assert find_lab([both]).find(ODOMETRY, "nn").run.estimator == "ekf"
    assert find_lab([trial(QUIET, both.runs[0])]).find(ODOMETRY, "nn").run.estimator == "isam2"
    assert find_lab([both]).find(ODOMETRY, "jcbb") is None


def test_why_nn_fails_is_told_with_counts_places_and_errors():
    given = trial(QUIET, lab_run(QUIET, "known"), lab_run(QUIET, "nn", error=0.3, changes=CONFUSED))
    q = facts(given).of["nn"]
    p = q["nn"].p
    assert (p.fp, p.observations, p.neighbour, p.first_wrong, p.duplicate) == (1, 10, 1, 2, 1)
    assert (p.apart, p.off) == (pytest.approx(0.5), pytest.approx(0.3))
    assert (p.before, p.after) == (pytest.approx(0.3 / math.sqrt(2.0)), pytest.approx(0.3))
    assert (q["nn"].landmarks, q["known"].landmarks) == (3, 2)
    assert (q["nn"].rmse, q["known"].rmse) == (pytest.approx(0.3 * RMS), pytest.approx(0.01 * RMS))
    assert q["explained"]
    assert q["costly"]
    text = words(given)[NN]
    assert "error of 0.300 m, more than half that spacing" in text
    assert text.endswith("0.268 m against 0.00894 m with known association, 30.0 times as large.")


def test_nn_that_does_not_fail_is_not_said_to():
    known = lab_run(QUIET, "known")
    right = trial(QUIET, known, lab_run(QUIET, "nn"))
    assert facts(right).of["nn"]["nn"].p.first_wrong is None
    assert "does not fail: none of its 8 pairings" in words(right)[NN]
    slight = facts(trial(QUIET, known, lab_run(QUIET, "nn", changes=CONFUSED))).of["nn"]
    assert not slight["costly"]
    assert not slight["explained"], "the error of the pose alone does not explain them"


def test_people_break_what_they_break():
    quiet = trial(QUIET, lab_run(QUIET, "nn"), lab_run(QUIET, "singles"))
    busy = [lab_run(BUSY, "nn", error=0.3, changes=FOOLED), lab_run(BUSY, "singles", changes={2: DISCARD})]
    q = facts(quiet, trial(BUSY, *busy)).of["people"]
    (nn, fooled), (singles, shy) = q["pairs"]
    assert (fooled.p.clutter, fooled.p.observations, fooled.p.clutter_paired, fooled.p.clutter_again) == (3, 13, 2, 1)
    assert (nn.p.fp, fooled.p.fp, shy.p.clutter_paired) == (0, 5, 0)
    assert (nn.rmse, fooled.rmse) == (pytest.approx(0.01 * RMS), pytest.approx(0.3 * RMS))
    assert (singles.p.missed, shy.p.missed) == (0, 1)
    assert (q["broken"], q["ghosts"], q["points"]) == (("NN",), 1, 1)
    text = words(quiet, trial(BUSY, *busy))[PEOPLE]
    assert "FP go from 0 to 5, recall is 100 % without people" in text
    assert "People make NN fail here. Mostly a person has moved when" in text
    calm = trial(BUSY, lab_run(BUSY, "nn"), lab_run(BUSY, "singles"))
    assert facts(quiet, calm).of["people"]["broken"] == ()
    assert "do not make them" in words(quiet, calm)[PEOPLE]


def test_a_method_that_was_run_on_one_log_only_is_named():
    given = trial(QUIET, lab_run(QUIET, "nn")), trial(BUSY, lab_run(BUSY, "nn"))
    assert facts(*given).of["people"]["lost"] == ("SINGLES",)
    assert words(*given)[PEOPLE].endswith("SINGLES was not run on both logs.")


def test_jcbb_copes_better_only_where_it_does():
    good, bad = lab_run(BUSY, "jcbb", error=0.02), lab_run(BUSY, "nn", error=0.3, changes=FOOLED)
    given = trial(BUSY, good, bad, lab_run(BUSY, "known"))
    q = facts(given).of["jcbb"]
    assert [(r.name, r.p.fp, r.p.fn) for r in q["runs"]] == [("JCBB", 0, 0), ("NN", 5, 1), ("known association", 0, 0)]
    assert q["better"]
    assert not q["close"]
    text = words(given)[JCBB]
    assert "JCBB 0 / 0 / 0.0179 m; NN 5 / 1 / 0.268 m; known association 0 / 0 / 0.00894 m." in text
    assert "less accurate than with known association (2.00 times the RMSE)" in text
    swapped = trial(BUSY, replace(good, association="nn"), replace(bad, association="jcbb"))
    q = facts(swapped).of["jcbb"]
    assert not q["better"]
    assert (q["jcbb"].p.wrong, q["nn"].p.wrong) == (6, 0)
    assert "agree on it" not in words(swapped)[JCBB]


def test_without_odometry_errors_and_reason_are_told():
    known = lab_run(BLIND, "known", error=0.5)
    jcbb = lab_run(BLIND, "jcbb", error=2.0, changes=dict.fromkeys(range(2, 10), 1))
    q = facts(trial(BLIND, known, jcbb, lab_run(BLIND, "known", estimator="batch"))).of["blind"]
    assert (q["motion"]["count"], q["motion"]["within"], q["motion"]["reasonable"]) == (4, 4, True)
    assert (q["jcbb"].rmse, q["jcbb"].largest, q["jcbb"].last) == (pytest.approx(2.0 * RMS), 2.0, 2.0)
    assert q["smoother"].rmse == pytest.approx(0.01 * RMS)
    assert q["suffices"]
    assert (q["jcbb"].p.tp, q["jcbb"].p.fp) == (4, 4)
    far = replace(BLIND, truth=replace(BLIND.truth, pose=np.outer(np.arange(5.0), [1.0, 0.0, 0.0])))
    q = facts(trial(far, known)).of["blind"]
    assert q["motion"]["distance"] == pytest.approx(10.0)
    assert (q["motion"]["within"], q["motion"]["reasonable"], q["jcbb"]) == (0, False, None)
    text = words(trial(far, known))[NO_ODOMETRY]
    assert "on average 10.0 σ away. 0 of 4 motions are inside" in text
    assert "JCBB was not run" in text


def test_map_maintenance_is_told_by_size_entries_and_counts():
    kept = replace(BUSY, name=f"{BUSY.name}:maintain")
    plain = lab_run(BUSY, "jcbb", changes={4: NEW, 7: 2})
    tidied = trial(kept, lab_run(kept, "jcbb", changes={4: NEW}, removed={2: 3}), variant_of=BUSY.name)
    given = trial(BUSY, plain), tidied
    q = facts(*given).of["maintenance"]
    assert (q["plain"].landmarks, q["kept"].landmarks, q["kept"].removed, q["kept"].removed_people) == (3, 2, 1, 1)
    # lengths 7, 9, 9, 9, 9 and with maintenance 7, 9, 9, 9, 7
    assert (q["plain"].entries, q["kept"].entries) == (49 + 4 * 81, 2 * 49 + 3 * 81)
    assert (q["plain"].p.fp, q["kept"].p.fp) == (1, 0)
    assert not q["better"]
    assert not q["worse"]
    text = words(*given)[UPKEEP]
    assert "91 % as many entries. Times: `timing.csv`." in text
    assert "FP are 0 instead of 1 (spurious: 0 instead of 1), FN 0 as before" in text
    assert "fewer pairings are wrong" in text
    same = trial(kept, lab_run(kept, "jcbb", changes={4: NEW, 7: 2}, removed={}), variant_of=BUSY.name)
    assert facts(trial(BUSY, plain), same).of["maintenance"]["kept"].removed == 0
    text = words(trial(BUSY, plain), same)[UPKEEP]
    assert "It removed nothing." in text
    assert "The map is not smaller here" in text


def test_a_question_without_its_runs_lacks_them_and_the_others_are_answered():
    q = facts(trial(QUIET, lab_run(QUIET, "known"), lab_run(QUIET, "nn")))
    assert [q.of[question.name]["lack"] for question in QUESTIONS] == [False, False, True, True, True, True]

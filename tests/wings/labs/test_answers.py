"""A lab's questions are answered in their order, each with numbers and one paragraph, whatever the runs did."""

from dataclasses import replace

import numpy as np
import pytest

from data.notice import stopped
from data.result import Failure
from eval.plan.experiment import Unfinished
from eval.plan.flags.options import read_options
from eval.referee.score import Trial, score
from eval.replay.settings import Setup
from tests.eval.handmade_lab import FOOLED, NEW, lab_log, lab_run
from wings.labs.corridor import JCBB, ODOMETRY, find_lab
from wings.labs.sections import KINDS, QUESTIONS, draw, hand_in, write_times

CONDITIONS = [(False, True), (True, True), (False, False), (True, False)]


def trials(**wrong) -> list[Trial]:
    """Every method in every condition: NN is off by 0.3 m, all others are right; maintenance removes a person."""
    made = []
    for people, odometry in CONDITIONS:
        log = lab_log(people=people, odometry=odometry)
        fooled = {**FOOLED} if people else {5: 0, 6: NEW}
        methods = [
            lab_run(log, m, error=0.3 if m == "nn" else 0.01, changes=fooled if m == "nn" else None)
            for m in ("known", "nn", "singles", "jcbb-first")
        ]
        made.append(Trial(log, "slam", tuple(methods)))
        kept = replace(log, name=f"{log.name}:maintain")
        run = lab_run(kept, "jcbb-first", removed={2: 4}, changes={4: NEW}) if people else lab_run(kept, "jcbb-first")
        made.append(Trial(kept, "slam", (run,), log.name))
    return made


def answered(tmp_path, given: list[Trial]):
    options = read_options(["--lab", "recorded", "--no-plots", "--out", str(tmp_path)])
    return hand_in(tmp_path, options, given, score(given), Unfinished(1))


def test_the_numbers_are_those_counted_by_hand(tmp_path):
    first, second, third, *_ = answered(tmp_path, trials())
    rows = first.blocks[1].frame.set_index("method")
    # two of ten observations of the log without people: point 2 taken for 1, and point 1 initialized twice
    assert rows.loc["nn", ["FP", "FN"]].tolist() == [1, 1]
    assert rows.loc["nn", "RMSE [m]"] == pytest.approx(0.3 * np.sqrt(0.8))
    assert "1 of 7 pairings are wrong, the first in frame 2" in first.blocks[0]
    assert "No fewer" not in second.blocks[0]
    assert third.blocks[1].frame["condition"].tolist() == ["no people", "no people", "people", "people"]


def test_jcbb_first_is_the_lab_s_jcbb_and_jcbb_stands_for_it_where_it_was_not_run():
    log = lab_log()
    both = Trial(log, "slam", (lab_run(log, "jcbb"), lab_run(log, "jcbb-first")))
    assert find_lab([both]).find(ODOMETRY, *JCBB).run.association == "jcbb-first"
    alone = find_lab([Trial(log, "slam", (lab_run(log, "jcbb"),))])
    assert alone.find(ODOMETRY, *JCBB).run.association == "jcbb"


def test_a_run_that_did_not_get_to_its_end_is_said_and_no_picture_of_it_is_asked_for(tmp_path):
    given = trials()
    halted = replace(given[0].runs[1], failure=Failure("diverged", 3, stopped("made up")))
    given[0] = replace(given[0], runs=(given[0].runs[0], halted, *given[0].runs[2:]))
    sections = answered(tmp_path, given)
    assert "stopped before the end" in sections[0].blocks[0]
    assert "Failures." in sections[0].blocks[-1]
    lab, setup = find_lab(given), Setup().settled(sensed=False)
    assert KINDS["first-wrong"](lab, setup) is None
    assert KINDS["people"](lab, setup) is not None, "SINGLES is there"


def test_every_picture_has_its_need_and_its_question():
    asked = [kind for q in QUESTIONS for kind in q.pictures]
    assert all(q.pictures for q in QUESTIONS)
    assert set(asked) == {*KINDS}
    assert len(asked) == len(set(asked))


def test_pictures_of_maintenance_need_runs_with_and_without_it(tmp_path):
    lab = find_lab([t for t in trials() if not t.log.name.endswith(":maintain")])
    assert draw(tmp_path, "maintenance", lab, Setup()) is None
    assert write_times(tmp_path, lab, Setup(), ()) is None

"""Steps in the words of the lab's program: numbers from 1, 0 for none, and nothing of the first step."""

from __future__ import annotations

import csv

import numpy as np
import pytest

from data.logs import open_log
from eval.referee.confusion import OUTCOMES
from eval.replay.run import compare
from eval.replay.settings import Setup
from wings.labs.stepping.problem import TruthRow
from wings.labs.stepping.text import Step, lab_block, run_text

LAB = Setup(new_gate=0.99)


RULE = "-" * 62


def _outcomes(*names: str) -> np.ndarray:
    return np.array([OUTCOMES.index(name) for name in names])


def test_a_step_is_said_word_for_word():
    truth = TruthRow(np.array([2, 11, -1, 4]), _outcomes("tp", "fp", "tn", "fn"))
    text = lab_block(Step(4, truth, np.array([2, 3, -1, -2]), np.array([-1, -1, 5, -1])))
    assert text.split("\n") == [
        RULE,
        "Step: 5",
        "GROUND  TRUTH:  3  12   0   5  ",
        "MY HYPOTHESIS:  3   4   0   0  ",
        "Correct (1/0)?  1   0   1   0  ",
        "",
        "NEW:  6   ",
        "Hypothesis not in agreement with ground truth",
        "True positives: 1",
        "True negatives: 1",
        "False positives: 1",
        "False negatives: 1",
    ]
    assert lab_block(Step(0, truth, np.array([-1]), np.array([0]))) == ""
    blind = lab_block(Step(4, None, np.array([2, -2]), np.array([-1, -1])))
    assert blind.split("\n")[1:] == ["Step: 5", "MY HYPOTHESIS:  3   0  "]


def test_the_worked_example_has_counts_4_1_1_1():
    """Four right pairings, a new landmark, a neighbour's landmark, and a known landmark that is taken for new."""
    truth = TruthRow(np.array([0, 1, 2, 3, -1, 4, 5]), _outcomes("tp", "tp", "tp", "tp", "tn", "fp", "fn"))
    text = lab_block(Step(1, truth, np.array([0, 1, 2, 3, -1, 5, -1]), np.array([-1, -1, -1, -1, 8, -1, 9])))
    assert text.split("\n") == [
        RULE,
        "Step: 2",
        "GROUND  TRUTH:  1   2   3   4   0   5   6  ",
        "MY HYPOTHESIS:  1   2   3   4   0   6   0  ",
        "Correct (1/0)?  1   1   1   1   1   0   0  ",
        "",
        "NEW:  9   10   ",
        "Hypothesis not in agreement with ground truth",
        "True positives: 4",
        "True negatives: 1",
        "False positives: 1",
        "False negatives: 1",
    ]


def test_counts_are_left_out_where_the_hypothesis_is_right():
    truth = TruthRow(np.array([2, -1]), _outcomes("tp", "tn"))
    discarded = lab_block(Step(4, truth, np.array([2, -2]), np.array([-1, -1])))
    assert discarded.split("\n")[2:] == [
        "GROUND  TRUTH:  3   0  ",
        "MY HYPOTHESIS:  3   0  ",
        "Correct (1/0)?  1   1  ",
    ]
    created = lab_block(Step(4, truth, np.array([2, -1]), np.array([-1, 3])))
    assert created.split("\n")[-2:] == ["", "NEW:  4   "]
    wrong = TruthRow(np.array([2]), _outcomes("fn"))
    missed = lab_block(Step(4, wrong, np.array([-2]), np.array([-1]))).split("\n")
    assert missed[5:7] == ["", "Hypothesis not in agreement with ground truth"]
    assert missed[-1] == "False negatives: 1"


@pytest.mark.parametrize("method", ["nn", "jcbb-first"])
def test_hypotheses_are_those_that_the_lab_s_program_recorded(shared_data, method):
    folder = shared_data / "lab_corridor" / "corridor_s0_people0_odo1"
    log = open_log(str(folder))
    run = compare(log.inputs(), "slam", ["ekf"], method, LAB)[0]
    lines = run_text(log, run, block=lab_block).split("\n")
    said = [int(n) for line in lines if line.startswith("MY HYPOTHESIS: ") for n in line.split(":")[1].split()]
    correct = [int(n) for line in lines if line.startswith("Correct (1/0)? ") for n in line.split("?")[1].split()]
    name = {"nn": "NN", "jcbb-first": "JCBB"}[method]
    with (folder / "reference" / name / "hypotheses.csv").open(newline="") as f:
        recorded = [(int(r["frame"]), int(r["h"])) for r in csv.DictReader(f)]
    assert said == [h for frame, h in recorded if frame > 0]
    with (folder / "reference" / name / "decisions.csv").open(newline="") as f:
        right = sum(int(r["tp"]) + int(r["tn"]) for r in csv.DictReader(f) if int(r["frame"]) > 0)
    assert sum(correct) == right

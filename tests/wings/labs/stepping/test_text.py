"""The text of a step, in our words and the lab's: golden blocks, and sums over whole runs as the referee says."""

import dataclasses
import re

import numpy as np
import pytest

from data.logs import open_log
from data.notice import stopped
from data.truth import UNKNOWN_ID, Truth
from data.worlds.arena import Arena, simulate
from eval.referee.confusion import OUTCOMES, confuse
from eval.referee.score import confusion_of
from eval.replay.run import compare, step_by_step
from eval.replay.settings import Setup
from tests.builders.tables import rows
from wings.labs.stepping.problem import FrameSoFar, TruthRow, row_of
from wings.labs.stepping.text import WIDTH, Step, closing, lab_block, run_text, statistics, step_block

NEW, DISCARD = -1, -2

GOLDEN = """\
step 1: 7 observations
observation    0   1   2   3   4   5   6
ground truth   0   1   2   3   -   4   6
hypothesis     0   1   2   3 NEW   5 NEW
correct        1   1   1   1   1   0   0
NEW                            7       8
ground truth and hypothesis disagree in 2 of 7 observations: 5 (FP), 6 (FN)
TP 4   TN 1   FP 1   FN 1"""


def seven() -> tuple[np.ndarray, ...]:
    """Frame 0 initializes landmarks 0 to 6 of the true ids 10 to 16; frame 1 is the one that is shown."""
    frame = np.repeat([0, 1], 7)
    true_id = np.array([10, 11, 12, 13, 14, 15, 16, 10, 11, 12, 13, 20, 14, 16])
    decisions = np.array([NEW] * 7 + [0, 1, 2, 3, NEW, 5, NEW])
    return frame, true_id, decisions, np.array([*range(7), -1, -1, -1, -1, 7, -1, 8])


def test_four_right_one_new_one_neighbour_and_one_known_taken_for_new_are_told_as_in_the_lab():
    frame, true_id, decisions, created = seven()
    scored = confuse(frame, true_id, decisions, created, None)
    rows = slice(7, 14)
    assert step_block(Step(1, row_of(scored, rows), decisions[rows], created[rows])) == GOLDEN


def test_without_truth_what_needs_it_is_left_out_and_the_text_says_so():
    assert step_block(Step(3, None, np.array([4, NEW, DISCARD]), np.array([-1, 9, -1]))) == (
        "step 3: 3 observations\n"
        "observation   0   1   2\n"
        "hypothesis    4 NEW   -\n"
        "NEW               9\n"
        "(true ids are unknown: no ground truth, correct and counts)"
    )


@pytest.mark.parametrize(("m", "first"), [(1, 5), (22, 1), (22, 100), (22, 99990), (200, 1)])
def test_columns_stand_below_each_other_and_no_line_is_too_long(m, first):
    decisions = np.arange(first, first + m)
    decisions[::3] = NEW
    created = np.where(decisions == NEW, first + m + np.arange(m), -1)
    wrong = TruthRow(np.where(decisions == NEW, first, 0), np.where(decisions == NEW, 3, 2))
    text = step_block(Step(10, wrong, decisions, created))
    assert max(map(len, text.split("\n"))) <= WIDTH
    shown: dict[str, list[str]] = {"observation": [], "hypothesis": [], "NEW": []}
    for part in text[text.index("\n") + 1 : text.index("ground truth and")].split("\n\n"):
        lines = part.strip().split("\n")
        label = len("ground truth")
        ends = [word.end() for word in re.finditer(r"\S+", lines[0][label:])]
        for line in lines:
            cells = list(re.finditer(r"\S+", line[label:]))
            assert {cell.end() for cell in cells} <= set(ends)
            shown.get(line[:label].strip(), []).extend(cell.group() for cell in cells)
    assert shown["observation"] == [str(i) for i in range(m)]
    assert shown["hypothesis"] == ["NEW" if d == NEW else str(d) for d in decisions]
    assert shown["NEW"] == [str(n) for n in created if n >= 0]


@pytest.mark.parametrize("phase", ["online", "final"])
def test_the_steps_of_a_run_sum_to_the_counts_of_the_referee(phase):
    log = open_log("corridor:0:people")
    setup = Setup(new_gate=0.99, maintain=True)
    run = step_by_step("ekf", log.recorded.without_map(), "slam", "nn", setup)
    text, c = run_text(log, run, phase), confusion_of(run, log, phase)
    assert min(c.tp, c.tn, c.fp, c.fn) > 0
    told = re.findall(r"^TP (\d+)   TN (\d+)   FP (\d+)   FN (\d+)$", text, re.MULTILINE)
    assert np.array(told, int).sum(axis=0).tolist() == [c.tp, c.tn, c.fp, c.fn]
    # in the end what was retracted has never been new
    lasting = run.created >= 0 if phase == "online" else (run.created >= 0) & (run.final_decisions != DISCARD)
    numbers = [number for line in text.split("\n") if line.startswith("NEW") for number in line.split()[1:]]
    assert numbers == [str(n) for n in run.created[lasting]]
    m = c.tp + c.tn + c.fp + c.fn
    assert f"whole run: {m} observations in 44 steps" in text
    for name in ("tp", "tn", "fp", "fn"):
        n = getattr(c, name)
        assert re.search(rf"^{name.upper()} +{n} +{100 * n / m:.1f} %$", text, re.MULTILINE)
    assert max(map(len, text.split("\n"))) <= WIDTH


@pytest.mark.parametrize("task", ["slam", "localization"])
def test_a_frame_is_judged_at_once_as_it_is_judged_in_the_end(task):
    log = open_log("corridor:0:people")
    inputs = log.recorded.without_map() if task == "slam" else log.recorded
    run = step_by_step("ekf", inputs, task, "nn", Setup(new_gate=0.99, maintain=True))
    whole = confusion_of(run, log, "online")
    for k in range(44):
        rows = slice(*log.recorded.start[k : k + 2].tolist())
        so_far = run.decisions.copy()
        so_far[rows.stop :] = DISCARD
        created = run.created.copy()
        created[rows.start :] = -1
        removed = None if run.removed is None else np.where(run.removed >= k, -1, run.removed)
        row = FrameSoFar(log, task, rows, so_far, created, removed).judged()
        assert row.outcome.tolist() == whole.outcome[rows].tolist()
        assert row.ground_truth.tolist() == whole.ground_truth[rows].tolist()


def test_one_unknown_true_id_leaves_the_counts_of_every_step_out():
    log = simulate(Arena(frames=6), 0)
    ids = log.truth.landmark_of.copy()
    ids[-1] = UNKNOWN_ID
    log = dataclasses.replace(log, truth=dataclasses.replace(log.truth, landmark_of=ids))
    run = step_by_step("ekf", log.recorded, "localization", "nn")
    assert "correct   " not in run_text(log, run)
    assert closing(log, run).startswith("whole run: true ids are unknown")
    assert FrameSoFar(log, "localization", slice(0, 3), run.decisions, run.created, None).judged() is None
    blind = dataclasses.replace(log, truth=Truth())
    assert "NIS per degree" in statistics(blind, run)
    assert "RMSE" not in statistics(blind, run)


def test_a_run_that_stopped_says_where_and_tells_no_step_after_it():
    log = simulate(Arena(frames=6), 0)
    run = step_by_step("ekf", log.recorded, "localization", "nn")
    from data.result import Failure

    text = run_text(log, dataclasses.replace(run, failure=Failure("diverged", 3, stopped("no reason"))))
    assert "step 2:" in text
    assert "step 3:" not in text
    assert "diverged at frame 3: no reason" in text


LAB = Setup(new_gate=0.99)
RULE = "-" * 62


def _outcomes(*names: str) -> np.ndarray:
    return np.array([OUTCOMES.index(name) for name in names])


def test_a_step_is_said_word_for_word():
    truth = TruthRow(np.array([2, 11, -1, 4]), _outcomes("tp", "fp", "tn", "fn"))
    assert lab_block(Step(4, truth, np.array([2, 3, -1, -2]), np.array([-1, -1, 5, -1]))).split("\n") == [
        RULE, "Step: 5", "GROUND  TRUTH:  3  12   0   5  ", "MY HYPOTHESIS:  3   4   0   0  ",
        "Correct (1/0)?  1   0   1   0  ", "", "NEW:  6   ", "Hypothesis not in agreement with ground truth",
        "True positives: 1", "True negatives: 1", "False positives: 1", "False negatives: 1",
    ]  # fmt: skip
    assert lab_block(Step(0, truth, np.array([-1]), np.array([0]))) == ""
    blind = lab_block(Step(4, None, np.array([2, -2]), np.array([-1, -1])))
    assert blind.split("\n")[1:] == ["Step: 5", "MY HYPOTHESIS:  3   0  "]


def test_the_worked_example_has_counts_4_1_1_1():
    """Four right pairings, a new landmark, a neighbour's landmark, and a known landmark that is taken for new."""
    truth = TruthRow(np.array([0, 1, 2, 3, -1, 4, 5]), _outcomes("tp", "tp", "tp", "tp", "tn", "fp", "fn"))
    text = lab_block(Step(1, truth, np.array([0, 1, 2, 3, -1, 5, -1]), np.array([-1, -1, -1, -1, 8, -1, 9])))
    assert text.split("\n") == [
        RULE, "Step: 2", "GROUND  TRUTH:  1   2   3   4   0   5   6  ", "MY HYPOTHESIS:  1   2   3   4   0   6   0  ",
        "Correct (1/0)?  1   1   1   1   1   0   0  ", "", "NEW:  9   10   ",
        "Hypothesis not in agreement with ground truth", "True positives: 4", "True negatives: 1",
        "False positives: 1", "False negatives: 1",
    ]  # fmt: skip


def test_counts_are_left_out_where_the_hypothesis_is_right():
    truth = TruthRow(np.array([2, -1]), _outcomes("tp", "tn"))
    assert lab_block(Step(4, truth, np.array([2, -2]), np.array([-1, -1]))).split("\n")[2:] == [
        "GROUND  TRUTH:  3   0  ", "MY HYPOTHESIS:  3   0  ", "Correct (1/0)?  1   1  ",
    ]  # fmt: skip
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
    reference = folder / "reference" / {"nn": "NN", "jcbb-first": "JCBB"}[method]
    recorded = [(int(r["frame"]), int(r["h"])) for r in rows(reference / "hypotheses.csv")]
    assert said == [h for frame, h in recorded if frame > 0]
    right = sum(int(r["tp"]) + int(r["tn"]) for r in rows(reference / "decisions.csv") if int(r["frame"]) > 0)
    assert sum(correct) == right

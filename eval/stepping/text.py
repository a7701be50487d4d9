"""The text of a step, as in the university lab on data association: decisions above the truth, and what they score.

Pure functions of decisions and of what the referee said about them; nothing is scored here.

The text of a step word for word as the lab's program prints it, so that an output can be laid beside it.

Steps, and landmarks in the order in which they were initialized, count from 1; 0 stands for none. The first step has
nothing to pair with, and the program says nothing of it. A landmark keeps its number when others leave the map (the
program numbers the rest anew).
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Sequence
from textwrap import fill
from typing import NamedTuple

import numpy as np

from association.expectation import Expectation, gate_threshold
from data.inputs import IntArray
from data.log import Log
from data.result import NEW, Run
from data.se2 import Array
from data.terminal import counted
from data.truth import UNKNOWN_ID
from data.words import sentence
from eval.referee.confusion import OUTCOMES, Confusion, confuse
from eval.referee.metrics import metric
from eval.referee.score import confusion_of, metrics_row

WIDTH = 100
"""Columns of the terminal that a line never goes beyond."""
NONE = "-"
UNKNOWN = "true ids are not known: ground truth, correct and counts are left out"
RIGHT = ("tp", "tn")
STATISTICS = (
    "frames", "observations", "landmarks", "rmse_position_m", "max_position_m", "rmse_heading_deg", "rmse_landmark_m",
    "nees_pose", "inside_3sigma", "nis",
)  # fmt: skip
"""Columns of metrics.csv that are shown at the end."""


class TruthRow(NamedTuple):
    """What the referee says of one frame's m observations.

    ground_truth: (m,) number of the right landmark, negative for none; outcome: (m,) index into `OUTCOMES`.
    """

    ground_truth: IntArray
    outcome: IntArray

    @property
    def correct(self) -> list[bool]:
        """Whether each decision is right."""
        return [OUTCOMES[o] in RIGHT for o in self.outcome.tolist()]

    def counts(self) -> dict[str, int]:
        """Observations by outcome, in the order of `OUTCOMES`."""
        found = Counter(self.outcome.tolist())
        return {name: found[i] for i, name in enumerate(OUTCOMES)}


def row_of(confusion: Confusion | None, rows: slice) -> TruthRow | None:
    """The part of a run's outcomes that belongs to some observations."""
    return None if confusion is None else TruthRow(confusion.ground_truth[rows], confusion.outcome[rows])


def judge_frame(
    log: Log, task: str, rows: slice, decisions: IntArray, created: IntArray, removed: IntArray | None
) -> TruthRow | None:
    """What the referee says of observations `rows` as soon as they are decided about; None without true ids.

    `decisions` and `created` (M,) are those of the whole log so far; `removed` as in `Run`. What is right now depends
    on the observations that initialized the landmarks, and on no other, so only those and the rows go to the referee.
    """
    true_id = log.truth.landmark_of
    if true_id is None or np.any(true_id == UNKNOWN_ID):
        return None
    first = np.flatnonzero(created[: rows.start] >= 0)
    those = np.concatenate([first, np.arange(rows.start, rows.stop)])
    known = log.recorded.map if task == "localization" else None
    frame = log.recorded.observations.frame
    scored = confuse(frame[those], true_id[those], decisions[those], created[those], known, removed)
    return row_of(scored, slice(len(first), None))


def step_block(frame: int, truth_row: TruthRow | None, decisions: IntArray, created: IntArray) -> str:
    """The lines of one step: truth, hypothesis, which of them are correct, new landmarks, agreement, counts.

    Args:
        frame: number of the step.
        truth_row: what the referee says; None leaves ground truth, correct and counts out.
        decisions: (m,) landmark number, `NEW` or `DISCARD`, shown as number, NEW or `-`.
        created: (m,) number of the landmark an observation initialized, -1 for none.
    """
    m = len(decisions)
    rows: list[tuple[str, list[str]]] = [("observation", [str(i) for i in range(m)])]
    if truth_row is not None:
        rows.append(("ground truth", [str(n) if n >= 0 else NONE for n in truth_row.ground_truth.tolist()]))
    rows.append(("hypothesis", [_hypothesis(d) for d in decisions.tolist()]))
    if truth_row is not None:
        rows.append(("correct", [str(int(right)) for right in truth_row.correct]))
    if np.any(created >= 0):
        rows.append(("NEW", [str(n) if n >= 0 else "" for n in created.tolist()]))
    lines = [f"step {frame}: {m} observation{'s' * (m != 1)}", *_table(rows)]
    if truth_row is None:
        return "\n".join([*lines, f"({UNKNOWN})"])
    lines += _agreement(truth_row)
    lines.append("   ".join(f"{name.upper()} {n}" for name, n in truth_row.counts().items()))
    return "\n".join(lines)


def _hypothesis(decision: int) -> str:
    return str(decision) if decision >= 0 else "NEW" if decision == NEW else NONE


def _table(rows: Sequence[tuple[str, Sequence[str]]]) -> list[str]:
    """Rows one below the other, in as few and as equal parts as the width of the terminal asks for."""
    label = max(len(name) for name, _ in rows)
    m = len(rows[0][1])
    cell = 1 + max((len(c) for _, cells in rows for c in cells), default=0)
    cell = max(cell, 4)
    parts = -(-m * cell // (WIDTH - label)) or 1
    size = -(-m // parts)
    lines: list[str] = []
    for begin in range(0, m, max(size, 1)):
        if begin:
            lines.append("")
        for name, cells in rows:
            part = cells[begin : begin + size]
            if any(part):
                lines.append((f"{name:<{label}}" + "".join(f"{c:>{cell}}" for c in part)).rstrip())
    return lines


def _agreement(truth_row: TruthRow) -> list[str]:
    wrong = [i for i, right in enumerate(truth_row.correct) if not right]
    if not wrong:
        return ["ground truth and hypothesis agree"]
    which = ", ".join(f"{i} ({OUTCOMES[truth_row.outcome[i]].upper()})" for i in wrong)
    m = len(truth_row.outcome)
    text = f"ground truth and hypothesis disagree in {len(wrong)} of {m} observation{'s' * (m != 1)}: {which}"
    return fill(text, WIDTH, subsequent_indent="  ").split("\n")


def totals(confusion: Confusion, steps: int) -> str:
    """Counts of a run with their shares of all observations."""
    counts = {name: int(getattr(confusion, name)) for name in OUTCOMES}
    m = sum(counts.values())
    width = len(str(max(counts.values(), default=0)))
    head = f"whole run: {m} observation{'s' * (m != 1)} in {steps} step{'s' * (steps != 1)}"
    return "\n".join([
        head,
        *(f"{name.upper()} {n:>{width}}  {100.0 * n / m if m else 0.0:5.1f} %" for name, n in counts.items()),
    ])  # fmt: skip


Block = Callable[[int, TruthRow | None, IntArray, IntArray], str]
"""Text of a step, as `step_block` makes one; empty where nothing is said."""


def run_text(log: Log, run: Run, phase: str = "online", block: Block = step_block) -> str:
    """All steps of a run that have observations, each by `block`, and the totals.

    `phase` is `online` or `final`: decisions as they were made, or after all revisions.
    """
    inputs, confusion = log.recorded, confusion_of(run, log, phase)
    decisions = run.decisions if phase == "online" else run.final_decisions
    # in the end a landmark that was retracted has never been
    created = run.created if phase == "online" else run.initialized
    frames = np.flatnonzero(np.diff(inputs.start))
    if run.failure is not None:
        frames = frames[frames < run.failure.frame]
    blocks = []
    for k in frames.tolist():
        rows = slice(int(inputs.start[k]), int(inputs.start[k + 1]))
        blocks.append(block(k, row_of(confusion, rows), decisions[rows], created[rows]))
    return "\n\n".join([*filter(None, blocks), closing(log, run, phase)])


def closing(log: Log, run: Run, phase: str = "online") -> str:
    """What is said after the last step: the totals of a run, and where it stopped if it did."""
    confusion = confusion_of(run, log, phase)
    lines = []
    if run.failure is not None:
        f = run.failure
        text = f"{f.status} at frame {f.frame}: {f.why}; all observations from there on count as discarded"
        lines.append(fill(text, WIDTH, subsequent_indent="  "))
    elif run.doubt is not None:
        text = f"{run.doubt.status} from frame {run.doubt.frame} on: {run.doubt.why}"
        lines.append(fill(text, WIDTH, subsequent_indent="  "))
    steps = int(np.count_nonzero(np.diff(log.recorded.start)))
    lines.append(f"whole run: {UNKNOWN}" if confusion is None else totals(confusion, steps))
    return "\n".join(lines)


def statistics(log: Log, run: Run) -> str:
    """The numbers of a run, a column per phase; what cannot be known is left out."""
    rows = {phase: metrics_row(run, phase, log, None) for phase in run.phases}
    lines = []
    for m in map(metric, STATISTICS):
        values = [row.get(m.column) for row in rows.values()]
        if any(isinstance(v, (int, float)) and math.isfinite(v) for v in values):
            lines.append(f"{m.line:<40}" + "".join(f"{_number(v, m.form):>12}" for v in values))
    head = f"{f'{log.name}: {run.task}, {run.estimator}, {run.association}':<40}" + "".join(f"{p:>12}" for p in rows)
    return "\n".join([head, *lines, *(fill(sentence(note), WIDTH, subsequent_indent="  ") for note in run.notes)])


def _number(value: object, form: str) -> str:
    return f"{value:{form}}" if isinstance(value, (int, float)) and math.isfinite(value) else NONE


def pose_text(pose: Array, covariance: Array) -> str:
    """A pose (3,) and the 3 sigma that its covariance (3, 3) claims."""
    x, y, theta = (3.0 * math.sqrt(max(v, 0.0)) for v in covariance.diagonal().tolist())
    return (
        f"pose {pose[0]:.3f} m, {pose[1]:.3f} m, {math.degrees(pose[2]):.2f} deg "
        f"(3σ {x:.3f} m, {y:.3f} m, {math.degrees(theta):.2f} deg)"
    )


def compatibility_text(e: Expectation, gate: float | None) -> str:
    """How many pairs are individually compatible, and how ambiguous the observations are."""
    each = (e.individual_distances() < gate_threshold(gate)).sum(axis=1)
    none, one, several = (int(mask.sum()) for mask in (each == 0, each == 1, each > 1))
    return (
        f"{counted(int(each.sum()), 'compatible pair')} with {counted(len(e.number), 'landmark')}; "
        f"observations with none {none}, with one {one}, with several {several}"
    )


RULE = 62 * "-"


def lab_block(frame: int, truth_row: TruthRow | None, decisions: IntArray, created: IntArray) -> str:
    """The lines of one step; arguments as of `eval.stepping.text.step_block`. Empty for the first step.

    Without true ids the lines about them are left out. `created` is not used: the program does not say what is new.
    """
    if frame == 0:
        return ""
    hypothesis = np.maximum(decisions + 1, 0)
    lines = [RULE, f"Step: {frame + 1}"]
    if truth_row is not None:
        truth = np.maximum(truth_row.ground_truth + 1, 0)
        lines.append(f"GROUND  TRUTH: {_numbers(truth)}")
    lines.append(f"MY HYPOTHESIS: {_numbers(hypothesis)}")
    if truth_row is not None:
        lines.append(f"Correct (1/0)? {_numbers((truth == hypothesis).astype(np.int64))}")
    return "\n".join(lines)


def _numbers(values: IntArray) -> str:
    return "".join(f"{v:2d}  " for v in values.tolist())

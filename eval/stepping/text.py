"""The text of a step, as in the university lab on data association: decisions above the truth, and counts.

Pure functions of decisions and of the referee's results. The words: `steps.j2`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from textwrap import fill
from typing import Any

import numpy as np

from association.expectation import Expectation
from data.inputs import IntArray
from data.log import Log
from data.result import DISCARD, NEW, PoseEstimate, Run
from data.se2 import Array
from data.words import environment, number, sentence
from eval.referee.confusion import OUTCOMES
from eval.referee.metrics import metric
from eval.referee.score import confusion_of, metrics_row
from eval.stepping.poses import PoseStep, of_run, rows_of
from eval.stepping.problem import TruthRow, row_of

WIDTH = 100  # columns of the terminal
NONE = "-"
ERRORS = ("rmse_position_m", "max_position_m", "rmse_heading_deg", "rmse_landmark_m")
STATISTICS = ("frames", "observations", "landmarks", *ERRORS, "nees_pose", "inside_3sigma", "nis")
"""Columns of metrics.csv that are shown at the end."""


@dataclass(frozen=True, eq=False)
class Step:
    """A frame's m observations once they are decided about."""

    frame: int
    truth: TruthRow | None  # of the referee, None without true ids
    decisions: IntArray  # (m,) landmark number, `NEW` or `DISCARD`
    created: IntArray  # (m,) number of the landmark an observation initialized, -1 for none


def _say(macro: str, **facts: Any) -> str:
    made = getattr(environment("eval.stepping").get_template("steps.j2").module, macro)
    return str(made(**facts)).strip("\n")


def _wrapped(text: str) -> str:
    return "\n".join(fill(line, WIDTH, subsequent_indent="  ") for line in text.split("\n"))


def step_block(s: Step) -> str:
    """The lines of one step: truth, hypothesis, which decisions are correct, new landmarks, agreement, counts.

    Decisions are a number, NEW or `-`. Without true ids ground truth, correct and counts are left out.
    """
    words = {NEW: "NEW", DISCARD: NONE}
    rows = [("observation", [str(i) for i in range(len(s.decisions))])]
    if s.truth is not None:
        rows.append(("ground truth", [str(n) if n >= 0 else NONE for n in s.truth.ground_truth.tolist()]))
    rows.append(("hypothesis", [words.get(d, str(d)) for d in s.decisions.tolist()]))
    if s.truth is not None:
        rows.append(("correct", [str(int(right)) for right in s.truth.correct]))
    if np.any(s.created >= 0):
        rows.append(("NEW", [str(n) if n >= 0 else "" for n in s.created.tolist()]))
    return _wrapped(_say("step", s=s, table=_table(rows)))


def poses_block(frame: int, steps: Sequence[PoseStep], gate: float | None) -> str:
    """The lines of a step's fixes and closures; empty where it has none."""
    if not steps:
        return ""
    counts = [sum(s.name.startswith(kind) for s in steps) for kind in ("fix", "closure")]
    return _wrapped(_say("poses", frame=frame, fixes=counts[0], closures=counts[1], table=_table(rows_of(steps, gate))))


def lab_block(s: Step) -> str:
    """The lines of one step as the lab's program prints them, for comparison.

    Steps, observations and landmarks, in order of initialization, count from 1; 0 is none. NEW lists the observations
    that initialize a landmark; the four counts follow where a decision is wrong. The first step is left out, as in that
    program. A landmark keeps its number when others leave the map (the program renumbers the rest).
    """
    return _say("lab", s=s, new=np.flatnonzero(s.created >= 0).tolist()) if s.frame else ""


def _table(rows: Sequence[tuple[str, Sequence[str]]]) -> str:
    """Rows in as few equal parts as the width of the terminal allows."""
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
    return "\n".join(lines)


Block = Callable[[Step], str]  # text of a step, as of `step_block`; may be empty


def run_text(log: Log, run: Run, phase: str = "online", block: Block = step_block) -> str:
    """All steps of a run that have observations, fixes or closures, each by `block`, and the totals.

    The lab's program knows no fixes and closures, so its text has none.

    `phase` is `online` or `final`: decisions as they were made, or after all revisions.
    """
    inputs, confusion = log.recorded, confusion_of(run, log, phase)
    decisions = run.decisions if phase == "online" else run.final_decisions
    # in the end a retracted landmark never existed
    created = run.created if phase == "online" else run.initialized
    end = len(inputs) if run.failure is None else run.failure.frame
    blocks = []
    for k in range(end):
        rows = slice(int(inputs.start[k]), int(inputs.start[k + 1]))
        if block is step_block:
            blocks.append(poses_block(k, *of_run(log, run, k)))
        if rows.stop > rows.start:
            blocks.append(block(Step(k, row_of(confusion, rows), decisions[rows], created[rows])))
    return "\n\n".join([*filter(None, blocks), closing(log, run, phase)])


def closing(log: Log, run: Run, phase: str = "online") -> str:
    """The totals of a run, and where it stopped if it did."""
    c = confusion_of(run, log, phase)
    counts = None if c is None else {name: int(getattr(c, name)) for name in OUTCOMES}
    steps = int(np.count_nonzero(np.diff(log.recorded.start)))
    return _wrapped(_say("closing", failure=run.failure, implausible=run.implausible, counts=counts, steps=steps))


def statistics(log: Log, run: Run) -> str:
    """The numbers of a run, a column per phase; unknown ones are left out."""
    rows = {phase: metrics_row(run, phase, log, None) for phase in run.phases}
    lines = []
    for m in map(metric, STATISTICS):
        values = [row.get(m.column) for row in rows.values()]
        if any(isinstance(v, (int, float)) and math.isfinite(v) for v in values):
            lines.append(f"{m.line:<40}" + "".join(f"{_number(v):>12}" for v in values))
    head = f"{f'{log.name}: {run.task}, {run.estimator}, {run.association}':<40}" + "".join(f"{p:>12}" for p in rows)
    return "\n".join([head, *lines, *(_wrapped(sentence(note)) for note in run.notes)])


def _number(value: object) -> str:
    return number(value) if isinstance(value, (int, float)) and math.isfinite(value) else NONE


def moved_text(odometry: Array, pose: PoseEstimate) -> str:
    """The stated motion (3,) and the predicted pose with 3 sigma."""
    return _say("moved", odometry=odometry.tolist(), mean=pose.mean.tolist(), sigmas=_sigmas(pose))


def updated_text(used: int, new: int, left: int, removed: Sequence[int], pose: PoseEstimate) -> str:
    """Uses of the observations, the pose after them, and landmarks that left the map."""
    mean, sigmas = pose.mean.tolist(), _sigmas(pose)
    return _say("updated", used=used, new=new, left=left, removed=removed, mean=mean, sigmas=sigmas)


def _sigmas(pose: PoseEstimate) -> list[float]:
    return [3.0 * math.sqrt(max(v, 0.0)) for v in pose.covariance.diagonal().tolist()]


def compatibility_text(e: Expectation, gate: float | None) -> str:
    """Number of individually compatible pairs, and of ambiguous observations."""
    each = (e.individual_distances() < e.threshold(gate)).sum(axis=1)
    none, one, several = (int(mask.sum()) for mask in (each == 0, each == 1, each > 1))
    pairs, landmarks = int(each.sum()), len(e.number)
    return _say("compatible", pairs=pairs, landmarks=landmarks, without=none, one=one, several=several)

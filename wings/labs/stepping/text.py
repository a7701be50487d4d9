"""The text of a step, as in the university lab on data association: decisions above the truth, and counts.

Pure functions of decisions and of the referee's results. The words: `steps.j2`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from textwrap import fill
from typing import Any

import numpy as np

from association.expectation import Expectation, gate_threshold
from association.names import SCAN
from data.inputs import IntArray
from data.log import Log
from data.pose_measurements import PoseUpdated
from data.result import DISCARD, NEW, PoseEstimate, Run
from data.se2 import Array
from data.words import environment, number, sentence
from eval.plan.flags.table import Output
from eval.referee.confusion import OUTCOMES
from eval.referee.metrics import metric
from eval.referee.result_files import LAB_TEXT
from eval.referee.score import Trial, confusion_of, metrics_row
from wings.labs.stepping.problem import TruthRow, row_of

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
    made = getattr(environment("wings.labs.stepping").get_template("steps.j2").module, macro)
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

    Steps and landmarks, in order of initialization, count from 1; 0 is none. NEW lists the landmarks initialized in
    this step; the four counts follow where a decision is wrong. The first step is left out, as in that program. A
    landmark keeps its number when others leave the map (the program renumbers the rest).
    """
    return _say("lab", s=s, new=s.created[s.created >= 0].tolist()) if s.frame else ""


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


def write_lab_text(place: Path, output: Output, trial: Trial, run: Run) -> None:
    """The steps of a run that decides about observations, as the lab's program prints them, if asked for."""
    if output.lab_text and run.association not in ("none", SCAN):
        text = run_text(trial.log, run, run.phases[0], lab_block)
        (place / LAB_TEXT.name).write_text(f"{text}\n", encoding="utf-8", newline="\n")


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


NAMES = ("x", "y", "θ")
UNITS = (("m", "m", "rad"), (("m²", "m²", "m rad"), ("m²", "m²", "m rad"), ("m rad", "m rad", "rad²")))
NOTHING = "-"

Rows = list[tuple[str, list[str]]]


@dataclass(frozen=True, eq=False)
class PoseStep:
    """A fix or closure of a frame, once it was tried.

    Attributes:
        name: as `fix 0`, counted within the frame.
        source: where it comes from.
        ends: frames of a closure; empty for a fix.
        nu: (3,) innovation x, y [m], theta [rad]; NaN: not measured, or not formed.
        S: (3, 3) its covariance.
        nis: normalized innovation squared; dof: its degrees of freedom.
        used: whether it was accepted.
        inlier: 1, 0, or -1 where that is not known.
    """

    name: str
    source: str
    ends: tuple[int, ...]
    nu: Array
    S: Array
    nis: float
    dof: int
    used: bool
    inlier: int

    @property
    def decided(self) -> str:
        """What became of it: accepted; rejected at the gate; or not used, since the estimator knows its frame no
        longer.
        """
        return "accepted" if self.used else "rejected" if math.isfinite(self.nis) else "not used"

    @property
    def right(self) -> bool:
        """Whether it was rightly accepted or left out."""
        return self.used == bool(self.inlier)


def of_frame(log: Log, k: int, fixed: PoseUpdated | None, closed: PoseUpdated | None) -> list[PoseStep]:
    """The fixes and closures of frame k with the results of their updates; none where those are None."""
    found: list[PoseStep] = []
    r, t = log.recorded, log.truth
    if fixed is not None and r.fixes is not None and (fixes := r.fixes.of(k)) is not None:
        names = [fixes.sources[s].name for s in fixes.source.tolist()]
        found += _steps("fix", names, [()] * len(fixes), fixed, t.fix_inlier, fixes.rows)
    if closed is not None and r.closures is not None and (closures := r.closures.of(k)) is not None:
        names = [closures.sources[s] for s in closures.source.tolist()]
        ends = list(zip(closures.frame1.tolist(), closures.frame2.tolist(), strict=True))
        found += _steps("closure", names, ends, closed, t.closure_inlier, closures.row)
    return found


def _steps(
    kind: str,
    names: Sequence[str],
    ends: Sequence[tuple[int, ...]],
    done: PoseUpdated,
    inlier: IntArray | None,
    rows: IntArray,
) -> Iterator[PoseStep]:
    known = np.full(len(rows), -1) if inlier is None else inlier[rows]
    for i, (name, of) in enumerate(zip(names, ends, strict=True)):
        nu, m = np.full(3, np.nan), np.flatnonzero(np.isfinite(np.diag(done.S[i])))
        if len(m):
            nu[m] = np.linalg.cholesky(done.S[i][np.ix_(m, m)]) @ done.white[i, m]
        number = f"{kind} {i}"
        of_it = done.S[i], float(done.nis[i]), int(done.dof[i]), bool(done.used[i]), int(known[i])
        yield PoseStep(number, name, of, nu, *of_it)


def of_run(log: Log, run: Run, k: int) -> tuple[list[PoseStep], float | None]:
    """The fixes and closures of frame k in a run, online, and the probability of their gate."""
    r = log.recorded
    fixes = None if r.fixes is None else r.fixes.of(k)
    closures = None if r.closures is None else r.closures.of(k)
    fixed = None if fixes is None or run.fixes is None else run.fixes.of(fixes.rows)
    closed = None if closures is None or run.closures is None else run.closures.of(closures.row)
    gate = next((each.gate for each in (run.fixes, run.closures) if each is not None), None)
    return of_frame(log, k, fixed, closed), gate


def rows_of(steps: Sequence[PoseStep], gate: float | None) -> Rows:
    """The rows of the table; those without any number are left out."""
    rows: Rows = [("measurement", [s.name for s in steps]), ("source", [s.source for s in steps])]
    rows.append(("frames", [" to ".join(map(str, s.ends)) for s in steps]))
    for i, name in enumerate(NAMES):
        rows.append((f"innovation {name} [{UNITS[0][i]}]", [_short(s.nu[i]) for s in steps]))
    for j, other in enumerate(NAMES):
        for i, name in enumerate(NAMES[: j + 1]):
            rows.append((f"covariance {name}{other} [{UNITS[1][i][j]}]", [_short(s.S[i, j]) for s in steps]))
    rows.append(("NIS", [_short(s.nis) for s in steps]))
    if gate is not None:
        rows.append((f"gate {gate:g}", [_short(gate_threshold(gate, s.dof)) for s in steps]))
    if any(s.inlier >= 0 for s in steps):
        rows.append(("ground truth", [("outlier", "inlier", NOTHING)[s.inlier] for s in steps]))
    rows.append(("hypothesis", [s.decided for s in steps]))
    if any(s.inlier >= 0 for s in steps):
        rows.append(("correct", [str(int(s.right)) if s.inlier >= 0 else NOTHING for s in steps]))
    return [row for row in rows if any(row[1])]


def _short(value: float) -> str:
    return f"{value:.3g}" if math.isfinite(value) else ""

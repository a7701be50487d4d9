"""The text of a step, as in the university lab on data association: decisions above the truth, and counts."""

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
from eval.referee.result_files import LAB_TEXT, metric
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
    return str(getattr(environment("wings.labs.stepping").get_template("steps.j2").module, macro)(**facts)).strip("\n")


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


def poses_block(frame: int, columns: Sequence[dict[str, str]]) -> str:
    """The lines of a step's fixes and closures, as of `pose_columns`; empty where it has none."""
    if not columns:
        return ""
    fixes, closures = (sum(c["measurement"].startswith(kind) for c in columns) for kind in ("fix", "closure"))
    table = _table([(row, [c[row] for c in columns]) for row in columns[0]])
    return _wrapped(_say("poses", frame=frame, fixes=fixes, closures=closures, table=table))


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
    """All steps of a run that have observations, fixes or closures (which the lab's program has not), each by `block`,
    and the totals; `phase`: `online` or `final`, decisions as made, or after all revisions.
    """
    inputs, confusion = log.recorded, confusion_of(run, log, phase)
    decisions = run.decisions if phase == "online" else run.final_decisions
    created = run.created if phase == "online" else run.initialized  # in the end a retracted landmark never existed
    end = len(inputs) if run.failure is None else run.failure.frame
    blocks = []
    for k in range(end):
        rows = slice(int(inputs.start[k]), int(inputs.start[k + 1]))
        if block is step_block:
            blocks.append(poses_block(k, columns_of_run(log, run, k)))
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
        known = [v if isinstance(v, (int, float)) and math.isfinite(v) else None for v in values]
        if known.count(None) < len(known):
            lines.append(f"{m.line:<40}" + "".join(f"{NONE if v is None else number(v):>12}" for v in known))
    head = f"{f'{log.name}: {run.task}, {run.estimator}, {run.association}':<40}" + "".join(f"{p:>12}" for p in rows)
    return "\n".join([head, *lines, *(_wrapped(sentence(note)) for note in run.notes)])


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


COMPONENTS = ("x [m]", "y [m]", "θ [rad]")


def pose_columns(
    log: Log, k: int, fixed: PoseUpdated | None, closed: PoseUpdated | None, gate: float | None
) -> list[dict[str, str]]:
    """The fixes and closures of frame k, each a column of text by row, with the results of their updates."""
    r, t = log.recorded, log.truth
    found: list[dict[str, str]] = []
    if fixed is not None and r.fixes is not None and (fixes := r.fixes.of(k)) is not None:
        heads = [{"source": fixes.sources[s].name, "frames": ""} for s in fixes.source.tolist()]
        found += _columns("fix", heads, fixed, t.fix_inlier, fixes.row, gate)
    if closed is not None and r.closures is not None and (closures := r.closures.of(k)) is not None:
        c = zip(closures.source.tolist(), closures.frame1.tolist(), closures.frame2.tolist(), strict=True)
        heads = [{"source": closures.sources[s], "frames": f"{first} to {second}"} for s, first, second in c]
        found += _columns("closure", heads, closed, t.closure_inlier, closures.row, gate)
    return found


def _columns(
    kind: str, heads: Sequence[dict[str, str]], done: PoseUpdated, inlier: IntArray | None, rows: IntArray,
    gate: float | None,
) -> Iterator[dict[str, str]]:  # fmt: skip
    known = np.full(len(rows), -1) if inlier is None else inlier[rows]
    for i, head in enumerate(heads):
        nu, sigma = np.full(3, np.nan), np.sqrt(np.diag(done.S[i]))
        m = np.flatnonzero(np.isfinite(sigma))  # components that are measured
        if len(m):
            nu[m] = np.linalg.cholesky(done.S[i][np.ix_(m, m)]) @ done.white[i, m]
        used, nis = bool(done.used[i]), float(done.nis[i])
        limit = {} if gate is None else {f"gate {gate:g}": _short(gate_threshold(gate, int(done.dof[i])))}
        yield {
            "measurement": f"{kind} {i}", **head,
            **{f"innovation {name}": _short(v) for name, v in zip(COMPONENTS, nu, strict=True)},
            **{f"its sigma {name}": _short(v) for name, v in zip(COMPONENTS, sigma, strict=True)}, "NIS": _short(nis),
            **limit, "ground truth": ("outlier", "inlier", "")[known[i]],
            "hypothesis": "accepted" if used else "rejected" if math.isfinite(nis) else "not used",
            "correct": str(int(used == bool(known[i]))) if known[i] >= 0 else "",
        }  # fmt: skip


def columns_of_run(log: Log, run: Run, k: int) -> list[dict[str, str]]:
    """The fixes and closures of frame k in a run, online."""
    r = log.recorded
    fixes = None if r.fixes is None else r.fixes.of(k)
    closures = None if r.closures is None else r.closures.of(k)
    fixed = None if fixes is None or run.fixes is None else run.fixes.of(fixes.row)
    closed = None if closures is None or run.closures is None else run.closures.of(closures.row)
    gate = next((each.gate for each in (run.fixes, run.closures) if each is not None), None)
    return pose_columns(log, k, fixed, closed, gate)


def _short(value: float) -> str:
    return f"{value:.3g}" if math.isfinite(value) else ""

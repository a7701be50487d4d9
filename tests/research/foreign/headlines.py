"""How often the headline objects to sound foreign logs, and prints a tick over a strong fault.

A strong fault is in the numbers, whatever was done to the log: in the NEES of filter or smoother, their pairings, or
their path. They are computed here from the runs, not taken from the headline's facts.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from data import se2
from data.log import Log
from data.result import Run
from eval.judgement.judgement import Verdict, judge
from eval.referee.score import confusion_of
from eval.report.overview import trust_mark
from tests.research.foreign.faults import FAULTS
from tests.research.foreign.shapes import SHAPES
from tests.research.foreign.study import Case, counted, done_all, share, table
from tests.research.foreign.world import make
from tests.research.headlines import trial_of

NEES, WRONG, LOST = 9.0, 0.1, 0.1
"""A fault is strong beyond this mean NEES, from this share of wrong pairings, or beyond this share of the path's
extent as RMSE."""
FAULTY = 100_000
"""First seed of logs with faults: they share none with sound ones."""
METHODS = ("known", "jcbb")


class Row(NamedTuple):
    """The headline of a log, task and association method; of filter and smoother NEES, RMSE [m] and wrong pairings.

    objection: the strongest, empty for none; strong: filter or smoother has a strong fault, trusted: one does that the
    headline says to trust.
    """

    shape: str
    seed: int
    fault: str
    task: str
    association: str
    verdict: str
    objection: str
    tick: bool
    strong: bool
    trusted: bool
    nees_filter: float
    nees_smoother: float
    rmse_filter: float
    rmse_smoother: float
    wrong_filter: float
    wrong_smoother: float
    seconds: float


def cases(sound: int, faulty: int, first: int = 0) -> list[Case]:
    """Logs over all shapes and faults in turn; each with both tasks (faults of the map: one) and methods."""
    shapes, faults, logs = list(SHAPES), list(FAULTS), []
    for i in range(max(sound, faulty)):
        shape = shapes[i % len(shapes)]
        logs += [(shape, first + i, "")] if i < sound else []
        logs += [(shape, FAULTY + first + i, faults[i % len(faults)])] if i < faulty else []
    return [
        Case(shape, seed, fault, task, method)
        for shape, seed, fault in logs
        for task in ("localization", "slam")
        for method in METHODS
        if not fault or (task in FAULTS[fault].tasks and not (FAULTS[fault].labels and method != "known"))
    ]


def measured(log: Log, run: Run | None) -> tuple[float, float, float, bool]:
    """Mean NEES, RMSE [m], share of wrong pairings, and whether that is a strong fault."""
    truth = log.truth.pose
    assert truth is not None
    if run is None or run.failure is not None:
        return math.nan, math.nan, math.nan, True
    path = run.trajectory(run.phases[0])
    e = se2.pose_error(path.pose, truth)
    try:
        nees = float(np.mean(np.einsum("ni,ni->n", e, np.linalg.solve(path.covariance, e[..., None])[..., 0])))
    except np.linalg.LinAlgError:
        nees = math.nan
    rmse, counts = float(np.sqrt(np.mean(np.sum(e[:, :2] ** 2, axis=1)))), confusion_of(run, log, "final")
    pairs = 0 if counts is None else counts.fp + counts.tp
    wrong = counts.fp / pairs if counts is not None and pairs else math.nan
    extent = float(np.hypot(*np.ptp(truth[:, :2], axis=0)))
    return nees, rmse, wrong, not (nees <= NEES and rmse <= LOST * extent) or wrong >= WRONG


def one(case: Case) -> Row:
    """The headline of a case, by the path of `slamref run`."""
    begin = time.perf_counter()
    log = make(case.shape, case.seed, case.fault or None)
    trial = trial_of(log, case.task, case.association)
    f = judge(trial)
    found = [measured(log, next((r for r in trial.runs if r.estimator == name), None)) for name in ("ekf", "batch")]
    strong = [each[3] for each in found]
    about = {Verdict.SMOOTHER: strong[1:], Verdict.FILTER: strong[:1]}.get(f.verdict, strong)
    objection = f.objections[0].objection.value if f.objections else ""
    (a, b), tick = found, trust_mark(f).tone == "good"
    return Row(
        **case._asdict(),
        verdict=f.verdict.value,
        objection=objection,
        tick=tick,
        strong=any(strong),
        trusted=any(about),
        nees_filter=a[0],
        nees_smoother=b[0],
        rmse_filter=a[1],
        rmse_smoother=b[1],
        wrong_filter=a[2],
        wrong_smoother=b[2],
        seconds=time.perf_counter() - begin,
    )


def report(rows: Sequence[Row]) -> str:
    """The tables: sound logs, then logs with a strong fault, and which ticks are over which."""
    sound = [r for r in rows if not r.fault]
    groups = [(t, m) for m in METHODS for t in ("localization", "slam", "both")]
    lines: list[list[object]] = []
    for task, method in groups:
        own = [r for r in sound if r.association == method and task in (r.task, "both")]
        against = [r for r in own if r.objection]
        right = sum(r.strong for r in against)
        filters = sum(r.verdict == Verdict.FILTER for r in own)
        lines.append([method, task, share(len(against), len(own)), right, share(filters, len(own))])
        lines[-1].append(counted(r.objection for r in against))
    heads: Sequence[str] = (
        "association",
        "task",
        "objects",
        "of these strong",
        "filter preferred",
        "objections",
    )
    text = "## Sound logs\n\n" + table(heads, lines)
    lines = []
    for task, method in groups:
        own = [r for r in rows if r.fault and r.strong and r.association == method and task in (r.task, "both")]
        trusted = [r for r in own if r.trusted]
        ticks = sum(r.tick for r in own)
        lines.append([method, task, share(ticks, len(own)), share(sum(r.tick for r in trusted), len(trusted))])
    heads = ("association", "task", "ticks", "ticks where the trusted one has it")
    text += "\n\n## Strong faults\n\n" + table(heads, lines)
    lines = []
    for fault in FAULTS:
        own = [r for r in rows if r.fault == fault]
        strong = [r for r in own if r.strong]
        over = [f"{r.shape}:{r.seed} {r.task} {r.association}" for r in strong if r.tick]
        lines.append([fault, len(own), len(strong), sum(bool(r.objection) for r in strong), len(over), "; ".join(over)])
    heads = ("fault", "runs", "strong", "objected", "ticks", "where")
    return text + "\n\n" + table(heads, lines)


def study(out: Path, wanted: Sequence[Case], jobs: int) -> None:
    """Run what is missing, then print the tables, and write them beside the rows."""
    rows = done_all(wanted, one, Row, out / "headlines.csv", jobs)
    text = report(rows)
    (out / "headlines.md").write_text(text + "\n", encoding="utf-8")
    print(text, flush=True)

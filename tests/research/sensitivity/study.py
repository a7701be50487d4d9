"""The study of sensitivity: each case as it is, then once for every constant that it reads, halved and doubled.

Rows are in a CSV that an interrupted study goes on with. In the end: what each constant does to decisions, errors and
maps.
"""

from __future__ import annotations

import hashlib
import math
import time
from collections.abc import Iterable, Iterator, Sequence
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
from joblib import Parallel, delayed
from threadpoolctl import threadpool_limits

from data.log import Log
from data.result import Run
from data.worlds.registry import named_log
from eval.referee.errors import position_distance, rms
from eval.referee.plausibility import judged
from eval.referee.score import confusion_of
from eval.replay.frontend import FrontEnd
from eval.replay.recorder import Observer
from eval.replay.run import step_by_step
from eval.replay.settings import HINDSIGHT
from tests.research.sensitivity.cases import (
    DIRECTIONS,
    DOUBLED,
    HALVED,
    SLAM,
    Case,
    Constant,
    all_constants,
    changed,
    is_world,
    load,
    reads,
    recorded,
    setup,
    text,
    varied,
    written,
)
from tests.research.variety.measure import LIMIT, SLOW, OutOfTimeError

BASE = "base"
"""In place of a direction: nothing is changed."""


class Row(NamedTuple):
    """One run.

    log, task: the case; constant, direction: what was changed, to `value`; readings: of the log; rmse_m: of the online
    positions, NaN without truth or end; fp, fn: final decisions, of `readings`; landmarks: in the map in the end;
    same: 1 if every decision, online and final, is that of the baseline; digest: of these; seconds: of the
    processor; status: that of the run, or `slow`; reads: of the baseline, how often it read each constant.
    """

    log: str
    task: str
    constant: str
    direction: str
    value: str
    readings: int
    rmse_m: float
    fp: int
    fn: int
    landmarks: int
    same: int
    digest: str
    seconds: float
    status: str
    reads: str = ""


def line_of(row: Row, place: str) -> str:
    """A row as a line of text; `place`: of how many it is."""
    what = BASE if row.direction == BASE else f"{row.constant} {row.direction} ({row.value})"
    return (
        f"{place:>12s} {row.log:18s} {row.task:12s} {what:44s} RMSE {row.rmse_m:8.3f} m, FP {row.fp:5d},"
        f" FN {row.fn:5d}, landmarks {row.landmarks:4d}, {'same' if row.same else 'other'} decisions,"
        f" {row.seconds:6.1f} s, {row.status}"
    )


NAMED_LIMIT = 300.0
"""s of processor time that a run on a named log has; on a world of the variety it is the limit there, ..."""
TIMES_BASE = 5.0
"""... and in any case so many times what the baseline took."""


class Job(NamedTuple):
    """A case, and what is changed: the name of a constant and a direction; the baseline has none."""

    case: Case
    constant: str
    direction: str


class Outcome(NamedTuple):
    """What a run came to: see `Row`."""

    rmse_m: float
    fp: int
    fn: int
    landmarks: int
    digest: str
    seconds: float
    status: str


class Deadline(Observer):
    """Ends a replay at the first frame that begins too late, by the time of the processor: others may be busy here."""

    def __init__(self, seconds: float) -> None:
        self._end = time.process_time() + seconds

    def moved(self, front: FrontEnd) -> None:
        """A frame begins."""
        if time.process_time() > self._end:
            raise OutOfTimeError


def run(log: Log, task: str, limit: float = math.inf) -> Outcome:
    """The decider on a log, with the constants as they are now; EKF, default gates, labels withheld."""
    inputs = log.inputs()
    if task == SLAM:
        inputs = inputs.without_map()
    begin = time.process_time()
    try:
        with threadpool_limits(1):
            done = step_by_step("ekf", inputs, task, HINDSIGHT, setup(), observer=Deadline(limit))
    except OutOfTimeError:
        return Outcome(math.nan, 0, 0, 0, "", time.process_time() - begin, SLOW)
    seconds = time.process_time() - begin
    (done,) = judged([done], inputs)
    truth, outcomes = log.truth.pose, confusion_of(done, log, "final")
    known = truth is not None and done.failure is None
    rmse = rms(position_distance(done.trajectory("online").pose, truth)) if truth is not None and known else math.nan
    fp, fn = (0, 0) if outcomes is None else (outcomes.fp, outcomes.fn)
    landmarks = 0 if done.map is None else len(done.map)
    return Outcome(rmse, fp, fn, landmarks, digest(done), seconds, done.status)


def digest(done: Run) -> str:
    """Of all decisions, online and final, and of the landmarks that they initialized."""
    h = hashlib.blake2b(digest_size=8)
    for decisions in (done.decisions, done.final_decisions, done.created):
        h.update(decisions.tobytes())
    return h.hexdigest()


def baseline(case: Case, log: Log) -> Row:
    """A case with nothing changed, and which constants it reads."""
    with recorded() as counts:
        found = run(log, case.task, _limit(case))
    return _row(log, Job(case, "", BASE), "", found, 1)._replace(reads=written(counts))


def variant(job: Job, log: Log, base: Row) -> Row:
    """A case with one constant changed."""
    constant = _by_name()[job.constant]
    value = varied(constant, job.direction)
    with changed(constant, value):
        found = run(log, job.case.task, max(_limit(job.case), TIMES_BASE * base.seconds))
    return _row(log, job, text(value), found, int(found.digest == base.digest))


def _row(log: Log, job: Job, value: str, o: Outcome, same: int) -> Row:
    n = len(log.recorded.observations.frame)
    return Row(
        *job.case, job.constant, job.direction, value, n, o.rmse_m, o.fp, o.fn, o.landmarks, same, o.digest, o.seconds,
        o.status,
    )  # fmt: skip


def _limit(case: Case) -> float:
    return LIMIT if is_world(case.log) else NAMED_LIMIT


def jobs_of(base: Row, constants: Sequence[Constant]) -> list[Job]:
    """The runs that a case needs beside its baseline; none where that had no end in time."""
    case = Case(base.log, base.task)
    return [
        Job(case, c.name, direction)
        for c in constants
        if base.status != SLOW and reads(c, base.task, base.reads)
        for direction in DIRECTIONS
        if varied(c, direction) is not None
    ]


def measure_all(
    cases: Sequence[Case],
    constants: Sequence[Constant],
    done: Sequence[Row],
    data: Path | None = None,
    processes: int = 1,
) -> Iterator[tuple[str, Row]]:
    """What is not done yet, each row as it comes, with its place among all that are left: `3 of 20`."""
    base = {Case(r.log, r.task): r for r in done if r.direction == BASE}
    first = [(Job(case, "", BASE), None) for case in cases if case not in base]
    for place, row in _placed(first, data, processes):
        base[Case(row.log, row.task)] = row
        yield place, row
    known = {(r.log, r.task, r.constant, r.direction) for r in done}
    left = [job for case in cases for job in jobs_of(base[case], constants)]
    left = [job for job in left if (*job.case, job.constant, job.direction) not in known]
    yield from _placed([(job, base[job.case]) for job in left], data, processes)


def _placed(jobs: Sequence[tuple[Job, Row | None]], data: Path | None, processes: int) -> Iterator[tuple[str, Row]]:
    """Runs in this process, or in several: one by one in the order of the cases, so that each loads a log once."""
    found: Iterable[Row]
    if processes == 1:
        found = (do(job, base, data) for job, base in jobs)
    else:
        pool = Parallel(n_jobs=processes, return_as="generator_unordered", batch_size=1)
        found = pool(delayed(do)(job, base, data) for job, base in jobs)
    for i, row in enumerate(found, 1):
        yield f"{i} of {len(jobs)}", row


def do(job: Job, base: Row | None, data: Path | None) -> Row:
    """One run, in any process."""
    _warm()
    log = load(job.case.log, data)
    return baseline(job.case, log) if base is None else variant(job, log, base)


@cache
def _warm() -> None:
    """Load compiled code, so that it is not counted."""
    log = named_log("arena:0:frames=20")
    for task in ("slam", "localization"):
        run(log, task)


@cache
def _by_name() -> dict[str, Constant]:
    return {c.name: c for c in all_constants()}


RMSE_LITTLE = 0.1
"""A change of the RMSE by less than this part, up or down, is little; ..."""
COUNTS_LITTLE = 0.02
"""... and one of FP and landmarks together by less than this share of the readings."""
NOT_READ, NO_RESULT, LITTLE, MATTERS = "not read", "no result", "little", "matters"


class Effect(NamedTuple):
    """What one run with a changed constant has beside the baseline.

    rmse: RMSE by that of the baseline; 1 where neither has one, infinite where the run lost its end, 0 where it won
    one; fp: change as a share of the readings; landmarks: change of their number; counts: change of both, as a share of
    the readings.
    """

    row: Row
    rmse: float
    fp: float
    landmarks: int
    counts: float

    @property
    def little(self) -> bool:
        """Whether it is next to nothing."""
        within = 1.0 / (1.0 + RMSE_LITTLE) <= self.rmse <= 1.0 + RMSE_LITTLE
        return within and self.counts <= COUNTS_LITTLE


class Summary(NamedTuple):
    """A constant in the study.

    logs: cases that read it; runs, needed: done, and how many it takes; halved, doubled: cases whose decisions change;
    effects: of all runs; says: the class.
    """

    constant: Constant
    logs: int
    runs: int
    needed: int
    halved: int
    doubled: int
    effects: tuple[Effect, ...]
    says: str


def effect(row: Row, base: Row) -> Effect:
    """A run beside its baseline."""
    n = max(row.readings, 1)
    fp, landmarks = row.fp - base.fp, row.landmarks - base.landmarks
    if row.status != base.status:
        rmse = math.inf if base.status == "ok" else 0.0
    elif math.isnan(row.rmse_m) or math.isnan(base.rmse_m) or row.rmse_m == base.rmse_m:
        rmse = 1.0
    else:
        rmse = row.rmse_m / base.rmse_m if base.rmse_m > 0.0 else math.inf
    return Effect(row, rmse, fp / n, landmarks, (abs(fp) + abs(landmarks)) / n)


def summaries(rows: Sequence[Row], constants: Sequence[Constant]) -> list[Summary]:
    """Every constant over all cases of the rows, in its order."""
    base = {Case(r.log, r.task): r for r in rows if r.direction == BASE}
    found = []
    for c in constants:
        effects = tuple(
            effect(r, base[Case(r.log, r.task)])
            for r in rows
            if r.constant == c.name and r.direction != BASE and Case(r.log, r.task) in base
        )
        logs = sum(reads(c, b.task, b.reads) for b in base.values())
        needed = sum(len(jobs_of(b, [c])) for b in base.values())
        half, twice = (sum(e.row.direction == d and not e.row.same for e in effects) for d in DIRECTIONS)
        found.append(Summary(c, logs, len(effects), needed, half, twice, effects, _class(logs, effects)))
    return found


def _class(logs: int, effects: Sequence[Effect]) -> str:
    if not logs:
        return NOT_READ
    if not all(e.little for e in effects):
        return MATTERS
    return NO_RESULT if all(e.row.same for e in effects) else LITTLE


def table(found: Sequence[Summary]) -> list[str]:
    """The summaries as lines of a Markdown table, and how many constants there are of each class."""
    lines = [
        "| constant | value | halved | doubled | logs | decisions change, halved | doubled | RMSE ratio, median |"
        " least | most | FP, least [% of readings] | most | landmarks, least | most | class |",
        "|---|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|---|",
    ]
    for s in found:
        half, twice = ("–" if (v := varied(s.constant, d)) is None else text(v) for d in (HALVED, DOUBLED))
        says = s.says if s.runs >= s.needed else f"{s.says} ({s.runs} of {s.needed} runs)"
        lines.append(
            f"| `{s.constant.name}` | {text(s.constant.value)} | {half} | {twice} | {s.logs} | {s.halved} |"
            f" {s.doubled} | {_changes(s)} | {says} |"
        )
    number = {says: sum(s.says == says for s in found) for says in (MATTERS, LITTLE, NO_RESULT, NOT_READ)}
    return [*lines, "", ", ".join(f"{says}: {count}" for says, count in number.items())]


def _changes(s: Summary) -> str:
    """Median of the RMSE ratio over runs whose decisions changed, and extremes over all runs."""
    if not s.effects:
        return " | ".join("–" * 7)
    rmse, other = [e.rmse for e in s.effects], [e.rmse for e in s.effects if not e.row.same]
    fp, landmarks = [100.0 * e.fp for e in s.effects], [e.landmarks for e in s.effects]
    return (
        f"{np.median(other) if other else 1.0:.3f} | {min(rmse):.2f} | {max(rmse):.2f} | {min(fp):+.1f} |"
        f" {max(fp):+.1f} | {min(landmarks):+d} | {max(landmarks):+d}"
    )

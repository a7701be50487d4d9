"""The runs of the study: each case as it is, then once for every constant that it reads, halved and doubled."""

from __future__ import annotations

import hashlib
import math
import time
from collections.abc import Iterable, Iterator, Sequence
from functools import cache
from pathlib import Path
from typing import NamedTuple

from joblib import Parallel, delayed
from threadpoolctl import threadpool_limits

from association.decide import HINDSIGHT
from data.log import Log
from data.result import Run
from data.worlds.registry import named_log
from eval.benchmarks.sensitivity.cases import Case, is_world, load
from eval.benchmarks.sensitivity.gates import setup
from eval.benchmarks.sensitivity.reading import reads, recorded, written
from eval.benchmarks.sensitivity.rows import BASE, Row
from eval.benchmarks.sensitivity.varying import DIRECTIONS, SLAM, Constant, all_constants, changed, text, varied
from eval.benchmarks.variety.measure import LIMIT, SLOW, OutOfTimeError
from eval.referee.errors import position_distance, rms
from eval.referee.score import confusion_of
from eval.replay.frontend import FrontEnd
from eval.replay.observer import Nobody
from eval.replay.plausible import judged
from eval.replay.run import step_by_step

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
    """What a run came to: see `rows.Row`."""

    rmse_m: float
    fp: int
    fn: int
    landmarks: int
    digest: str
    seconds: float
    status: str


class Deadline(Nobody):
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
    *,
    only_base: bool = False,
) -> Iterator[tuple[str, Row]]:
    """What is not done yet, each row as it comes, with its place among all that are left: `3 of 20`."""
    base = {Case(r.log, r.task): r for r in done if r.direction == BASE}
    first = [(Job(case, "", BASE), None) for case in cases if case not in base]
    for place, row in _placed(first, data, processes):
        base[Case(row.log, row.task)] = row
        yield place, row
    if only_base:
        return
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

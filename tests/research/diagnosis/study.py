"""Validation of the diagnosis without ground truth: rejection rate on sound logs, detection and causes of faults.

A log is simulated, a fault injected (or a broken filter run), twins are drawn, and the log is judged as any other; its
truth is not used. Every log's twins have random numbers of their own, so logs are independent. `python -m
tests.research diagnosis OUT` judges what is not kept in OUT, and writes the tables of `tables.py`.
"""

from __future__ import annotations

import hashlib
import json
import math
import zlib
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from data.errors import UsageError
from data.log import Log
from data.notice import Notice
from data.result import Run
from data.whole import whole_file
from data.words import sentence
from data.worlds import registry
from eval.compare import compare
from eval.plan.flags.table import Execution
from eval.plan.work import Job, cached
from eval.referee.attribution import ESTIMATOR, NOTHING
from eval.referee.consistency import gated, nis_bounds
from eval.referee.score import nis_of
from eval.replay.settings import Setup
from eval.studies import store
from eval.studies.diagnosis import judged
from eval.studies.sampled import Sample, one_twin, sample_of, smoother_of, twin_sample
from eval.studies.twins import Source, inputs_of, source_of, twin
from tests.research.diagnosis.broken import BROKEN
from tests.research.diagnosis.faults import FAULTS

STREAM = 0xFA017  # separates the faults' random numbers from those of logs and twins of the same seed
SOUND = ""  # the fault of a sound log
KNOWN = "known"


@dataclass(frozen=True)
class World:
    """A simulated world and the task in it; `values` differ from its defaults."""

    name: str
    kind: str
    task: str
    values: tuple[tuple[str, object], ...] = ()

    def parameters(self) -> Any:
        """Of the simulator. Raises UsageError for values that it refuses."""
        return registry.parameters_of(self.kind)(**dict(self.values))

    def simulate(self, seed: int) -> Log:
        """The log of a seed."""
        return registry.simulate(self.kind, self.parameters(), seed, f"{self.name}:{seed}")


@dataclass(frozen=True)
class Validation:
    """One study."""

    name: str  # of the tables
    worlds: tuple[World, ...]  # for the false-rejection rate, `runs` logs each
    runs: int
    twins: int  # of each log
    power: str  # name of the world for the power, `power_runs` logs for each fault and size
    power_runs: int
    faults: tuple[str, ...] = tuple(FAULTS)  # of logs
    broken: tuple[str, ...] = tuple(BROKEN)  # broken filters
    estimators: tuple[str, ...] = ("ekf",)  # on logs and twins, in addition to batch
    setup: Setup = field(default_factory=Setup)


TRUST = Validation(
    "trust",
    (
        World("arena", "arena", "slam"),
        World("corridor", "corridor", "slam"),
        World("circle", "circle", "slam", (("frames", 400),)),  # of 2500, so that the study takes no more than an hour
    ),
    200,
    39,
    "arena",
    20,
)
SHORT = Validation(
    "short",
    (
        World("arena-slam", "arena", "slam", (("frames", 80),)),
        World("arena-localization", "arena", "localization", (("frames", 80),)),
        World("circle-slam", "circle", "slam", (("frames", 120),)),
    ),
    200,
    39,
    "arena-slam",
    0,
)
STUDIES = {study.name: study for study in (TRUST, SHORT)}


@dataclass(frozen=True)
class Case:
    """One log: `fault` of `size`, or all broken filters one after the other (`broken`)."""

    world: World
    seed: int
    fault: str = SOUND
    size: float = 0.0
    broken: tuple[tuple[str, float], ...] = ()


@dataclass(frozen=True)
class Examined:
    """The judgement of one log."""

    world: str
    seed: int
    fault: str  # `SOUND`, one of a log, or a broken filter
    size: float
    p: float = math.nan  # smallest family-wise p value
    objected: bool = False  # whether the battery rejects
    cause: str = NOTHING  # its attribution
    found: tuple[str, ...] = ()  # kinds and names of the findings, the strongest first
    nis: bool = False  # whether the NIS of filter or smoother is outside its 95 % bounds
    convicted: bool = False  # whether an estimator is inconsistent on the twins, in NEES or NIS
    failure: str = ""  # why there is no judgement; empty otherwise


def cases(study: Validation, first: int) -> list[Case]:
    """All logs of a study, seeds from `first` on."""
    result = [Case(w, first + i) for w in study.worlds for i in range(study.runs)]
    world = next(w for w in study.worlds if w.name == study.power)
    for i in range(study.power_runs):
        for name in study.faults:
            result += [Case(world, first + i, name, size) for size in FAULTS[name].sizes]
        if study.broken:
            each = [(n, s) for n in study.broken for s in BROKEN[n].sizes]
            result.append(Case(world, first + i, broken=tuple(each)))
    return result


def examined(study: Validation, case: Case) -> tuple[Examined, ...]:
    """The judgement of one log, or of each broken filter on it."""
    with threadpool_limits(1):  # logs are done in parallel
        return _with_broken(study, case) if case.broken else (_with_fault(study, case),)


def log_of(case: Case) -> Log:
    """The log of a case, with its fault."""
    log = case.world.simulate(case.seed)
    if case.fault == SOUND:
        return log
    stream = np.random.default_rng([case.seed, STREAM, zlib.crc32(case.fault.encode())])
    return FAULTS[case.fault].put_in(log, case.size, stream)


def twin_seeds(study: Validation, case: Case) -> range:
    """Seeds of a log's twins; logs of one world share none."""
    return range(case.seed * study.twins, (case.seed + 1) * study.twins)


def _with_fault(study: Validation, case: Case) -> Examined:
    log, task = log_of(case), case.world.task
    inputs = inputs_of(log, task, KNOWN)
    runs = compare(inputs, task, (*study.estimators, "batch"), KNOWN, study.setup)
    smoother = smoother_of(runs, inputs)
    about = (case.world.name, case.seed, case.fault, case.size)
    if smoother is None:
        return Examined(*about, failure="every filter failed")
    try:
        source = source_of(log, smoother, study.estimators, study.setup)
    except UsageError as why:
        return Examined(*about, failure=str(why))
    real = sample_of(log, task, KNOWN, runs, smoother)
    twins = [one_twin(source, seed) for seed in twin_seeds(study, case)]
    return _concluded(about, log, task, runs, real, twins, smoother)


def _with_broken(study: Validation, case: Case) -> tuple[Examined, ...]:
    """Each broken filter in place of `ekf`, on the log and on its twins; twins and smoother are the same for all."""
    log, task = case.world.simulate(case.seed), case.world.task
    source, smoother, real = _broken_on(None, log, case, study)
    abouts = [(case.world.name, case.seed, name, size) for name, size in case.broken]
    if source is None:
        return tuple(Examined(*about, failure="batch failed") for about in abouts)
    twins = [_broken_on(source, twin(source, seed), case, study)[2] for seed in twin_seeds(study, case)]
    result = []
    for i, about in enumerate(abouts):
        runs, sample = real[i]
        result.append(_concluded(about, log, task, runs, sample, [t[i][1] for t in twins], smoother))
    return tuple(result)


def _broken_on(
    source: Source | None, log: Log, case: Case, study: Validation
) -> tuple[Source | None, Run | None, list[tuple[list[Run], Sample]]]:
    """Broken filters on a log (`source` None) or on a twin: the source of its twins, the smoother, runs and samples."""
    task = case.world.task
    inputs = inputs_of(log, task, KNOWN)
    smoother = smoother_of(runs := compare(inputs, task, ("ekf", "batch"), KNOWN, study.setup), inputs)
    if smoother is None or smoother.flaw is not None:
        return None, None, []
    if source is None:
        source = source_of(log, smoother, study.estimators, study.setup)
    result = []
    for name, size in case.broken:
        runs = [BROKEN[name].run(inputs, task, size), smoother]
        result.append((runs, twin_sample(source, log, runs, smoother)))
    return source, smoother, result


def _concluded(
    about: tuple[str, int, str, float],
    log: Log,
    task: str,
    runs: Sequence[Run],
    real: Sample,
    twins: Sequence[Sample],
    smoother: Run | None,
) -> Examined:
    if real.failures:
        return Examined(*about, failure="; ".join(f"{n} failed ({why})" for n, why in real.failures.items()))
    blame = judged(log, task, KNOWN, real, twins, smoother).blame
    if blame is None:
        return Examined(*about, failure="too few twins")
    found = tuple(f"{f.kind} {f.name}" for f in blame.findings)
    convicted = any(f.cause == ESTIMATOR for f in blame.findings)
    return Examined(*about, blame.p, bool(blame.objected), blame.cause, found, nis_out(runs), convicted)


def nis_out(runs: Sequence[Run]) -> bool:
    """Whether the NIS of a filter or smoother is outside its 95 % chi-square bounds."""
    for run in runs:
        total = nis_of(run, run.phases[0])
        if run.failure is None and total is not None and total[1] > 0:
            lower, upper = nis_bounds(total[1], gated(run, run.phases[0]))
            if not lower <= total[0] / total[1] <= upper:
                return True
    return False


def save(path: Path, found: Sequence[Examined]) -> None:
    """Keep the result of a case; the file is written atomically."""
    with whole_file(path) as partial:
        partial.write_bytes(json.dumps([asdict(e) for e in found]).encode())


def load(path: Path) -> tuple[Examined, ...] | None:
    """A kept result; None if it is missing or damaged."""
    try:
        rows = json.loads(path.read_bytes())
        names = {f.name for f in fields(Examined)}
        if not all(set(row) == names for row in rows):
            return None
        return tuple(Examined(**{**row, "found": tuple(row["found"])}) for row in rows)
    except (FileNotFoundError, ValueError, TypeError, AttributeError):
        return None


def results(study: Validation, out: Path, seed: int, jobs: int) -> list[Examined]:
    """The judgements of all logs, in the order of `cases`; what is kept in `out` is not done again.

    Raises UsageError if a log runs out of memory.
    """

    def lost(case: Case, why: Notice) -> None:
        raise UsageError(f"{case}: {sentence(why)}")

    texts = [(Path(__file__).parent / name).read_bytes() for name in ("study.py", "faults.py", "broken.py")]
    content = hashlib.sha256(repr((study.twins, study.estimators, study.setup, texts)).encode()).hexdigest()
    folder, every = store.kept_folder(out, study.name, content), cases(study, seed)
    work = [(Job(case, examined, (study, case)), folder / file_of(case)) for case in every]
    kept = cached(work, load, save, Execution(jobs=jobs), lost, lambda i, n: print(f"{i} of {n} logs", flush=True))
    return [e for case in every for e in kept[case]]


def file_of(case: Case) -> str:
    """File name of a case: world, fault, digest of its other settings, and seed."""
    what = "broken" if case.broken else case.fault or "sound"
    digest = hashlib.sha256(repr((case.world, case.size, case.broken)).encode()).hexdigest()[: store.DIGITS]
    return f"{case.world.name}-{what}-{digest}-{case.seed}.json"

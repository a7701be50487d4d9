"""Validation of the test battery: rejection rate on sound logs, detection and attribution of faults.

A log is simulated, a fault injected (or a broken filter run), twins are drawn, and the log is judged as any other; its
truth is not used. Every log's twins have random numbers of their own, so logs are independent.

Studies are TOML files with `study = "validation"` at the top and checked keys.
"""

from __future__ import annotations

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
from data.result import Run
from data.toml_table import TomlTable, load_toml
from data.whole import whole_file
from data.worlds import registry
from data.worlds.registry import SIMULATORS
from eval.compare import compare
from eval.referee import truth_free
from eval.referee.attribution import ESTIMATOR, NOTHING
from eval.referee.consistency import gated, nis_bounds
from eval.referee.score import nis_of
from eval.replay.settings import TASKS, Setup
from eval.studies.broken import BROKEN
from eval.studies.diagnosis import FEWEST, judged
from eval.studies.faults import FAULTS
from eval.studies.sampled import Sample, one_twin, sample_of, smoother_of, twin_sample
from eval.studies.scenario import paragraph, parameters, parameters_of_kind
from eval.studies.shipped import path_of
from eval.studies.twins import Source, inputs_of, source_of, twin

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

    name: str  # in the tables; `source`: a shipped name or a file; `about`: one paragraph
    source: str
    about: str
    worlds: tuple[World, ...]  # for the false-rejection rate, `runs` logs each
    runs: int
    twins: int  # of each log
    power: str  # name of the world for the power, `power_runs` logs for each fault and size
    power_runs: int
    faults: tuple[str, ...] = tuple(FAULTS)  # of logs
    broken: tuple[str, ...] = tuple(BROKEN)  # broken filters
    estimators: tuple[str, ...] = ("ekf",)  # on logs and twins, in addition to batch
    setup: Setup = field(default_factory=Setup)
    largest: bool = False  # only the largest size of each fault


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
            result += [Case(world, first + i, name, size) for size in _sizes(FAULTS[name].sizes, study.largest)]
        if study.broken:
            each = [(n, s) for n in study.broken for s in _sizes(BROKEN[n].sizes, study.largest)]
            result.append(Case(world, first + i, broken=tuple(each)))
    return result


def _sizes(sizes: Sequence[float], largest: bool) -> Sequence[float]:
    return sizes[-1:] if largest else sizes


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
    smoothed = truth_free.of_smoother(smoother, inputs)
    result = []
    for name, size in case.broken:
        runs = [BROKEN[name].run(inputs, task, size), smoother]
        result.append((runs, twin_sample(source, log, runs, smoother, smoothed)))
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


VALIDATION = "validation"
VALIDATION_KEYS = {
    "": ("study", "name", "about", "runs", "twins", "worlds", "power"),
    "power": ("world", "runs", "faults", "broken"),
}
"""Keys of each table; those of a world are `kind`, `name`, `task` and the parameters of its kind."""


def load_validation(name: str) -> Validation | None:
    """A validation study, shipped or by file; None if the file is missing or of another kind of study.

    Raises UsageError for an error in it.
    """

    def fault(what: str) -> UsageError:
        return UsageError(f"--scenario {name}: {what}")

    path = path_of(name)
    table = load_toml(path, fault) if path.is_file() else {}
    if table.get("study") is None:
        return None
    top = TomlTable(fault, table, VALIDATION_KEYS)
    top.one_of("study", (VALIDATION,))
    worlds = tuple(_world(t) for t in top.tables_of("worlds"))
    names = [w.name for w in worlds]
    if not worlds or len(set(names)) < len(names):
        raise fault("[[worlds]]: at least one is needed, and none of the same name")
    power = top.optional_table("power")
    if power is None:
        power = TomlTable(fault, {"runs": 0}, {})
    try:
        for world in worlds:
            world.parameters()
    except UsageError as wrong:  # the simulator's own checks, before anything runs
        raise fault(str(wrong)) from None
    where = power.one_of("world", names, names[0])
    task = worlds[names.index(where)].task
    fitting = tuple(name for name, broken in BROKEN.items() if task in broken.tasks)
    return Validation(
        name=top.text("name", path.stem),
        source=name,
        about=paragraph(top.text("about")),
        worlds=worlds,
        runs=top.whole("runs", 200, least=1),
        twins=top.whole("twins", 39, least=FEWEST),
        power=where,
        power_runs=power.whole("runs", 20, least=0),
        faults=power.names("faults", tuple(FAULTS), tuple(FAULTS)),
        broken=power.names("broken", fitting, fitting),
    )


def _world(table: TomlTable) -> World:
    kind = table.one_of("kind", tuple(SIMULATORS))
    own = ("kind", "name", "task")
    checked = TomlTable(table.fault, table.table, {"worlds": (*own, *parameters_of_kind(kind))}, "worlds")
    values = {key: value for key, value in checked.table.items() if key not in own}
    return World(
        name=checked.text("name", kind),
        kind=kind,
        task=checked.one_of("task", TASKS, "slam"),
        values=parameters(TomlTable(table.fault, values, {}, "worlds"), kind),
    )

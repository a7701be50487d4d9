"""Scenarios, TOML files as in `eval/scenarios`: a world, estimators, declarations about them, and published numbers."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, fields, replace
from functools import partial
from typing import Any

import numpy as np

from data.errors import UsageError, did_you_mean
from data.log import Log
from data.motion.priors import AUTO, PRIORS, systematic
from data.se2 import Array
from data.toml_table import Fault, TomlTable, finite, load_toml, not_negative
from data.truth_windows import scored
from data.worlds import registry
from data.worlds.registry import SIMULATORS, parameters_of
from eval.referee.consistency import QUANTITIES
from eval.replay.external.adapter import load
from eval.replay.external.spec import entry_points, is_foreign, name_of, one_settled, own_or_foreign, settled, shown
from eval.replay.flag import read_values, rows
from eval.replay.settings import ESTIMATORS, TASKS, Setup, check_gates
from eval.studies.shipped import path_of, scenarios

PUBLISHABLE = (*(f"nees_{q}" for q in QUANTITIES), "rmse_position_m", "rmse_heading_deg")
OWN = "own"  # a function of the user's makes the logs


@dataclass(frozen=True)
class Row:
    """A published number with the standard error of its Monte Carlo (0: unknown)."""

    estimator: str
    quantity: str
    value: float
    se: float


@dataclass(frozen=True)
class Published:
    """Published numbers of a scenario, and the definition of their averages."""

    rows: tuple[Row, ...] = ()
    skipped_are_zero: bool = False  # frames before the scenario's first count as zeros in the average NEES
    per_dof: bool = False  # NEES divided by its degrees of freedom
    note: str = ""  # for the reader

    def average(self, nees: Array, dof: int, from_frame: int) -> float:
        """Average NEES (N,) of a run by this definition; NaN if a step in the average has none."""
        used = nees[from_frame:]
        total = float(used.sum()) / (dof if self.per_dof else 1)
        return total / (len(nees) if self.skipped_are_zero else len(used)) if len(used) else math.nan


@dataclass(frozen=True)
class Member:
    """An estimator of a scenario."""

    name: str  # of ours, or the settled text of a foreign one
    must_be_consistent: tuple[str, ...] = ()  # tasks in which it is declared consistent
    world: tuple[tuple[str, object], ...] = ()  # parameters of what it is given, never of what happened


@dataclass(frozen=True)
class Scenario:
    """One study."""

    name: str  # in every table; `source`: a shipped name or a file
    source: str
    about: str  # description, one paragraph
    cite: str  # its reference
    runs: int  # their default number
    task: tuple[str, ...]  # every estimator runs with each task and association method
    association: tuple[str, ...]
    members: tuple[Member, ...]  # the estimators
    kind: str  # the simulator
    values: tuple[tuple[str, object], ...]
    maker: str = ""  # of a world of the user's: the settled text of a function that makes the log of a seed
    setup: Setup = field(default_factory=Setup)  # gates and the like
    from_frame: int = 0  # first frame whose NEES counts (an exact start has singular covariances)
    wrong: float = 0.0  # share of observations whose label names another landmark
    rates: tuple[float, ...] = ()  # of an outlier study: each becomes a scenario with `wrong` set
    part: bool = False  # whether this is one
    published: Published | None = None  # numbers to compare with

    @property
    def estimators(self) -> tuple[str, ...]:
        """Names of the members, as in tables."""
        return tuple(name_of(m.name) for m in self.members)

    def declared(self, task: str, estimator: str) -> bool:
        """Whether the exit status depends on this estimator."""
        return any(task in m.must_be_consistent for m in self.members if name_of(m.name) == estimator)

    def world(self, changed: tuple[tuple[str, object], ...] = ()) -> Any:
        """Parameters of the simulator, some of them changed."""
        return registry.parameters_of(self.kind)(**{**dict(self.values), **dict(changed)})

    def simulate(self, seed: int, changed: tuple[tuple[str, object], ...] = ()) -> Log:
        """The log of a seed, under the scenario's name; wrong labels are the same for every estimator."""
        log = self._made(seed) if self.maker else self._simulated(seed, self.world(changed))
        if self.setup.calibrate:
            log = replace(log, recorded=replace(log.recorded, systematic=systematic(self.setup.calibrate)))
        return with_wrong_labels(log, self.wrong, seed) if self.wrong else log

    def _simulated(self, seed: int, world: Any) -> Log:
        log = registry.simulate(self.kind, world, seed, f"{self.name}:{seed}")
        return replace(log, source={**log.source, "kind": f"scenario {self.name}", self.kind: asdict(world)})

    def _made(self, seed: int) -> Log:
        """The log of a seed that a function of the user's makes. Raises UsageError if it is none."""
        log = load(self.maker).thing(seed)
        if not isinstance(log, Log):
            raise UsageError(f"{shown(self.maker)}: it returned {type(log).__name__}; a slamref.Log is needed")
        if log.truth.pose is None:
            raise UsageError(f"{shown(self.maker)}: log {log.name} has no truth; a study needs it in every frame")
        return replace(scored(log), name=f"{self.name}:{seed}", source={**log.source, "kind": f"scenario {self.name}"})

    def parts(self) -> tuple[Scenario, ...]:
        """An outlier study as one scenario for each rate; a calibrating one also without calibrating and declaring."""
        if self.setup.calibrate and not self.part:
            plain = replace(
                self, name=f"{self.name}:plain", members=tuple(replace(m, must_be_consistent=()) for m in self.members),
                setup=replace(self.setup, calibrate=()), part=True,
            )  # fmt: skip
            return (plain, replace(self, name=f"{self.name}:calibrated", part=True))
        if not self.rates:
            return (self,)
        return tuple(replace(self, name=f"{self.name}:{r:g}", wrong=r, rates=(), part=True) for r in self.rates)

    def only(self, estimators: tuple[str, ...]) -> Scenario:
        """The same with these estimators; members keep declarations and parameters."""
        own = {m.name: m for m in self.members}
        return replace(self, members=tuple(own.get(name, Member(name)) for name in estimators))


def with_wrong_labels(log: Log, rate: float, seed: int) -> Log:
    """The log with a share of its labels naming another landmark, drawn from a stream of its own. Rates are nested: a
    label wrong at one rate is wrong in the same way at every higher one.
    """
    true_id = log.truth.landmark_of
    if true_id is None or log.truth.landmarks is None:
        raise UsageError(f"{log.name}: wrong labels need true ones, and this log has none")
    rng = np.random.default_rng(np.random.SeedSequence([seed, 0x0BAD1D]))
    chosen = (rng.random(len(true_id)) < rate) & (true_id >= 0)
    ids = log.truth.landmarks.id
    shift = rng.integers(1, len(ids), len(true_id))
    row = np.searchsorted(ids, np.maximum(true_id, ids[0]))
    return replace(log, label=np.where(chosen, ids[(row + shift) % len(ids)], true_id))


CONSISTENT = "consistent"
SCENARIO_KEYS = {
    "": (
        *("name", "about", "cite", "runs", "task", "association", "estimators", "world", "setup", "from_frame"),
        *("wrong", "published"),
    ),
    "estimators": ESTIMATORS,
    "setup": tuple(rows(Setup)),
    "published": ("skipped_are_zero", "per_dof", "row", "note"),
    "published.row": ("estimator", "quantity", "value", "se", "note"),
}  # keys of each table; those of a world are the parameters of its kind


def load_scenario(name: str) -> Scenario:
    """A shipped scenario by name or any by file. Raises UsageError for an error in it."""
    path = path_of(name)
    if not path.is_file():
        known = scenarios()
        names = ", ".join((*known, "or all"))
        raise UsageError(f"--scenario {name}: no such file{did_you_mean(name, known)}; shipped: {names}")

    def fault(what: str) -> UsageError:
        return UsageError(f"--scenario {name}: {what}")

    top = TomlTable(fault, load_toml(path, fault), SCENARIO_KEYS)
    stated = top.optional_table("setup")
    with _named(fault):
        setup = Setup() if stated is None else _setup(stated)
    made = _scenario(top, setup, name, path.stem)
    if made.maker:
        load(made.maker)
    else:
        with _named(fault):  # the simulator's own checks, before anything runs
            for m in made.members:
                made.world(m.world)
    return made


@contextmanager
def _named(fault: Fault, less: str = "") -> Iterator[None]:
    """Add the name of the file, or of the key, to an error; `less`: how the error begins without it."""
    try:
        yield
    except UsageError as wrong:
        raise fault(str(wrong).removeprefix(less)) from None


def _scenario(top: TomlTable, setup: Setup, source: str, stem: str) -> Scenario:
    task = top.names("task", TASKS, ("slam",))
    maker, kind, values = _maker(top), OWN, tuple[tuple[str, object], ...]()
    if not maker:
        world = top.table_of("world", _world_keys(top))
        values = parameters(world, kind := world.one_of("kind", SIMULATORS))
    # names of ours, of installed packages, and possibly foreign ones, which `_member` settles
    stated, added = top.table.get("estimators"), entry_points("estimator")
    theirs = [key for key in (stated if isinstance(stated, dict) else ()) if is_foreign(key) or key in added]
    estimators = top.table_of("estimators", (*ESTIMATORS, *theirs))
    members = tuple(_member(estimators, name, task, kind) for name in estimators.table)
    if not members:
        raise top.error("estimators", "at least one is needed")
    return Scenario(
        name=top.text("name", stem), source=source, about=paragraph(top.text("about")),
        cite=paragraph(top.text("cite", "")), runs=top.whole("runs", 100, least=1), task=task,
        association=_associations(top), members=members, kind=kind, values=values, maker=maker, setup=setup,
        from_frame=top.whole("from_frame", 0, least=0), rates=_rates(top),
        published=_published(top.table_of("published"), members) if "published" in top else None,
    )  # fmt: skip


def _maker(top: TomlTable) -> str:
    """The settled text of a function that makes logs, as in `world = "./mine.py:make"`; empty for a world of ours."""
    stated = top.table.get("world")
    if not isinstance(stated, str):
        return ""
    with _named(partial(top.error, "world"), "world = "):
        return settled("world =", stated, "world")


def _associations(top: TomlTable) -> tuple[str, ...]:
    given = top.table.get("association", ["known"])
    if not isinstance(given, list):
        raise top.error("association", "a list is needed")
    with _named(partial(top.error, "association"), "association = "):
        found: tuple[str, ...] = own_or_foreign("association", least=1)("association =", given)
    return found


def paragraph(text: str) -> str:
    """Text of several lines as one paragraph."""
    return " ".join(text.split())


def _rates(top: TomlTable) -> tuple[float, ...]:
    if "wrong" not in top:
        return ()
    what = "shares from 0 to below 1, ascending, are"
    rates = top.numbers("wrong", None, what, lambda share: 0.0 <= share < 1.0).tolist()
    if rates != sorted(set(rates)):
        raise top.error("wrong", f"{what} needed")
    return tuple(rates)


def _world_keys(top: TomlTable) -> tuple[str, ...]:
    """Keys of [world] for its kind; any, if that is unknown or missing."""
    table = top.table.get("world")
    if not isinstance(table, dict):
        return ()
    kind = str(table.get("kind"))
    return ("kind", *parameters_of_kind(kind)) if kind in SIMULATORS else tuple(table)


def parameters_of_kind(kind: str) -> tuple[str, ...]:
    """Parameters of a world of a kind."""
    return () if kind == OWN else tuple(f.name for f in fields(parameters_of(kind)))


def parameters(table: TomlTable, kind: str) -> tuple[tuple[str, object], ...]:
    """Checked parameters of a world; angles in degrees are converted."""
    keys = [key for key in table.table if key != "kind"]
    if kind == OWN:
        return tuple((key, table.table[key]) for key in keys)
    known = {f.name: f for f in fields(parameters_of(kind))}
    result: list[tuple[str, object]] = []
    for key in keys:
        default = known[key].default
        if isinstance(default, bool):
            result.append((key, table.flag(key)))
        elif isinstance(default, int):
            result.append((key, table.whole(key, default)))
        elif isinstance(default, str):
            result.append((key, table.text(key)))
        else:
            value = table.number(key, None, "a finite number", finite)
            result.append((key, math.radians(value) if known[key].metadata.get("unit") == "deg" else value))
    return tuple(result)


def _member(estimators: TomlTable, name: str, task: tuple[str, ...], kind: str) -> Member:
    table = estimators.table_of(name, ("must_be", "task", "world"))
    if table.table.get("must_be", CONSISTENT) != CONSISTENT:
        raise table.error("must_be", f"only {CONSISTENT!r} can be demanded")
    tasks = table.names("task", task, task)
    world = table.optional_table("world", parameters_of_kind(kind))
    with _named(partial(estimators.error, name), ": "):
        text = one_settled("", name, "estimator")
    return Member(text, tasks if "must_be" in table else (), () if world is None else parameters(world, kind))


def _setup(table: TomlTable) -> Setup:
    setup = Setup(**read_values(Setup, table.table, lambda row: f"[setup] {row.name} ="))
    check_gates(setup.gate, setup.new_gate, ("gate =", "[setup] new_gate ="))
    if setup.calibrate == (AUTO,):
        raise UsageError(f"[setup] calibrate = {AUTO}: a scenario names the errors, of {', '.join(PRIORS)}")
    return setup


def _published(table: TomlTable, members: tuple[Member, ...]) -> Published:
    known = tuple(name_of(m.name) for m in members)
    rows = []
    for row in table.tables_of("row"):
        estimator, quantity = row.one_of("estimator", known), row.one_of("quantity", PUBLISHABLE)
        value, se = row.number("value", None, "a number"), row.number("se", 0.0, "a number from 0 up", not_negative)
        rows.append(Row(estimator, quantity, value, se))
    note = paragraph(table.text("note", ""))
    return Published(tuple(rows), table.flag("skipped_are_zero"), table.flag("per_dof"), note)

"""The constants of `jcbb-hindsight` and how one is changed for the time of a run; the logs of the study.

Constants are read where they are used, as `constants.NAME` or as a global of their own module: to set the attribute of
the module is enough (a test sees to it). Kernels get them as arguments. Which ones a run reads: the module that holds
them counts every look at one of them. The gates that a person may choose are varied beside the constants. Logs are
worlds of the variety, and named logs, recorded ones where they are at hand.
"""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from types import ModuleType
from typing import NamedTuple

import association.candidates
import eval.replay.hindsight.hypotheses
import eval.replay.hindsight.two_models
from data.errors import DataError, UsageError
from data.formats.mrclam.load import Treatment, corrected_landmarks, load_mrclam
from data.formats.recordings.victoria_park import load_victoria_park
from data.inputs import Systematic
from data.log import Log
from data.worlds.registry import named_log
from eval.replay.hindsight import constants, mapper
from eval.replay.settings import Setup
from tests.research.variety.worlds import KINDS, draw, indices, log_of

GATE = Setup().gate
NEW_GATE = Setup().new_gate


def setup() -> Setup:
    """The settings of a run, with these gates as they are now."""
    return Setup(gate=GATE, new_gate=NEW_GATE)


SLAM, LOCALIZATION = "slam", "localization"
HALVED, DOUBLED = "halved", "doubled"
DIRECTIONS = (HALVED, DOUBLED)

BESIDE: tuple[tuple[ModuleType, str, tuple[str, ...]], ...] = (
    (sys.modules[__name__], SLAM, ("GATE", "NEW_GATE")),
    (association.candidates, SLAM, ("SIGMAS", "MARGIN")),
    (eval.replay.hindsight.two_models, SLAM, ("STRONG", "DECIDED")),
    (
        eval.replay.hindsight.hypotheses, LOCALIZATION,
        ("GATE", "LIMIT", "DROP", "MERGE", "ALIKE", "STRAY", "BINS", "FIRST", "DEPENDENCE", "SIGMAS", "MARGIN"),
    ),
)  # fmt: skip
"""Constants that stand beside what reads them, which is every run of one of the tasks."""

NEAR_ONE = 0.9
"""Numbers from here to 1 are probabilities near one, of gates mostly: what is halved and doubled is what they leave."""
MOST = 0.99
"""Other shares and probabilities are not doubled past this."""
NO_SHARES = frozenset({"DENSE", "MERGE", "FIT_SLACK"})
"""Numbers between `MOST` / 2 and 1 that are no shares: they may be doubled past one."""


class Constant(NamedTuple):
    """One number, or pair of numbers, that decisions may depend on.

    name: in the study; module, attribute: where it is; part: of a `Systematic`, the error's name or `length`; task:
    every run of it reads the constant; empty: which runs do is recorded.
    """

    name: str
    module: ModuleType
    attribute: str
    part: str = ""
    task: str = ""

    @property
    def value(self) -> object:
        """As it is now."""
        found = getattr(self.module, self.attribute)
        if not self.part:
            return found
        return found.length if self.part == "length" else float(found.sigma[found.names.index(self.part)])


def constants_of(module: ModuleType) -> list[str]:
    """Names of the public numbers and tuples of numbers of a module, in their order."""
    return [
        name
        for name, value in vars(module).items()
        if name.isupper() and not name.startswith("_") and all(_is_number(v) for v in _elements(value))
    ]


def all_constants() -> list[Constant]:
    """Every constant of the decider: those of `eval.replay.hindsight.constants`, then those that stand beside."""
    found = [Constant(name, constants, name) for name in constants_of(constants)]
    for module, task, names in BESIDE:
        last = "gates" if module is sys.modules[__name__] else module.__name__.rpartition(".")[2]
        found += [Constant(f"{last}.{name}", module, name, task=task) for name in names]
    parts = (*mapper.TIGHT.names, "length")
    return found + [Constant(f"TIGHT.{part}", mapper, "TIGHT", part, SLAM) for part in parts]


def chosen(names: Sequence[str] | None) -> list[Constant]:
    """Those of these names, or all. Raises UsageError for a name that is not one of them."""
    every = all_constants()
    unknown = [n for n in names or () if n not in {c.name for c in every}]
    if unknown:
        raise UsageError(f"{unknown[0]} is no constant of jcbb-hindsight; one is {every[0].name}")
    return [c for c in every if names is None or c.name in names]


def varied(constant: Constant, direction: str) -> object:
    """Its value halved or doubled; None where that is the value itself.

    Of a probability near one its complement is halved or doubled. Integers are rounded down, and at least 1. Tuples:
    each element.
    """
    before = constant.value
    after = tuple(_varied(v, direction, constant.name not in NO_SHARES) for v in _elements(before))
    if after == _elements(before):
        return None
    return after if isinstance(before, tuple) else after[0]


def _varied(value: float, direction: str, share: bool) -> float:
    """One number."""
    factor = 0.5 if direction == HALVED else 2.0
    if isinstance(value, int):
        return max(1, value // 2) if direction == HALVED else 2 * value
    if NEAR_ONE <= value < 1.0:
        return 1.0 - factor * (1.0 - value)
    if share and direction == DOUBLED and 0.5 * MOST < value < 1.0:
        return MOST
    return factor * value


@contextmanager
def changed(constant: Constant, value: object) -> Iterator[None]:
    """The constant has another value; afterwards its old one, whatever happened."""
    before = getattr(constant.module, constant.attribute)
    setattr(constant.module, constant.attribute, _with_part(before, constant.part, value))
    try:
        yield
    finally:
        setattr(constant.module, constant.attribute, before)


def _with_part(before: object, part: str, value: object) -> object:
    if not part:
        return value
    assert isinstance(before, Systematic)
    assert isinstance(value, float)
    if part == "length":
        return replace(before, length=value)
    sigma = before.sigma.copy()
    sigma[before.names.index(part)] = value
    return replace(before, sigma=sigma)


def text(value: object) -> str:
    """A value as it stands in the file and the table."""
    return " ".join(f"{v:.8g}" for v in _elements(value))


def _elements(value: object) -> tuple[float, ...]:
    return value if isinstance(value, tuple) else (value,)


def _is_number(value: object) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)


SIMULATED = "corridor:0:people"
VICTORIA_PARK = "victoria-park"
VARIETY, UTIAS = "variety", "utias"
DATASETS, ROBOT = (1, 6, 9), 3
"""Of UTIAS, and the robot of each that is run."""


class Case(NamedTuple):
    """A log by its name, and the task."""

    log: str
    task: str


def world_name(index: int) -> str:
    """Of a world of the variety."""
    return f"{VARIETY}-{index:03d}"


def is_world(log: str) -> bool:
    """Whether a log is one of the variety."""
    return log.startswith(f"{VARIETY}-")


def worlds(half: str, count: int | None) -> list[Case]:
    """Those of a half, or some of them: of the three kinds in turn, those with the fewest readings first."""
    every = indices(half, 10**6)
    if count is None or count >= len(every):
        return [Case(world_name(i), SLAM) for i in every]
    size = {i: len(log_of(draw(i)).recorded.observations.frame) for i in every} if count else {}
    return [Case(world_name(i), SLAM) for i in fewest(size, count)]


def fewest(size: Mapping[int, int], count: int) -> list[int]:
    """Indices of `count` worlds, ascending, of the three kinds in turn those of the least size."""
    by_kind = [sorted((i for i in size if draw(i).name.startswith(kind)), key=lambda i: (size[i], i)) for kind in KINDS]
    order = sorted((rank, kind, i) for kind, of in enumerate(by_kind) for rank, i in enumerate(of))
    return sorted(i for _, _, i in order[:count])


def named(data: Path | None) -> tuple[list[Case], list[str]]:
    """The named logs, and a line for each that is not at hand; `data`: folder with the zips of UTIAS."""
    cases, missing = [Case(SIMULATED, SLAM)], []
    try:
        load_victoria_park()
        cases.append(Case(VICTORIA_PARK, SLAM))
    except DataError as why:
        missing.append(f"left out: {VICTORIA_PARK} ({why})")
    for number in DATASETS:
        if archive(data, number) is None:
            where = "no --data" if data is None else f"not in {data}"
            missing.append(f"left out: UTIAS Dataset {number} ({where})")
            continue
        cases += [Case(f"{UTIAS}-{number}-{ROBOT}", task) for task in (SLAM, LOCALIZATION)]
    return cases, missing


def archive(data: Path | None, number: int) -> Path | None:
    """The zip of a UTIAS dataset in a folder or its `mrclam`, if it is there."""
    places: Sequence[Path] = [] if data is None else [data, data / "mrclam"]
    found = [p / f"MRCLAM_Dataset{number}.zip" for p in places]
    return next((p for p in found if p.is_file()), None)


@lru_cache(maxsize=2)
def load(name: str, data: Path | None) -> Log:
    """The log of a case. A process that runs case by case loads each once."""
    kind, _, rest = name.partition("-")
    if name == VICTORIA_PARK:
        return load_victoria_park()
    if kind == VARIETY:
        return log_of(draw(int(rest)))
    if kind == UTIAS:
        number, robot = (int(part) for part in rest.split("-"))
        source = archive(data, number)
        if source is None:
            raise DataError(f"UTIAS Dataset {number}: not in {data}")
        return load_mrclam(source, robot, Treatment(landmarks=corrected_landmarks(source)))
    return named_log(name)


@contextmanager
def recorded() -> Iterator[Counter[str]]:
    """How often each constant of `eval.replay.hindsight.constants` is read from here on, until the end of the block."""
    counts: Counter[str] = Counter()

    class Counting(ModuleType):
        """A module that counts what is looked up in it."""

        def __getattribute__(self, name: str) -> object:
            if name.isupper():
                counts[name] += 1
            return super().__getattribute__(name)

    before = constants.__class__
    constants.__class__ = Counting
    try:
        yield counts
    finally:
        constants.__class__ = before


def written(counts: Counter[str]) -> str:
    """The counts as one field of a file."""
    return " ".join(f"{name}={count}" for name, count in sorted(counts.items()))


def counts_in(field: str) -> dict[str, int]:
    """The counts that a field says."""
    return {name: int(count) for name, _, count in (pair.partition("=") for pair in field.split())}


def reads(constant: Constant, task: str, field: str) -> bool:
    """Whether a run of a task with these counts depends on a constant: its result is that of the baseline if not."""
    return constant.task == task if constant.task else constant.name in counts_in(field)

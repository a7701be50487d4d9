"""The constants of `jcbb-hindsight`, what half and twice of each is, and how one is changed for the time of a run.

Constants are read where they are used, as `constants.NAME` or as a global of their own module: to set the attribute of
the module is enough (a test sees to it). Kernels get them as arguments.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from types import ModuleType
from typing import NamedTuple

import association.candidates
import ekf.hypotheses
import ekf.two_models
from association.evidence import constants
from data.errors import UsageError
from data.inputs import Systematic
from eval.benchmarks.sensitivity import gates
from eval.replay.hindsight import mapper

SLAM, LOCALIZATION = "slam", "localization"
HALVED, DOUBLED = "halved", "doubled"
DIRECTIONS = (HALVED, DOUBLED)

BESIDE: tuple[tuple[ModuleType, str, tuple[str, ...]], ...] = (
    (gates, SLAM, ("GATE", "NEW_GATE")),
    (association.candidates, SLAM, ("SIGMAS", "MARGIN")),
    (ekf.two_models, SLAM, ("STRONG", "DECIDED")),
    (
        ekf.hypotheses, LOCALIZATION,
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
    """Every constant of the decider: those of `association.evidence.constants`, then those that stand beside."""
    found = [Constant(name, constants, name) for name in constants_of(constants)]
    for module, task, names in BESIDE:
        last = module.__name__.rpartition(".")[2]
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

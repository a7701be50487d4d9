"""Which constants a run reads: the module that holds them counts every look at one of them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from types import ModuleType

from association.evidence import constants
from eval.benchmarks.sensitivity.varying import Constant


@contextmanager
def recorded() -> Iterator[Counter[str]]:
    """How often each constant of `association.evidence.constants` is read from here on, until the end of the block."""
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

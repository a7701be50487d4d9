"""Which look a name that is not ours gets: the same in every figure and every process, and different for each.

A name's place follows from its letters, so that it looks the same in tomorrow's report; where two of one run would get
the same, the later one (in the order of the alphabet) moves on. That is why the names of a run are introduced.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Iterable
from typing import Any

_NAMES: list[str] = []


def introduce(names: Iterable[str]) -> None:
    """The foreign names of this run, instead of those of the last one."""
    _NAMES[:] = sorted(set(names))


def introduced() -> tuple[str, ...]:
    """The names of this run, for other processes."""
    return tuple(_NAMES)


def place(name: str, places: int) -> int:
    """Which of so many looks; no two introduced names have the same as long as there are enough."""
    taken: set[int] = set()
    for known in _NAMES:
        found = _free(known, places, taken)
        if known == name:
            return found
        taken.add(found)
    return _free(name, places, set())


def _free(name: str, places: int, taken: set[int]) -> int:
    begin = zlib.crc32(name.encode()) % places
    return next((i for k in range(places) if (i := (begin + k) % places) not in taken), begin)


def acquainted(names: tuple[str, ...], function: Callable[..., Any], arguments: tuple[Any, ...]) -> Any:
    """A call in a process that may not know the names of this run."""
    introduce(names)
    return function(*arguments)

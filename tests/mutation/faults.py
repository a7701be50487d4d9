"""What a fault of this suite is: how it is put in, and the named check that must fail while it is there."""

from __future__ import annotations

import inspect
import textwrap
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import pytest


@dataclass(frozen=True)
class Check:
    """A statement about the product, by name: `run` returns where it holds, and raises where it does not."""

    name: str
    run: Callable[[], None]


@dataclass(frozen=True)
class Fault:
    """One fault.

    Attributes:
        trap: number in the list of traps (1 to 27); None: one of the broken twins of the consistency verdicts.
        what: the fault in words.
        check: passes without the fault, fails with it.
        put_in: patches the product (or the data, where the fault lives there).
        by: what the failing check raises.
        match: what it must say, as a regular expression.
    """

    trap: int | None
    what: str
    check: Check
    put_in: Callable[[pytest.MonkeyPatch], None]
    by: type[Exception] | tuple[type[Exception], ...] = AssertionError
    match: str = ""


def interpreted(function: Any, changes: Mapping[str, str] | None = None, **instead: Any) -> Any:
    """A (compiled) function as plain Python with parts of its source changed; `instead` replaces globals it uses.

    A part that does not stand in the source exactly once is an error: the fault would no longer be the one meant.
    """
    plain = getattr(function, "py_func", function)
    source = textwrap.dedent(inspect.getsource(plain))
    source = source[source.index("def ") :]
    for old, new in (changes or {}).items():
        if source.count(old) != 1:
            raise ValueError(f"{plain.__name__}: {old!r} stands there {source.count(old)} times, not once")
        source = source.replace(old, new)
    scope = {**plain.__globals__, **instead}
    exec(compile(source, f"<{plain.__name__} with a fault>", "exec"), scope)
    return scope[plain.__name__]


def changed(target: str, changes: Mapping[str, str]) -> Callable[[pytest.MonkeyPatch], None]:
    """Put in: the function at the dotted path `target` with parts of its source changed."""

    def put_in(monkeypatch: pytest.MonkeyPatch) -> None:
        module, name = target.rsplit(".", 1)
        function = getattr(__import__(module, fromlist=[name]), name)
        monkeypatch.setattr(target, interpreted(function, changes))

    return put_in


def replaced(target: str, make: Callable[[Any], Any]) -> Callable[[pytest.MonkeyPatch], None]:
    """Put in: `make(real)` instead of what stands at the dotted path `target`."""

    def put_in(monkeypatch: pytest.MonkeyPatch) -> None:
        owner, name = target.rsplit(".", 1)
        try:
            real = getattr(__import__(owner, fromlist=[name]), name)
        except ModuleNotFoundError:  # a class of a module
            module, of = owner.rsplit(".", 1)
            real = vars(getattr(__import__(module, fromlist=[of]), of))[name]
        monkeypatch.setattr(target, make(real))

    return put_in

"""Makes foreign estimators and association methods, and reports what they lack for a run."""

from __future__ import annotations

import inspect
from collections.abc import Sequence
from dataclasses import fields, replace
from typing import Any

import numpy as np

from association.expectation import Expectation
from data.errors import UsageError
from data.inputs import IntArray
from data.result import DISCARD, NEW
from ekf.filter import DEFAULT, FilterOptions
from eval.replay.external.adapter import Adapter
from eval.replay.external.load import ForeignError, Loaded, call, load, whole
from eval.replay.external.spec import is_foreign
from eval.replay.settings import HINDSIGHT, TASKS, Given, Setup

SIGNATURES = "one of (prior, sensor, options) does SLAM, of (prior, sensor, map, options) localization"
VERBS = ("predict", "update", "estimate")  # required methods


class CannotError(Exception):
    """An estimator lacks what this run needs; the others go on."""


def estimator(text: str, given: Given, options: FilterOptions | None = None) -> Adapter:
    """A fresh foreign estimator. Raises ForeignError if its constructor crashes."""
    loaded, options = load(text), options or DEFAULT
    beginning = (given.prior, given.sensor) if given.map is None else (given.prior, given.sensor, given.map)
    return Adapter(loaded.name, call(f"{loaded.name}()", loaded.thing, *beginning, options), given.map)


def tasks_of(loaded: Loaded) -> tuple[str, ...]:
    """Its tasks, from its attribute `tasks`, or else from the number of arguments of its constructor.

    Raises UsageError: neither is given, or it lacks a required method.
    """
    missing = [v for v in VERBS if isinstance(loaded.thing, type) and not callable(getattr(loaded.thing, v, None))]
    if missing:
        raise UsageError(f"{loaded.name}: no method {missing[0]!r}; an estimator has {', '.join(VERBS)} at least")
    stated: Any = getattr(loaded.thing, "tasks", None)
    if stated is not None:
        tasks = (stated,) if isinstance(stated, str) else tuple(stated)
        if not tasks or set(tasks) - set(TASKS):
            raise UsageError(f"{loaded.name}.tasks is {stated!r}; some of {', '.join(TASKS)} are needed")
        return tasks
    try:
        parameters = inspect.signature(loaded.thing).parameters.values()
    except (TypeError, ValueError):
        return TASKS
    if any(p.kind is p.VAR_POSITIONAL for p in parameters):
        return TASKS
    count = sum(p.kind in (p.POSITIONAL_ONLY, p.POSITIONAL_OR_KEYWORD) for p in parameters)
    if count not in (3, 4) or any(p.kind is p.KEYWORD_ONLY and p.default is p.empty for p in parameters):
        takes = f"({', '.join(p.name for p in parameters)})"
        raise UsageError(f"{loaded.name}: its constructor takes {takes}; {SIGNATURES}; see docs/extending.md")
    return ("slam",) if count == 3 else ("localization",)


def lack(text: str, task: str, association: str, setup: Setup) -> str | None:
    """Reason why a foreign estimator cannot do a run, in a sentence; None if it can.

    `association` is a name of ours, or any other text.
    """
    loaded = load(text)
    tasks = tasks_of(loaded)
    if task not in tasks:
        how = "by its attribute tasks" if hasattr(loaded.thing, "tasks") else f"by its constructor: {SIGNATURES}"
        return f"{loaded.name} does {tasks[0]} only, {how}"
    if not isinstance(loaded.thing, type):
        return None
    needed: dict[str, str] = {}
    slam = task == "slam"
    if association == HINDSIGHT:
        needed = dict.fromkeys(("remove", "merge") if slam else ("expect", "reset"), f"--association {HINDSIGHT}")
    elif association != "known":
        needed["expect"] = "any --association but known"
    smooths = bool(getattr(loaded.thing, "smooths", False))
    if slam and (setup.maintain or (setup.forget_after is not None and not smooths)):
        needed.setdefault("remove", "--maintain" if setup.maintain else "--forget-after")
    if slam and setup.deactivate_after is not None and not smooths:
        needed |= dict.fromkeys(("park", "restore", "parked_xy"), "--deactivate-after")
    for verb, why in needed.items():
        if not callable(getattr(loaded.thing, verb, None)):
            return f"{loaded.name} has no `{verb}`, which {why} needs"
    return None


def able(names: Sequence[str], task: str, association: str, setup: Setup) -> list[str]:
    """Names of estimators, ours or foreign, that lack nothing."""
    return [n for n in names if not is_foreign(n) or lack(n, task, association, setup) is None]


def require(text: str, task: str, association: str, setup: Setup) -> None:
    """Raises CannotError if anything is lacking."""
    why = lack(text, task, association, setup)
    if why is not None:
        raise CannotError(why)


class Method:
    """A foreign association method; `NEW` founds a landmark only outside the gate of new ones, as with our plain
    methods.
    """

    def __init__(self, loaded: Loaded) -> None:
        """Use `loaded.thing`; a class is instantiated once, without arguments, and then called."""
        self.name = loaded.name  # in tables
        thing = loaded.thing
        self._function = call(f"{self.name}()", thing) if isinstance(thing, type) else thing

    def __call__(self, expectation: Expectation, gate: float | None) -> IntArray:
        """Decisions (m,): landmark number, `NEW` or `DISCARD`.

        Raises ForeignError: it crashed, or returned no decisions.
        """
        m = len(expectation.z)
        found: IntArray = whole(self.name, call(self.name, self._function, expectation, gate), m, "what it returned")
        known = np.isin(found, expectation.number) | (found == NEW) | (found == DISCARD)
        if not known.all():
            i = int(np.argmin(known))
            raise ForeignError(
                f"{self.name}: decision {found[i]} about observation {i} names no candidate; the number of one, "
                f"NEW ({NEW}) or DISCARD ({DISCARD}) is needed"
            )
        return found


def locked(e: Expectation) -> Expectation:
    """The same expectation with read-only arrays."""
    views: dict[str, Any] = {f.name: v.view() for f in fields(e) if isinstance(v := getattr(e, f.name), np.ndarray)}
    for view in views.values():
        view.setflags(write=False)
    return replace(e, **views)

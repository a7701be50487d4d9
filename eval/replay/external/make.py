"""A foreign estimator is constructed exactly as ours; before that, whether it can do what is asked of it."""

from __future__ import annotations

import inspect
from collections.abc import Sequence
from typing import Any

from data.errors import UsageError
from ekf.filter import DEFAULT, FilterOptions
from eval.replay.foreign.adapter import Adapter
from eval.replay.foreign.guard import call
from eval.replay.foreign.load import Loaded, load
from eval.replay.foreign.spec import is_foreign
from eval.replay.given import Given
from eval.replay.names import TASKS
from eval.replay.settings import Setup

SIGNATURES = "one of (prior, sensor, options) does SLAM, of (prior, sensor, map, options) localization"
HINDSIGHT = "jcbb-hindsight"
VERBS = ("predict", "update", "estimate")
"""What it must have."""


class CannotError(Exception):
    """An estimator lacks what this run needs of it; the others go on."""


def estimator(text: str, given: Given, options: FilterOptions | None = None) -> Adapter:
    """A fresh one, among ours. Raises ForeignError if its constructor crashes."""
    loaded, options = load(text), options or DEFAULT
    beginning = (given.prior, given.sensor) if given.map is None else (given.prior, given.sensor, given.map)
    return Adapter(loaded.name, call(f"{loaded.name}()", loaded.thing, *beginning, options), given.map)


def tasks_of(loaded: Loaded) -> tuple[str, ...]:
    """What it can do: its attribute `tasks`, or else by how many arguments its constructor takes.

    Raises:
        UsageError: neither says so, or it lacks a verb that every estimator has.
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
    """What a foreign estimator lacks for a run, in a sentence; None if nothing.

    `association` is a name of ours, or any other text.
    """
    loaded = load(text)
    tasks = tasks_of(loaded)
    if task not in tasks:
        how = "says its attribute tasks" if hasattr(loaded.thing, "tasks") else f"by its constructor: {SIGNATURES}"
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
    """Those of some names, ours among them, that lack nothing."""
    return [n for n in names if not is_foreign(n) or lack(n, task, association, setup) is None]


def require(text: str, task: str, association: str, setup: Setup) -> None:
    """Raises CannotError if anything is lacking."""
    why = lack(text, task, association, setup)
    if why is not None:
        raise CannotError(why)

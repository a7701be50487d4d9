"""A lab's settings, kept in its report: `step` and `play` take them for the lab's logs, so that all counts agree."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from eval.plan.flags.table import DEFAULT_ESTIMATORS, Options
from eval.referee.score import Trial
from eval.replay.flag import rows
from eval.replay.settings import Setup

TABLE = rows(Options)
# what a lab does not state for its logs: it runs all of them with and without maintenance
SETTINGS = tuple(name for name in rows(Setup) if name not in ("maintain", "calibrate"))


def settings_by_log(options: Options, trials: Sequence[Trial]) -> dict[str, dict[str, object]]:
    """The settings of a lab by log, as values of flags: those that are not the default, tasks and methods always."""
    if options.selection.lab is None:
        return {}
    stated = {name: TABLE[name].of(options) for name in SETTINGS}
    shared = {name: _plain(value) for name, value in stated.items() if value != TABLE[name].default}
    found: dict[str, dict[str, object]] = {}
    for trial in (t for t in trials if t.variant_of is None):
        own = found.setdefault(trial.log.name, {"task": [], **_methods(trial, options), **shared})
        own["task"] = [*_list(own["task"]), trial.task]
    return found


def _methods(trial: Trial, options: Options) -> dict[str, object]:
    """Association methods, and the estimators that ran with each of them."""
    ran: dict[str, list[str]] = {}
    for run in trial.runs:
        if run.association != "none":
            ran.setdefault(run.association, []).append(run.estimator)
    groups, stated = list(ran.values()), options.selection.estimator
    shared = [e for e in groups[0] if all(e in g for g in groups)]
    return {"association": list(ran), "estimator": shared if stated == DEFAULT_ESTIMATORS else list(stated)}


def _plain(value: object) -> object:
    return "none" if value is None else list(value) if isinstance(value, tuple) else value


def _list(value: Any) -> list[str]:
    return list(value)

"""A lab's settings, kept in its report: `step` and `play` take them for the lab's logs, so that all counts agree."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from data.errors import UsageError
from data.log import Log
from eval.plan.flags.table import DEFAULT_ESTIMATORS, Options
from eval.plan.provenance import input_digest
from eval.referee.score import Trial
from eval.replay.flag import rows
from eval.replay.settings import Setup

REPORT = Path("results/report")
"""Where a lab's report is, unless `--report` names another folder."""
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


def settings_of_lab(log: Callable[[], Log], report: Path | None) -> dict[str, object]:
    """The settings of the lab whose report is in a folder, if the lab ran on this very log; else none.

    `log` opens it, and is called only if there is a lab's report.

    Raises:
        UsageError: a folder was named (`report`), and holds no lab with this log.
    """
    try:
        kept = json.loads(((report or REPORT) / "provenance.json").read_text(encoding="utf-8"))
        lab, inputs = kept.get("lab", {}), kept.get("inputs", {})
    except (OSError, ValueError, AttributeError):
        lab, inputs = {}, {}  # no report, or not one of ours
    if lab:
        opened = log()
        if opened.name in lab and inputs[opened.name]["sha256"] == input_digest(opened):
            return dict(lab[opened.name])
    if report is not None:
        raise UsageError(f"--report {report}: no lab ran on this log there; `slamref lab NAME --out {report}` runs one")
    return {}


def settings_line(own: Options, taken: Options, report: Path | None) -> str:
    """The settings that differ from the command's `own` in flags; blank if none does."""
    words = [w for row in TABLE.values() if row.of(taken) != row.of(own) for w in row.words(row.of(taken))]
    return f"settings of the lab in {report or REPORT}: {' '.join(words)}" if words else ""

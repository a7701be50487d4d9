"""Decisions that were revised: how many, why, and one example for the report."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from data.log import folder_name
from data.result import DISCARD, NEW, Event, Run
from data.terminal.words import counted
from eval.figures.revision import Example, revision_figure
from eval.figures.style import save
from eval.page.document import Picture, Section, written_table
from eval.plan.flags.options import Options
from eval.referee.score import Trial
from eval.replay.hindsight.ledger import MERGED, PAIRED_ANEW, UNREAD

LATE = ("uncertain", "put off until the end", PAIRED_ANEW, UNREAD)
"""Reasons that only say that the log was over."""
COLUMNS = (
    *("deciding for", "pairings undone", "made instead", "put off, then made", "landmarks merged", "retracted"),
    "paired anew at the end",
)
CAPTION = (
    "Decisions revised in hindsight. Undone: a pairing given up, made instead: another one put in its place; put off,"
    " then made: an observation used only later; merged: a landmark that turned out to be another one; retracted: one"
    " that was never there; paired anew at the end: observations that another landmark of the smoothed map explains, or"
    " none of it."
)


def groups(run: Run) -> dict[tuple[int, str], list[Event]]:
    """Events by frame and reason, in order."""
    found: dict[tuple[int, str], list[Event]] = {}
    for e in run.events:
        found.setdefault((e.frame, e.why), []).append(e)
    return found


def example(run: Run) -> Example | None:
    """The revision that shows most: landmarks merged or pairings made anew before others, then the longest."""
    shown = {key: events for key, events in groups(run).items() if key[1] not in LATE}
    if not shown:
        return None

    def weight(key: tuple[int, str]) -> tuple[bool, int, int]:
        events = shown[key]
        return key[1] == MERGED, sum(e.old >= 0 and e.new >= 0 for e in events), len(events)

    frame, why = max(shown, key=lambda key: (*weight(key), -key[0]))
    events = shown[frame, why]
    rows, old, new = (np.array(x, np.int64) for x in zip(*[(e.observation, e.old, e.new) for e in events], strict=True))
    # the observation that initialized a landmark is known by its number
    old = np.where(old == NEW, run.created[rows], old)
    if np.all(new == DISCARD):
        most = old == np.argmax(np.bincount(old[old >= 0]))
        rows, old, new = rows[most], old[most], new[most]
    return Example(frame, why, rows, old, new)


def tally(run: Run) -> dict[str, str]:
    """A row of the table: counts, and the reasons why landmarks left the map."""
    anew = {e.observation for e in run.events if e.why == PAIRED_ANEW}
    on_the_way = [e for e in run.events if e.why != PAIRED_ANEW]
    undone = [e for e in on_the_way if e.old >= 0]
    initializing = [e for e in on_the_way if e.old == NEW]
    why = Counter(e.why for e in initializing if e.new == DISCARD)
    reasons = f" ({', '.join(f'{n} {w}' for w, n in sorted(why.items()))})" if why else ""
    counts = (
        len(undone),
        sum(e.new >= 0 for e in undone),
        sum(e.old == DISCARD and e.new >= 0 for e in on_the_way),
        sum(e.new >= 0 for e in initializing),
    )
    cells = [*(str(c) for c in counts), f"{why.total()}{reasons}", str(len(anew))]
    return dict(zip(COLUMNS[1:], cells, strict=True))


def revising(trial: Trial) -> list[tuple[Run, str]]:
    """A run for each set of revisions, with the names of all estimators that share it."""
    found: list[tuple[Run, list[str]]] = []
    for run in trial.runs:
        if not run.events:
            continue
        same = [names for other, names in found if other.events == run.events]
        if same:
            same[0].append(run.estimator)
        else:
            found.append((run, [run.estimator]))
    return [(run, ", ".join(names)) for run, names in found]


def revision_section(folder: Path, options: Options, trials: Sequence[Trial]) -> list[Section]:
    """What was taken back on all logs, and a picture of one example each; nothing where nothing was."""
    rows, pictures = [], []
    for trial in trials:
        for run, names in revising(trial):
            rows.append({"log": trial.log.name, "task": trial.task, COLUMNS[0]: names, **tally(run)})
        picture = None if options.no_plots else _picture(folder, options, trial)
        pictures += [] if picture is None else [picture]
    if not rows:
        return []
    table = written_table(pd.DataFrame(rows), folder, "revisions", CAPTION, options)
    return [Section("Decisions taken back", (table, *pictures), 3)]


def _picture(folder: Path, options: Options, trial: Trial) -> Picture | None:
    """One example of a trial: of a run that knows its whole path in the end, if there is one."""
    runs = [run for run, _ in revising(trial) if run.flaw is None]
    known = [r for r in trial.runs if r.events and r.flaw is None and r.final is not None]
    run = next(iter([*known, *runs]), None)
    one = None if run is None else example(run)
    if run is None or one is None:
        return None
    name = f"{folder_name(trial.log.name)}-{trial.task}-revision"
    save(revision_figure(trial.log, run, one), folder / "figures", name, ("png",) if options.quick else ("pdf", "png"))
    numbers = counted(len(np.unique(one.old[one.old >= 0])), "landmark")
    return Picture(
        name,
        f"`{trial.log.name}`, {trial.task}, {run.estimator}: what frame {one.frame} revised ({one.why}):"
        f" {counted(len(one.rows), 'sighting')} of {numbers}. Left: sightings where the path known then puts them, with"
        " the decisions made then; right: the same with the decisions and the path in the end. Where nothing was"
        " decided instead, lines lead to the poses it was seen from, with their frames.",
        f"Sightings on {trial.log.name} before and after frame {one.frame} revised the decisions about them",
    )

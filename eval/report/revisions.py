"""Which decisions were revised: how many, why, and one example."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from data.result import DISCARD, NEW, Event, Run
from eval.figures.association import Example, revision_figure
from eval.figures.style import save
from eval.plan.flags.table import Output
from eval.referee.score import Trial
from eval.replay.hindsight.ledger import MERGED, REASSOCIATED, UNREAD
from eval.report.page.blocks import Picture, Section
from eval.report.page.files import written_table
from eval.report.rows import stem
from eval.report.words import paragraph

LATE = ("uncertain", "put off until the end", REASSOCIATED, UNREAD)  # reasons that only say that the log was over
COLUMNS = (
    *("deciding for", "undone", "replaced", "deferred, then paired", "landmarks merged", "retracted"),
    "final re-association",
)


def example(run: Run) -> Example | None:
    """The revision that shows most: landmarks merged or pairings made anew before others, then the longest."""
    shown: dict[tuple[int, str], list[Event]] = {}
    for e in (e for e in run.events if e.why not in LATE):
        shown.setdefault((e.frame, e.why), []).append(e)
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
    anew = {e.observation for e in run.events if e.why == REASSOCIATED}
    on_the_way = [e for e in run.events if e.why != REASSOCIATED]
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


def revision_section(folder: Path, wanted: Output, trials: Sequence[Trial]) -> list[Section]:
    """What was taken back on all logs, and a picture of one example each; nothing where nothing was."""
    rows, pictures = [], []
    for trial in trials:
        for run, names in revising(trial):
            rows.append({"log": trial.log.name, "task": trial.task, COLUMNS[0]: names, **tally(run)})
        picture = None if wanted.no_plots else _picture(folder, trial, quick=wanted.quick)
        pictures += [] if picture is None else [picture]
    if not rows:
        return []
    table = written_table(pd.DataFrame(rows), folder, "revisions", paragraph("deciding#revisions"), wanted)
    return [Section("Revised decisions", (table, *pictures), facts=rows, page="revisions")]


def _picture(folder: Path, trial: Trial, *, quick: bool) -> Picture | None:
    """One example of a trial: of a run that knows its whole path in the end, if there is one."""
    runs = [run for run, _ in revising(trial) if run.flaw is None]
    known = [r for r in trial.runs if r.events and r.flaw is None and r.final is not None]
    run = next(iter([*known, *runs]), None)
    one = None if run is None else example(run)
    if run is None or one is None:
        return None
    name, log = stem(trial, "revision"), trial.log.name
    save(revision_figure(trial.log, run, one), folder / "figures", name)
    about = {"log": log, "task": trial.task, "estimator": run.estimator, "frame": one.frame, "why": one.why}
    landmarks = len(np.unique(one.old[one.old >= 0]))
    caption = paragraph("deciding#revision", **about, observations=len(one.rows), landmarks=landmarks)
    return Picture(name, caption, paragraph("deciding#revision_alt", log=log, frame=one.frame))

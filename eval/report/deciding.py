"""How the ways of deciding without labels did, in a sentence: the best and the worst, by decisions and by path.

Decisions that were revised: how many, why, and one example for the report.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from data.log import folder_name
from data.result import DISCARD, NEW, Event, Run
from data.terminal import counted
from eval.figures.association import Example, revision_figure
from eval.figures.style import save
from eval.plan.flags.options import Options
from eval.referee.score import Trial
from eval.replay.hindsight.ledger import MERGED, PAIRED_ANEW, UNREAD
from eval.replay.settings import steps
from eval.report.page.document import Picture, Section, written_table
from eval.report.page.tables import is_blank, number
from eval.report.rows import Row, filters_in, value_of

SAME = 0.02
"""Relative difference of two RMSE values below which they are called equal."""
USABLE = 0.9
"""A way of deciding is usable whose path has less than this share of dead reckoning's error."""


def f1(row: Row) -> float:
    """Harmonic mean of precision and recall, 2 TP / (2 TP + FP + FN); NaN where nothing was or should be paired."""
    tp, wrong = value_of(row, "tp"), value_of(row, "fp") + value_of(row, "fn")
    return 2.0 * tp / (2.0 * tp + wrong) if tp + wrong > 0 else math.nan


def deciding_rows(rows: Sequence[Row], outcomes: Sequence[Row]) -> list[Row]:
    """Outcomes of the runs that decided for themselves, got to the end and are plausible, in their last phase."""
    ended = {(r["estimator"], r["association"]) for r in rows if r["status"] == "ok"}
    filters = filters_in(rows)
    deciding = [
        r
        for r in outcomes
        if r["association"] not in ("known", "none")
        and (r["estimator"], r["association"]) in ended
        and r["phase"] == ("online" if r["estimator"] in filters else "final")
    ]
    # batch smoothers take the decisions of another run, which speaks for itself where it is there
    own = [r for r in deciding if steps(str(r["estimator"]))] or deciding
    own = [r for r in own if math.isfinite(f1(r))]
    return own


def extremes(rows: Sequence[Row], outcomes: Sequence[Row]) -> tuple[Row, Row] | None:
    """The best way of deciding, by F1, of those with a usable path (of all, where none has one), and the worst."""
    own = deciding_rows(rows, outcomes)
    if not own:
        return None
    usable = [r for r in own if _usable(r, rows)] or own
    return max(usable, key=quality), min(own, key=quality)


def quality(row: Row) -> tuple[float, float]:
    """By which ways of deciding are ordered."""
    return f1(row), -value_of(row, "fp") - value_of(row, "fn")


def best_and_worst(rows: Sequence[Row], outcomes: Sequence[Row], labelled: int | None) -> str:
    """How the methods that decide for themselves did: the best and the worst, or against labels in a log without path.

    Only runs that got to the end and are plausible count: the others' decisions end with them.
    """
    own = deciding_rows(rows, outcomes)
    if not own:
        return ""
    path = any(math.isfinite(value_of(r, "rmse_position_m")) for r in rows)

    best, worst = max(own, key=quality), min(own, key=quality)
    if not path:
        return " ".join(_agreement(r, rows, labelled) for r in ([best] if best is worst else [best, worst]))
    if best is worst:
        return f"Deciding itself, {_outcome(best)}."
    if f1(best) == 0.0:
        return "Of the ways of deciding without labels none made a single right pairing."
    usable = [r for r in own if _usable(r, rows)]
    if not usable:
        least = f"{_outcome(best)} is least bad by F1{_path(best, rows)}"
        return f"Without labels no way of deciding gives a usable path; {least}."
    best = max(usable, key=quality)
    text = f"Without labels, {_outcome(best)} decides best{_path(best, rows)} and {_outcome(worst)} worst"
    nearest = min(usable, key=lambda r: _rmse(r, rows))
    if _rmse(nearest, rows) < (1.0 - SAME) * _rmse(best, rows):
        text += f"; the path is best with {_outcome(nearest)}{_path(nearest, rows)}"
    return f"{text}; even the best is mostly wrong." if f1(best) < 0.5 else f"{text}."


def _scored(row: Row, rows: Sequence[Row]) -> Row:
    """The row of metrics of the run and phase that a row of decisions is about; empty if there is none."""
    return next((r for r in rows if all(r[c] == row[c] for c in ("estimator", "association", "phase"))), {})


def _rmse(row: Row, rows: Sequence[Row]) -> float:
    return value_of(_scored(row, rows), "rmse_position_m")


def _dead_reckoned(rows: Sequence[Row]) -> float:
    """Position RMSE of dead reckoning, NaN if it did not run."""
    return next((value_of(r, "rmse_position_m") for r in rows if r["estimator"] == "dead-reckoning"), math.nan)


def _path(row: Row, rows: Sequence[Row]) -> str:
    """Its error, with that of dead reckoning where that ran."""
    own, reckoned = _rmse(row, rows), _dead_reckoned(rows)
    compared = f" where dead reckoning has {number(reckoned)} m" if math.isfinite(reckoned) else ""
    return f" (path {number(own)} m{compared})" if math.isfinite(own) else ""


def _usable(row: Row, rows: Sequence[Row]) -> bool:
    """Whether deciding so is better than not looking: not lost, and nearer to the truth than dead reckoning."""
    lost = not is_blank(_scored(row, rows).get("lost_why"))
    return not lost and not _rmse(row, rows) >= USABLE * _dead_reckoned(rows)


def _outcome(row: Row) -> str:
    counts = {c: int(value_of(row, c)) for c in ("tp", "tn", "fp", "fn")}
    numbers = f"{counts['fp']} FP and {counts['fn']} FN in {sum(counts.values())} decisions, F1 {f1(row):.2f}"
    return f"{row['association']} ({row['estimator']}: {numbers})"


def _agreement(row: Row, rows: Sequence[Row], labelled: int | None) -> str:
    """Decisions against a log's own labels, which may be wrong themselves, and the size of the map."""
    right, total = (int(sum(value_of(row, c) for c in columns)) for columns in (("tp", "tn"), ("tp", "tn", "fp", "fn")))
    text = (
        f"Deciding itself with {row['association']}, {row['estimator']} agrees with the log's labels in {right} of"
        f" {total} decisions ({100.0 * right / total:.0f} %)"
    )
    same = [r for r in rows if (r["estimator"], r["association"]) == (row["estimator"], row["association"])]
    size = value_of(same[-1], "landmarks") if same else math.nan
    if math.isfinite(size) and labelled is not None:
        text += f"; its map has {counted(int(size), 'landmark')} where the labels tell {labelled} apart"
    return text + "."


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

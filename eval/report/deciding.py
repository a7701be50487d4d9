"""How the association methods without labels did, and which decisions were revised: how many, why, and one example."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from data.result import DISCARD, NEW, Event, Run
from eval.figures.association import Example, revision_figure
from eval.figures.style import save
from eval.plan.flags.table import Output
from eval.referee.score import Trial
from eval.replay.hindsight.ledger import MERGED, REASSOCIATED, UNREAD
from eval.replay.settings import steps
from eval.report.page.blocks import Picture, Section
from eval.report.page.files import written_table
from eval.report.rows import Row, Scored, filters_in, stem, value_of
from eval.report.words import paragraph

SAME = 0.02  # relative difference of two RMSE values below which they are called equal
USABLE = 0.9  # a association method is usable whose path has less than this share of dead reckoning's error


@dataclass(frozen=True)
class MethodOutcome:
    """How a run decided without labels: outcomes in its last phase, position RMSE [m] and size of its map (or NaN)."""

    association: str
    estimator: str
    tp: int
    tn: int
    fp: int
    fn: int
    rmse: float = math.nan
    landmarks: float = math.nan
    lost: bool = False

    @property
    def decisions(self) -> int:
        """All of them."""
        return self.tp + self.tn + self.fp + self.fn

    @property
    def f1(self) -> float:
        """Harmonic mean of precision and recall, 2 TP / (2 TP + FP + FN); NaN: nothing was or should be paired."""
        wrong = self.fp + self.fn
        return 2.0 * self.tp / (2.0 * self.tp + wrong) if self.tp + wrong > 0 else math.nan

    @property
    def mostly_wrong(self) -> bool:
        """Whether more decisions about pairings are wrong than right."""
        return self.f1 < 0.5

    @property
    def quality(self) -> tuple[float, int]:
        """By which association methods are ordered."""
        return self.f1, -self.fp - self.fn


@dataclass(frozen=True)
class Deciding:
    """How the association methods without labels did on one log and task."""

    first: MethodOutcome  # first, worst: by their decisions alone, the same if there is one
    worst: MethodOutcome
    best: MethodOutcome  # by its decisions, of those with a usable path (of all, where none has one)
    usable: bool  # whether one has: not lost, and nearer to the truth than dead reckoning
    nearest: MethodOutcome | None  # whose path is clearly nearer to the truth than that of the best, if one is
    measured: bool  # whether errors of paths are known
    dead_reckoning: float  # its RMSE [m], or NaN
    labelled: int | None = None  # landmarks that the log's ids tell apart


def deciding(rows: Sequence[Scored], metrics: Sequence[Row], outcomes: Sequence[Row]) -> list[MethodOutcome]:
    """The plausible runs that decided without labels, in their last phase; `rows` are those of `metrics`, typed."""
    ended = {(r.estimator, r.association) for r in rows if r.status == "ok"}
    filters = filters_in(rows)
    by_phase = {(r.estimator, r.association, r.phase): r for r in reversed(rows)}
    sizes = {(str(r["estimator"]), str(r["association"])): value_of(r, "landmarks") for r in metrics}
    own = []
    for r in outcomes:
        estimator, association, phase = (str(r[c]) for c in ("estimator", "association", "phase"))
        last = "online" if estimator in filters else "final"
        if association in ("known", "none") or (estimator, association) not in ended or phase != last:
            continue
        tp, tn, fp, fn = (int(value_of(r, c)) for c in ("tp", "tn", "fp", "fn"))
        row, size = by_phase.get((estimator, association, phase)), sizes.get((estimator, association), math.nan)
        rmse, lost = (math.nan, False) if row is None else (row.rmse, bool(row.lost_why))
        own.append(MethodOutcome(association, estimator, tp, tn, fp, fn, rmse, size, lost))
    # batch smoothers take the decisions of another run, which speaks for itself where it is there
    own = [w for w in own if steps(w.estimator)] or own
    return [w for w in own if math.isfinite(w.f1)]


def deciding_facts(
    rows: Sequence[Scored], metrics: Sequence[Row], outcomes: Sequence[Row], labelled: int | None = None
) -> Deciding | None:
    """The best and the worst association method; None where nobody decided. Arguments as of `deciding`."""
    own = deciding(rows, metrics, outcomes)
    if not own:
        return None
    reckoned = next((r.rmse for r in rows if r.estimator == "dead-reckoning"), math.nan)
    usable = [w for w in own if not w.lost and not w.rmse >= USABLE * reckoned]
    best = max(usable or own, key=lambda w: w.quality)
    nearest = min(usable, key=lambda w: w.rmse, default=best)
    return Deciding(
        first=max(own, key=lambda w: w.quality),
        worst=min(own, key=lambda w: w.quality),
        best=best,
        usable=bool(usable),
        nearest=nearest if nearest.rmse < (1.0 - SAME) * best.rmse else None,
        measured=any(math.isfinite(r.rmse) for r in rows),
        dead_reckoning=reckoned,
        labelled=labelled,
    )


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

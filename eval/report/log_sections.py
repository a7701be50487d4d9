"""The report's sections on each log: its comparison, and the decisions made on it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import pandas as pd

from data.words import sentence
from eval.plan.calibrate import Calibration
from eval.plan.flags.options import Options
from eval.referee.diagnostics import ambiguity_of, minima, naming
from eval.referee.score import Scores, Trial
from eval.report import comparison
from eval.report.comparison import CAPTION as DIFFERENCES_CAPTION
from eval.report.comparison import FINE as DIFFERENCES_FINE
from eval.report.comparison import differences_table, missing_intervals
from eval.report.diagnostics import of_runs
from eval.report.laser import GRID_PICTURE, LOOP_PICTURE
from eval.report.names import SYSTEMATIC, stem
from eval.report.page.document import Block, Folded, Picture, Section, written_table
from eval.report.pictures import FILTER_SMOOTHER, films_of
from eval.report.results import aligned_statement
from eval.report.systematic import systematic_section
from eval.report.trust import trust_section
from eval.report.tutorials import beside_note
from eval.studies.trusted import Trust


def beside(trial: Trial, trials: Sequence[Trial]) -> tuple[Trial, ...]:
    """The trials that stand beside one."""
    if trial.beside is not None:
        return ()
    return tuple(t for t in trials if t.beside == trial.log.name and t.task == trial.task)


def rows_of(frame: pd.DataFrame, trial: Trial) -> pd.DataFrame:
    """Rows of one of the tables of `Scores` that belong to a trial."""
    return frame[(frame["log"] == trial.log.name) & (frame["task"] == trial.task)]


BESIDE, NOTES = "Rows that stand beside, and why", "Notes on the log and its runs"
"""What folded texts are called."""
ELSEWHERE = ("association", FILTER_SMOOTHER, SYSTEMATIC, GRID_PICTURE, LOOP_PICTURE)
"""Pictures that stand in a section of their own."""


def trial_sections(
    folder: Path,
    options: Options,
    trials: Sequence[Trial],
    scores: Scores,
    published: Sequence[Sequence[Picture]],
    trust: Sequence[Trust] = (),
    told: Mapping[tuple[str, str], Sequence[Block]] | None = None,
    calibrations: Sequence[Calibration] = (),
) -> list[Section]:
    """A section per log and task, with what it says about itself; a tutorial's row stands in the table of its log.

    `told`: filter and smoother in words, by log and task; they stand under the table.
    """
    sections = []
    for trial, pictures in zip(trials, published, strict=True):
        if trial.beside is not None:
            continue
        rows = rows_of(scores.metrics, trial)
        blocks: list[Block] = []
        others = beside(trial, trials)
        every = pd.concat([rows, *(rows_of(scores.metrics, t) for t in others)])
        table = comparison.comparison_table(every, aligned=True)
        wide = comparison.comparison_table(every, options.columns)
        caption = f"{trial.log.name}, {trial.task}. {comparison.COMPARISON_CAPTION}{aligned_statement(trial)}"
        name, fine = stem(trial, "comparison"), comparison.COMPARISON_FINE
        apart = tuple(i for i, status in enumerate(every["status"].tolist()) if status != "ok")
        blocks.append(written_table(table, folder, name, caption, options, for_paper=wide, fine=fine, apart=apart))
        blocks += (told or {}).get((trial.log.name, trial.task), ())
        beside_notes = [beside_note(t, rows_of(scores.metrics, t)) for t in others]
        blocks += [Folded(BESIDE, tuple(beside_notes))] if beside_notes else []
        blocks += _differences(folder, options, trial, rows_of(scores.differences, trial))
        blocks += [p for p in pictures if p.stem not in {stem(trial, kind) for kind in ELSEWHERE}]
        if options.animate:
            blocks += [film for t in (trial, *others) for film in films_of(folder, t)]
        notes = [*trial.log.notes, *(f"{r.estimator}: {sentence(n)}." for r in trial.runs for n in r.notes)]
        doubted = (*minima(trial), *(n for run in trial.runs for n in ambiguity_of(run, trial.log.recorded)))
        notes += of_runs(doubted)
        if notes:
            blocks.append(Folded(NOTES, ("\n".join(f"* {n}" for n in dict.fromkeys(notes)),)))
        sections.append(Section(f"{trial.log.name}, {trial.task}", tuple(blocks)))
        sections += systematic_section(folder, options, trial, pictures, calibrations)
        sections += trust_section(folder, options, trial, pictures, trust)
    return sections


def _differences(folder: Path, options: Options, trial: Trial, rows: pd.DataFrame) -> list[Block]:
    """Filters against smoothers on a log with truth, and why intervals are missing."""
    if not len(rows):
        return []
    name, caption = stem(trial, "differences"), f"{trial.log.name}, {trial.task}. {DIFFERENCES_CAPTION}"
    table = written_table(differences_table(rows), folder, name, caption, options, fine=DIFFERENCES_FINE)
    missing = missing_intervals(rows)
    return [table, Folded("Why intervals are missing", (missing,))] if missing else [table]


def association_sections(
    folder: Path,
    options: Options,
    trials: Sequence[Trial],
    scores: Scores,
    published: Sequence[Sequence[Picture]],
) -> list[Section]:
    """Decisions of every log where some were made without labels, and in one table the logs with labels alone."""
    head = "Data association"
    if not len(scores.association):
        return [Section(head, ("No log states which landmark each observation shows, so decisions cannot be scored.",))]
    blocks: list[Block] = []
    sections, granted = [], []
    for trial, pictures in zip(trials, published, strict=True):
        if trial.beside is not None:
            continue
        rows = pd.concat([rows_of(scores.association, t) for t in (trial, *beside(trial, trials))])
        if not (rows["association"] != "known").any():
            granted.append(rows)
            continue
        table = comparison.association_table(rows)
        name, what = stem(trial, "association"), f"{trial.log.name}, {trial.task}"
        caption = f"{what}: outcomes of the decisions, estimators with the same ones share a row."
        fine = comparison.ASSOCIATION_FINE
        written = written_table(table, folder, name, caption, options, fine=fine)
        shown = (p for p in pictures if p.stem == name)
        named = of_runs(naming(run, scores, trial.log.name) for run in trial.runs)
        notes = ["\n".join(f"* {n}" for n in named)] if named else []
        sections.append(Section(f"Decisions: {what}", (written, *notes, *shown), level=3))
    if granted and any(len(rows) for rows in granted):
        blocks.append(
            "With known association the labels decide: a wrong pairing is a wrong label, a missed one was gated out."
        )
        table = comparison.association_table(pd.concat(granted))
        caption = "Logs on which only known association was run: outcomes of the decisions."
        fine = comparison.ASSOCIATION_FINE
        blocks.append(written_table(table, folder, "association", caption, options, fine=fine))
    return [Section(head, tuple(blocks)), *sections]

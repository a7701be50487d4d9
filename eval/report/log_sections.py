"""The report's sections on each log: its comparison, and the decisions made on it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from eval.page.document import Block, Picture, Section, written_table
from eval.plan.flags.options import Options
from eval.player.write import player_of
from eval.referee.score import Scores, Trial
from eval.report import comparison
from eval.report.differences import CAPTION as DIFFERENCES_CAPTION
from eval.report.differences import differences_table, missing_intervals
from eval.report.doubt.minima import minima_statements
from eval.report.doubt.naming import naming_statements
from eval.report.films import films_of
from eval.report.laser.pictures import GRID, LOOPS
from eval.report.names import stem
from eval.report.pictures import FILTER_SMOOTHER
from eval.report.results.said import aligned_statement
from eval.report.rows import rows_of as rows_by
from eval.report.trust.sections import trust_section
from eval.report.tutorials.section import beside_note
from eval.studies.trusted import Trust


def beside(trial: Trial, trials: Sequence[Trial]) -> tuple[Trial, ...]:
    """The trials that stand beside one."""
    if trial.beside is not None:
        return ()
    return tuple(t for t in trials if t.beside == trial.log.name and t.task == trial.task)


def rows_of(frame: pd.DataFrame, trial: Trial) -> pd.DataFrame:
    """Rows of one of the tables of `Scores` that belong to a trial."""
    return frame[(frame["log"] == trial.log.name) & (frame["task"] == trial.task)]


ELSEWHERE = ("association", FILTER_SMOOTHER, GRID, LOOPS)
"""Pictures that stand in a section of their own."""


def trial_sections(
    folder: Path,
    options: Options,
    trials: Sequence[Trial],
    scores: Scores,
    published: Sequence[Sequence[Picture]],
    trust: Sequence[Trust] = (),
) -> list[Section]:
    """A section per log and task, with what it says about itself; a tutorial's row stands in the table of its log."""
    sections = []
    for trial, pictures in zip(trials, published, strict=True):
        if trial.beside is not None:
            continue
        rows = rows_of(scores.metrics, trial)
        blocks: list[Block] = []
        others = beside(trial, trials)
        every = pd.concat([rows, *(rows_of(scores.metrics, t) for t in others)])
        table, wide = comparison.comparison_table(every), comparison.comparison_table(every, options.columns)
        caption = f"{trial.log.name}, {trial.task}. {comparison.COMPARISON_CAPTION}{aligned_statement(trial)}"
        blocks.append(written_table(table, folder, stem(trial, "comparison"), caption, options, for_paper=wide))
        blocks += [beside_note(t, rows_of(scores.metrics, t)) for t in others]
        blocks += _differences(folder, options, trial, rows_of(scores.differences, trial))
        blocks += [p for p in pictures if p.stem not in {stem(trial, kind) for kind in ELSEWHERE}]
        if options.animate:
            blocks += [film for t in (trial, *others) for film in films_of(folder, t)]
        notes = [*trial.log.notes, *(f"{r.estimator}: {n}." for r in trial.runs for n in r.notes)]
        notes += [f"{text}." for text in minima_statements(trial)]
        if notes:
            blocks.append("\n".join(f"* {n}" for n in dict.fromkeys(notes)))
        if (folder / player_of(trial.log.name)).is_file():
            blocks.insert(0, f"[Play {trial.log.name} in the browser]({player_of(trial.log.name)}).")
        sections.append(Section(f"{trial.log.name}, {trial.task}", tuple(blocks)))
        sections += trust_section(folder, options, trial, pictures, trust)
    return sections


def _differences(folder: Path, options: Options, trial: Trial, rows: pd.DataFrame) -> list[Block]:
    """Filters against smoothers on a log with truth, and why intervals are missing."""
    if not len(rows):
        return []
    name, caption = stem(trial, "differences"), f"{trial.log.name}, {trial.task}. {DIFFERENCES_CAPTION}"
    table = written_table(differences_table(rows), folder, name, caption, options)
    missing = missing_intervals(rows)
    return [table, missing] if missing else [table]


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
    blocks: list[Block] = [comparison.ASSOCIATION_CAPTION]
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
        caption = f"{what}: outcomes of the decisions, as explained above."
        fine = comparison.ASSOCIATION_CAPTION
        written = written_table(table, folder, name, caption, options, fine_print=fine)
        shown = (p for p in pictures if p.stem == name)
        named = naming_statements(trial, *(rows_by(rows_of(t, trial)) for t in (scores.metrics, scores.association)))
        notes = ["\n".join(f"* {n}" for n in named)] if named else []
        sections.append(Section(f"Decisions: {what}", (written, *notes, *shown), level=3))
    if granted and any(len(rows) for rows in granted):
        blocks.append(
            "With known association the labels decide: a wrong pairing is a wrong label, a missed one was gated out."
        )
        table = comparison.association_table(pd.concat(granted))
        caption = "Logs on which only known association was run: outcomes of the decisions."
        fine = comparison.ASSOCIATION_CAPTION
        blocks.append(written_table(table, folder, "association", caption, options, fine_print=fine))
    return [Section(head, tuple(blocks)), *sections]

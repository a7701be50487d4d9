"""The report's sections on each log: filter and smoother compared, and the decisions made on it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from data.words import sentence
from eval.plan.calibrate import Calibration
from eval.plan.flags.table import Output
from eval.referee.diagnostics import ambiguity_of, minima, naming, unused
from eval.referee.given_runs import is_truth_alone
from eval.referee.score import Scores, Trial
from eval.report.answer import AnswerFacts, answer, answer_facts
from eval.report.comparison import association_table, comparison_table, differences_table, missing_intervals
from eval.report.diagnostics import of_runs
from eval.report.laser import GRID_PICTURE, LOOP_PICTURE, against_relations
from eval.report.names import SYSTEMATIC, stem, variants
from eval.report.overview import gauge_statement, in_short
from eval.report.overview_facts import LogFacts
from eval.report.page.blocks import Block, Folded, Picture, Section, Table
from eval.report.page.files import written_table
from eval.report.pictures import FILTER_SMOOTHER
from eval.report.publish import films_of
from eval.report.results import aligned_statement, results_statement
from eval.report.rows import rows_of
from eval.report.systematic import systematic_section
from eval.report.trust import first_said, trust_section
from eval.report.tutorials import beside_note
from eval.report.words import fine_print, paragraph, say
from eval.studies.trusted import Trust

IN_FULL, WHY_MISSING = "Filter and smoother in full", "Why intervals are missing"
BESIDE, NOTES = "Rows that stand beside, and why", "Notes on the log and its runs"
"""What folded texts are called."""
ELSEWHERE = ("association", FILTER_SMOOTHER, SYSTEMATIC, GRID_PICTURE, LOOP_PICTURE)
"""Pictures that stand in a section of their own."""


def of_trial(frame: pd.DataFrame, trial: Trial) -> pd.DataFrame:
    """Rows of one of the tables of `Scores` that belong to a trial."""
    return frame[(frame["log"] == trial.log.name) & (frame["task"] == trial.task)]


def trial_sections(
    folder: Path,
    output: Output,
    trials: Sequence[Trial],
    facts: Sequence[LogFacts],
    scores: Scores,
    published: Sequence[Sequence[Picture]],
    trust: Sequence[Trust] = (),
    calibrations: Sequence[Calibration] = (),
) -> list[Section]:
    """A section per log and task, with what it says about itself; a tutorial's row stands in the table of its log.

    `facts` are of the trials that stand beside no other, in their order; `published` are the pictures of every trial.
    """
    sections, told = [], iter(facts)
    for trial, pictures in zip(trials, published, strict=True):
        if trial.variant_of is not None:
            continue
        others = variants(trial, trials)
        made = _answer_facts(trial, scores)
        blocks: list[Block] = [_comparison(folder, output, trial, others, scores)]
        blocks += _told(trial, next(told), made, scores, first_said(trial, trust))
        beside_notes = tuple(beside_note(t, of_trial(scores.metrics, t)) for t in others)
        blocks += [Folded(BESIDE, beside_notes)] if beside_notes else []
        blocks += _differences(folder, output, trial, of_trial(scores.differences, trial))
        blocks += [p for p in pictures if p.stem not in {stem(trial, kind) for kind in ELSEWHERE}]
        if output.animate:
            blocks += [film for t in (trial, *others) for film in films_of(folder, t)]
        notes = [*trial.log.notes, *(f"{r.estimator}: {sentence(n)}." for r in trial.runs for n in r.notes)]
        notes += of_runs([*minima(trial), *(n for run in trial.runs for n in ambiguity_of(run, trial.log.recorded))])
        if notes:
            blocks.append(Folded(NOTES, ("\n".join(f"* {n}" for n in dict.fromkeys(notes)),)))
        sections.append(Section(f"{trial.log.name}, {trial.task}", tuple(blocks), facts=made))
        sections += systematic_section(folder, output, trial, pictures, calibrations)
        sections += trust_section(folder, output, trial, pictures, trust)
    return sections


def _comparison(folder: Path, output: Output, trial: Trial, others: Sequence[Trial], scores: Scores) -> Table:
    """Every run of a trial and of those that stand beside it."""
    rows = pd.concat([of_trial(scores.metrics, t) for t in (trial, *others)])
    caption = paragraph("comparison#errors", where=_where(trial), aligned=aligned_statement(trial))
    return written_table(
        comparison_table(rows, aligned=True),
        folder,
        stem(trial, "comparison"),
        caption,
        output,
        for_paper=comparison_table(rows, output.columns),
        fine=fine_print("Errors and consistency of one log"),
        apart=tuple(i for i, status in enumerate(rows["status"].tolist()) if status != "ok"),
    )


def _where(trial: Trial) -> str:
    return f"{trial.log.name}, {trial.task}"


def _answer_facts(trial: Trial, scores: Scores) -> AnswerFacts:
    true_id = trial.log.truth.landmark_of
    labelled = None if true_id is None else len(np.unique(true_id[true_id >= 0]))
    tables = (of_trial(t, trial) for t in (scores.metrics, scores.association, scores.differences))
    metrics, decided, differences = tables
    return answer_facts(metrics, decided, labelled, differences)


def _told(trial: Trial, f: LogFacts, made: AnswerFacts, scores: Scores, trust: str) -> list[Block]:
    """Filter and smoother on one log and task: at most three lines in front, in full below."""
    theirs = results_statement(trial, rows_of(of_trial(scores.metrics, trial)))
    said = "" if theirs and is_truth_alone(trial.log) else answer(made, trust)
    text = " ".join(s for s in (against_relations(trial), said, theirs) if s)
    nothing = " ".join(of_runs(map(unused, trial.runs)))
    front = " ".join(s for s in (in_short(f), nothing or gauge_statement(f)) if s)
    return [front, Folded(IN_FULL, (text,))] if text else [front]


def _differences(folder: Path, output: Output, trial: Trial, rows: pd.DataFrame) -> list[Block]:
    """Filters against smoothers on a log with truth, and why intervals are missing."""
    if not len(rows):
        return []
    caption, fine = paragraph("comparison#differences", where=_where(trial)), fine_print("Filters against smoothers")
    table = written_table(differences_table(rows), folder, stem(trial, "differences"), caption, output, fine=fine)
    missing = missing_intervals(rows)
    return [table, Folded(WHY_MISSING, (say("comparison#missing", intervals=missing),))] if missing else [table]


def association_sections(
    folder: Path, output: Output, trials: Sequence[Trial], scores: Scores, published: Sequence[Sequence[Picture]]
) -> list[Section]:
    """Decisions of every log where some were made without labels, and in one table the logs with labels alone."""
    head = "Data association"
    if not len(scores.association):
        return [Section(head, (paragraph("comparison#nothing_decided"),))]

    def table(rows: pd.DataFrame, name: str, where: str) -> Table:
        caption, fine = paragraph("comparison#decisions", where=where), fine_print("Decisions")
        return written_table(association_table(rows), folder, name, caption, output, fine=fine)

    sections, granted = [], []
    for trial, pictures in zip(trials, published, strict=True):
        if trial.variant_of is not None:
            continue
        rows = pd.concat([of_trial(scores.association, t) for t in (trial, *variants(trial, trials))])
        if not (rows["association"] != "known").any():
            granted.append(rows)
            continue
        name = stem(trial, "association")
        named = of_runs(naming(run, scores, trial.log.name) for run in trial.runs)
        notes = ["\n".join(f"* {n}" for n in named)] if named else []
        shown = (p for p in pictures if p.stem == name)
        block = table(rows, name, _where(trial))
        sections.append(Section(f"Decisions: {_where(trial)}", (block, *notes, *shown), level=3))
    first: tuple[Block, ...] = ()
    if any(len(rows) for rows in granted):
        first = (paragraph("comparison#granted"), table(pd.concat(granted), "association", ""))
    return [Section(head, first), *sections]

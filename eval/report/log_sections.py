"""The report's sections on each log: filter and smoother compared, and the log's page in `details/`."""

import math
import re
from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from data.notice import Code, Notice, Severity
from data.origin import assumed
from data.wing import of_all
from eval.figures.kinds import DETAILS, FRONT, aligned_statement
from eval.judgement.judgement import Comparison, Judgement
from eval.plan.flags.table import Output
from eval.referee.given.runs import is_truth_alone
from eval.referee.plausibility import IMPLAUSIBLE
from eval.referee.result_files import heads, rows_of
from eval.referee.score import Scores, Trial
from eval.replay.settings import Setup
from eval.report import comparison
from eval.report.diagnosis import first_page_words, source_section, systematic_section, trust_section
from eval.report.overview import gauge_statement, in_short
from eval.report.page.blocks import Block, Folded, Picture, Section, Table
from eval.report.page.files import stem, variants, written_table
from eval.report.publish import films_of
from eval.report.results import space_tables
from eval.report.words import fine_print, of_runs, one_line, paragraph, say
from eval.studies.diagnosis import Trust


def outcome(compared: Comparison) -> str:
    """What came of a comparison, by status and errors of the two, as `answer.md.j2` calls it."""
    there = compared.pair
    cases = {
        "failed": any(r.status not in ("ok", IMPLAUSIBLE) for r in there),
        "implausible": any(r.status == IMPLAUSIBLE for r in there), "none ran": not there, "one ran": len(there) == 1,
        "lost": any(r.lost_why for r in there), "no truth": not all(math.isfinite(r.rmse) for r in there),
    }  # fmt: skip
    return next((name for name, applies in cases.items() if applies), "compared")


def answer(j: Judgement, trust: str = "") -> str:
    """The comparison in a few sentences; `trust`, the diagnosis, comes first without ground truth."""
    about = {"outcome": outcome(j.compared), "verdict": j.verdict, "linearized": j.compared.lost_to_linearization}
    words = say("answer", j.compared, **about, methods=j.methods, trust=trust, assumed=assumed(j.origins))
    return "\n".join(map(one_line, re.split(r"\n(?=\* )", words)))


def gate_sentence(setup: Setup, *, sensed: bool) -> str:
    """The gate of observations paired by label; `sensed`: a sensor read the labels of this log."""
    gate, by_default = setup.settled(sensed).label_gate, setup.gate_known == "auto"
    return paragraph("settings#gate", gate=gate, by_default=by_default, smoothers=setup.gate_smoothers, sensed=sensed)


IN_FULL = "The comparison in words"
IN_SUMMARY = {"errors": "rmse_position_m", "nees": "nees_pose", "nis": "nis", "decided": "fp"}
VARIANTS, NOTES = "Additional variants", "Notes on the log and its runs"  # what folded texts are called


def of_trial(frame: pd.DataFrame, trial: Trial) -> pd.DataFrame:
    """Rows of one of the tables of `Scores` that belong to a trial."""
    return frame[(frame["log"] == trial.log.name) & (frame["task"] == trial.task)]


def _rows(frame: pd.DataFrame, trials: Sequence[Trial]) -> pd.DataFrame:
    return pd.concat([of_trial(frame, t) for t in trials])


def _where(trial: Trial) -> str:
    return f"{trial.log.name}, {trial.task}"


def trial_sections(
    folder: Path, output: Output, trials: Sequence[Trial], judgements: Sequence[Judgement], scores: Scores,
    published: Sequence[Sequence[Picture]], found: Sequence[Notice] = (), trust: Sequence[Trust] = (),
) -> list[Section]:  # fmt: skip
    """Of each log and task a section of the report and one of details; `judgements`: of those that are no variants."""
    sections, own = [], iter(judgements)
    for trial, pictures in zip(trials, published, strict=True):
        if trial.variant_of is not None:
            continue
        group = (trial, *variants(trial, trials))
        j = next(own)
        wide = _comparison(folder, output, trial, group, scores)
        about_log = [n for n in found if n.log == trial.log.name and n.task in ("", trial.task)]
        blocks = _front(trial, j, about_log, scores, first_page_words(trial, trust))
        blocks.append(_summary(trial, group, scores, wide))
        blocks += space_tables(folder, output, trial)
        blocks += [p for p in pictures if p.place == FRONT]
        blocks += [film for t in group for film in films_of(folder, t)] if output.animate else []
        blocks.append(paragraph("comparison#details", page=stem(trial)))
        sections.append(Section(_where(trial), tuple(blocks), facts=j))
        sections += source_section(folder, output, trial, scores, about_log)
        sections += systematic_section(folder, output, trial, pictures)
        details: list[Block] = [*comparison.parts(wide)]
        if len(rows := of_trial(scores.differences, trial)):
            frame, fine = comparison.differences_table(rows), fine_print("Filters against smoothers")
            caption, name = paragraph("comparison#differences", where=_where(trial)), stem(trial, "differences")
            details.append(written_table(frame, folder, name, caption, output, fine=fine))
        details += [p for p in pictures if p.place == DETAILS]
        about = tuple(paragraph("comparison#variant", name=t.log.name, about=t.about) for t in group[1:])
        details += [Folded(VARIANTS, about)] if about else []
        notes = of_runs(n for n in about_log if n.severity is Severity.INFO)
        details += [Folded(NOTES, ("\n".join(f"* {n}" for n in notes),))] if notes else []
        sections.append(Section(f"{_where(trial)}: details", tuple(details), page=stem(trial)))
        sections += trust_section(folder, output, trial, trust)
        for of_wing in of_all("log_sections"):
            sections += of_wing(folder, output, trial)
        sections += _decisions(folder, output, group, scores, pictures)
    return sections


def _comparison(folder: Path, output: Output, trial: Trial, group: Sequence[Trial], scores: Scores) -> Table:
    """Every run of a trial and of its variants, with every column."""
    rows = _rows(scores.metrics, group)
    caption = paragraph("comparison#errors", where=_where(trial), aligned=aligned_statement(trial))
    wide, for_paper = comparison.comparison_table(rows, aligned=True), comparison.comparison_table(rows, output.columns)
    name, fine = stem(trial, "comparison"), fine_print("Errors and consistency of one log")
    return written_table(wide, folder, name, caption, output, for_paper=for_paper, fine=fine)


def _summary(trial: Trial, group: Sequence[Trial], scores: Scores, wide: Table) -> Table:
    """The same rows with the columns that matter most."""
    frame = comparison.summary_table(*(_rows(t, group) for t in (scores.metrics, scores.association)))
    shown = {what: heads((column,))[column] in frame for what, column in IN_SUMMARY.items()}
    caption = paragraph("comparison#summary", where=_where(trial), **shown)
    return Table(frame, caption + aligned_statement(trial), fine=wide.fine)


def _front(trial: Trial, j: Judgement, found: Sequence[Notice], scores: Scores, trust: str) -> list[Block]:
    """Filter and smoother on one log and task: at most three lines in front, the rest folded."""
    names, rows = {r.estimator for r in trial.runs if r.handed_in}, rows_of(of_trial(scores.metrics, trial))
    theirs = one_line(say("results#statement", phases=[row for row in rows if row["estimator"] in names]))
    whole = "" if theirs and is_truth_alone(trial.log) else answer(j, trust if j.measured else "")
    text = "\n\n".join(s for s in (whole, theirs) if s)
    nothing = " ".join(of_runs(n for n in found if n.code is Code.UNUSED))
    front = " ".join(s for s in (in_short(j), nothing or gauge_statement(j)) if s)
    return [front, Folded(IN_FULL, (text,))] if text else [front]


def _decided(folder: Path, output: Output, rows: pd.DataFrame, name: str, where: str) -> Table:
    caption, fine = paragraph("comparison#decisions", where=where), fine_print("Decisions")
    return written_table(comparison.association_table(rows), folder, name, caption, output, fine=fine)


def _decisions(
    folder: Path, output: Output, group: Sequence[Trial], scores: Scores, pictures: Sequence[Picture]
) -> list[Section]:
    """Decisions on a log, where some were made without labels."""
    trial, rows = group[0], _rows(scores.association, group)
    if not (rows["association"] != "known").any():
        return []
    name = stem(trial, "association")
    blocks: list[Block] = [_decided(folder, output, rows, name, _where(trial))]
    blocks += [p for p in pictures if p.stem == name]
    return [Section(f"Decisions: {_where(trial)}", tuple(blocks), level=3, page=stem(trial))]


def association_sections(folder: Path, output: Output, trials: Sequence[Trial], scores: Scores) -> list[Section]:
    """In one table the decisions on logs with known association alone; a sentence where none can be scored."""
    if not len(scores.association):
        return [Section("Data association", (paragraph("comparison#nothing_decided"),))]
    each = [_rows(scores.association, (t, *variants(t, trials))) for t in trials if t.variant_of is None]
    granted = [rows for rows in each if len(rows) and (rows["association"] == "known").all()]
    if not granted:
        return []
    table = _decided(folder, output, pd.concat(granted), "association", "")
    return [Section("Data association by labels", (paragraph("comparison#granted"), table), page="association")]

"""The report's sections "Trust without ground truth", one for each log and task, and what the first page says of it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from eval.page.document import Block, FinePrint, Picture, Section, folded, written_table
from eval.plan.flags.options import Options
from eval.referee.score import Trial
from eval.report.names import stem
from eval.report.pictures import FILTER_SMOOTHER
from eval.report.shown_runs import associations
from eval.report.trust.phrases import terms_of
from eval.report.trust.said import online
from eval.report.trust.tables import shown, trust_frame
from eval.report.trust.words import first_words, paragraphs
from eval.studies.trusted import Trust

HEADING = "Trust without ground truth"
CAPTION = "What the log says of itself, no truth used."
FINE = FinePrint(
    "What a log says of itself",
    "P_f and P_s are the covariances of the online and of the smoothed pose, d is their difference. All statistics:"
    " trust.csv; definitions: docs/verdicts.md.",
)
MORE = "More of what the log says of itself"
WITH_TWINS = " First what lies outside what the twins show (family-wise p at most 0.05)."
WITHOUT = " Standard errors are those of the noise as stated; without twins there is no p value."


def of_trial(trial: Trial, said: Sequence[Trust]) -> list[Trust]:
    """What is told of a log and task: all ways of association that have twins, else the first one alone."""
    own = [t for t in said if (t.log, t.task) == (trial.log.name, trial.task) and trial.beside is None]
    order = associations(trial.runs)
    own.sort(key=lambda t: order.index(t.association) if t.association in order else len(order))
    asked = [t for t in own if t.twins or any(n.startswith("no twins") for n in t.notes)]
    return asked or [t for t in own if online(t)][:1]


def first_said(trial: Trial, said: Sequence[Trust]) -> str:
    """For the first page: the first way of association; with truth only what twins say."""
    for trust in of_trial(trial, said)[:1]:
        measured = trial.log.truth.known_poses > 0
        if trust.blame is not None or not measured:
            return first_words(trust, terms=terms_of(trial.log.recorded), measured=measured)
    return ""


def trust_section(
    folder: Path, options: Options, trial: Trial, pictures: Sequence[Picture], said: Sequence[Trust]
) -> list[Section]:
    """The words, the table and the figure of a log and task; none where nothing is known."""
    told = of_trial(trial, said)
    terms, labels = terms_of(trial.log.recorded), trial.log.has_labels
    blocks: list[Block] = []
    for trust in told:
        if len(told) > 1 or len(associations(trial.runs)) > 1:
            blocks.append(f"With association `{trust.association}`:")
        front, *more = folded(paragraphs(trust, terms=terms, labels=labels), MORE) or ("",)
        blocks += [front] if front else []
        if shown(trust):
            caption = f"{trial.log.name}, {trial.task}, association {trust.association}. {CAPTION}"
            caption += WITH_TWINS if trust.twins else WITHOUT
            name, frame = stem(trial, f"trust-{trust.association}"), trust_frame(trust, terms=terms)
            blocks.append(written_table(frame, folder, name, caption, options, fine=FINE))
        blocks += more
    blocks += [p for p in pictures if p.stem == stem(trial, FILTER_SMOOTHER)]
    return [Section(f"{HEADING}: {trial.log.name}, {trial.task}", tuple(blocks), 3)] if blocks else []

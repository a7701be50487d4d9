"""The first sections of a report made with `--lab`: the lab's questions, answered in their order."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from eval.page.document import Block, Picture, Section, written_table
from eval.plan.flags.options import Options
from eval.plan.unfinished import Unfinished
from eval.plan.work import work
from eval.referee.score import Scores, Trial
from eval.report.corridor.facts import Lab, find_lab
from eval.report.lab.answers import QUESTIONS, numbers
from eval.report.lab.pictures import NEEDED, draw
from eval.report.lab.visual import visual_hand_in

HEADS = (
    "Online. TP to FN: outcomes of the decisions; RMSE: of the position; in 3σ: share of the frames (98.9 % expected);"
    " landmarks at the end; state: mean length. "
)
LOST = "A run that this question is about did not get to its end; Failures says where and why."
METHODS = (
    "Methods by their names on the command line: jcbb-first is the lab's JCBB (of solutions with equally many pairings"
    " the first), jcbb takes the one with the least joint distance, jcbb-hindsight may revise; known: by labels."
)


def hand_in(folder: Path, options: Options, trials: Sequence[Trial], scores: Scores, lost: Unfinished) -> list[Section]:
    """The answers to a lab's questions; nothing without `--lab`."""
    if options.lab is None:
        return []
    if any(t.log.evidence is not None for t in trials):
        return visual_hand_in(folder, options, trials)
    lab = find_lab(trials, named=False)
    return [] if lab is None else _corridor(folder, options, lab, scores, lost)


def _corridor(folder: Path, options: Options, lab: Lab, scores: Scores, lost: Unfinished) -> list[Section]:
    """Six sections, their pictures drawn in parallel."""
    wanted = [] if options.no_plots else [k for q in QUESTIONS for k in q.pictures if NEEDED[k](lab)]
    formats = ("png",) if options.quick else ("pdf", "png")
    setup = next(iter(lab.trials.values())).log.labels_are_sensed
    jobs = [
        (kind, (draw, (folder, kind, lab, options.setup.settled(setup), formats, options.formats))) for kind in wanted
    ]
    made: dict[str, Picture] = dict(work(jobs, options, lost=lambda kind, why: lost.say(f"lab: {kind} missing", why)))
    sections = []
    for n, question in enumerate(QUESTIONS, start=1):
        name = f"lab-question-{n}"
        caption = f"Question {n}. {HEADS}{METHODS}" if n == 1 else f"Question {n}; heads as in the first table."
        paragraph, known = question.paragraph(lab, scores)
        blocks: list[Block] = [
            f"**{question.short(lab, scores)}**",
            *(made[kind] for kind in question.pictures if kind in made),
            written_table(numbers(question.table(lab), scores), folder, name, caption, options),
            paragraph if known else LOST,
        ]
        sections.append(Section(f"Question {n}: {question.heading}", tuple(blocks)))
    return sections

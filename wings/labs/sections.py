"""The corridor lab in the report: the answers of a lab that is handed in."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import pandas as pd

from eval.plan.experiment import Unfinished
from eval.plan.flags.options import Options
from eval.plan.flags.table import Output
from eval.plan.work import Job, work
from eval.referee.confusion import OUTCOMES
from eval.referee.consistency import ASTRAY_NEES
from eval.referee.score import Scores, Trial
from eval.report.page.blocks import Block, Folded, Picture, Section
from eval.report.page.files import written_table
from eval.report.words import paragraph
from wings.labs.corridor import BLIND, BLIND_PEOPLE, METHODS, ODOMETRY, PEOPLE, Lab, find_lab
from wings.labs.pictures import draw
from wings.labs.questions import Answers, answers
from wings.labs.seeds import OverSeeds, Seed, over_seeds, seed_jobs
from wings.labs.times import write_times
from wings.labs.visual import visual_hand_in

TEMPLATE = "labs/corridor"
LAB = ("nn", "singles", "jcbb-first")


class Question(NamedTuple):
    """A question of the assignment."""

    name: str  # of its facts in `Answers` and of its macros
    heading: str
    shown: tuple[tuple[bool, bool, bool], ...]  # conditions (people, odometry, maintained) of its table, and methods
    methods: tuple[str, ...]
    pictures: tuple[str, ...]


PLAIN, CROWDED, TIDIED = (*ODOMETRY, False), (*PEOPLE, False), (*PEOPLE, True)
NOT_READ = ((*BLIND, False), (*BLIND_PEOPLE, False))
QUESTIONS = (
    Question("nn", "Why does nearest neighbour (NN) fail?", (PLAIN,), ("known", "nn"), ("first-wrong",)),
    Question("singles", "Does SINGLES do better?", (PLAIN,), LAB, ("errors",)),
    Question("people", "What do people do to NN and SINGLES?", (PLAIN, CROWDED), LAB[:2], ("people",)),
    Question("jcbb", "Why does JCBB cope better?", (CROWDED,), METHODS, ("methods",)),
    Question("blind", "What happens without odometry?", NOT_READ, METHODS, ("paths",)),
    Question("maintenance", "What does map maintenance change?", (CROWDED, TIDIED), LAB, ("maintenance",)),
)
HEADS = (
    "Online. TP to FN: outcomes of the decisions; RMSE: of the position; in 3σ: frames [%] with the position error"
    " inside 3σ (98.9 expected); landmarks: at the end; state: mean number of state entries; usable: no, if the run is"
    " implausible, lost, or mean pose NEES is above "
    f"{ASTRAY_NEES:g}. "
)
LOST = "A run that this question needs stopped before the end; see Failures."
NAMES_OF_METHODS = (
    "Methods by their names on the command line: known: by labels; jcbb-first: the lab's JCBB, keeps the first of"
    " equally large hypotheses; jcbb: the one with the least joint distance; jcbb-hindsight: revises decisions"
    " (final: after the last frame)."
)


def hand_in(folder: Path, options: Options, trials: Sequence[Trial], scores: Scores, lost: Unfinished) -> list[Section]:
    """The answers to a lab's questions, the first sections of its report; nothing without `--lab`."""
    if options.selection.lab is None:
        return []
    if any(t.log.evidence is not None for t in trials):
        return visual_hand_in(folder, options.output, trials)
    lab = find_lab(trials)
    return [] if lab is None else _corridor(folder, options, lab, answers(lab, scores), lost)


def _corridor(folder: Path, options: Options, lab: Lab, facts: Answers, lost: Unfinished) -> list[Section]:
    """Six sections, their pictures drawn in parallel."""
    output = options.output
    wanted = [] if output.no_plots else [k for q in QUESTIONS for k in q.pictures]
    setup = options.setup.settled(next(iter(lab.trials.values())).log.labels_are_sensed)
    jobs: list[Job[str]] = [Job(kind, draw, (folder, kind, lab, setup)) for kind in wanted]
    jobs += [] if output.no_plots else [Job("update-time", write_times, (folder, lab, setup, output.formats))]
    if (jcbb := facts.of["jcbb"]["jcbb"]) is not None and jcbb.estimator == "ekf":
        jobs += seed_jobs(options.selection.lab or "", setup)
    done = dict(work(jobs, options.execution, lost=lambda kind, why: lost.say("picture", why, name=f"lab: {kind}")))
    made: dict[str, Picture] = {kind: found for kind, found in done.items() if isinstance(found, Picture)}
    repeated, sections = over_seeds([s for s in done.values() if isinstance(s, Seed)]), []
    for n, question in enumerate(QUESTIONS, start=1):
        q = facts.of[question.name]
        caption = f"Question {n}. {HEADS}{NAMES_OF_METHODS}" if n == 1 else f"Question {n}; columns as in Table 1."
        more: dict[str, object] = {"repeated": repeated} if question.name == "jcbb" else {}
        more |= {"measured": done.get("update-time")} if question.name == "maintenance" else {}
        line = paragraph(f"{TEMPLATE}#{question.name}_line", q=q)
        if repeated is not None:
            line += " " + paragraph(f"{TEMPLATE}#over_seeds", claims=repeated.compared(question.name))
        blocks: list[Block] = [
            f"**{line}**",
            *(made[kind] for kind in question.pictures if kind in made),
            written_table(_numbers(question, facts), folder, f"lab-question-{n}", caption, output),
            *(_seeds(folder, repeated, output) if question.name == "jcbb" else ()),
            LOST if q["lack"] else Folded("In detail", (paragraph(f"{TEMPLATE}#{question.name}", q=q, **more),)),
        ]
        answer = f"{n}. {question.heading} {line}"
        sections.append(Section(f"Question {n}: {question.heading}", tuple(blocks), facts=q, answer=answer))
    return sections


def _seeds(folder: Path, found: OverSeeds | None, output: Output) -> list[Block]:
    if found is None:
        return []
    return [written_table(found.table(), folder, "lab-seeds", paragraph(f"{TEMPLATE}#seeds", found=found), output)]


def _numbers(question: Question, facts: Answers) -> pd.DataFrame:
    """Outcomes and errors, online, of the runs that a question's table shows."""
    rows = []
    for r in (r for condition in question.shown for r in facts.rows(condition, question.methods)):
        rows.append(
            {
                "condition": r.condition,
                "method": r.association,
                **{c.upper(): getattr(r.p, c) for c in OUTCOMES},
                "RMSE [m]": r.rmse,
                "in 3σ [%]": 100.0 * r.inside,
                "landmarks": r.landmarks,
                "state": None if math.isnan(r.state) else round(r.state),
                "usable": "yes" if r.usable else "no",
            }
        )
        if question.name == "jcbb" and r.revised:
            revised = {c.upper(): n for c, n in r.revised.items()}
            rows.append({**dict.fromkeys(rows[-1]), **revised, "condition": rows[-1]["condition"]})
            rows[-1]["method"] = f"{r.association}, final"
    return pd.DataFrame(rows, dtype=object)

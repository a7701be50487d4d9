"""Questions about a run that got to its end: nearly nothing used, or more landmarks than the readings make sense of."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial import cKDTree

from data.inputs import Inputs
from data.questions.ask import ask
from data.questions.question import Question
from data.result import Run
from eval.page.document import Section
from eval.page.numbers import number
from eval.referee.score import Trial

UNUSED = 0.1
"""Share of the readings paired with a landmark below which an estimate is dead reckoning under another name."""
FEWEST = 20
"""Fewer readings, or half as many landmarks, say nothing."""
CROWDED = 0.5
"""Share of landmarks that stand on top of another. With right labels it is at most 0.23 in every world and recording
this was measured on (Victoria Park; 0 in all others); 20 landmarks mapped as 95 to 330, because sigmas were stated 2 or
3 times too small, give 0.64 to 0.97."""
ON_TOP = 5.0
"""Standard deviations of a reading within which two landmarks that were never seen in one frame may be one: the gate
outside which a new landmark is made is 4.8 of them wide."""

TEXT = """\
Asked by checks of what a log says and of what came out of it. A question is no verdict: where the answer is fine,
nothing is wrong."""


def questions_of_run(run: Run, inputs: Inputs) -> list[Question]:
    """What to ask about one run; nothing about dead reckoning or one that failed. No truth is used."""
    if run.association == "none" or run.failure is not None:
        return []
    return [*_unused(run), *_crowded(run, inputs)]


def _unused(run: Run) -> list[Question]:
    """Next to no reading was paired."""
    used, seen = int((run.final_decisions >= 0).sum()), len(run.final_decisions)
    if seen < FEWEST or used >= UNUSED * seen:
        return []
    advice = (
        "look at the frame of map and prior, at units and signs of the readings"
        if run.task == "localization"
        else "nothing is seen twice: look at units and signs of odometry and readings, and at the stated sigmas"
    )
    return [Question("unused", f"{used} of {seen} observations used, so this is dead reckoning: {advice}")]


def _crowded(run: Run, inputs: Inputs) -> list[Question]:
    """Most landmarks stand on top of another one that was never seen beside them."""
    if run.task != "slam" or run.map is None or 2 * len(run.map) < FEWEST or not inputs.sensor.sees_points:
        return []
    o, places = inputs.observations, run.map
    _, spread = inputs.sensor.body_points(o.z, o.R)
    reach = ON_TOP * float(np.sqrt(np.median(np.trace(spread, axis1=1, axis2=2))))
    near = cKDTree(places.xy).query_pairs(reach, output_type="ndarray")
    if len(np.unique(near)) <= CROWDED * len(places):
        return []
    of = np.where(run.initialized >= 0, run.initialized, run.final_decisions)
    frames = {i: np.unique(o.frame[of == places.number[i]]) for i in np.unique(near).tolist()}
    apart = [i for a, b in near.tolist() if not len(np.intersect1d(frames[a], frames[b])) for i in (a, b)]
    doubles = len(set(apart))
    if doubles <= CROWDED * len(places):
        return []
    return [
        Question(
            "landmarks",
            f"{len(places)} landmarks, of which {doubles} stand within {number(reach)} m (five sigmas of a reading) of "
            "another that was never seen with them: more than make sense; are the stated sigmas too small "
            "(`python -m eval.tune` fits them), or would another --association do better?",
        )
    ]


def said_after(trials: Sequence[Trial]) -> list[tuple[str, Question]]:
    """Questions about every run, each with whom it is about: log, task, and the estimators that share it."""
    said: dict[tuple[str, Question], list[str]] = {}
    for trial in trials:
        for run in trial.runs:
            for question in questions_of_run(run, trial.log.recorded):
                key = (f"{trial.log.name}, {trial.task}, {run.association}", question)
                said.setdefault(key, []).append(run.estimator)
    return [(f"{who}: {', '.join(names)}", question) for (who, question), names in said.items()]


def said_before(trials: Sequence[Trial]) -> list[tuple[str, Question]]:
    """Questions about every log, each with the log's name."""
    logs = {t.log.name: t.log for t in trials if t.beside is None}
    return [(name, question) for name, log in logs.items() for question in ask(log)]


def questions_section(trials: Sequence[Trial]) -> list[Section]:
    """A section with all of them; none where there is nothing to ask."""
    said = [*said_before(trials), *said_after(trials)]
    lines = [f"* **{question.name}** ({who}): {_ended(question.text)}" for who, question in said]
    return [Section("Questions", (TEXT, "\n".join(dict.fromkeys(lines))))] if lines else []


def _ended(text: str) -> str:
    return text if text.endswith("?") else f"{text}."


def is_unused(run: Run) -> bool:
    """Whether an estimate is dead reckoning under another name, as next to no reading was paired."""
    return run.association != "none" and run.failure is None and bool(_unused(run))


def unused_statement(trial: Trial) -> str:
    """For the headline: who used next to nothing, and how much; empty if nobody."""
    said = [
        f"{run.estimator} ({run.association}): {question.text}."
        for run in trial.runs
        for question in (_unused(run) if run.association != "none" and run.failure is None else ())
    ]
    return " ".join(said)

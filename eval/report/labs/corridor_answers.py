"""The corridor lab's six questions in the assignment's order: heading, answer in a line, numbers, pictures, paragraph.

1 to 6 are the assignment's steps: nearest neighbour; SINGLES; people; JCBB; no odometry; features seen only once are
eliminated. The paragraphs are those of `eval.report.corridor`, in which every number is taken from the runs.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
import pandas as pd

from data.result import Run
from data.truth import CLUTTER
from eval.plan.lab import switched_on
from eval.referee.errors import landmark_true_ids
from eval.referee.score import Scores, Trial
from eval.report.labs.corridor_facts import BLIND, NAMES, ODOMETRY, PEOPLE, WORSE, Lab, look, move, plural, rmse, run_of
from eval.report.labs.corridor_questions import (
    what_maintenance_changes,
    why_jcbb_copes,
    why_nn_fails,
    why_people_break_it,
    without_odometry,
)
from eval.report.labs.pictures import BLIND_PEOPLE, UPDATE_TIME, has, maintained_pair
from eval.report.page.tables import number

Rows = Sequence[tuple[Trial | None, Sequence[str]]]
"""What a table of numbers shows: trials with the ways of association of each."""
LABS = ("known", "nn", "singles", "jcbb-first", "jcbb", "jcbb-hindsight")


class Question(NamedTuple):
    """A question: its heading, the answer in a line, the paragraph, what its table shows, its pictures."""

    heading: str
    short: Callable[[Lab, Scores], str]
    paragraph: Callable[[Lab, Scores], tuple[str, bool]]
    table: Callable[[Lab], Rows]
    pictures: tuple[str, ...]


def numbers(rows: Rows, scores: Scores) -> pd.DataFrame:
    """Outcomes and errors, online, of the first finished run with each way of association."""
    lines: list[dict[str, object]] = []
    for trial, methods in rows:
        for method in methods:
            run = None if trial is None else _finished(trial, method)
            if trial is None or run is None:
                continue
            lines.append({"condition": _condition(trial), "method": method, **_outcomes(trial, run, scores)})
    return pd.DataFrame(lines, dtype=object)


def _condition(trial: Trial) -> str:
    """What is special about a trial's log."""
    people, odometry = switched_on(trial.log)
    said = [
        w
        for w, on in (("people", people), ("no odometry", not odometry), ("maintained", trial.beside is not None))
        if on
    ]
    return ", ".join(said) or "plain"


def _finished(trial: Trial, association: str) -> Run | None:
    found = (trial.find(estimator, association) for estimator in ("ekf", "isam2"))
    return next((r for r in found if r is not None and r.failure is None), None)


def _outcomes(trial: Trial, run: Run, scores: Scores) -> dict[str, object]:
    counts = look(run, trial.log).counts
    m = _row(trial, run, scores)
    return {
        "TP": counts.tp, "TN": counts.tn, "FP": counts.fp, "FN": counts.fn,
        "RMSE [m]": m("rmse_position_m"), "in 3σ [%]": round(100.0 * m("inside_3sigma"), 1),
        "landmarks": 0 if run.map is None else len(run.map),
        "state": None if run.state_size is None else round(float(np.mean(run.state_size))),
    }  # fmt: skip


def _row(trial: Trial, run: Run, scores: Scores) -> Callable[[str], float]:
    """A column of the online row of a run in metrics.csv, NaN where it is blank."""
    m = scores.metrics
    found = m[
        (m["log"] == trial.log.name) & (m["task"] == trial.task) & (m["estimator"] == run.estimator)
        & (m["association"] == run.association) & (m["phase"] == "online")
    ]  # fmt: skip

    def value(column: str) -> float:
        values = found[column].tolist()
        return float(values[0]) if values and not pd.isna(values[0]) else math.nan

    return value


def _nn_in_a_line(lab: Lab, scores: Scores) -> str:
    trial = lab.trials[ODOMETRY]
    nn, known = run_of(trial, "nn"), run_of(trial, "known")
    if nn is None or known is None:
        return "NN or known association did not get to its end; see Failures."
    p, mine, best = look(nn, trial.log), rmse(scores, trial, nn), rmse(scores, trial, known)
    if p.first_wrong is None:
        return f"It does not, on this log: no pairing is wrong, RMSE {number(mine)} m."
    return (
        f"It takes the nearest landmark for each observation alone: {p.counts.fp} of {len(p.counts.outcome)} wrong, the"
        f" first in frame {p.first_wrong}; RMSE {number(mine)} m, {number(best)} m with labels."
    )


def _singles_in_a_line(lab: Lab, scores: Scores) -> str:
    trial = lab.trials[ODOMETRY]
    nn, singles = run_of(trial, "nn"), run_of(trial, "singles")
    if nn is None or singles is None:
        return "NN or SINGLES did not get to its end; see Failures."
    a, b = look(nn, trial.log).counts, look(singles, trial.log).counts
    return (
        f"{'Fewer' if b.fp < a.fp else 'No fewer'} wrong pairings ({b.fp} instead of {a.fp}), and {b.missed}"
        f" observations of mapped points unused: RMSE {number(rmse(scores, trial, singles))} m instead of"
        f" {number(rmse(scores, trial, nn))} m."
    )


def what_singles_does(lab: Lab, scores: Scores) -> tuple[str, bool]:
    """SINGLES beside NN and JCBB on the log without people."""
    trial = lab.trials[ODOMETRY]
    notes, counted, errors = [], {}, {}
    for method in ("nn", "singles", "jcbb"):
        run = run_of(trial, method)
        if run is None:
            notes.append(f"{NAMES[method]} did not get to its end.")
            continue
        p, row = look(run, trial.log), _row(trial, run, scores)
        counted[method], errors[method] = p.counts, row("rmse_position_m")
        notes.append(
            f"**{NAMES[method]}** uses {p.counts.tp + p.counts.fp} of {len(p.counts.outcome)} observations of"
            f" `{trial.log.name}` ({p.counts.fp} wrongly); its position error is inside 3σ in"
            f" {100.0 * row('inside_3sigma'):.0f} % of the frames (98.9 % expected), RMSE"
            f" {number(errors[method])} m."
        )
    if {"nn", "singles"} <= set(counted):
        fewer, better = counted["singles"].fp < counted["nn"].fp, errors["singles"] < errors["nn"]
        notes.append(
            "SINGLES pairs an observation only if it has one candidate and that candidate no other observation, so"
            " that where two points are as near as the prediction is uncertain nothing is paired:"
            f" {counted['singles'].missed} observations of points in the map go unused."
            + (
                " What it does pair is right more often, and few right pairings correct the pose better than many of"
                " which some are wrong."
                if fewer and better
                else " Here that caution does not pay."
            )
        )
    if {"jcbb", "singles"} <= set(counted):
        gap = errors["singles"] / errors["jcbb"] if errors["jcbb"] > 0.0 else math.nan
        notes.append(
            f"JCBB uses {counted['jcbb'].tp - counted['singles'].tp} right pairings more, and SINGLES' RMSE is"
            f" {number(gap, 2)} times as large."
            if counted["jcbb"].tp > counted["singles"].tp
            else "JCBB finds no more right pairings here."
        )
    return " ".join(notes), True


def _people_in_a_line(lab: Lab, scores: Scores) -> str:
    parts = []
    for method in ("nn", "singles"):
        if not (has(lab, ODOMETRY, method) and has(lab, PEOPLE, method)):
            continue
        errors = []
        for switches in (ODOMETRY, PEOPLE):
            run = run_of(lab.trials[switches], method)
            assert run is not None  # `has` says so
            errors.append(rmse(scores, lab.trials[switches], run))
        parts.append(f"{NAMES[method]}'s RMSE {move(*errors)} m")
    return f"With people about {' and '.join(parts)}." if parts else "Neither NN nor SINGLES got to its end."


def _jcbb_in_a_line(lab: Lab, scores: Scores) -> str:
    trial = lab.trials[PEOPLE if has(lab, PEOPLE, "jcbb", "nn") else ODOMETRY]
    jcbb, nn = run_of(trial, "jcbb"), run_of(trial, "nn")
    if jcbb is None or nn is None:
        return "JCBB or NN did not get to its end; see Failures."
    a, b = look(jcbb, trial.log).counts, look(nn, trial.log).counts
    return (
        "It accepts only pairings that agree with each other on where the robot is:"
        f" {a.fp} wrong on `{trial.log.name}` where NN has {b.fp}, RMSE {number(rmse(scores, trial, jcbb))} m instead"
        f" of {number(rmse(scores, trial, nn))} m."
    )


def _blind_in_a_line(lab: Lab, scores: Scores) -> str:
    trial = lab.trials[BLIND]
    errors = {m: rmse(scores, trial, r) for m in LABS if (r := _finished(trial, m)) is not None}
    if not errors:
        return "No method gets to its end."
    best = min(errors, key=lambda m: errors[m])
    usable = [m for m, e in errors.items() if e < 0.5]
    listed = ", ".join(f"{m} {number(e)} m" for m, e in errors.items())
    if not usable:
        return f"Every method is lost, {best} least: position RMSE {listed}."
    return f"Only {', '.join(usable)} {'finds' if len(usable) == 1 else 'find'} the way: position RMSE {listed}."


def without_odometry_by_all(lab: Lab, scores: Scores) -> tuple[str, bool]:
    """What happens without odometry to every method, and why."""
    text, known = without_odometry(lab, scores)
    trial = lab.trials[BLIND]
    each = []
    for method in ("nn", "singles", "jcbb-hindsight"):
        run = _finished(trial, method)
        if run is not None:
            c = look(run, trial.log).counts
            each.append(
                f"{NAMES[method]} makes {plural(c.tp, 'right pairing')} and {plural(c.fp, 'wrong one')}, and leaves"
                f" {c.missed} out"
            )
    return f"{text} The others: {'; '.join(each)}." if each else text, known


def _maintenance_in_a_line(lab: Lab, scores: Scores) -> str:
    both = maintained_pair(lab)
    if both is None:
        return "No method got to its end both with and without maintenance."
    _, kept = both
    sizes = [0 if s.run.map is None else len(s.run.map) for s in both]
    gone = 0 if kept.run.removed is None else int((kept.run.removed >= 0).sum())
    people = 0
    if gone and kept.run.removed is not None:
        ids = landmark_true_ids(kept.run.created, kept.log.truth, np.flatnonzero(kept.run.removed >= 0))
        people = int((ids == CLUTTER).sum())
    a, b = (rmse(scores, s.trial, s.run) for s in both)
    verdict = "better" if b * WORSE < a else "about as good" if b <= WORSE * a else "worse"
    return (
        f"It removes {plural(gone, 'landmark')} seen only once, {people} of them people: {sizes[1]} in the map instead"
        f" of {sizes[0]}, and the path is {verdict} (RMSE {number(b)} m, {number(a)} m without)."
    )


def what_maintenance_does(lab: Lab, scores: Scores) -> tuple[str, bool]:
    """What map maintenance changes, with a word on where the measured times are."""
    text, known = what_maintenance_changes(lab, scores)
    measured = (
        f"the update was measured frame by frame (the figure of measured times, and `tables/lab-{UPDATE_TIME}.csv`,"
        " which alone differ from run to run)."
    )
    return text.replace("the seconds are in `timing.csv`.", measured), known


QUESTIONS = (
    Question(
        "Why does nearest neighbour (NN) fail?", _nn_in_a_line, why_nn_fails,
        lambda lab: [(lab.trials.get(ODOMETRY), ("known", "nn"))], ("first-wrong",),
    ),
    Question(
        "Does SINGLES do better?", _singles_in_a_line, what_singles_does,
        lambda lab: [(lab.trials.get(ODOMETRY), ("nn", "singles", "jcbb-first"))], ("errors",),
    ),
    Question(
        "What do people do to NN and SINGLES?", _people_in_a_line, why_people_break_it,
        lambda lab: [(lab.trials.get(c), ("nn", "singles")) for c in (ODOMETRY, PEOPLE)], ("people",),
    ),
    Question(
        "Why does JCBB cope better?", _jcbb_in_a_line, why_jcbb_copes,
        lambda lab: [(lab.trials.get(PEOPLE), LABS)], ("methods",),
    ),
    Question(
        "What happens without odometry?", _blind_in_a_line, without_odometry_by_all,
        lambda lab: [(lab.trials.get(c), LABS) for c in (BLIND, BLIND_PEOPLE)], ("paths",),
    ),
    Question(
        "What does map maintenance change?", _maintenance_in_a_line, what_maintenance_does,
        lambda lab: [(t.get(PEOPLE), ("nn", "singles", "jcbb-first")) for t in (lab.trials, lab.maintained)],
        ("maintenance", UPDATE_TIME),
    ),
)  # fmt: skip
"""The assignment's six, in its order."""

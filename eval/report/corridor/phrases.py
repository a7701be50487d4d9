"""Words and constants that the answers to the lab's questions share."""

from __future__ import annotations

import math

from data.result import Run
from eval.page.numbers import number
from eval.referee.score import Scores, Trial
from eval.report.corridor.facts import Lab

WORSE = 1.5
"""An error this many times another one is called worse, below it comparable."""
NAMES = {
    "nn": "NN",
    "singles": "SINGLES",
    "jcbb": "JCBB",
    "jcbb-first": "JCBB",
    "known": "known association",
    "jcbb-hindsight": "JCBB in hindsight",
}
ODOMETRY, PEOPLE, BLIND = (False, True), (True, True), (False, False)
"""(people, odometry) of the logs that the questions are about."""


def missing(lab: Lab, switches: tuple[bool, bool], *names: str, maintained: bool = False) -> str:
    """Why a question cannot be answered."""
    people, odometry = switches
    what = f"{'with' if people else 'without'} people, {'with' if odometry else 'without'} odometry"
    runs = ", ".join(NAMES[n] for n in names)
    extra = " and once more with map maintenance" if maintained else ""
    state = "such a log was run, but not with all of these" if switches in lab.trials else "no such log was run"
    return f"Not answered: this needs a corridor {what}, run with {runs}{extra}; {state}."


def rmse(scores: Scores, trial: Trial, run: Run, phase: str = "online") -> float:
    """Position RMSE [m] of a run by the referee."""
    m = scores.metrics
    row = m[
        (m["log"] == trial.log.name) & (m["task"] == trial.task) & (m["estimator"] == run.estimator)
        & (m["association"] == run.association) & (m["phase"] == phase)
    ]  # fmt: skip
    value = row["rmse_position_m"].tolist()
    return math.nan if not value or value[0] is None else float(value[0])


def plural(count: int, what: str) -> str:
    """A number and its noun."""
    return f"{count} {what}{'' if count == 1 else 's'}"


def share(value: float) -> str:
    """A share in percent."""
    return "none" if math.isnan(value) else f"{100.0 * value:.1f} %"


def move(before: float, after: float) -> str:
    """A change of a number, in words."""
    if number(before) == number(after):
        return f"stays at {number(after)}"
    return f"{'rises' if after > before else 'falls'} from {number(before)} to {number(after)}"


def count_move(before: int, after: int) -> str:
    """A count beside what it was."""
    return f"{before} as before" if before == after else f"{after} instead of {before}"


def count_change(before: int, after: int) -> str:
    """A change of a plural subject, in words."""
    return f"stay {after}" if before == after else f"go from {before} to {after}"

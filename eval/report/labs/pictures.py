"""The pictures of the corridor lab's answers: each made as a job of its own, with caption and alternative text."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from data.result import Run
from eval.figures.error import error_figure
from eval.figures.style import save
from eval.page.document import Picture
from eval.page.written import write_table
from eval.referee.score import Trial
from eval.replay.settings import Setup
from eval.report.corridor.facts import Lab, look, pair_of, run_of
from eval.report.corridor.phrases import BLIND, ODOMETRY, PEOPLE
from eval.report.lab.figures import (
    Shown,
    called,
    maintenance_figure,
    paths_figure,
    people_figure,
    update_time_figure,
)
from eval.report.lab.timing import REPEATS, update_times
from eval.walk.closer import closer_figure, methods_figure
from eval.walk.deciding import wrong_of
from eval.walk.plane import Matching
from eval.walk.problem import problems_of

Drawn = tuple[Figure, str, str]
"""Figure, caption (Markdown), and what it shows in a sentence."""
TIME_HEADS = ("run", "median [ms]", "largest [ms]", "whole run [ms]", "removing landmarks [ms]")
BLIND_PEOPLE = (True, False)
UPDATE_TIME = "update-time"
"""The one picture that is never the same twice."""


def stem(kind: str) -> str:
    """Name of a picture's files."""
    return f"lab-{kind}"


def draw(folder: Path, kind: str, lab: Lab, setup: Setup, formats: tuple[str, ...], tables: tuple[str, ...]) -> Picture:
    """Draw one picture of `KINDS` below the result folder."""
    if kind == UPDATE_TIME:
        figure, caption, alt = _update_time(folder, lab, setup, tables)
    else:
        figure, caption, alt = KINDS[kind](lab, setup)
    save(figure, folder / "figures", stem(kind), formats)
    return Picture(stem(kind), caption, alt)


def _need(lab: Lab, switches: tuple[bool, bool], method: str) -> Shown:
    """A run that the lab has, as it runs every method in every condition; one that diverged raises."""
    trial = lab.trials[switches]
    run = run_of(trial, method)
    if run is None:
        raise LookupError(f"{trial.log.name}: no run with {method} got to its end")
    return Shown(trial, run)


def has(lab: Lab, switches: tuple[bool, bool], *methods: str) -> bool:
    """Whether runs with all these methods got to their end in a condition."""
    return all(run_of(lab.trials.get(switches), m) is not None for m in methods)


def _frame_problem(
    s: Shown, setup: Setup, frames: list[int], title: str, methods: tuple[str, ...]
) -> dict[int, Matching]:
    return problems_of(s.log, "slam", s.run.estimator, s.run.association, setup, frames, methods, title)


def _first_wrong(lab: Lab, setup: Setup) -> Drawn:
    s = _need(lab, ODOMETRY, "nn")
    first = look(s.run, s.log).first_wrong
    frame = len(s.log.recorded) - 1 if first is None else first
    title = f"{s.log.name}, frame {{frame}}"
    m = _frame_problem(s, setup, [frame], title, ("nn",))[frame]
    what = (
        "the first frame in which NN pairs wrongly" if first is not None else "the last frame; NN pairs nothing wrongly"
    )
    return (
        closer_figure(m, "nn"),
        f"`{s.log.name}`, {what}, zoomed, seen from the robot: what is compatible, with d²; what NN makes of it.",
        f"Compatibility and matching of NN in frame {frame} of {s.log.name}, observations and landmarks numbered",
    )


def _errors(lab: Lab, setup: Setup) -> Drawn:
    shown = [_need(lab, ODOMETRY, m) for m in ("nn", "singles", "jcbb") if has(lab, ODOMETRY, m)]
    log = shown[0].log
    return (
        error_figure(log, [replace(s.run, final=None) for s in shown]),
        f"`{log.name}`: error of each coordinate with the filter's own ±3σ, by NN, SINGLES and JCBB.",
        f"Errors over time on {log.name} in x, y and heading with 3 sigma: {', '.join(called(s.run) for s in shown)}",
    )


def _people(lab: Lab, setup: Setup) -> Drawn:
    methods = [m for m in ("nn", "singles") if has(lab, ODOMETRY, m) and has(lab, PEOPLE, m)]
    quiet, busy = ([_need(lab, c, m) for m in methods] for c in (ODOMETRY, PEOPLE))
    return (
        people_figure(quiet, busy),
        f"`{busy[0].log.name}`: squares are landmarks initialized on people. Below: error with people and without.",
        f"Maps of {' and '.join(called(s.run) for s in busy)} with people about, and their position errors",
    )


def _methods(lab: Lab, setup: Setup) -> Drawn:
    switches = PEOPLE if has(lab, PEOPLE, "jcbb") else ODOMETRY
    s = _need(lab, switches, "jcbb")
    names = ("nn", "singles", s.run.association)
    title = f"{s.log.name}, frame {{frame}}: the same map and prediction for all"
    found = _frame_problem(s, setup, list(range(1, len(s.log.recorded))), title, names)

    def gained(m: Matching) -> int:
        return len(wrong_of(m.truth.get("nn"))) - len(wrong_of(m.truth.get(s.run.association)))

    frame = max(found, key=lambda k: (gained(found[k]), -k))
    return (
        methods_figure(found[frame], names),
        f"`{s.log.name}`, the frame in which JCBB gains most over NN, zoomed: what each makes of the same map.",
        f"Decisions of NN, SINGLES and JCBB in frame {frame} of {s.log.name}, side by side",
    )


def _paths(lab: Lab, setup: Setup) -> Drawn:
    quiet, busy = ([Shown(lab.trials[c], r) for r in _online(lab.trials[c])] for c in (BLIND, BLIND_PEOPLE))
    return (
        paths_figure(quiet, busy),
        f"`{quiet[0].log.name}`: true path and what each method believes, online; the map is the one without people.",
        f"True and believed paths without odometry of {', '.join(s.run.association for s in quiet)}",
    )


def _online(trial: Trial) -> list[Run]:
    """The filters' runs that got to their end, one for each way of association."""
    found: dict[str, Run] = {}
    for run in trial.runs:
        if run.failure is None and run.online is not None and run.association != "none":
            found.setdefault(run.association, run)
    return list(found.values())


def maintained_pair(lab: Lab) -> tuple[Shown, Shown] | None:
    """The runs that the answer about map maintenance compares: without and with it."""
    for switches in (PEOPLE, *lab.maintained):
        plain, kept = lab.trials.get(switches), lab.maintained.get(switches)
        for method in ("jcbb", "nn", "singles"):
            both = pair_of(plain, kept, method)
            if plain is not None and kept is not None and both is not None:
                return Shown(plain, both[0]), Shown(kept, both[1])
    return None


def _maintenance(lab: Lab, setup: Setup) -> Drawn:
    both = maintained_pair(lab)
    assert both is not None  # asked for only where there is one
    plain, kept = both
    return (
        maintenance_figure(plain, kept),
        f"`{plain.log.name}`, {called(plain.run)}: map and state without and with maintenance; crosses: where removed"
        " landmarks had been initialized.",
        f"Maps and length of the state on {plain.log.name} without and with map maintenance",
    )


def _update_time(folder: Path, lab: Lab, setup: Setup, tables: tuple[str, ...]) -> Drawn:
    both = maintained_pair(lab)
    assert both is not None  # asked for only where there is one
    plain = both[0]
    setups = [replace(setup, maintain=maintain) for maintain in (False, True)]
    measured = update_times(plain.log, plain.run.estimator, plain.run.association, setups)
    labels = [f"{called(plain.run)} {what} maintenance" for what in ("without", "with")]
    times = [(label, plain.run.association, t) for label, t in zip(labels, measured, strict=True)]
    log = both[0].log
    rows = [
        [label, *(1e3 * f(t.update) for f in (np.median, np.max, np.sum)), 1e3 * np.sum(t.maintenance)]
        for label, _, t in times
    ]
    caption = f"{log.name}: measured time of a frame's update, fastest of {REPEATS}. Differs from run to run."
    write_table(pd.DataFrame(rows, columns=list(TIME_HEADS)), folder / "tables", stem(UPDATE_TIME), caption, tables)
    return (
        update_time_figure(log, times, REPEATS),
        f"`{log.name}`: measured time of each frame's update, new landmarks included. Never the same twice.",
        f"Measured time of an update over the frames of {log.name}, without and with map maintenance",
    )


KINDS: dict[str, Callable[[Lab, Setup], Drawn]] = {
    "first-wrong": _first_wrong,
    "errors": _errors,
    "people": _people,
    "methods": _methods,
    "paths": _paths,
    "maintenance": _maintenance,
}
NEEDED: dict[str, Callable[[Lab], bool]] = {
    "first-wrong": lambda lab: has(lab, ODOMETRY, "nn"),
    "errors": lambda lab: any(has(lab, ODOMETRY, m) for m in ("nn", "singles", "jcbb")),
    "people": lambda lab: any(has(lab, ODOMETRY, m) and has(lab, PEOPLE, m) for m in ("nn", "singles")),
    "methods": lambda lab: any(has(lab, c, "jcbb") for c in (PEOPLE, ODOMETRY)),
    "paths": lambda lab: BLIND_PEOPLE in lab.trials and BLIND in lab.trials and bool(_online(lab.trials[BLIND])),
    "maintenance": lambda lab: maintained_pair(lab) is not None,
    UPDATE_TIME: lambda lab: maintained_pair(lab) is not None,
}
"""What each picture needs: runs that got to their end."""

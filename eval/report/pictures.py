"""The files of one trial: its runs and films, and each of its pictures with caption and alternative text.

The films of a trial: one for each run, named by estimator and association, and where the report shows them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from data.log import Log
from data.result import Run
from eval import figures
from eval.figures.association import bars
from eval.figures.error import longest_sigma
from eval.figures.film import AS_THEN, History
from eval.figures.growth import closing_frame, state_is_informative
from eval.figures.plane import SIGMAS, longest_axis
from eval.figures.style import save
from eval.plan.flags.options import Options
from eval.player.watch import Watched
from eval.referee.given_runs import log_of
from eval.referee.score import Trial, confusion_of
from eval.referee.trust import SHARE
from eval.report.laser import GRID_PICTURE, LOOP_PICTURE, laser_kinds, laser_picture, write_laser_files
from eval.report.names import SYSTEMATIC, stem
from eval.report.page.blocks import Film
from eval.report.page.document import Picture
from eval.report.page.tables import number
from eval.report.results import aligned_statement
from eval.report.run_files import write_run
from eval.report.shown_runs import (
    finished,
    for_fate,
    for_filter_smoother,
    for_growth,
    for_map,
    for_panels,
    has_covariance,
    left_out,
    plausible,
    same,
    worst,
)


def publish_runs(folder: Path, options: Options, trial: Trial) -> None:
    """Write the run files of a trial, and its films if asked for."""
    if trial.beside is None:
        write_laser_files(folder, trial)
    for run in trial.runs:
        write_run(folder, trial, run, lab_text=options.lab_text)
    if options.animate:
        write_films(folder, options, trial)


FILTER_SMOOTHER = "filter-smoother"
QUICK = ("map", GRID_PICTURE, "error", "difference", "association", SYSTEMATIC)
"""All that a quick report shows."""


def kinds(trial: Trial, beside: Sequence[Trial] = (), *, quick: bool = False) -> tuple[str, ...]:
    """Which pictures a trial gets, with the trials that stand beside it."""
    shown, reference = finished(trial), trial.find("batch")
    found = ["map", *laser_kinds(trial)]
    if shown and trial.log.truth.known_poses:
        found += ["error", "nees"] if any(has_covariance(r) for r in shown) else ["error"]
    elif shown:
        if reference is not None and reference.flaw is None and len(shown) > 1:
            found.append("difference")
        if any(has_covariance(r) for r in shown):
            found.append("claims")
        if for_fate(trial):
            found.append("fate")
    if trial.beside is None and for_filter_smoother(trial) is not None:
        found.append(FILTER_SMOOTHER)
    if trial.beside is None and _calibrated(trial):
        found.append(SYSTEMATIC)
    if trial.task == "slam" and trial.log.truth.known_poses and for_growth(trial):
        found.append("growth")
    if state_is_informative(trial, beside):
        found.append("state")
    if has_outcomes(trial, beside):
        found.append("association")
    return tuple(kind for kind in found if kind in QUICK or not quick)


def has_outcomes(trial: Trial, beside: Sequence[Trial] = ()) -> bool:
    """Whether decisions were made (not only labels read) that can be scored."""
    return any(
        confusion_of(r, t.log, "online") is not None
        for t in (trial, *beside)
        for r in t.runs
        if r.association != "known" and r.failure is None
    )


def draw(folder: Path, trial: Trial, kind: str, beside: Sequence[Trial] = (), *, quick: bool = False) -> Picture:
    """Draw one picture of `kinds`, as files below the result folder: PDF and PNG, in a quick report PNG alone."""
    figure, caption, alt = _picture(trial, kind, beside)
    save(figure, folder / "figures", stem(trial, kind), ("png",) if quick else ("pdf", "png"))
    return Picture(stem(trial, kind), caption, alt)


def _picture(trial: Trial, kind: str, beside: Sequence[Trial]) -> tuple[Figure, str, str]:
    """Figure, caption and what it shows in a sentence."""
    log = trial.log
    where = f"`{log.name}`, {trial.task}"
    if kind in (GRID_PICTURE, LOOP_PICTURE):
        return laser_picture(trial, kind)
    if kind == "association":
        return (
            figures.confusion_figure(f"{log.name}, {trial.task}: decisions", bars(trial, beside)),
            f"{where}: outcomes of all observations' decisions, right ones blue; numbers: FP and FN. Estimators with"
            " the same decisions share a bar.",
            f"Bars of right and wrong association decisions on {log.name}",
        )
    if kind == "state":
        return (
            figures.state_figure(trial, beside),
            f"{where}: length of the filters' state after each frame. A method that initializes landmarks twice, or on"
            " clutter, pays for them in every later update.",
            f"Length of the state over time on {log.name}",
        )
    if kind == "growth":
        runs = for_growth(trial)
        return (
            figures.growth_figure(log, runs),
            f"{where}, association {runs[0].association}: standard deviation along the least certain direction, of the"
            f" robot at each frame and of the landmarks after the last one, and where shown at each frame: it shrinks"
            f" at loop closure.{_closure(log, runs)}",
            f"Uncertainty of robot and landmarks on {log.name}",
        )
    if kind == FILTER_SMOOTHER:
        return _filter_smoother(trial, where)
    if kind == SYSTEMATIC:
        return _systematic(trial, where)
    if kind == "map":
        drawn = for_map(trial)
        return (
            figures.map_figure(log, drawn),
            f"{where}: paths and landmarks with 3σ ellipses. World frame, no alignment.{aligned_statement(trial)}"
            f"{left_out(trial, drawn)}{_contrast(trial, drawn)}",
            f"Map of {log.name} with the paths of {', '.join(f'{r.estimator} ({r.association})' for r in drawn)}",
        )
    if kind == "error":
        columns = for_panels(finished(trial))
        return (
            figures.error_figure(log, columns),
            f"{where}: error of each coordinate with the estimator's own ±3σ, which it rarely leaves if consistent."
            f"{left_out(trial, columns)}",
            f"Errors over time on {log.name} in x, y and heading, one column per estimator",
        )
    if kind == "claims":
        claiming = for_panels([r for r in finished(trial) if has_covariance(r)])
        return (
            figures.claims_figure(log, claiming),
            f"{where}: NIS in stretches of equal degrees of freedom with its 95 % bounds, and the standard deviations"
            " that the estimators claim (position: along the least certain direction). The log has no true path."
            f"{left_out(trial, claiming)}",
            f"NIS and claimed standard deviations over time on {log.name}",
        )
    if kind == "fate":
        fated = for_fate(trial)
        return (
            figures.fate_figure(log, fated),
            f"{where}: every reading where the last path puts it, by what became of it.{left_out(trial, fated)}",
            f"Map of {log.name} with paired, new, discarded and revised readings",
        )
    if kind == "nees":
        columns = for_panels([r for r in finished(trial) if has_covariance(r)])
        return (
            figures.nees_figure(log, columns),
            f"{where}: pose NEES per frame; a consistent one is in the band 95 % of the time. One run: no verdict."
            f"{left_out(trial, columns)}",
            f"Pose NEES over time on {log.name}",
        )
    reference = trial.find("batch")
    assert reference is not None  # `kinds` asks for a difference only where there is one
    rows = for_panels([r for r in finished(trial) if r is not reference], complete=(reference.association,))
    return (
        figures.difference_figure(log, rows, reference),
        f"{where}: distance from the batch solution, with each run's own 3σ. No error: the log has no true path."
        f"{left_out(trial, [*rows, reference])}",
        f"Distance from the batch solution over time on {log.name}",
    )


def _filter_smoother(trial: Trial, where: str) -> tuple[Figure, str, str]:
    alike = for_filter_smoother(trial)
    assert alike is not None  # `kinds` asks for it only where there are some
    runs, smoother = alike
    others = [r for r in plausible(trial) if r.online is not None and r.association == smoother.association]
    names = ", ".join(r.estimator for r in others if not any(r is shown for shown in runs))
    return (
        figures.filter_smoother_figure(trial.log, runs, smoother),
        f"{where}, association {smoother.association}: each online estimate less `{smoother.estimator}`'s under the"
        " same decisions, in world coordinates. If all is as stated it is rarely outside ±3σ of the difference (the"
        f" root of the diagonal of P_f − P_s; blank where later data took less than {100 * SHARE:g} % of the variance"
        " away); along a run it is strongly correlated. Marked: largest excursion in sigmas."
        + (f" Not shown, as other decisions were made: {names}." if names else ""),
        f"Online less smoothed estimates on {trial.log.name} in x, y and heading",
    )


def _calibrated(trial: Trial) -> list[Run]:
    """Runs that estimated systematic errors along, with the first way of association that has some."""
    there = [r for r in finished(trial) if r.errors is not None and r.association != "none"]
    return [r for r in there if r.association == there[0].association]


def _systematic(trial: Trial, where: str) -> tuple[Figure, str, str]:
    runs, systematic = _calibrated(trial), trial.log.recorded.systematic
    assert systematic is not None  # or nothing was estimated
    return (
        figures.systematic_figure(trial.log, systematic, runs),
        f"{where}, association {runs[0].association}: systematic errors as estimated along, ±3σ; grey what was known"
        " before. Online an estimate is of the data up to its frame; what stays inside the grey band is told by the"
        " prior, not by the log.",
        f"Systematic errors over time on {trial.log.name} as {', '.join(r.estimator for r in runs)} estimate them",
    )


def _contrast(trial: Trial, drawn: Sequence[Run]) -> str:
    """Which run is in the map for going astray, where not all are."""
    astray = worst(trial)
    if astray is None or len(drawn) == len(trial.runs) or not any(same(r, astray) for r in drawn):
        return ""
    return f" Furthest from the truth is {astray.estimator} with {astray.association}."


def _closure(log: Log, runs: Sequence[Run]) -> str:
    """The uncertainty of robot and landmarks round the loop, in numbers."""
    text, line = "", False
    for run in runs:
        closed, sigma = closing_frame(log, run), longest_sigma(run.trajectory("online"))
        text += f" {run.estimator}: robot at most {number(float(np.nanmax(sigma)))} m"
        if closed is not None and closed > 0:
            line = True
            text += f", {number(float(sigma[closed - 1]))} m just before the loop is closed"
        text += f", {number(float(sigma[-1]))} m at the end"
        if run.map is not None and len(run.map):
            each, who = longest_axis(run.map.covariance) / SIGMAS, run.map.number
            text += (
                f"; first landmark {number(float(each[0]))} m, last {number(float(each[-1]))} m, least certain"
                f" {number(float(each.max()))} m (number {who[each.argmax()]})"
            )
        text += "."
    return (" The dotted line: landmarks are seen again after going round." if line else "") + text


def film_stem(trial: Trial, run: Run) -> str:
    """Name of a run's film: as its folder below `runs/`, so that no two runs of a report share one."""
    return stem(trial, f"{run.estimator}-{run.association}")


def write_films(folder: Path, options: Options, trial: Trial) -> None:
    """Film every run of a trial that got to the end."""
    from eval.figures.film import animate  # OpenCV is loaded only where films are wanted

    for run in _filmed(trial):
        path = folder / "figures" / f"{film_stem(trial, run)}.webm"
        animate(log_of(run, trial.log), run, path, speed=options.speed, history=history_of(run))


def history_of(run: Run) -> History | None:
    """Landmarks as they were at each instant, where somebody wrote them down while the run was made.

    Of a smoother only their places were, so that its landmarks are dots.
    """
    watched = run.watched
    if not isinstance(watched, Watched) or not len(watched.change_frame):
        return None
    sigma, product = watched.change_sigma, watched.change_rho * watched.change_sigma.prod(axis=1)
    covariance = np.empty((len(sigma), 2, 2))
    covariance[:, 0, 0], covariance[:, 1, 1] = np.square(sigma).T
    covariance[:, 0, 1] = covariance[:, 1, 0] = product
    there = watched.change_there.astype(bool)
    return History(watched.change_frame, watched.change_number, there, watched.change_xy, covariance, AS_THEN)


def films_of(folder: Path, trial: Trial) -> list[Film]:
    """The films of a trial that were written."""
    found = []
    for run in _filmed(trial):
        film = Film(film_stem(trial, run), _caption(trial, run))
        if (folder / film.path).exists():
            found.append(film)
    return found


def _filmed(trial: Trial) -> Iterator[Run]:
    return (run for run in trial.runs if run.failure is None)


def _caption(trial: Trial, run: Run) -> str:
    return (
        f"`{trial.log.name}`, {trial.task}: `{run.estimator}` with association {run.association}, {run.phases[0]};"
        " its path fades behind it, rays are observations (grey: not used), the truth is black."
    )

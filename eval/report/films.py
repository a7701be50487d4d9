"""The films of a trial: one for each run, named by estimator and association, and where the report shows them."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from data.result import Run
from eval.figures.films.landmarks import AS_THEN, History
from eval.page.film import Film
from eval.plan.flags.options import Options
from eval.player.watch import Watched
from eval.referee.paths.given import log_of
from eval.referee.score import Trial
from eval.report.names import stem


def film_stem(trial: Trial, run: Run) -> str:
    """Name of a run's film: as its folder below `runs/`, so that no two runs of a report share one."""
    return stem(trial, f"{run.estimator}-{run.association}")


def write_films(folder: Path, options: Options, trial: Trial) -> None:
    """Film every run of a trial that got to the end."""
    from eval.figures.films.film import animate  # OpenCV is loaded only where films are wanted

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

"""Run files, films and pictures of all trials and the player of each log, written as parallel jobs."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from data.notice import Notice
from data.result import Run
from eval.figures.film import AS_THEN, History
from eval.plan.flags.table import Execution, Output
from eval.plan.unfinished import MISSING_RUN, Unfinished
from eval.plan.work import Job, work
from eval.player.document import played, write_player
from eval.player.watch import Watched
from eval.referee.given_runs import log_of
from eval.referee.score import Trial
from eval.replay.settings import Setup
from eval.report.laser import write_laser_files
from eval.report.page.blocks import Film, Picture
from eval.report.pictures import draw, kinds
from eval.report.rows import stem, variants
from eval.report.run_files import write_run
from eval.report.words import paragraph

RUN_FILES, PLAYER = -1, -2  # places of jobs that are no pictures
MISSING = {RUN_FILES: "files", PLAYER: "player"}  # what is missing without them; see `missing` in notices.j2
DRAWING, WRITING = 0.5, 1e-3
"""s of processor time for a figure, and for a frame of a log's files or player; measured, rounded up."""


def publish(
    folder: Path,
    output: Output,
    setup: Setup,
    trials: Sequence[Trial],
    lost: Unfinished,
    execution: Execution,
    progress: Callable[[int, int], None],
) -> list[list[Picture]]:
    """Write everything; returns the pictures of each trial. What there was no memory for is reported to `lost`."""
    jobs: list[Job[tuple[int, int]]] = []
    for i, trial in enumerate(trials):
        others = variants(trial, trials)
        drawn = not (output.no_plots or _shown_elsewhere(trial, trials))
        for place, kind in enumerate(kinds(trial, others, quick=output.quick) if drawn else ()):
            jobs.append(Job((i, place), draw, (folder, trial, kind, others), DRAWING))
    for i, trial in enumerate(trials):
        length = WRITING * len(trial.log.recorded)
        jobs.append(Job((i, RUN_FILES), publish_runs, (folder, output, trial), math.inf if output.animate else length))
    for group in () if output.no_plots else played(trials):
        owner = (trials.index(group[0]), PLAYER)
        jobs.append(Job(owner, write_player, (folder, group, setup), WRITING * len(group[0].log.recorded)))

    def missing(owner: tuple[int, int], why: Notice) -> None:
        trial = trials[owner[0]]
        lost.say(MISSING.get(owner[1], "picture"), why, MISSING_RUN.about(log=trial.log.name, task=trial.task))

    made: dict[tuple[int, int], Picture] = {}
    for done, (owner, picture) in enumerate(work(jobs, execution, lost=missing), start=1):
        if owner[1] >= 0:
            made[owner] = picture
        progress(done, len(jobs))
    return [[made[owner] for owner in sorted(made) if owner[0] == i] for i in range(len(trials))]


def _shown_elsewhere(trial: Trial, trials: Sequence[Trial]) -> bool:
    """Whether a variant is on the very recording or images of its trial, whose pictures show it."""
    log = trial.log
    return any(
        t.log.recorded is log.recorded or (t.log.evidence is not None and t.log.evidence is log.evidence)
        for t in trials
        if trial in variants(t, trials)
    )


def publish_runs(folder: Path, output: Output, trial: Trial) -> None:
    """Write the run files of a trial, and its films if asked for."""
    if trial.variant_of is None:
        write_laser_files(folder, trial)
    for run in trial.runs:
        write_run(folder, trial, run, lab_text=output.lab_text)
    if output.animate:
        write_films(folder, trial, output.speed)


def write_films(folder: Path, trial: Trial, speed: float | None = None) -> None:
    """Film every run of a trial that reached the end; `speed`: seconds of the log in one of the film."""
    from eval.figures.film import animate  # OpenCV is loaded only where films are wanted

    for run in (r for r in trial.runs if r.failure is None):
        path = folder / "figures" / f"{stem(trial, f'{run.estimator}-{run.association}')}.webm"
        animate(log_of(run, trial.log), run, path, speed=speed, history=history_of(run))


def history_of(run: Run) -> History | None:
    """Landmarks as they were at each instant, where the run was watched; of a smoother without covariances."""
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
    for run in (r for r in trial.runs if r.failure is None):
        caption = paragraph("pictures#film", log=trial.log.name, task=trial.task, run=run)
        film = Film(stem(trial, f"{run.estimator}-{run.association}"), caption)
        if (folder / film.path).exists():
            found.append(film)
    return found

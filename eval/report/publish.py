"""Run files, films and pictures of all trials and the player of each log, written as parallel jobs."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd

from association.names import SCAN
from data.log import folder_name
from data.notice import Notice
from data.result import Run, Trajectory
from data.se2 import Array
from data.wing import by_name, of_all
from eval.figures.kinds import Kind, Variants, every
from eval.figures.style import save_for_page
from eval.plan.experiment import MISSING_RUN, Unfinished
from eval.plan.flags.table import Execution, Output
from eval.plan.work import Job, work
from eval.player.document import company_of, played, player_of, write_page
from eval.referee import result_files
from eval.referee.ambiguity import ambiguous
from eval.referee.confusion import OUTCOMES
from eval.referee.errors import identified, landmark_true_ids, named
from eval.referee.given.runs import log_of
from eval.referee.score import Trial, confusion_of
from eval.replay.settings import Setup
from eval.report.page.blocks import Film, Picture
from eval.report.page.files import stem, variants
from eval.report.words import paragraph

RUN_FILES, PLAYER = -1, -2  # places of jobs that are no pictures
MISSING = {RUN_FILES: "files", PLAYER: "player"}  # what is missing without them; see `missing` in notices.j2
DRAWING, WRITING = 0.8, 1e-3  # s of processor time for a figure, and a frame of a log's files or player; measured


def kinds(trial: Trial, variants: Variants = (), *, quick: bool = False) -> dict[str, Kind]:
    """The figures that a trial gets, with its variants, in the order of the report."""
    (first, of_map), *rest = every().items()
    all_kinds = {first: of_map, **by_name("figures"), **dict(rest)}
    return {n: kind for n, kind in all_kinds.items() if (kind.in_quick or not quick) and kind.applies(trial, variants)}


def draw(folder: Path, trial: Trial, name: str, variants: Variants = ()) -> Picture:
    """Draw one figure of `kinds`, as files below the result folder."""
    kind = kinds(trial, variants)[name]
    (first, facts), name_of_file = kind.drawn(trial, variants), stem(trial, name)
    macro = kind.macro or f"pictures#figure_{name.replace('-', '_')}"
    caption, alt = (paragraph(m, log=trial.log.name, task=trial.task, **facts) for m in (macro, f"{macro}_alt"))
    save_for_page(lambda: kind.drawn(trial, variants)[0], folder / "figures", name_of_file, first)
    return Picture(name_of_file, caption, alt, place=kind.place)


def publish(
    folder: Path, output: Output, setup: Setup, trials: Sequence[Trial], lost: Unfinished, execution: Execution,
    progress: Callable[[int, int], None],
) -> list[list[Picture]]:  # fmt: skip
    """Write everything; returns the pictures of each trial. What there was no memory for is reported to `lost`."""
    jobs: list[Job[tuple[int, int]]] = []
    for i, trial in enumerate(trials):
        others = variants(trial, trials)
        # pictures of its trial show a variant on the very recording or images
        hosts, log = [t.log for t in trials if trial in variants(t, trials)], trial.log
        seen = any(h.recorded is log.recorded or (h.evidence is not None and h.evidence is log.evidence) for h in hosts)
        drawn = not (output.no_plots or seen)
        wanted = (*output.show, "dead-reckoning")
        shown = replace(trial, runs=tuple(r for r in trial.runs if r.estimator in wanted)) if output.show else trial
        there = kinds(shown, others, quick=output.quick) if drawn else ()
        for place, kind in enumerate(k for k in there if not output.figures or k in output.figures):
            jobs.append(Job((i, place), draw, (folder, shown, kind, others), DRAWING))
    for i, trial in enumerate(trials):
        length = WRITING * len(trial.log.recorded)
        jobs.append(Job((i, RUN_FILES), publish_runs, (folder, output, trial), math.inf if output.animate else length))
    for group in () if output.no_plots else played(trials):
        owner, log = (trials.index(group[0]), PLAYER), group[0].log
        page = folder / player_of(log.name)
        page.parent.mkdir(exist_ok=True)
        given = page, group, setup, company_of(group, trials)
        jobs.append(Job(owner, write_page, given, WRITING * len(log.recorded)))

    def missing(owner: tuple[int, int], why: Notice) -> None:
        trial = trials[owner[0]]
        lost.say(MISSING.get(owner[1], "picture"), why, MISSING_RUN.about(log=trial.log.name, task=trial.task))

    made: dict[tuple[int, int], Picture] = {}
    for done, (owner, picture) in enumerate(work(jobs, execution, lost=missing), start=1):
        if owner[1] >= 0:
            made[owner] = picture
        progress(done, len(jobs))
    return [[made[owner] for owner in sorted(made) if owner[0] == i] for i in range(len(trials))]


def publish_runs(folder: Path, output: Output, trial: Trial) -> None:
    """Write the run files of a trial, and its films if asked for."""
    if trial.variant_of is None:
        for of_wing in of_all("files"):
            of_wing(folder, trial)
    for run in trial.runs:
        place = write_run(folder, trial, run)
        for of_wing in of_all("run_files"):
            of_wing(place, output, trial, run)
    if output.animate:
        write_films(folder, trial, output.speed)


def write_films(folder: Path, trial: Trial, speed: float | None = None) -> None:
    """Film every run of a trial that reached the end; `speed`: seconds of the log in one of the film."""
    from eval.figures.film import animate  # needs OpenCV

    for run in (r for r in trial.runs if r.failure is None):
        path = folder / "figures" / f"{stem(trial, f'{run.estimator}-{run.association}')}.webm"
        animate(log_of(run, trial.log), run, path, speed)


def films_of(folder: Path, trial: Trial) -> list[Film]:
    """The films of a trial that were written."""
    found = []
    for run in (r for r in trial.runs if r.failure is None):
        caption = paragraph("pictures#film", log=trial.log.name, task=trial.task, run=run)
        film = Film(stem(trial, f"{run.estimator}-{run.association}"), caption)
        if (folder / film.path).exists():
            found.append(film)
    return found


FILES = {"online": result_files.ONLINE, "final": result_files.FINAL}


def _blank(values: Array) -> pd.Series:
    """Numbers for a CSV: unknown is blank."""
    return pd.Series(values).astype(object).where(np.isfinite(values), None)


def trajectory_table(time: Array, trajectory: Trajectory) -> pd.DataFrame:
    """One row per frame: time, pose, upper triangle of the world-frame covariance."""
    rows, cols = np.triu_indices(3)
    values = np.column_stack([time, trajectory.pose, trajectory.covariance[:, rows, cols]])
    return pd.DataFrame({name: _blank(values[:, i]) for i, name in enumerate(c.name for c in result_files.PATH)})


def write_tum(path: Path, time: Array, pose: Array) -> None:
    """`t x y z qx qy qz qw`, the format other evaluation tools read; frames without a pose are left out."""
    known = np.isfinite(pose[:, :2]).all(axis=1)
    half = 0.5 * pose[known, 2]
    zero = np.zeros(len(half))
    turn = np.nan_to_num([np.sin(half), np.cos(half)])  # a quaternion of zeros where there is no heading
    columns = [time[known], pose[known, 0], pose[known, 1], zero, zero, zero, *turn]
    with path.open("w", encoding="utf-8") as file:
        np.savetxt(file, np.column_stack(columns), fmt="%.17g")


def write_truths(folder: Path, trials: Sequence[Trial]) -> None:
    """The true path of every log that has one, as `runs/<log>/truth.tum`."""
    for log in {t.log.name: t.log for t in trials}.values():
        if log.truth.pose is not None and log.truth.known_poses:
            place = folder / "runs" / folder_name(log.name)
            place.mkdir(parents=True, exist_ok=True)
            write_tum(place / "truth.tum", log.recorded.time, log.truth.pose)


def write_run(folder: Path, trial: Trial, run: Run) -> Path:
    """Everything about one run below `folder/runs/<log>/<task>-<estimator>-<association>/`, which is returned."""
    log = trial.log
    place = folder / "runs" / folder_name(log.name) / f"{run.task}-{run.estimator}-{run.association}"
    place.mkdir(parents=True, exist_ok=True)
    time = log_of(run, log).recorded.time
    for phase in run.phases:
        trajectory = run.trajectory(phase)
        table = trajectory_table(time, trajectory)
        if phase == "online":
            likelihood = run.innovations.log_likelihood if run.innovations is not None else np.full(len(time), np.nan)
            table["log_likelihood"] = _blank(likelihood)
            table["state_size"] = run.state_size if run.state_size is not None else None
        errors = run.errors_online if phase == "online" else run.errors_final
        if errors is not None:  # estimated along
            for i, name in enumerate(errors.names):
                table[name], table[f"sigma_{name}"] = _blank(errors.mean[:, i]), _blank(errors.sigma[:, i])
        FILES[phase].write(table, place)
        write_tum(place / f"{phase}.tum", time, trajectory.pose)
    _write_map(place, trial, run)
    _write_decisions(place, trial, run)
    return place


def _write_map(place: Path, trial: Trial, run: Run) -> None:
    m = run.map
    if m is None:
        bare = run.handed_in or run.association in ("none", SCAN)
        if run.task != "slam" or bare or run.failure is not None:
            return
        raise AssertionError(f"{run.estimator} did SLAM but returned no map")
    ids = m.number if run.task == "localization" else landmark_true_ids(named(run), identified(trial.log), m.number)
    near, until = ambiguous(run, trial.log.recorded), np.full(len(m), -1, np.int64)
    for n in [] if run.left is None else run.left.tolist():  # of those that left the map: their last observation
        until[m.number == n] = trial.log.recorded.observations.frame[run.final_decisions == n].max(initial=-1)
    table = pd.DataFrame({
        "landmark": m.number, "x": m.xy[:, 0], "y": m.xy[:, 1], "c_xx": m.covariance[:, 0, 0],
        "c_xy": m.covariance[:, 0, 1], "c_yy": m.covariance[:, 1, 1],
        "true_id": pd.Series(ids, dtype=object).where(ids >= -1, None), "first_frame": m.first_frame,
        "times_seen": m.times_seen, "ambiguous": pd.Series(near, dtype=object).where(near >= 0, None),
        "until": pd.Series(until, dtype=object).where(until >= 0, None),
    })  # fmt: skip
    result_files.LANDMARKS.write(table, place)


def _write_decisions(place: Path, trial: Trial, run: Run) -> None:
    """One row per observation; truth and outcome are blank where the true id is unknown."""
    if not run.decides:
        return
    recorded = trial.log.recorded
    frame = recorded.observations.frame
    table = pd.DataFrame({"frame": frame, "observation": np.arange(len(frame)) - recorded.start[frame]})
    table["decision"] = run.decisions
    names = np.array(OUTCOMES, dtype=object)
    scored = {phase: confusion_of(run, trial.log, phase) for phase in ("online", "final")}
    online, final = scored["online"], scored["final"]
    table["truth"] = None if online is None else online.ground_truth
    table["outcome"] = None if online is None else names[online.outcome]
    # -1 says that a landmark begins with the observation that created it; with another one: its number
    moved = (run.initialized >= 0) & (run.initialized != run.created)
    table["final_decision"] = np.where(moved, run.initialized, run.final_decisions)
    table["final_outcome"] = None if final is None else names[final.outcome]
    table["begins"] = run.initialized
    result_files.DECISIONS.write(table, place)

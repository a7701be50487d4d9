"""The files of one run in the result folder: trajectories, map and decisions, as DESIGN's columns and as TUM paths."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from association.scans.constraints import SCAN
from data.log import folder_name
from data.result import Run, Trajectory
from data.se2 import Array
from eval.referee import result_files
from eval.referee.ambiguity import ambiguous
from eval.referee.confusion import OUTCOMES
from eval.referee.errors import landmark_true_ids, named
from eval.referee.given_runs import log_of
from eval.referee.score import Trial, confusion_of
from eval.stepping.text import lab_block, run_text

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
    known = np.isfinite(pose).all(axis=1)
    half = 0.5 * pose[known, 2]
    zero = np.zeros(len(half))
    columns = [time[known], pose[known, 0], pose[known, 1], zero, zero, zero, np.sin(half), np.cos(half)]
    with path.open("w", encoding="utf-8") as file:
        np.savetxt(file, np.column_stack(columns), fmt="%.17g")


def write_truths(folder: Path, trials: Sequence[Trial]) -> None:
    """The true path of every log that has one, as `runs/<log>/truth.tum`."""
    for log in {t.log.name: t.log for t in trials}.values():
        if log.truth.pose is not None and log.truth.known_poses:
            place = folder / "runs" / folder_name(log.name)
            place.mkdir(parents=True, exist_ok=True)
            write_tum(place / "truth.tum", log.recorded.time, log.truth.pose)


def write_run(folder: Path, trial: Trial, run: Run, *, lab_text: bool = False) -> None:
    """Everything about one run below `folder/runs/<log>/<task>-<estimator>-<association>/`."""
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
    if lab_text and run.association not in ("none", SCAN):
        text = run_text(log, run, run.phases[0], lab_block)
        (place / result_files.LAB_TEXT.name).write_text(f"{text}\n", encoding="utf-8", newline="\n")


def _write_map(place: Path, trial: Trial, run: Run) -> None:
    m = run.map
    if m is None:
        bare = run.handed_in or run.association in ("none", SCAN)
        if run.task != "slam" or bare or run.failure is not None:
            return
        raise AssertionError(f"{run.estimator} did SLAM but returned no map")
    ids = landmark_true_ids(named(run), trial.log.truth, m.number)
    near = ambiguous(run, trial.log.recorded)
    table = pd.DataFrame({
        "landmark": m.number, "x": m.xy[:, 0], "y": m.xy[:, 1], "c_xx": m.covariance[:, 0, 0],
        "c_xy": m.covariance[:, 0, 1], "c_yy": m.covariance[:, 1, 1],
        "true_id": pd.Series(ids, dtype=object).where(ids >= -1, None), "first_frame": m.first_frame,
        "times_seen": m.times_seen, "ambiguous": pd.Series(near, dtype=object).where(near >= 0, None),
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
    result_files.DECISIONS.write(table, place)

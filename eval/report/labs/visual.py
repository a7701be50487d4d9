"""The visual lab's three questions in their order: the robot's motion, what the camera sees, and both put together.

The assignment asks for the motion model and the observation model with their Jacobians, and for the filter's path with
its ellipses.

The first sections of a report made with `--lab`: the lab's questions, answered in their order.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from data.log import folder_name
from data.result import Run
from data.se2 import Array, dead_reckoned
from eval.figures.error import error_figure, longest_sigma
from eval.figures.map import map_figure
from eval.figures.plane import along_path, draw_ellipses
from eval.figures.style import save, series
from eval.figures.visual import contact_sheet, draw_pictures, plan_figure
from eval.plan.flags.options import Options
from eval.referee.errors import position_distance, rms
from eval.referee.score import Trial
from eval.report.page.document import Block, Picture, Section, written_table
from eval.report.page.tables import number
from eval.report.visual import (
    MOTION,
    OBSERVATION,
    UPDATE,
    constants,
    models_latex,
    statistics_of,
    summary,
    tiles_of,
)

SHOWN = ("dead-reckoning", "ekf", "ekf-iterated", "isam2", "batch")
FEW_TILES = 2
"""Frames in the answer; the sheet with all that were kept stands below."""


def visual_hand_in(folder: Path, options: Options, trials: Sequence[Trial]) -> list[Section]:
    """Three sections on the first log made from images; nothing where there is none."""
    trial = next(
        (t for t in trials if t.log.evidence is not None and t.beside is None and t.task == "localization"), None
    )
    if trial is None:
        return []
    if "tex" in options.formats:
        (folder / "tables").mkdir(parents=True, exist_ok=True)
        models = folder / "tables" / f"{folder_name(trial.log.name)}-models.tex"
        models.write_text(models_latex(), encoding="utf-8", newline="\n")
    return [_motion(folder, options, trial), _observation(folder, options, trial), _filter(folder, options, trial)]


def _run(trial: Trial, estimator: str) -> Run | None:
    run = next((r for r in trial.runs if r.estimator == estimator), None)
    return None if run is None or run.failure is not None else run


def _formats(options: Options) -> tuple[str, ...]:
    return ("png",) if options.quick else ("pdf", "png")


def _motion(folder: Path, options: Options, trial: Trial) -> Section:
    log, run = trial.log, _run(trial, "dead-reckoning")
    path = dead_reckoned(log.recorded.prior.mean, log.recorded.increments.mean) if run is None else _path(run)
    length = float(np.hypot(*np.diff(path[:, :2], axis=0).T).sum())
    said = f"Commands alone lead over {number(length)} m of path"
    if log.truth.pose is not None and log.truth.known_poses:
        off = position_distance(path, log.truth.pose)
        said += f" and end {number(float(off[np.isfinite(off)][-1]))} m off"
    if run is not None:
        said += f", with a standard deviation of {number(float(longest_sigma(run.trajectory('online'))[-1]))} m"
    blocks: list[Block] = [f"**{said}.**"]
    if not options.no_plots:
        blocks.append(
            _plan(
                folder,
                options,
                trial,
                ("dead-reckoning",),
                "lab-motion",
                "dead reckoning alone, 3σ ellipses in their size",
            )
        )
    blocks += [MOTION.formula, f"{MOTION.about} {constants(log)}"]
    return Section("Question 1: How does the robot move, and how does its uncertainty grow?", tuple(blocks))


def _observation(folder: Path, options: Options, trial: Trial) -> Section:
    log = trial.log
    assert log.evidence is not None  # a log made from images
    found = log.evidence.found
    said = (
        f"{len(found.frame)} pictures were found in {len(found.time)} frames, four corners each:"
        f" {len(log.recorded.observations.frame)} observations."
    )
    blocks: list[Block] = [f"**{said}**"]
    tiles = tiles_of(log.evidence)
    if tiles and not options.no_plots:
        chosen = [tiles[i] for i in np.unique(np.linspace(0, len(tiles) - 1, FEW_TILES).round().astype(int))]
        # images are the whole figure: as PDF it would be many times as large and show no more
        save(
            contact_sheet(chosen, f"{log.name}: pictures found, with their numbers"),
            folder / "figures",
            "lab-camera",
            ("png",),
        )
        names = " and ".join(tile.name.partition(",")[0] for tile in chosen)
        blocks.append(
            Picture(
                "lab-camera",
                f"`{log.name}`: {names} with the pictures found.",
                f"Camera images of {log.name}, corners found",
            )
        )
    blocks += [
        OBSERVATION.formula,
        f"{OBSERVATION.about} {summary(statistics_of(log.evidence), found).replace('**Detections.** ', 'Found: ')}",
    ]
    return Section("Question 2: What does the camera see of a picture's corners?", tuple(blocks))


def _filter(folder: Path, options: Options, trial: Trial) -> Section:
    log = trial.log
    rows, errors = [], {}
    for name in SHOWN:
        run = _run(trial, name)
        for phase in () if run is None else run.phases:
            assert run is not None  # it has phases
            trajectory = run.trajectory(phase)
            row: dict[str, object] = {"estimator": name, "phase": phase}
            if log.truth.pose is not None and log.truth.known_poses:
                off = position_distance(trajectory.pose, log.truth.pose)
                errors[name, phase] = rms(off)
                row |= {"RMSE [m]": rms(off), "largest error [m]": float(np.nanmax(off))}
            row["σ at the end [m]"] = float(longest_sigma(trajectory)[-1])
            rows.append(row)
    blocks: list[Block] = [f"**{_in_a_line(errors)}**"]
    if not options.no_plots:
        factor = options.ellipse_factor
        size = "in their size" if factor == 1 else "enlarged as the legend says"
        blocks.append(
            _plan(folder, options, trial, ("dead-reckoning", "ekf"), "lab-plan", f"3σ ellipses {size}", factor)
        )
        run = _run(trial, "ekf")
        if run is not None and log.truth.pose is not None and log.truth.known_poses:
            save(error_figure(log, [replace(run, final=None)]), folder / "figures", "lab-error", _formats(options))
            blocks.append(
                Picture(
                    "lab-error",
                    f"`{log.name}`: the filter's error with its ±3σ.",
                    f"Errors of the filter on {log.name}",
                )
            )
    caption = f"{log.name}, localization: position errors without alignment, and σ along the least certain direction."
    blocks.append(written_table(pd.DataFrame(rows, dtype=object), folder, "lab-question-3", caption, options))
    blocks += [UPDATE.formula, UPDATE.about]
    return Section("Question 3: Where was the robot, and how sure is the filter of it?", tuple(blocks))


def _in_a_line(errors: dict[tuple[str, str], float]) -> str:
    alone, filtered = errors.get(("dead-reckoning", "online"), math.nan), errors.get(("ekf", "online"), math.nan)
    smoothed = errors.get(("batch", "final"), math.nan)
    if not math.isfinite(filtered):
        return "The log has no true path: the filter's own ellipses say how sure it is; errors are not known."
    text = f"The filter's position RMSE is {number(filtered)} m"
    if math.isfinite(alone):
        text += f" where commands alone have {number(alone)} m"
    return f"{text}{f'; smoothed {number(smoothed)} m' if math.isfinite(smoothed) else ''}."


def _plan(
    folder: Path, options: Options, trial: Trial, names: Sequence[str], stem: str, what: str, factor: int | None = 1
) -> Picture:
    log = trial.log
    assert log.evidence is not None  # a log made from images
    runs = [replace(r, final=None) if r.online is not None else r for n in names if (r := _run(trial, n)) is not None]
    corners = log.evidence.setup.corners
    if list(names) == ["dead-reckoning"] and runs:  # the map figure shows how sure estimators are, and that is none
        figure = map_figure(log, runs, surveyed=lambda ax: [*draw_pictures(ax, corners), *_grown(ax, runs[0])])
    else:
        figure = plan_figure(log, runs, corners, factor=factor)
    save(figure, folder / "figures", stem, _formats(options))
    return Picture(stem, f"`{log.name}`: {what}. World frame, no alignment.", f"Plan of {log.name}: {what}")


def _grown(ax: Axes, run: Run) -> list[Line2D]:
    """Ellipses along a dead-reckoned path, in their size; what the legend shows of them."""
    mean, covariance = along_path(series([run])[0])
    draw_ellipses(ax, mean, covariance, "#606060", 1.0, 3.5)
    return [Line2D([], [], color="#606060", marker="o", markerfacecolor="none", linestyle="none", label="3σ ellipses")]


def _path(run: Run) -> Array:
    return run.trajectory(run.phases[0]).pose

"""The visual lab's three questions: the robot's motion, what the camera sees, and both put together."""

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from data.log import Log
from data.result import Run
from data.se2 import Array, dead_reckoned
from eval.figures.error import error_figure, longest_sigma
from eval.figures.map import enlarged, map_figure
from eval.figures.plane import along_path, draw_ellipses
from eval.figures.style import save_for_page, series
from eval.plan.flags.table import Output
from eval.referee.errors import position_distance, rms
from eval.referee.result_files import value_of
from eval.referee.score import Trial, metrics_row
from eval.report.page.blocks import Block, Picture, Section
from eval.report.page.files import written_table
from eval.report.words import paragraph
from wings.camera import report

SHOWN = ("dead-reckoning", "ekf", "ekf-iterated", "isam2", "batch")
TEMPLATE = "labs/visual"
HEADS = ("estimator", "phase", "RMSE [m]", "largest error [m]", "σ at the end [m]")


def visual_hand_in(folder: Path, output: Output, trials: Sequence[Trial]) -> list[Section]:
    """Three sections on the first log made from images; nothing where there is none."""
    made = [t for t in trials if t.log.evidence is not None and t.variant_of is None]
    trial = next((t for t in made if t.task == "localization"), None)
    if trial is None:
        return []
    report.write_models(folder, output, trial.log)
    return [_motion(folder, output, trial), _observation(folder, output, trial), _filter(folder, output, trial)]


def _run(trial: Trial, estimator: str) -> Run | None:
    run = next((r for r in trial.runs if r.estimator == estimator), None)
    return None if run is None or run.failure is not None else run


def _off(log: Log, path: Array) -> Array:
    """Position errors [m] of the frames with truth; empty where there is none."""
    off = np.empty(0) if log.truth.pose is None else np.asarray(position_distance(path, log.truth.pose))
    return off[np.isfinite(off)]


def reckoned(trial: Trial) -> dict[str, float]:
    """Dead reckoning [m]: length of its path, error and largest standard deviation at its end; NaN: not known."""
    r, run = trial.log.recorded, _run(trial, "dead-reckoning")
    path = dead_reckoned(r.prior.mean, r.increments.mean) if run is None else run.trajectory("online").pose
    off, length = _off(trial.log, path), float(np.hypot(*np.diff(path[:, :2], axis=0).T).sum())
    sigma = math.nan if run is None else float(longest_sigma(run.trajectory("online"))[-1])
    return {"length": length, "off": float(off[-1]) if len(off) else math.nan, "sigma": sigma}


def estimates(trial: Trial) -> list[dict[str, Any]]:
    """Of each run and phase position RMSE and largest error [m], at the end the largest sigma [m]; NaN: not known."""
    found = []
    for run in filter(None, (_run(trial, name) for name in SHOWN)):
        for phase in run.phases:
            path = run.trajectory(phase)
            off, sigma = _off(trial.log, path.pose), float(longest_sigma(path)[-1])
            rmse, largest = (rms(off), float(off.max())) if len(off) else (math.nan, math.nan)
            values = (run.estimator, phase, rmse, largest, sigma)
            found.append(dict(zip(("estimator", "phase", "rmse", "largest", "sigma"), values, strict=True)))
    return found


def certainty(log: Log, run: Run) -> dict[str, float]:
    """How sure a filter is online, and whether rightly; NaN: not known. `median`, `largest`, `last`: 3σ of the position
    along its least certain direction [m]; `heading`: its 3σ at the end [deg]; `inside`: share of frames inside the 3σ
    ellipse.
    """
    path, row = run.trajectory("online"), metrics_row(run, "online", log, None)
    sigma = 3.0 * longest_sigma(path)
    known = sigma[np.isfinite(sigma)]
    sizes = (float(np.median(known)), float(known.max()), float(sigma[-1])) if len(known) else 3 * (math.nan,)
    return {
        **dict(zip(("median", "largest", "last"), sizes, strict=True)),
        "heading": 3.0 * math.degrees(math.sqrt(max(float(path.covariance[-1, 2, 2]), 0.0))),
        "inside": value_of(row, "inside_3sigma"), "nees": value_of(row, "nees_pose"),
    }  # fmt: skip


def _motion(folder: Path, output: Output, trial: Trial) -> Section:
    q = reckoned(trial)
    blocks: list[Block] = [f"**{paragraph(f'{TEMPLATE}#motion', q=q)}**"]
    if not output.no_plots:
        what = "dead reckoning alone, 3σ ellipses in their size"
        blocks.append(_plan(folder, trial, _shown(trial, ("dead-reckoning",)), "lab-motion", what))
    blocks += [report.MOTION.formula, f"{report.MOTION.about} {report.constants(trial.log)}"]
    return Section("Question 1: How does the robot move, and how does its uncertainty grow?", tuple(blocks), facts=q)


def _observation(folder: Path, output: Output, trial: Trial) -> Section:
    log = trial.log
    assert log.evidence is not None  # a log made from images
    found = log.evidence.found
    q = {"pictures": len(found.frame), "frames": len(found.time), "observations": len(log.recorded.observations.frame)}
    blocks: list[Block] = [f"**{paragraph(f'{TEMPLATE}#observation', q=q)}**"]
    if not output.no_plots:
        blocks += report.sheet(folder, log, log.evidence)
    detected = report.summary(report.statistics_of(log.evidence), found, head="Found:")
    blocks += [report.OBSERVATION.formula, f"{report.OBSERVATION.about} {detected}"]
    return Section("Question 2: What does the camera see of a picture's corners?", tuple(blocks), facts=q)


def _filter(folder: Path, output: Output, trial: Trial) -> Section:
    log, found, run = trial.log, estimates(trial), _run(trial, "ekf")
    rmse = {(r["estimator"], r["phase"]): r["rmse"] for r in found}
    keys = {"commands": ("dead-reckoning", "online"), "filter": ("ekf", "online"), "smoother": ("batch", "final")}
    q = {name: rmse.get(key, math.nan) for name, key in keys.items()}
    blocks: list[Block] = [f"**{paragraph(f'{TEMPLATE}#estimate', q=q)}**"]
    sure = None if run is None else certainty(log, run)
    if sure is not None:
        blocks.append(paragraph(f"{TEMPLATE}#certainty", c=sure))
    if not output.no_plots:
        shown = _shown(trial, ("dead-reckoning", "ekf"))
        factor = enlarged(log, shown, output.ellipse_factor)
        what = f"3σ ellipses {'in their size' if factor == 1 else f'drawn {factor} times larger'}"
        blocks.append(_plan(folder, trial, shown, "lab-plan", what, factor))
        if run is not None and log.truth.known_poses:
            save_for_page(partial(error_figure, log, [replace(run, final=None)]), folder / "figures", "lab-error")
            caption = f"`{log.name}`: the filter's error with its ±3σ."
            blocks.append(Picture("lab-error", caption, f"Errors of the filter on {log.name}"))
    table = pd.DataFrame([[*r.values()] for r in found], columns=list(HEADS), dtype=object)
    if not log.truth.known_poses:
        table = table.drop(columns=list(HEADS[2:4]))
    caption = f"{log.name}, localization: position errors without alignment, and σ along the least certain direction."
    blocks.append(written_table(table, folder, "lab-question-3", caption, output))
    blocks += [report.UPDATE.formula, report.UPDATE.about]
    heading = "Question 3: Where was the robot, and how sure is the filter of it?"
    return Section(heading, tuple(blocks), facts={"runs": found, "certainty": sure})


def _shown(trial: Trial, names: Sequence[str]) -> list[Run]:
    """The runs of estimators that got to the end, without their final phase."""
    runs = [r for n in names if (r := _run(trial, n)) is not None]
    return [replace(r, final=None) if r.online is not None else r for r in runs]


def _plan(folder: Path, trial: Trial, runs: Sequence[Run], stem: str, what: str, factor: int = 1) -> Picture:
    log = trial.log
    assert log.evidence is not None  # a log made from images
    corners = log.evidence.setup.corners
    # the map figure shows how sure estimators are, and dead reckoning is none
    if [r.estimator for r in runs] == ["dead-reckoning"]:
        draw = partial(
            map_figure, log, runs, surveyed=lambda ax: [*report.draw_pictures(ax, corners), *_grown(ax, runs[0])]
        )
    else:
        draw = partial(report.plan_figure, log, runs, corners, factor=factor)
    save_for_page(draw, folder / "figures", stem)
    return Picture(stem, f"`{log.name}`: {what}. World frame, no alignment.", f"Plan of {log.name}: {what}")


def _grown(ax: Axes, run: Run) -> list[Line2D]:
    """Ellipses along a dead-reckoned path, in their size; what the legend shows of them."""
    mean, covariance = along_path(series([run])[0])
    draw_ellipses(ax, mean, covariance, "#606060", 1.0, 3.5)
    return [Line2D([], [], color="#606060", marker="o", markerfacecolor="none", linestyle="none", label="3σ ellipses")]

"""The figure of growth in SLAM: how sure an estimator is of robot and landmarks."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from data.log import Log
from data.result import Run
from data.words import number
from eval.figures import kinds
from eval.figures.error import longest_sigma, ticks, time_axis
from eval.figures.plane import SIGMAS, longest_axis
from eval.figures.style import DASHED, DOTTED, SOLID, drawing, finish, page_width, style_of
from eval.referee.score import Trial
from eval.replay.settings import ESTIMATORS, associations

LOOP = 0.3  # a landmark seen again after this share of the run means that a loop was closed


def closing_frame(log: Log, run: Run) -> int | None:
    """First frame that pairs a landmark unseen for a good part of the run; None if no loop is closed."""
    frames = log.recorded.observations.frame
    number = np.where(run.created >= 0, run.created, run.decisions)
    last: dict[int, int] = {}
    for frame, n in zip(frames.tolist(), number.tolist(), strict=True):
        if n >= 0:
            if frame - last.get(n, frame) > LOOP * len(log.recorded):
                return int(frame)
            last[n] = frame
    return None


@drawing()
def growth_figure(log: Log, runs: Sequence[Run]) -> Figure:
    """Standard deviation, along its least certain direction, of the robot online and of each landmark in the last map.
    A vertical line marks the frame that closed a loop.
    """
    time = log.recorded.time
    fig = Figure(figsize=(page_width(), 2.9))
    robot, landmarks = fig.subplots(1, 2)
    for i, run in enumerate(runs):
        style, sigma = style_of(run.estimator), longest_sigma(run.trajectory("online"))
        known = sigma[np.isfinite(sigma)]
        most, end = (float(known.max()), float(known[-1])) if len(known) else (np.nan, np.nan)
        label = f"{style.label}, {run.association}: at most {number(most)} m, {number(end)} m at the end"
        robot.plot(time, sigma, color=style.colour, linestyle=SOLID if i == 0 else DASHED, linewidth=1.2, label=label)
        if run.map is not None and len(run.map):
            last = longest_axis(run.map.covariance) / SIGMAS
            face, size = (style.colour, 2.2) if i == 0 else ("none", 4.0)
            look = dict[str, Any](markeredgecolor=style.colour, markeredgewidth=0.7)
            landmarks.plot(run.map.number, last, "o", markersize=size, markerfacecolor=face, **look)
    closed = next((f for f in (closing_frame(log, r) for r in runs) if f is not None), None)
    if closed is not None:
        robot.axvline(
            time[closed], color="#505050", linestyle=DOTTED, linewidth=1.0, label="first landmarks seen again"
        )
    robot.set(ylabel="robot σ [m]", ylim=(0.0, None))
    time_axis(robot, log.recorded)
    landmarks.set(xlabel="landmark number [–]", ylabel="landmark σ [m]", ylim=(0.0, None))
    for ax in (robot, landmarks):
        ax.xaxis.set_major_locator(ticks(6))
        ax.yaxis.set_major_locator(ticks(6))
    robot.set_title("robot, online", loc="left")
    landmarks.set_title("landmarks in the last map, in order of initialization", loc="left")
    handles: Any = robot.get_legend_handles_labels()[0]
    finish(fig, f"{log.name}: claimed σ along the least certain direction", handles, 1 if len(handles) > 3 else 2)
    return fig


def growing(trial: Trial) -> list[Run]:
    """A filter and an incremental smoother under one association, known if there is one: how uncertainty grew."""
    estimates = [r for r in kinds.plausible(trial) if r.task == "slam" and r.online is not None and r.map is not None]
    order = associations(estimates)
    alike = [r for r in estimates if r.association == order[0]] if order else []
    found = [next((r for r in alike if r.estimator == name), None) for name in ("ekf", "isam2")]
    found += [r for r in alike if r.estimator not in ESTIMATORS and kinds.has_covariance(r)]
    return [r for r in found if r is not None]


def _in_numbers(trial: Trial, run: Run) -> dict[str, object]:
    """Standard deviations [m] along the least certain direction: of the robot online, and of the last landmarks."""
    closed, sigma = closing_frame(trial.log, run), longest_sigma(run.trajectory("online"))
    before = float(sigma[closed - 1]) if closed is not None and closed > 0 else None
    made: dict[str, object] = {"estimator": run.estimator, "at_most": float(np.nanmax(sigma))}
    # landmarks: of the first, the last, and the least certain one
    made |= {"at_end": float(sigma[-1]), "before_closing": before, "landmarks": None}
    if run.map is not None and len(run.map):
        each = longest_axis(run.map.covariance) / SIGMAS
        largest = int(each.argmax())
        made["landmarks"] = (float(each[0]), float(each[-1]), float(each[largest]))
        made["number"] = int(run.map.number[largest])
    return made


@kinds.figure("growth", lambda trial, _: trial.log.truth.known_poses > 0 and bool(growing(trial)))
def _growth(trial: Trial, _: kinds.Variants) -> tuple[Figure, kinds.Facts]:
    runs = growing(trial)
    grown = [_in_numbers(trial, r) for r in runs]
    alike = replace(trial, runs=tuple(r for r in trial.runs if r.association == runs[0].association))
    others = kinds.left_out(alike, runs, lambda run: "online" if run.online is None or run.map is None else "room")
    return growth_figure(trial.log, runs), {"association": runs[0].association, "grown": grown, "others": others}

"""A log as it was recorded, and a map of what became of every observation: paired, new, discarded, or decided again."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from data.inputs import CLUTTER, IntArray
from data.log import Log
from data.result import DISCARD, NEW, Run
from data.se2 import Array, BoolArray, dead_reckoned
from data.sensors import Sensor
from data.terminal import counted
from eval.figures.kinds import (
    Facts,
    Variants,
    blind,
    figure,
    kind_of,
    left_out,
    plausible,
)
from eval.figures.plane import draw_start, draw_walls, feet
from eval.figures.style import DOTTED, STYLES, TRUTH_COLOUR, drawing, finish, key, page_width, settle, style_of
from eval.referee.given.runs import log_of
from eval.referee.score import Trial
from eval.replay.settings import HINDSIGHT, associations

SEEN_COLOUR = "#56B4E9"
CLUTTER_COLOUR = "#D55E00"


@drawing()
def log_figure(log: Log) -> Figure:
    """A log from above, metres, equal aspect; observations are placed from true poses, or else dead reckoning."""
    inputs, truth = log.recorded, log.truth
    fig = Figure()
    ax = fig.add_subplot()
    reckoned = dead_reckoned(inputs.prior.mean, inputs.increments.mean)
    pose, origin = reckoned, "dead reckoning"
    if truth.pose is not None and truth.known_poses:
        pose, origin = truth.pose, "the true path"
        ax.plot(*pose[:, :2].T, color=TRUTH_COLOUR, linewidth=1.0, label="true path", zorder=4)
    grey = STYLES["dead-reckoning"].colour
    ax.plot(*reckoned[:, :2].T, color=grey, linestyle=DOTTED, linewidth=1.0, label="dead reckoning", zorder=3)

    o = inputs.observations
    placed: IntArray = np.flatnonzero(np.all(np.isfinite(pose[o.frame]), axis=1))
    if len(placed):
        xy = feet(log, pose)[placed]
        label = log.granted
        clutter = np.zeros(len(placed), bool) if label is None else label[placed] == CLUTTER
        name = f"{len(placed)} of {counted(len(o.frame), 'observation')}, from {origin}"
        dots = dict[str, Any](marker=".", linestyle="none", markersize=3.0, markeredgewidth=0.0, rasterized=True)
        ax.plot(*xy[~clutter].T, color=SEEN_COLOUR, alpha=0.6, label=name, zorder=2, **dots)
        if clutter.any():
            ax.plot(*xy[clutter].T, color=CLUTTER_COLOUR, label=f"{clutter.sum()} of them clutter", zorder=2, **dots)
    landmarks = inputs.map if inputs.map is not None else truth.landmarks
    if landmarks is not None and len(landmarks.id):
        name = counted(len(landmarks.id), "landmark")
        points, walls = inputs.sensor.split(landmarks.xy)
        if len(points):
            ax.plot(*points.T, "k+", markersize=5.0, markeredgewidth=0.7, label=name, zorder=5)
        draw_walls(ax, walls, "black", label=name, zorder=1)
    draw_start(ax, inputs.prior.mean)

    ax.set(xlabel="x [m]", ylabel="y [m]")
    ax.set_aspect("equal")
    ax.set_title(f"{log.name}: {counted(len(inputs), 'frame')}, as recorded", loc="left")
    fig.legend(loc="outside lower left", ncols=3, markerscale=1.5)
    # the page is cut to the scene, so that equal aspect leaves no blank paper
    (left, right), (bottom, top) = ax.get_xlim(), ax.get_ylim()
    fig.set_size_inches(page_width(), float(np.clip(page_width() * (top - bottom) / (right - left), 2.0, 6.5)) + 0.9)
    return fig


LOOP_STATES = {
    "paired": ("#9FC2DE", ".", 3.0, "paired with a landmark"),
    "new": ("#009E73", "^", 3.5, "made a new landmark"),
    "discarded": ("#D55E00", "x", 3.5, "discarded"),
    "revised": ("#CC79A7", "D", 3.5, "decided again later"),
}  # colour, marker, size and words of each; drawn in this order, so that the rare ones are on top
MOST = 2  # maps beside each other
HIGHEST = 4.5  # in, of a map
EDGE = 0.04  # share of the scene left free around it


def loop_states(run: Run) -> dict[str, BoolArray]:
    """Observations (M,) by what became of them; one that was decided again counts as that alone."""
    revised = run.final_decisions != run.decisions
    final = run.final_decisions
    return {
        "paired": (final >= 0) & ~revised,
        "new": (final == NEW) & ~revised,
        "discarded": (final == DISCARD) & ~revised,
        "revised": revised,
    }


@drawing()
def loop_state_figure(log: Log, runs: Sequence[Run]) -> Figure:
    """Observations placed from each run's last path, by what became of them; a map per run, no truth used."""
    runs = list(runs)[:MOST]
    places = [feet(log, run.trajectory(run.phases[-1]).pose) for run in runs]
    paths = [run.trajectory(run.phases[-1]).pose[:, :2] for run in runs]
    low, high = _scene([*places, *paths])
    w, h = high - low
    across = (page_width() - 0.6) / max(len(runs), 1)
    fig = Figure(figsize=(page_width(), float(np.clip(across * h / w, 1.5, HIGHEST)) + 1.0))
    axes = fig.subplots(1, max(len(runs), 1), squeeze=False, sharey=True)[0]
    for ax, run, xy, path in zip(axes, runs, places, paths, strict=False):
        ax.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))  # walls are drawn across it
        _draw(ax, run, xy, path, log.recorded.sensor)
    for ax in axes:
        ax.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), xlabel="x [m]", aspect="equal")
    axes[0].set_ylabel("y [m]")
    handles = [
        key(text, color=c, marker=m, markersize=s + 1.0, linestyle="none")
        for name, (c, m, s, text) in LOOP_STATES.items()
        if any(loop_states(run)[name].any() for run in runs)
    ]
    point: dict[str, Any] = {"marker": "+", "markersize": 5.0, "linestyle": "none"}
    look = point if log.recorded.sensor.sees_points else {"linewidth": 0.7}
    finish(fig, f"{log.name}: what became of the readings", [*handles, key("landmark", color="black", **look)], 5)
    settle(fig)
    return fig


def _draw(ax: Axes, run: Run, xy: Array, path: Array, sensor: Sensor) -> None:
    ax.plot(*path.T, color=style_of(run.estimator).colour, linewidth=0.7, zorder=2)
    loop_state = loop_states(run)
    for name, (colour, marker, size, _) in LOOP_STATES.items():
        rows = loop_state[name]
        ax.plot(
            *xy[rows].T, color=colour, marker=marker, markersize=size, markeredgewidth=0.7, linestyle="none", zorder=3
        )
    if run.map is not None:
        points, walls = sensor.split(run.map.xy)
        ax.plot(*points.T, "k+", markersize=4.0, markeredgewidth=0.7, zorder=4)
        draw_walls(ax, walls, "black", zorder=4)
    counted = ", ".join(f"{int(rows.sum())} {name}" for name, rows in loop_state.items() if rows.any())
    ax.set_title(f"{style_of(run.estimator).label}, {run.association}\n{counted}", loc="left")


def _scene(parts: Sequence[Array]) -> tuple[Array, Array]:
    """Corners that hold nearly all of it; a few far points do not squash the rest."""
    points = np.concatenate([p[np.isfinite(p).all(axis=1)] for p in parts] or [np.zeros((0, 2))])
    if len(points) == 0:
        return np.array([-1.0, -1.0]), np.array([1.0, 1.0])
    low, high = np.quantile(points, [0.002, 0.998], axis=0)
    margin = EDGE * max(float((high - low).max()), 1.0)
    return low - margin, high + margin


def _deciding(trial: Trial) -> list[Run]:
    """For each association method the last smoother, else the filter: decisions in hindsight first, labels last."""
    deciding = [
        r
        for r in plausible(trial)
        if r.association != "none"
        and len(r.decisions) == len(trial.log.recorded.observations.frame) > 0
        and log_of(r, trial.log) is trial.log
    ]
    methods = sorted(associations(deciding), key=lambda a: (a == "known") - (a == HINDSIGHT))
    return [max((r for r in deciding if r.association == method), key=kind_of) for method in methods]


@figure("fate", lambda trial, _: blind(trial) and bool(_deciding(trial)))
def _fate(trial: Trial, _: Variants) -> tuple[Figure, Facts]:
    shown = _deciding(trial)
    return loop_state_figure(trial.log, shown), {"others": left_out(trial, shown, lambda run: "method")}

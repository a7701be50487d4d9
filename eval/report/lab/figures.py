"""Figures that answer the corridor lab's questions: maps with people in them, believed paths, map maintenance."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from data.inputs import CLUTTER, IntArray
from data.log import Log
from data.result import Run
from data.se2 import Array
from eval.figures.error import ticks, time_label
from eval.figures.paper.look import page_width
from eval.figures.style import DASHED, SOLID, TRUTH_COLOUR, colour_of_method, drawing
from eval.figures.view import true_landmarks
from eval.referee.errors import landmark_true_ids, named, position_distance, rms
from eval.referee.score import Trial
from eval.report.corridor.phrases import NAMES
from eval.report.lab.timing import Times
from eval.walk.marks import BAD, FAINT


class Shown(NamedTuple):
    """A run and the trial it belongs to."""

    trial: Trial
    run: Run

    @property
    def log(self) -> Log:
        """Its log."""
        return self.trial.log


def called(run: Run) -> str:
    """The way of association as the lab calls it; where that is ambiguous, as on the command line."""
    return "by labels" if run.association == "known" else NAMES.get(run.association, run.association)


def people_figure(quiet: Sequence[Shown], busy: Sequence[Shown]) -> Figure:
    """Maps of some methods with people about, and their position error with people and without."""
    with drawing():
        fig = Figure(figsize=(page_width(), 4.9))
        grid = fig.add_gridspec(2, len(busy), height_ratios=(2.5, 1.0))
        for k, (without, s) in enumerate(zip(quiet, busy, strict=True)):
            ax = fig.add_subplot(grid[0, k])
            _draw_map(ax, s, left=k == 0)
            ax.set_title(f"{called(s.run)} with people: the map at the end", loc="left")
            below = fig.add_subplot(grid[1, k])
            for shown, line, label in ((without, DASHED, "without people"), (s, SOLID, "with people")):
                error = _error(shown)
                below.plot(
                    shown.log.recorded.time, error, color=colour_of_method(shown.run.association), linestyle=line,
                    linewidth=1.1, label=f"{label}: at most {np.nanmax(error):.2g} m",
                )  # fmt: skip
            below.set(
                xlabel=time_label(s.log.recorded), ylabel="position error [m]" if k == 0 else "", ylim=(0.0, None)
            )
            below.yaxis.set_major_locator(ticks(4))
            below.legend(loc="upper left")
        fig.legend(handles=_map_handles(), loc="outside lower center", ncols=5)
        return fig


def paths_figure(quiet: Sequence[Shown], busy: Sequence[Shown]) -> Figure:
    """What every method believes the path to be, a panel each: with its map, and dashed the path with people about."""
    with drawing():
        columns = 3
        rows = -(-len(quiet) // columns)
        fig = Figure(figsize=(page_width(), 0.5 + 2.6 * rows))
        axes = fig.subplots(rows, columns, squeeze=False, sharex=True, sharey=True)
        for k, s in enumerate(quiet):
            ax = axes.flat[k]
            _draw_map(ax, s, left=k % columns == 0, size=2.5)
            title = f"{s.run.association}: RMSE {rms(_error(s)):.2g} m"
            other = next((b for b in busy if b.run.association == s.run.association), None)
            if other is not None:
                path, colour = other.run.trajectory("online").pose[:, :2], colour_of_method(other.run.association)
                ax.plot(*path.T, color=colour, linestyle=DASHED, linewidth=0.9, zorder=2.8)
                title += f", with people {rms(_error(other)):.2g} m"
            ax.set_title(title, loc="left", fontsize=7.0)
            ax.set_xlabel("x [m]" if k + columns >= len(quiet) else "")
        for ax in axes.flat[len(quiet) :]:
            ax.set_axis_off()
        dashed = Line2D([], [], color="#404040", linestyle=DASHED, linewidth=0.9, label="with people about")
        fig.legend(handles=[*_map_handles(), dashed], loc="outside lower center", ncols=4)
        return fig


def maintenance_figure(plain: Shown, kept: Shown) -> Figure:
    """The map at the end without and with maintenance, what was removed, and the length of the state over time."""
    with drawing():
        fig = Figure(figsize=(page_width(), 4.9))
        grid = fig.add_gridspec(2, 2, height_ratios=(2.5, 1.0))
        for k, (s, what) in enumerate(((plain, "without maintenance"), (kept, "with maintenance"))):
            ax = fig.add_subplot(grid[0, k])
            _draw_map(ax, s, left=k == 0)
            size = 0 if s.run.map is None else len(s.run.map)
            ax.set_title(f"{called(s.run)} {what}: {size} landmarks", loc="left")
        below = fig.add_subplot(grid[1, :])
        for s, line, what in ((plain, DASHED, "without"), (kept, SOLID, "with maintenance")):
            if s.run.state_size is not None:
                below.step(
                    s.log.recorded.time, s.run.state_size, where="post", color=colour_of_method(s.run.association),
                    linestyle=line, linewidth=1.1, label=f"{what}: {int(s.run.state_size[-1])} at the end",
                )  # fmt: skip
        below.set(xlabel=time_label(plain.log.recorded), ylabel="length of the state", ylim=(0.0, None))
        below.yaxis.set_major_locator(ticks(4))
        below.legend(loc="upper left")
        fig.legend(handles=_map_handles(), loc="outside lower center", ncols=5)
        return fig


def update_time_figure(log: Log, times: Sequence[tuple[str, str, Times]], repeats: int) -> Figure:
    """Measured time of each frame's update, by label and way of association. Never the same twice."""
    with drawing():
        fig = Figure(figsize=(page_width(), 2.5))
        ax = fig.add_subplot()
        for k, (label, association, seconds) in enumerate(times):
            ms, more = 1e3 * seconds.update, 1e3 * float(np.sum(seconds.maintenance))
            ax.step(
                log.recorded.time, ms, where="post", color=colour_of_method(association),
                linestyle=SOLID if k else DASHED, linewidth=1.1,
                label=f"{label}: median {np.median(ms):.3f} ms, all {np.sum(ms):.1f} ms; removal {more:.1f} ms",
            )  # fmt: skip
        ax.set(xlabel=time_label(log.recorded), ylabel="update of a frame [ms]", ylim=(0.0, None))
        ax.yaxis.set_major_locator(ticks(5))
        ax.set_title(f"{log.name}: measured, the fastest of {repeats} repetitions of each frame", loc="left")
        fig.legend(loc="outside lower center", ncols=1)
        return fig


def _error(s: Shown) -> Array:
    truth = s.log.truth.pose
    assert truth is not None  # the lab's logs have a true path
    return np.asarray(position_distance(s.run.trajectory("online").pose, truth))


def _draw_map(ax: Axes, s: Shown, *, left: bool, size: float = 3.0) -> None:
    """True points and path, believed path, landmarks at the end by what initialized them, and where removed ones stood.

    Landmarks and paths that left the scene are cut: truth and points fill the picture.
    """
    known, truth, run = true_landmarks(s.log), s.log.truth.pose, s.run
    colour = colour_of_method(run.association)
    if known is not None:
        ax.plot(*known.xy.T, "+", color=FAINT, markersize=1.6 * size, markeredgewidth=0.7, zorder=1)
    if truth is not None:
        ax.plot(*truth[:, :2].T, color=TRUTH_COLOUR, linewidth=1.0, zorder=2)
    ax.plot(*run.trajectory("online").pose[:, :2].T, color=colour, linewidth=1.2, zorder=3)
    if run.map is not None and len(run.map):
        person = landmark_true_ids(named(run), s.log.truth, run.map.number) == CLUTTER
        ax.plot(*run.map.xy[~person].T, ".", color=colour, markersize=1.3 * size, zorder=4)
        ax.plot(*run.map.xy[person].T, "s", color=BAD, markersize=1.2 * size, markerfacecolor="none", zorder=5)
    at = removed_places(s)
    ax.plot(*at.T, "x", color="#808080", markersize=1.2 * size, markeredgewidth=0.7, zorder=3.5)
    scene = [p for p in (None if known is None else known.xy, None if truth is None else truth[:, :2]) if p is not None]
    points = np.concatenate(scene)
    low, high = points.min(axis=0), points.max(axis=0)
    middle, half = 0.5 * (low + high), 0.6 * float((high - low).max())
    ax.set(
        xlim=middle[0] + [-half, half], ylim=middle[1] + [-half, half], xlabel="x [m]", ylabel="y [m]" if left else ""
    )
    ax.set_aspect("equal")


def removed_places(s: Shown) -> Array:
    """Where landmarks that were removed had been initialized (r, 2): reading placed from the pose of that frame."""
    run, o = s.run, s.log.recorded.observations
    if run.removed is None or not np.any(run.removed >= 0):
        return np.empty((0, 2))
    gone: IntArray = np.flatnonzero(run.removed >= 0)
    rows = np.flatnonzero(np.isin(run.created, gone))
    pose = run.trajectory("online").pose[o.frame[rows]]
    return np.asarray(s.log.recorded.sensor.inverse(pose, o.z[rows])[0])


def _map_handles() -> list[Line2D]:
    grey = "#404040"
    return [
        Line2D([], [], color=TRUTH_COLOUR, linewidth=1.0, label="true path"),
        Line2D([], [], color=grey, linewidth=1.2, label="believed path (colour of the method)"),
        Line2D([], [], marker="+", color=FAINT, linestyle="none", label="true point"),
        Line2D([], [], marker=".", color=grey, linestyle="none", label="landmark"),
        Line2D(
            [], [], marker="s", color=BAD, linestyle="none", markerfacecolor="none", label="initialized on a person"
        ),
        Line2D([], [], marker="x", color="#808080", linestyle="none", label="removed"),
    ]

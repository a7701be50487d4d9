"""The figure of one revision: sightings as they were decided about at first, and as they are in the end."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from data.inputs import IntArray
from data.log import Log
from data.result import Run
from data.se2 import Array
from eval.figures.paper.look import page_width, points
from eval.figures.style import TRUTH_COLOUR, drawing, settle

BEFORE, AFTER, PATH = "#D55E00", "#0072B2", "#808080"
"""Decisions that were given up, those that stand, and the robot's path."""
MARGIN = 0.15
"""Of the extent, around what is shown."""
LEAST = 2.5
"""m, half the width of what is shown."""


@dataclass(frozen=True)
class Example:
    """What one frame revised for one reason: rows (k,) of the log, with the landmarks (k,) before and after."""

    frame: int
    why: str
    rows: IntArray
    old: IntArray
    new: IntArray


def revision_figure(log: Log, run: Run, one: Example, *, width: float | None = None) -> Figure:
    """Two maps with one scale: as decided at first, along the path known then, and in the end."""
    with drawing():
        width = width or page_width()
        assert run.online is not None  # who revises decides frame by frame
        last = run.online.pose if run.final is None else run.final.pose
        # landmarks that stay, seen by decisions that were never in doubt
        number = np.where(run.created >= 0, run.created, run.decisions)
        others = np.setdiff1d(np.flatnonzero(np.isin(number, one.new[one.new >= 0])), one.rows)
        panels = [
            (f"as decided before frame {one.frame}", run.online.pose, one.old, BEFORE),
            ("in the end", last, one.new, AFTER),
        ]
        fig = Figure(figsize=(width, 0.6 * width), layout="constrained")
        axes = fig.subplots(1, 2, sharex=True, sharey=True)
        boxes = []
        for ax, (title, path, decided, colour) in zip(axes, panels, strict=True):
            boxes.append(_panel(ax, log, run, one, path, decided, colour, others))
            ax.set_title(title)
            ax.set_xlabel("x [m]")
            ax.set_aspect("equal")
        axes[0].set_ylabel("y [m]")
        every = np.concatenate(boxes)
        low, high = every.min(axis=0), every.max(axis=0)
        half = max((0.5 + MARGIN) * float((high - low).max()), LEAST)
        for limit, middle in zip((axes[0].set_xlim, axes[0].set_ylim), 0.5 * (low + high), strict=True):
            limit(middle - half, middle + half)
        handles, labels = axes[0].get_legend_handles_labels()
        more = [(h, t) for h, t in zip(*axes[1].get_legend_handles_labels(), strict=True) if t not in labels]
        fig.legend(
            [*handles, *(h for h, _ in more)], [*labels, *(t for _, t in more)], loc="outside lower center", ncols=3
        )
        settle(fig)
        return fig


def _panel(
    ax: Axes, log: Log, run: Run, one: Example, path: Array, decided: IntArray, colour: str, others: IntArray
) -> Array:
    """Draw one of both; returns points (p, 2) that should be in view."""
    o, sensor = log.recorded.observations, log.recorded.sensor

    def places(rows: IntArray) -> Array:
        each = [sensor.inverse(path[o.frame[i]], o.z[i : i + 1])[0][0] for i in rows.tolist()]
        return np.array(each, float).reshape(-1, 2)

    ax.plot(path[:, 0], path[:, 1], color=PATH, lw=0.6, zorder=1, label="path as known then")
    seen, stay = places(one.rows), places(others)
    shown = [seen, stay]
    if log.recorded.map is not None and run.task == "localization":
        known = log.recorded.map
        ax.plot(*known.xy.T, "+", color=TRUTH_COLOUR, ms=5, zorder=2, label="landmark of the map")
        held = dict(zip(known.id.tolist(), known.xy, strict=True))
    else:
        if run.map is not None:
            ax.plot(*run.map.xy.T, "o", color=PATH, ms=2, zorder=2, label="landmark of the final map")
        if len(stay):
            ax.plot(*stay.T, "o", mfc="none", mec=AFTER, ms=4, mew=0.7, zorder=3, label="of the landmark that stays")
        number = np.where(run.created >= 0, run.created, run.decisions)
        centres = {n: stay[number[others] == n].mean(axis=0) for n in np.unique(number[others]).tolist()}
        held = centres if decided is one.new else {}
    if np.all(one.new < 0):
        from_there = np.unique(np.append(o.frame[one.rows], one.frame))
        ax.plot(*path[from_there, :2].T, "^", color=PATH, ms=4, zorder=2)
        for i, xy in zip(one.rows.tolist(), seen, strict=True):
            ax.plot(*np.stack([path[o.frame[i], :2], xy]).T, color=PATH, lw=0.4, zorder=1)
        for k in from_there.tolist():
            x, y = path[k, :2].tolist()
            ax.annotate(
                f"frame {k}", (x, y), xytext=(4, -8), textcoords="offset points", fontsize=points(6), color=PATH
            )
        shown.append(path[from_there, :2])
    given_up = decided < 0
    if given_up.any():
        ax.plot(*seen[given_up].T, "x", color=PATH, ms=4, zorder=4, label="sighting not used")
    if (~given_up).any():
        label = "sighting, decision given up" if decided is one.old else "sighting, decision made instead"
        ax.plot(*seen[~given_up].T, ".", color=colour, ms=4, zorder=4, label=label)
    for n in np.unique(decided[~given_up]).tolist():
        own = seen[decided == n]
        to = held.get(n, own.mean(axis=0))
        for xy in own:
            ax.plot([xy[0], to[0]], [xy[1], to[1]], color=colour, lw=0.5, zorder=3)
        ax.annotate(str(n), to, xytext=(3, 3), textcoords="offset points", color=colour, fontsize=points(6.5))
        shown.append(np.atleast_2d(to))
    return np.concatenate([s for s in shown if len(s)])

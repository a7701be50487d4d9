"""A log as it was recorded, seen from above."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from data.inputs import CLUTTER, IntArray
from data.log import Log
from data.se2 import dead_reckoned
from data.terminal import counted
from eval.figures.plane import draw_start, draw_walls, feet
from eval.figures.style import DOTTED, STYLES, TRUTH_COLOUR, drawing, page_width

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

"""A log as it was recorded, seen from above."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from data.inputs import CLUTTER
from data.log import Log
from data.se2 import dead_reckoned
from data.terminal import counted
from eval.figures.map import map_figure
from eval.figures.plane import draw_walls, feet
from eval.figures.style import key

SEEN_COLOUR = "#56B4E9"
CLUTTER_COLOUR = "#D55E00"


def log_figure(log: Log) -> Figure:
    """The map of a log without runs; observations are placed from true poses, or else dead reckoning."""
    return map_figure(log, (), surveyed=lambda ax: _observed(ax, log))


def _observed(ax: Axes, log: Log) -> list[Line2D]:
    inputs, truth, handles = log.recorded, log.truth, list[Line2D]()
    pose, origin = dead_reckoned(inputs.prior.mean, inputs.increments.mean), "dead reckoning"
    if truth.pose is not None and truth.known_poses:
        pose, origin = truth.pose, "the true path"
    frame = inputs.observations.frame
    placed = np.flatnonzero(np.isfinite(pose[frame]).all(axis=1))
    if len(placed):
        xy, label = feet(log, pose)[placed], log.granted
        clutter = np.zeros(len(placed), bool) if label is None else label[placed] == CLUTTER
        name = f"{len(placed)} of {counted(len(frame), 'observation')},\nfrom {origin}"
        dots = dict[str, Any](marker=".", linestyle="none", markersize=3.0, markeredgewidth=0.0, rasterized=True)
        handles += ax.plot(*xy[~clutter].T, color=SEEN_COLOUR, alpha=0.6, label=name, zorder=2, **dots)
        if clutter.any():
            name = f"{clutter.sum()} of them clutter"
            handles += ax.plot(*xy[clutter].T, color=CLUTTER_COLOUR, label=name, zorder=2, **dots)
    landmarks = inputs.map if inputs.map is not None else truth.landmarks
    if landmarks is not None and len(landmarks.id):
        name = counted(len(landmarks.id), "landmark")
        points, walls = inputs.sensor.split(landmarks.xy)
        if len(points):
            handles += ax.plot(*points.T, "k+", markersize=5.0, markeredgewidth=0.7, label=name, zorder=5)
        elif len(walls):
            handles.append(key(name, color="black", linewidth=0.7))
        draw_walls(ax, walls, "black", zorder=1)
    return handles

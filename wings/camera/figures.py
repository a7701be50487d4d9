"""Figures of a log made from images: a sheet of frames with the pictures found in them, and the plan with ellipses."""

import math
from collections.abc import Sequence
from textwrap import fill
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patheffects import withStroke
from numpy.typing import NDArray

from data.log import Log
from data.result import Run
from data.se2 import Array
from eval.figures.map import map_figure
from eval.figures.style import SINGLE, across, drawing, page_width

CAPTION, LINE = 6.5, 0.115  # pt, in. A tile's caption, and the height of a line of it


def contact_sheet(tiles: Sequence[tuple[NDArray[np.uint8], Sequence[str]]], title: str) -> Figure:
    """Images (H, W, 3) side by side, RGB, with lines of text below each."""
    columns = min(len(tiles), 2 if len(tiles) in (2, 4) else across(3))
    width = SINGLE if columns == 1 else page_width()
    side = width / columns
    captions = ["\n".join(fill(t, round(20.0 * side)) for t in lines) for _, lines in tiles]
    high = max(image.shape[0] / image.shape[1] for image, _ in tiles) * side
    high += LINE * (max(c.count("\n") for c in captions) + 2)
    with drawing():
        fig = Figure(figsize=(width, 0.3 + high * -(-len(tiles) // columns)))
        axes = fig.subplots(-(-len(tiles) // columns), columns, squeeze=False)
        for ax in axes.flat:
            ax.set_axis_off()
        for ax, (image, _), caption in zip(axes.flat, tiles, captions, strict=False):
            ax.imshow(image)
            ax.text(0.0, -0.02, caption, transform=ax.transAxes, va="top", fontsize=CAPTION)
        fig.suptitle(fill(title, round(16.0 * width)), x=0.01, ha="left", fontsize=8.0)
        return fig


def plan_figure(
    log: Log, runs: Sequence[Run], corners: Array, *, width: float | None = None, factor: int | None = 1
) -> Figure:
    """The map figure with pictures in place of landmarks: corners (L, 4, 2) m as in `data.pictures.VisualSetup`."""
    return map_figure(log, runs, width=width, surveyed=lambda ax: draw_pictures(ax, corners), factor=factor)


def draw_pictures(ax: Axes, corners: Array) -> list[Line2D]:
    """Pictures seen from above, thick lines on their walls, each with its number behind it; what the legend shows."""
    halo = [withStroke(linewidth=1.5, foreground="white")]
    drawn: list[Line2D] = []
    for number, (left, right) in enumerate(corners[:, :2]):
        look = dict[str, Any](color="black", linewidth=3.2, solid_capstyle="butt", zorder=4)
        drawn = ax.plot(*np.stack([left, right], axis=1), label="pictures (number behind)", **look)
        # seen from in front the left corner is to the left, so what is behind is a quarter turn left of left to right
        along = right - left
        length = math.hypot(*along.tolist())
        behind = np.array([-along[1], along[0]]) / length if length > 0.0 else np.zeros(2)
        at = dict[str, Any](textcoords="offset points", ha="center", va="center_baseline", fontsize=6.5)
        middle, away = tuple(0.5 * (left + right)), tuple(6.5 * behind)
        ax.annotate(str(number), middle, xytext=away, color="black", path_effects=halo, zorder=5.5, **at)
    return drawn

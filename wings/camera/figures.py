"""Figures of a log made from images: a sheet of frames with the pictures found in them, and the plan with ellipses."""

from __future__ import annotations

import math
from collections.abc import Sequence
from textwrap import fill
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patheffects import withStroke
from numpy.typing import NDArray

from data.log import Log
from data.pictures import Detection
from data.result import Run
from data.se2 import Array
from eval.figures.map import map_figure
from eval.figures.style import SINGLE, across, drawing, page_width

MOST_TILES = 12
OUTLINE = "#F0E442"
"""Okabe and Ito's yellow; with its black edge it stands out from light and dark images, in colour and in grey."""
EDGE = "#000000"
TAG, CAPTION = 6.5, 6.5  # pt
LINE = 0.115  # in. Height of a line of a tile's caption


class Tile(NamedTuple):
    """A frame to look at: its name, image (H, W, 3) uint8 RGB, what was found in it, and notes."""

    name: str
    rgb: NDArray[np.uint8]
    detections: Sequence[Detection]
    notes: Sequence[str]


def contact_sheet(tiles: Sequence[Tile], title: str) -> Figure:
    """Frames side by side with the pictures found. Raises ValueError for none and for more than `MOST_TILES`."""
    if not 0 < len(tiles) <= MOST_TILES:
        raise ValueError(f"{len(tiles)} frames for a contact sheet; from 1 to {MOST_TILES} fit")
    columns = min(len(tiles), 2 if len(tiles) in (2, 4) else across(3))
    width = SINGLE if columns == 1 else page_width()
    gap, side = 0.08, (width - 0.08 * (columns + 1)) / columns
    captions = ["\n".join(fill(t, round(20.0 * side)) for t in (tile.name, *tile.notes)) for tile in tiles]
    rows = [range(k, min(k + columns, len(tiles))) for k in range(0, len(tiles), columns)]
    shape = [side * tile.rgb.shape[0] / tile.rgb.shape[1] for tile in tiles]
    high = [max(shape[k] for k in row) for row in rows]
    below = [LINE * max(captions[k].count("\n") + 1 for k in row) + 0.06 for row in rows]
    head = fill(title, round(16.0 * width))
    top = 0.1 + 0.15 * (head.count("\n") + 1)
    height = top + sum(high) + sum(below) + gap * len(rows)
    with drawing():
        fig = Figure(figsize=(width, height))
        fig.set_layout_engine("none")
        fig.text(gap / width, 1.0 - 0.07 / height, head, va="top", ha="left", fontsize=8.0)
        y = height - top
        for row, tall, under in zip(rows, high, below, strict=True):
            for column, k in enumerate(row):
                x = gap + column * (side + gap)
                ax = fig.add_axes((x / width, (y - shape[k]) / height, side / width, shape[k] / height))
                _paint(ax, tiles[k])
                for i, line in enumerate(captions[k].split("\n"), start=1):
                    fig.text(x / width, (y - tall - i * LINE) / height, line, va="baseline", fontsize=CAPTION)
            y -= tall + under + gap
        return fig


def _paint(ax: Axes, tile: Tile) -> None:
    """A frame without axes, and on it the outline, corners and number of each picture found."""
    height, width = tile.rgb.shape[:2]
    ax.imshow(tile.rgb, aspect="auto")
    ax.set_axis_off()
    ax.set(xlim=(-0.5, width - 0.5), ylim=(height - 0.5, -0.5))
    black = [withStroke(linewidth=2.2, foreground=EDGE)]
    for found in tile.detections:
        closed = np.concatenate([found.pixels, found.pixels[:1]])
        ax.plot(*closed.T, color=OUTLINE, linewidth=1.0, path_effects=black, solid_joinstyle="miter")
        ax.plot(*found.pixels.T, "o", color=OUTLINE, markersize=2.6, markeredgecolor=EDGE, markeredgewidth=0.5)
        u, v = found.pixels[0].tolist()
        # above the corner, or below it where the image ends
        inside = v < 0.09 * height
        away, side = (-3.5, "top") if inside else (3.5, "bottom")
        box = {"boxstyle": "square,pad=0.18", "facecolor": OUTLINE, "edgecolor": EDGE, "linewidth": 0.5}
        look = dict[str, Any](fontsize=TAG, fontweight="bold", color=EDGE, annotation_clip=False, bbox=box)
        at = dict[str, Any](xytext=(0.0, away), textcoords="offset points", ha="left", va=side)
        ax.annotate(str(found.picture), (u, v), **at, **look)


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

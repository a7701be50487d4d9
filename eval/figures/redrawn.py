"""What a figure shows, as CSV, and a short script beside it that draws it anew, to be edited for a paper."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.collections import Collection, LineCollection, PathCollection
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.transforms import Transform

from data.se2 import Array

LINE, AREA = "line", "area"
SCRIPT = '''\
"""Draws {stem}.csv anew: python {stem}.py"""
import matplotlib.pyplot as plt
import pandas as pd

PANELS = {panels}  # place, title, x and y axis, aspect
fig, axes = plt.subplots({rows}, {columns}, figsize=({width:.3g}, {height:.3g}), squeeze=False, layout="constrained")
for (place, _), s in pd.read_csv("{stem}.csv", keep_default_na=False, na_values="nan").groupby(["panel", "series"]):
    look = s.iloc[0][["label", "color", "alpha", "linestyle", "linewidth", "zorder"]].to_dict()
    if s.kind.iloc[0] == "area":
        axes.flat[place].fill(s.x, s.y, **look)
    else:
        axes.flat[place].plot(s.x, s.y, marker=s.marker.iloc[0], markersize=s.markersize.iloc[0], **look)
for place, title, x, y, aspect in PANELS:
    axes.flat[place].set(title=title, xlabel=x, ylabel=y, aspect=aspect)
fig.savefig("{stem}-redrawn.pdf")
'''


class Series(NamedTuple):
    """One curve (NaN where it is interrupted) or one filled area of a panel: points (n, 2) and how they look."""

    kind: str
    points: Array
    label: str
    color: str
    alpha: float
    linestyle: str
    marker: str
    linewidth: float
    markersize: float
    zorder: float


def write(fig: Figure, folder: Path, stem: str) -> list[Path]:
    """Write `stem.csv` and `stem.py`; pictures such as a grid of the laser are left out.

    Columns: panel (place in the grid of panels), series, kind (line or area), label, color, alpha, linestyle, marker,
    linewidth, markersize [pt], zorder, x, y, in the units of the axes.
    """
    fig.draw_without_rendering()  # so that all limits are settled
    geometry = [ax.get_subplotspec() for ax in fig.axes]
    rows, columns = next((g.get_gridspec().get_geometry() for g in geometry if g is not None), (1, 1))
    parts, panels = [], []
    for ax, place in zip(fig.axes, geometry, strict=True):
        at = 0 if place is None else place.rowspan.start * columns + place.colspan.start
        title = ax.get_title() or ax.get_title(loc="left")
        panels.append((at, title, ax.get_xlabel(), ax.get_ylabel(), "equal" if ax.get_aspect() == 1.0 else "auto"))
        for series, s in enumerate(_series(ax)):
            look = {name: getattr(s, name) for name in Series._fields if name != "points"}
            parts.append(
                pd.DataFrame({"panel": at, "series": series, **look, "x": s.points[:, 0], "y": s.points[:, 1]})
            )
    if not parts:
        return []
    width, height = fig.get_size_inches()
    data, script = folder / f"{stem}.csv", folder / f"{stem}.py"
    pd.concat(parts).to_csv(data, index=False, na_rep="nan", float_format="%.9g", lineterminator="\n")
    grid = {"rows": rows, "columns": columns, "width": width, "height": height}
    script.write_text(SCRIPT.format(stem=stem, panels=panels, **grid), encoding="utf-8", newline="\n")
    return [data, script]


def _series(ax: Axes) -> Iterator[Series]:
    """All that a panel shows, from behind to the front."""
    found = [*_lines(ax), *(s for c in ax.collections for s in _of_collection(ax, c)), *_patches(ax)]
    return iter(sorted(found, key=lambda s: s.zorder))


def _lines(ax: Axes) -> Iterator[Series]:
    for line in ax.get_lines():
        points = _in_data(ax, line.get_transform(), np.column_stack([np.asarray(v) for v in line.get_data(orig=False)]))
        marker = line.get_marker() if line.get_markevery() is None else ""  # with it every point would have one
        marker = marker if isinstance(marker, str) else "^"  # an arrow head
        yield Series(
            LINE,
            points,
            _label(line.get_label()),
            to_hex(line.get_color()),
            _alpha(line.get_alpha()),
            str(line.get_linestyle()).replace("None", ""),
            marker.replace("None", ""),
            line.get_linewidth(),
            line.get_markersize(),
            line.zorder,
        )


def _of_collection(ax: Axes, c: Collection) -> Iterator[Series]:
    faces, edges = np.asarray(c.get_facecolor(), float), np.asarray(c.get_edgecolor(), float)
    label = _label(c.get_label())
    if isinstance(c, PathCollection):
        points = _in_data(ax, c.get_offset_transform(), np.asarray(c.get_offsets(), float))
        if len(points):
            color = (faces if len(faces) else edges)[0]
            yield Series(LINE, points, label, to_hex(tuple(color)), float(color[3]), "", "o", 0.0, 3.0, c.zorder)
        return
    shapes = [_in_data(ax, c.get_transform(), np.asarray(p.vertices, float)) for p in c.get_paths()]
    shapes = [shape for shape in shapes if len(shape)]
    if isinstance(c, LineCollection) and shapes and len(edges):
        gap = np.full((1, 2), np.nan)
        yield _shape(LINE, np.concatenate([part for s in shapes for part in (s, gap)]), label, edges[0], c.zorder)
        return
    for i, shape in enumerate(shapes):
        kind, colors = (AREA, faces) if len(faces) else (LINE, edges)
        if len(colors):
            yield _shape(kind, shape, label if i == 0 else "", colors[i % len(colors)], c.zorder)


def _patches(ax: Axes) -> Iterator[Series]:
    for patch in ax.patches:
        face, edge = (np.asarray(c, float) for c in (patch.get_facecolor(), patch.get_edgecolor()))
        outline = np.asarray(patch.get_path().to_polygons(closed_only=False)[0], float)
        points = _in_data(ax, patch.get_transform(), outline)
        filled = bool(patch.get_fill() and face[3] > 0.0)
        kind, color = (AREA, face) if filled else (LINE, edge)
        yield _shape(kind, points, _label(patch.get_label()), color, patch.zorder)


def _shape(kind: str, points: Array, label: str, color: Array, zorder: float) -> Series:
    return Series(kind, points, label, to_hex(tuple(color)), float(color[3]), "-", "", 0.8, 0.0, zorder)


def _in_data(ax: Axes, transform: Transform, points: Array) -> Array:
    """Points (n, 2) of an artist in the units of the axes."""
    if transform == ax.transData:
        return np.asarray(points, float)
    return np.asarray((transform - ax.transData).transform(np.asarray(points, float)))


def _label(label: object) -> str:
    return "" if str(label).startswith("_") else str(label)


def _alpha(alpha: object) -> float:
    return float(alpha) if isinstance(alpha, (int, float)) else 1.0

"""What a figure shows, as CSV beside it, to be drawn anew for a paper."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PathCollection
from matplotlib.colors import to_hex, to_rgba
from matplotlib.figure import Figure
from matplotlib.transforms import Transform

LINE, AREA = "line", "area"


def write(fig: Figure, folder: Path, stem: str) -> list[Path]:
    """Write `stem.csv`; pictures such as a grid of the laser are left out.

    Columns: panel (place in the grid of panels), series, kind (line, NaN where it is interrupted, or area), label,
    color, x, y, in the units of the axes.
    """
    fig.draw_without_rendering()  # so that all limits are settled
    parts = []
    for ax in fig.axes:
        place = ax.get_subplotspec()
        at = 0 if place is None else place.rowspan.start * place.get_gridspec().ncols + place.colspan.start
        for series, (_, part) in enumerate(sorted(_series(ax), key=lambda each: each[0])):
            parts.append(pd.DataFrame({"panel": at, "series": series}, part.index).join(part))
    if not parts:
        return []
    data = folder / f"{stem}.csv"
    pd.concat(parts).to_csv(data, index=False, na_rep="nan", float_format="%.9g", lineterminator="\n")
    return [data]


def _series(ax: Axes) -> list[tuple[float, pd.DataFrame]]:
    """All that a panel shows, with its order from behind to the front."""
    found = list[tuple[float, pd.DataFrame]]()

    def add(artist: Artist, transform: Transform, points: Any, kind: str, color: Any) -> None:
        xy, label = np.asarray(points, float).reshape(-1, 2), str(artist.get_label())
        if transform != ax.transData:
            xy = np.asarray((transform - ax.transData).transform(xy))
        named = {"kind": kind, "label": "" if label.startswith("_") else label, "color": to_hex(color)}
        if len(xy):
            found.append((artist.zorder, pd.DataFrame({**named, "x": xy[:, 0], "y": xy[:, 1]})))

    for line in ax.get_lines():
        add(line, line.get_transform(), np.column_stack(line.get_data(orig=False)), LINE, line.get_color())
    for c in ax.collections:
        kind, colors = (AREA, c.get_facecolor()) if len(c.get_facecolor()) else (LINE, c.get_edgecolor())
        shapes = [np.asarray(path.vertices, float) for path in c.get_paths()]
        if isinstance(c, PathCollection):
            add(c, c.get_offset_transform(), c.get_offsets(), LINE, colors[0])
        elif isinstance(c, LineCollection) and shapes:
            add(c, c.get_transform(), np.concatenate([np.vstack([s, [np.nan] * 2]) for s in shapes]), LINE, colors[0])
        else:
            for i, shape in enumerate(shapes):
                add(c, c.get_transform(), shape, kind, colors[i % len(colors)])
    for patch in ax.patches:
        outline = patch.get_path().to_polygons(closed_only=False)[0]
        filled = patch.get_fill() and to_rgba(patch.get_facecolor())[3] > 0.0
        kind, color = (AREA, patch.get_facecolor()) if filled else (LINE, patch.get_edgecolor())
        add(patch, patch.get_transform(), outline, kind, color)
    return found

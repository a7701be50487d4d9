"""A small HTML card: a table of facts beside a map as inline SVG, reproducible to the byte."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
SIDE, EDGE = 300.0, 8.0
"""px, longer side of a map, and its margin."""
MOST = 400
"""Most points of a path that are drawn."""
BLACK, GREY, WARM, COOL = "#000000", "#A6A6A6", "#D55E00", "#0064A8"
COLOURS = (WARM, COOL, "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#332288", "#999933")
"""Colours of runs, from the colour-blind safe set of Okabe and Ito."""


class Path(NamedTuple):
    """A path (N, 2) in metres, with gaps where it is NaN."""

    label: str
    xy: Array
    colour: str
    dashed: bool = False


class Points(NamedTuple):
    """Points (L, 2) in metres."""

    label: str
    xy: Array
    colour: str


def card(
    title: str, facts: Sequence[tuple[str, str]], paths: Sequence[Path] = (), points: Sequence[Points] = ()
) -> str:
    """Title, facts, and a map with its legend."""
    cells = "<tr><th style='text-align:left'>{}</th><td style='text-align:left'>{}</td></tr>"
    rows = "".join(cells.format(escape(name), escape(text)) for name, text in facts)
    return side_by_side(title, f"<table>{rows}</table>", drawing(paths, points))


def side_by_side(title: str, table: str, picture: str) -> str:
    """A table (HTML) beside a picture (SVG, may be empty)."""
    cell = "<div style='display:inline-block;vertical-align:top;margin-right:1.5em'>"
    return f"<div><b>{escape(title)}</b><br>{cell}{table}</div>{cell}{picture}</div></div>"


def drawing(paths: Sequence[Path], points: Sequence[Points]) -> str:
    """The map as SVG, north up, with a legend; empty without data.

    The first path or, without one, the first points set the extent; distant points are clipped.
    """
    every: list[Path | Points] = [*paths, *points]
    known = [p.xy[np.isfinite(p.xy).all(axis=1)] for p in every]
    known = [xy for xy in known if len(xy)]
    if not known:
        return ""
    low, high = known[0].min(axis=0), known[0].max(axis=0)
    reach = max(float((high - low).max()), 1.0)
    for xy in known[1:]:
        near = xy[np.all((xy > low - reach) & (xy < high + reach), axis=1)]
        if len(near):
            low, high = np.minimum(low, near.min(axis=0)), np.maximum(high, near.max(axis=0))
    scale = SIDE / max(float((high - low).max()), 1e-9)
    width, height = (scale * (high - low) + 2.0 * EDGE).tolist()

    def place(xy: Array) -> Array:
        return np.asarray(np.column_stack([EDGE + scale * (xy[:, 0] - low[0]), EDGE + scale * (high[1] - xy[:, 1])]))

    def sign(p: Path | Points) -> str:
        return "●" if isinstance(p, Points) else "┄" if p.dashed else "━"

    drawn = "".join(
        f"<circle cx='{x:.1f}' cy='{y:.1f}' r='2' fill='{p.colour}'/>"
        for p in points for x, y in place(p.xy).tolist() if np.isfinite([x, y]).all()
    )  # fmt: skip
    drawn += "".join(_line(place(p.xy), p) for p in paths)
    legend = "".join(f"<span style='color:{p.colour}'>{sign(p)}</span> {escape(p.label)}&ensp;" for p in every)
    size = f"width='{width:.0f}' height='{height:.0f}' viewBox='0 0 {width:.1f} {height:.1f}'"
    box = f"<rect width='{width:.1f}' height='{height:.1f}' fill='white' stroke='#C8C8C8'/>"
    span = " x ".join(f"{v:.3g}" for v in (high - low).tolist())
    return f"<svg xmlns='http://www.w3.org/2000/svg' {size}>{box}{drawn}</svg><br><small>{legend}{span} m</small>"


def _line(xy: Array, path: Path) -> str:
    """Polylines between gaps."""
    step = max(len(xy) // MOST, 1)
    kept = xy[np.unique(np.append(np.arange(0, len(xy), step), len(xy) - 1))] if len(xy) else xy
    inside = np.isfinite(kept).all(axis=1)
    pieces = np.split(kept, np.flatnonzero(np.diff(inside)) + 1) if len(kept) else []
    dash = " stroke-dasharray='4 3'" if path.dashed else ""
    return "".join(
        f"<polyline points='{_numbers(p)}' fill='none' stroke='{path.colour}' stroke-width='1.5'{dash}/>"
        for p in pieces
        if len(p) > 1 and np.isfinite(p[0]).all()
    )


def _numbers(xy: Array) -> str:
    return " ".join(f"{x:.1f},{y:.1f}" for x, y in xy.tolist())

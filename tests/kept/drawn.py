"""What a figure shows, as text: panels with their words and limits, every line, patch, collection and image in them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import Collection
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from matplotlib.legend import Legend
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.text import Text


def drawn(figure: Figure) -> list[str]:
    """The figure line by line."""
    width, height = figure.get_size_inches()
    lines = [f"figure {width:.4g} x {height:.4g} in"]
    lines += [f"  {t}" for t in _texts([*figure.texts, figure._suptitle])]
    lines += [f"  legend {_legend(legend)}" for legend in figure.legends]
    for axes in figure.axes:
        lines += [f"  {line}" for line in _panel(axes)]
    return lines


def _panel(axes: Axes) -> Iterator[str]:
    yield f"panel {axes.get_title()!r} x {axes.get_xlabel()!r} y {axes.get_ylabel()!r} on {axes.axison}"
    x, y = axes.get_xlim(), axes.get_ylim()
    yield f"  {axes.get_xscale()} {_row(x)}; {axes.get_yscale()} {_row(y)}; aspect {axes.get_aspect()}"
    for axis in (axes.xaxis, axes.yaxis):
        ticks = [t.get_text() for t in axis.get_ticklabels() if t.get_visible()]
        yield f"  ticks {ticks}"
    for artist in axes.get_children():
        if artist.get_visible() and artist is not axes.patch:
            for line in _artist(artist):
                yield f"  {line}"


def _artist(artist: Artist) -> Iterator[str]:
    over = f"z {artist.get_zorder():g}"
    match artist:
        case Line2D():
            style = f"{_colour(artist.get_color())} {artist.get_linestyle()} {artist.get_linewidth():g}"
            marker = f"{artist.get_marker()} {artist.get_markersize():g} every {artist.get_markevery()}"
            yield f"line {artist.get_label()!r} {style} {marker} {over} {_points(artist.get_xydata())}"
        case Text():
            yield from _texts([artist])
        case Legend():
            yield f"legend {_legend(artist)}"
        case AxesImage():
            values = np.asarray(artist.get_array(), float)
            yield f"image {values.shape} {_row([np.nanmin(values), np.nanmax(values), np.nanmean(values)])} {over}"
        case Collection():
            ends = [p.vertices for p in artist.get_paths() if len(p.vertices)]
            colours = [_colour(c) for c in np.concatenate([artist.get_facecolor(), artist.get_edgecolor()])[:4]]
            offsets = np.asarray(artist.get_offsets(), float)
            vertices = np.concatenate(ends) if ends else np.empty((0, 2))
            yield f"collection {artist.get_label()!r} {colours} {over} {_points(offsets)} {_points(vertices)}"
        case Patch():
            corners = artist.get_transform().transform_path(artist.get_path()).vertices
            inside = artist.axes.transData.inverted().transform(corners) if artist.axes else corners
            face, edge = _colour(artist.get_facecolor()), _colour(artist.get_edgecolor())
            yield f"patch {artist.get_label()!r} {face} {edge} {over} {_points(inside)}"


def _texts(texts: Iterable[Text | None]) -> Iterator[str]:
    for text in texts:
        if text is not None and text.get_text():
            yield f"text {text.get_text()!r} at {_row(text.get_position())} {_colour(text.get_color())} {text.get_ha()}"


def _legend(legend: Legend) -> str:
    return f"{[t.get_text() for t in legend.get_texts()]} {legend._loc}"


def _points(xy: object) -> str:
    """How many, the first and the last, least, most and mean of those that are finite."""
    points = np.asarray(xy, float).reshape(-1, 2)
    points = points[np.isfinite(points).all(axis=1)]
    if not len(points):
        return "none"
    shown = [points[0], points[-1], points.min(axis=0), points.max(axis=0), points.mean(axis=0)]
    return f"{len(points)}: {' | '.join(_row(p) for p in shown)}"


def _row(values: Iterable[float]) -> str:
    return " ".join(f"{float(v) + 0.0:.6g}" if abs(float(v)) > 1e-9 else "0" for v in values)


def _colour(colour: object) -> str:
    return to_hex(colour, keep_alpha=True)  # type: ignore[arg-type]

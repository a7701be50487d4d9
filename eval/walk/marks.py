"""Marks that the figures of a step share: ellipses, the robot, numbers; and measurements as points in its frame."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.patheffects import withStroke

from data.se2 import Array
from eval.figures.ellipses import ellipses

ONE, MANY = (7.0, 5.6), (10.5, 6.8)
"""in. Size of a figure with one picture, and with one per method."""
GOOD, BAD, DULL, FAINT = "#0064A8", "#D55E00", "#606060", "#B0B0B0"
LANDMARK = "#6A3D9A"
"""Of a landmark's number; a reading's is black, a wrong one's like its mark."""
TITLES = {
    "truth": "ground truth", "nn": "NN", "singles": "SINGLES", "ml": "ML", "jcbb": "JCBB", "gnn": "GNN",
    "jcbb-first": "JCBB", "jcbb-hindsight": "hindsight", "known": "by labels",
}  # fmt: skip
"""The lab's JCBB is `jcbb-first`; where `jcbb` stands beside it the titles have the names as they are."""
SHOWN_WITHOUT_GATE = 0.99
"""Without a gate every pair is compatible; only those inside this one are drawn."""
DASHES = (0, (3.0, 1.5))
HALO = [withStroke(linewidth=1.5, foreground="white")]


def outlines(ax: Axes, xy: Array, covariance: Array, colour: str, order: float = 2.0, fill: float = 0.15) -> None:
    """Ellipses of points (m, 2) with covariances (m, 2, 2), filled faintly."""
    if len(xy):
        outline = list(ellipses(xy, covariance))
        ax.add_collection(
            PolyCollection(outline, facecolor=colour, edgecolor="none", alpha=fill, zorder=order), autolim=False
        )
        ax.add_collection(
            PolyCollection(outline, facecolor="none", edgecolor=colour, linewidth=0.6, zorder=order), autolim=False
        )


def mark_robot(ax: Axes, pose: Array, colour: str, label: str, order: float = 6.0) -> None:
    """The robot as a triangle that points where it looks."""
    marker = (3, 0, float(np.degrees(pose[2])) - 90.0)
    ax.plot(
        pose[0], pose[1], marker=marker, markersize=9, color=colour, markeredgecolor="white", markeredgewidth=0.5,
        linestyle="none", label=label, zorder=order,
    )  # fmt: skip


def fit(ax: Axes, points: Array, margin: float = 0.06) -> None:
    """Show points (n, 2) with equal aspect and fill the place of the axes."""
    finite = points[np.isfinite(points).all(axis=1)]
    low, high = finite.min(axis=0), finite.max(axis=0)
    place = ax.get_position(original=True)
    inches = np.asarray(ax.figure.transSubfigure.transform((1.0, 1.0))) / ax.figure.dpi * [place.width, place.height]
    scale = float(((high - low) / inches).max())
    half = 0.5 * max((1.0 + 2.0 * margin) * scale, 1.0 / float(inches.min())) * inches
    middle = 0.5 * (low + high)
    ax.set(xlim=(middle[0] - half[0], middle[0] + half[0]), ylim=(middle[1] - half[1], middle[1] + half[1]))
    ax.set_aspect("equal")


def write_numbers(
    ax: Axes, xy: Array, texts: Sequence[str], colour: str, size: float, offset: tuple[float, float] = (3.0, 2.5)
) -> None:
    """Texts beside points, `offset` pt from them."""
    across, up = "left" if offset[0] >= 0 else "right", "baseline" if offset[1] >= 0 else "top"
    for (x, y), text in zip(xy.tolist(), texts, strict=True):
        ax.annotate(
            text, (x, y), xytext=offset, textcoords="offset points", fontsize=size, color=colour, ha=across, va=up,
            path_effects=HALO, zorder=8, annotation_clip=True,
        )  # fmt: skip


def robot_axes(ax: Axes, left: bool = True, bottom: bool = True) -> None:
    """Labels of the axes of the robot frame."""
    ax.set(xlabel="x forward [m]" if bottom else "", ylabel="y left [m]" if left else "")


def called(name: str, beside: Sequence[str] = ()) -> str:
    """The title of a panel that shows a method; its own name where another of those beside has the same title."""
    title = TITLES.get(name, name)
    same = [n for n in (*beside, name) if TITLES.get(n, n) == title]
    return name if len(set(same)) > 1 else title

"""A frame's problem laid out in the robot frame (x forward, y left), and the marks that the figures of a step share."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.patheffects import withStroke

from association.expectation import gate_threshold
from data.inputs import IntArray
from data.se2 import Array, BoolArray
from eval.figures.plane import ellipses
from eval.stepping.problem import Matching

ONE, MANY = (7.0, 5.6), (10.5, 6.8)  # in; size of a figure with one picture, and with one per method
GOOD, BAD, DULL, FAINT = "#0064A8", "#D55E00", "#606060", "#B0B0B0"
LANDMARK = "#6A3D9A"  # landmark numbers; those of observations are black, of wrong ones like their marks
TITLES = {name: name.upper() for name in ("nn", "singles", "ml", "jcbb", "gnn")} | {
    "truth": "ground truth",
    "jcbb-first": "JCBB",
    "jcbb-hindsight": "hindsight",
    "known": "by labels",
}
"""The lab's JCBB is `jcbb-first`; next to `jcbb` the titles are the plain names."""
SHOWN_WITHOUT_GATE = 0.99  # gate of drawn pairs, if there is none
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


def mark_robot(ax: Axes, pose: Array, colour: str, label: str) -> None:
    """The robot as a triangle in its heading."""
    marker = (3, 0, float(np.degrees(pose[2])) - 90.0)
    edge: dict[str, Any] = {"markeredgecolor": "white", "markeredgewidth": 0.5, "linestyle": "none"}
    ax.plot(pose[0], pose[1], marker=marker, markersize=9, color=colour, label=label, zorder=6.0, **edge)


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
    ax: Axes,
    xy: Array,
    numbers: IntArray,
    colour: str,
    size: float,
    offset: tuple[float, float] = (3.0, 2.5),
    *,
    first: int = 0,
) -> None:
    """Numbers (n,) at points, `offset` pt from them; `first`: what 0 is called."""
    across, up = "left" if offset[0] >= 0 else "right", "baseline" if offset[1] >= 0 else "top"
    look: dict[str, Any] = {"fontsize": size, "color": colour, "ha": across, "va": up, "path_effects": HALO}
    place: dict[str, Any] = {"xytext": offset, "textcoords": "offset points", "annotation_clip": True}
    for (x, y), number in zip(xy.tolist(), numbers.tolist(), strict=True):
        ax.annotate(str(number + first), (x, y), zorder=8, **place, **look)


def robot_axes(ax: Axes, left: bool = True, bottom: bool = True) -> None:
    """Labels of the axes of the robot frame."""
    ax.set(xlabel="x forward [m]" if bottom else "", ylabel="y left [m]" if left else "")


def called(name: str, others: Sequence[str] = ()) -> str:
    """The title of a method's panel; its name where another panel has the same title."""
    title = TITLES.get(name, name)
    same = [n for n in (*others, name) if TITLES.get(n, n) == title]
    return name if len(set(same)) > 1 else title


@dataclass(frozen=True, eq=False)
class Plane:
    """A problem laid out in the robot frame; `compatible` pairs (m, n) pass the gate, `near` ones are drawn in grey."""

    xy: Array
    P: Array
    landmarks: Array
    Pl: Array
    compatible: BoolArray
    near: BoolArray
    shown: Array
    number: IntArray  # (n,) of the landmarks
    named: BoolArray  # (n,) those whose number is written
    column: dict[int, int]  # of a number, its place among them
    first: int  # what landmark and observation 0 are called


def plane_of(m: Matching) -> Plane:
    """Places, compatible pairs, and the part of the plane that is shown."""
    e = m.expectation
    xy, P = m.sensor.body_points(e.z, e.R)
    landmarks, Pl = m.sensor.body_points(e.z_hat, e.HPHt)
    d2 = e.individual_distances()
    compatible: BoolArray = d2 < e.threshold(m.gate)
    near: BoolArray = d2 < gate_threshold(SHOWN_WITHOUT_GATE if m.gate is None else m.gate)
    involved = near.any(axis=0) if m.right is None else near.any(axis=0) | np.isin(e.number, m.right)
    # far landmarks would make everything else small
    scene = np.concatenate([xy, np.zeros((1, 2))])
    low, high = scene.min(axis=0), scene.max(axis=0)
    reach = max(float((high - low).max()), 1.0)
    involved &= np.all((landmarks > low - reach) & (landmarks < high + reach), axis=1)
    shown = np.concatenate([scene, landmarks[involved]])
    column = {int(n): j for j, n in enumerate(e.number)}
    return Plane(xy, P, landmarks, Pl, compatible, near, shown, e.number, involved, column, m.first)


def make_panels(fig: Figure, names: Sequence[str]) -> tuple[list[Axes], tuple[float, float] | None]:
    """One panel per name, at most six, and the place for a legend, if any."""
    fig.set_layout_engine("none")
    fig.set_size_inches(*MANY)
    full = len(names) == 6
    bottom, high = (0.14, 0.335) if full else (0.065, 0.375)
    corners = [(0.055 + 0.318 * column, bottom + row * (high + 0.085)) for row in (1, 0) for column in range(3)]
    axes = [fig.add_axes((x, y, 0.28, high)) for (x, y), _ in zip(corners, names, strict=False)]
    return axes, None if full else corners[len(names)]


def legend(fig: Figure, place: tuple[float, float] | None, handles: Sequence[Line2D | Patch]) -> None:
    """The legend in a free panel, or else below all."""
    if place is not None:
        fig.legend(handles=handles, loc="lower left", bbox_to_anchor=place, fontsize=8.0, labelspacing=0.8)
    else:
        fig.legend(handles=handles, loc="lower center", ncols=4)


def background(ax: Axes, p: Plane) -> None:
    """Expected landmarks and observations with their ellipses, compatible pairs in grey, and the robot."""
    outlines(ax, p.landmarks, p.Pl, DULL, 1.5, 0.08)
    ax.plot(*p.landmarks.T, "+", color=DULL, markersize=4.5, markeredgewidth=0.7, zorder=3)
    outlines(ax, p.xy, p.P, GOOD, 2.0, 0.08)
    mark_robot(ax, np.zeros(3), "black", "robot")
    lines(ax, p, [(int(i), int(j)) for i, j in np.argwhere(p.near)], color=FAINT, linewidth=0.8, zorder=2.5)
    fit(ax, p.shown, 0.1)


def lines(ax: Axes, p: Plane, pairs: Sequence[tuple[int, int]], **look: Any) -> None:
    """Lines from observations to landmarks, pairs of (observation, row of the landmark)."""
    if pairs:
        ax.add_collection(
            LineCollection([np.stack([p.xy[i], p.landmarks[j]]) for i, j in pairs], **look), autolim=False
        )


def name_landmarks(ax: Axes, p: Plane) -> None:
    """Numbers of possible landmarks, below left of them; observations have theirs above."""
    low, high = np.array(ax.get_xlim()), np.array(ax.get_ylim())
    x, y = p.landmarks.T
    inside = p.named & (x >= low[0]) & (x <= low[1]) & (y >= high[0]) & (y <= high[1])
    write_numbers(ax, p.landmarks[inside], p.number[inside], LANDMARK, 5.0, (-2.5, -2.5), first=p.first)

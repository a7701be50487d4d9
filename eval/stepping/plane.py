"""A frame's problem laid out in the robot frame, and what every picture of it has behind: landmarks, readings, robot.

Seen from the robot: x forward, y left.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from association.expectation import Expectation, gate_threshold
from data.inputs import IntArray
from data.se2 import Array, BoolArray
from data.sensors import Sensor
from eval.walk.marks import (
    DULL,
    FAINT,
    GOOD,
    LANDMARK,
    MANY,
    SHOWN_WITHOUT_GATE,
    fit,
    mark_robot,
    outlines,
    write_numbers,
)
from eval.walk.text import TruthRow


@dataclass(frozen=True, eq=False)
class Matching:
    """A frame's problem and its solutions.

    Attributes:
        title: of the figure.
        expectation: what every method was given; sensor: which makes points of its measurements.
        gate: probability of the individual test, None for none.
        decisions: (m,) by method, in the order of the panels; a text says why a method has none.
        chosen: the method that updates.
        truth: by method, what the referee says; empty without true ids.
        right: (m,) number of the right landmark, negative for none; None without true ids.
    """

    title: str
    expectation: Expectation
    sensor: Sensor
    gate: float | None
    decisions: Mapping[str, IntArray | str]
    chosen: str
    truth: Mapping[str, TruthRow]
    right: IntArray | None


@dataclass(frozen=True, eq=False)
class Plane:
    """A problem laid out in the robot frame; `compatible` pairs (m, n) pass the gate, `near` ones are drawn in grey.

    number: (n,) of the landmarks; column: of a number, its place among them; named: (n,) those whose number is written.
    """

    xy: Array
    P: Array
    landmarks: Array
    Pl: Array
    compatible: BoolArray
    near: BoolArray
    shown: Array
    number: IntArray
    named: BoolArray
    column: dict[int, int]


def plane_of(m: Matching) -> Plane:
    """Where everything stands, which pairs are compatible, and what part of the plane is shown."""
    e = m.expectation
    xy, P = m.sensor.body_points(e.z, e.R)
    landmarks, Pl = m.sensor.body_points(e.z_hat, e.HPHt)
    d2 = e.individual_distances()
    compatible: BoolArray = d2 < gate_threshold(m.gate)
    near: BoolArray = d2 < gate_threshold(SHOWN_WITHOUT_GATE if m.gate is None else m.gate)
    involved = near.any(axis=0) if m.right is None else near.any(axis=0) | np.isin(e.number, m.right)
    # a landmark that is far off would make everything else small
    scene = np.concatenate([xy, np.zeros((1, 2))])
    low, high = scene.min(axis=0), scene.max(axis=0)
    reach = max(float((high - low).max()), 1.0)
    involved &= np.all((landmarks > low - reach) & (landmarks < high + reach), axis=1)
    shown = np.concatenate([scene, landmarks[involved]])
    column = {int(n): j for j, n in enumerate(e.number)}
    return Plane(xy, P, landmarks, Pl, compatible, near, shown, e.number, involved, column)


def make_panels(fig: Figure, names: Sequence[str]) -> tuple[list[Axes], tuple[float, float] | None]:
    """One panel per name, at most six, and the place left for a legend if there is one."""
    fig.set_layout_engine("none")
    fig.set_size_inches(*MANY)
    full = len(names) == 6
    bottom, high = (0.14, 0.335) if full else (0.065, 0.375)
    corners = [(0.055 + 0.318 * column, bottom + row * (high + 0.085)) for row in (1, 0) for column in range(3)]
    axes = [fig.add_axes((x, y, 0.28, high)) for (x, y), _ in zip(corners, names, strict=False)]
    return axes, None if full else corners[len(names)]


def legend(fig: Figure, place: tuple[float, float] | None, handles: Sequence[Line2D | Patch]) -> None:
    """The legend where a panel is free, or else below all."""
    if place is not None:
        fig.legend(handles=handles, loc="lower left", bbox_to_anchor=place, fontsize=8.0, labelspacing=0.8)
    else:
        fig.legend(handles=handles, loc="lower center", ncols=4)


def background(ax: Axes, p: Plane) -> None:
    """Predicted landmarks and readings with their ellipses, compatible pairs in grey, and the robot."""
    outlines(ax, p.landmarks, p.Pl, DULL, 1.5, 0.08)
    ax.plot(*p.landmarks.T, "+", color=DULL, markersize=4.5, markeredgewidth=0.7, zorder=3)
    outlines(ax, p.xy, p.P, GOOD, 2.0, 0.08)
    mark_robot(ax, np.zeros(3), "black", "robot")
    lines(ax, p, [(int(i), int(j)) for i, j in np.argwhere(p.near)], color=FAINT, linewidth=0.8, zorder=2.5)
    fit(ax, p.shown, 0.1)


def lines(ax: Axes, p: Plane, pairs: Sequence[tuple[int, int]], **look: Any) -> None:
    """Lines from readings to landmarks, pairs of (reading, row of the landmark)."""
    if pairs:
        ax.add_collection(
            LineCollection([np.stack([p.xy[i], p.landmarks[j]]) for i, j in pairs], **look), autolim=False
        )


def name_landmarks(ax: Axes, p: Plane, size: float = 5.0) -> None:
    """Numbers of the landmarks that somebody may be paired with, below left of them; readings have theirs above."""
    low, high = np.array(ax.get_xlim()), np.array(ax.get_ylim())
    x, y = p.landmarks.T
    inside = p.named & (x >= low[0]) & (x <= low[1]) & (y >= high[0]) & (y <= high[1])
    write_numbers(ax, p.landmarks[inside], [str(n) for n in p.number[inside]], LANDMARK, size, (-2.5, -2.5))

"""The figures of a frame's problem and its solutions: compatibility and matching, a panel for each method.

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
from data.result import NEW
from data.se2 import Array, BoolArray
from data.sensors import Sensor
from eval.walk.marks import (
    BAD,
    DASHES,
    DULL,
    FAINT,
    GOOD,
    MANY,
    SHOWN_WITHOUT_GATE,
    TITLES,
    fit,
    mark_robot,
    outlines,
    robot_axes,
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
class _Plane:
    """A problem laid out in the robot frame; `compatible` pairs (m, n) pass the gate, `near` ones are drawn in grey."""

    xy: Array
    P: Array
    landmarks: Array
    Pl: Array
    compatible: BoolArray
    near: BoolArray
    shown: Array
    column: dict[int, int]


def _plane(m: Matching) -> _Plane:
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
    return _Plane(xy, P, landmarks, Pl, compatible, near, shown, {int(n): j for j, n in enumerate(e.number)})


def _panels(fig: Figure, names: Sequence[str]) -> tuple[list[Axes], tuple[float, float] | None]:
    """One panel per name, at most six, and the place left for a legend if there is one."""
    fig.set_layout_engine("none")
    fig.set_size_inches(*MANY)
    full = len(names) == 6
    bottom, high = (0.14, 0.335) if full else (0.065, 0.375)
    corners = [(0.055 + 0.318 * column, bottom + row * (high + 0.085)) for row in (1, 0) for column in range(3)]
    axes = [fig.add_axes((x, y, 0.28, high)) for (x, y), _ in zip(corners, names, strict=False)]
    return axes, None if full else corners[len(names)]


def _legend(fig: Figure, place: tuple[float, float] | None, handles: Sequence[Line2D | Patch]) -> None:
    if place is not None:
        fig.legend(handles=handles, loc="lower left", bbox_to_anchor=place, fontsize=8.0, labelspacing=0.8)
    else:
        fig.legend(handles=handles, loc="lower center", ncols=4)


def _background(ax: Axes, p: _Plane) -> None:
    outlines(ax, p.landmarks, p.Pl, DULL, 1.5, 0.08)
    ax.plot(*p.landmarks.T, "+", color=DULL, markersize=4.5, markeredgewidth=0.7, zorder=3)
    outlines(ax, p.xy, p.P, GOOD, 2.0, 0.08)
    mark_robot(ax, np.zeros(3), "black", "robot")
    _lines(ax, p, [(int(i), int(j)) for i, j in np.argwhere(p.near)], color=FAINT, linewidth=0.8, zorder=2.5)
    fit(ax, p.shown, 0.1)


def _lines(ax: Axes, p: _Plane, pairs: Sequence[tuple[int, int]], **look: Any) -> None:
    if pairs:
        ax.add_collection(
            LineCollection([np.stack([p.xy[i], p.landmarks[j]]) for i, j in pairs], **look), autolim=False
        )


def _background_handles(gate: float | None) -> list[Line2D | Patch]:
    inside = f"d² inside {SHOWN_WITHOUT_GATE:g} (no gate: every pair is compatible)"
    return [
        Line2D([], [], marker="+", color=DULL, linestyle="none", label="predicted landmark, 3σ ellipse"),
        Line2D([], [], color=FAINT, linewidth=0.8, label=inside if gate is None else "individually compatible pair"),
    ]


def evidence(name: str, m: Matching) -> list[tuple[int, int]]:
    """Pairs (observation, candidate) on which a method builds.

    The right ones for `truth`, the decisions by label for `known`, the nearest of each observation for `nn`, the
    likeliest for `ml`, pairs without rivals for `singles`, and for other methods all that are compatible.
    """
    e, p = m.expectation, _plane(m)
    if name in ("truth", "known"):
        found = m.right if name == "truth" else m.decisions[name]
        pairs = [] if found is None or isinstance(found, str) else list(enumerate(found.tolist()))
        return [(i, p.column[n]) for i, n in pairs if n in p.column]
    if name in ("nn", "ml"):
        score = e.individual_distances() + (e.log_determinants() if name == "ml" else 0.0)
        best = np.where(p.compatible, score, np.inf)
        return [(i, int(row.argmin())) for i, row in enumerate(best) if np.isfinite(row).any()]
    taken = p.near
    if name == "singles":
        alone = p.compatible.sum(axis=0) == 1, p.compatible.sum(axis=1) == 1
        taken = p.compatible & alone[0][None, :] & alone[1][:, None]
    return [(int(i), int(j)) for i, j in np.argwhere(taken)]


EVIDENCE = {
    "truth": "right pairs", "nn": "nearest of each", "ml": "likeliest of each", "singles": "pairs without rivals",
    "known": "pairs by label",
}  # fmt: skip


def paint_compatibility(fig: Figure, m: Matching) -> None:
    """What can be paired: compatible pairs in grey, and in colour those on which each method builds."""
    p, names = _plane(m), list(m.decisions)
    panels, place = _panels(fig, names)
    rest = "all compatible pairs" if m.gate is not None else f"all pairs; drawn: inside {SHOWN_WITHOUT_GATE:g}"
    for at, (ax, name) in enumerate(zip(panels, names, strict=True)):
        _background(ax, p)
        pairs = evidence(name, m)
        good = [q for q in pairs if p.compatible[q]]
        bad = [q for q in pairs if not p.compatible[q]]
        _lines(ax, p, good, color=GOOD, linewidth=1.3, zorder=4)
        _lines(ax, p, bad, color=BAD, linewidth=1.3, linestyle=DASHES, zorder=4)
        without = ~np.isin(np.arange(len(p.xy)), [i for i, _ in pairs])
        ax.plot(*p.xy.T, "o", color=GOOD, markersize=3.5, markeredgewidth=0.8, zorder=5)
        ax.plot(*p.xy[without].T, "o", color="white", markersize=2.2, markeredgewidth=0.0, zorder=5.1)
        if at == 0:
            write_numbers(ax, p.xy, [str(i) for i in range(len(p.xy))], "#202020", 5.5)
        out = f", {len(bad)} incompatible" if bad else ""
        ax.set_title(f"{_called(name)}: {EVIDENCE.get(name, rest)} ({len(pairs)}{out})")
        robot_axes(ax, left=at % 3 == 0, bottom=at >= len(names) - 3)
    handles: list[Line2D | Patch] = [
        Line2D([], [], marker="o", color=GOOD, linestyle="none", markersize=4.0, label="observation, 3σ ellipse"),
        Line2D([], [], marker="o", color=GOOD, markerfacecolor="white", linestyle="none", markersize=4.0,
               label="observation without such a pair"),
        *_background_handles(m.gate),
        Line2D([], [], color=GOOD, linewidth=1.3, label="pair on which the method builds"),
    ]  # fmt: skip
    if "truth" in names:
        handles.append(Line2D([], [], color=BAD, linestyle=DASHES, label="true pair that is not compatible"))
    _legend(fig, place, handles)
    fig.suptitle(f"{m.title}: compatibility, robot frame", x=0.01, ha="left")


def _called(name: str) -> str:
    return TITLES.get(name, name)


def paint_matching(fig: Figure, m: Matching) -> None:
    """What each method decides on the same expectation: shapes say what, colours whether it is right."""
    p, names = _plane(m), list(m.decisions)
    panels, place = _panels(fig, names)
    for at, (ax, name) in enumerate(zip(panels, names, strict=True)):
        _background(ax, p)
        made = m.decisions[name]
        update = " (updates)" if name == m.chosen else ""
        if isinstance(made, str):
            ax.set_title(f"{_called(name)}{update}: {made}")
        else:
            ax.set_title(f"{_called(name)}{update}: {_counted(made, m.truth.get(name))}")
            _decided(ax, p, made, m.truth.get(name), all_numbers=at == 0)
        if name == m.chosen:
            for spine in ax.spines.values():
                spine.set(linewidth=1.8, edgecolor="black")
        robot_axes(ax, left=at % 3 == 0, bottom=at >= len(names) - 3)
    shapes = (("o", "paired"), ("*", "NEW"), ("x", "left out"))
    handles: list[Line2D | Patch] = [
        *(Line2D([], [], marker=s, color=GOOD, linestyle="none", label=f"observation: {what}") for s, what in shapes),
        *_background_handles(m.gate),
        Line2D([], [], color=GOOD, linewidth=1.3, label="pairing"),
    ]  # fmt: skip
    if m.right is not None:
        handles += [
            Line2D([], [], color=BAD, linewidth=1.3, linestyle=DASHES, label="wrong pairing"),
            Line2D([], [], color=BAD, marker="o", linestyle="none", label="wrong (FP or FN), numbered"),
            Line2D([], [], color=BAD, linewidth=0.9, linestyle=":", label="to the landmark that is right"),
        ]
    _legend(fig, place, handles)
    fig.suptitle(f"{m.title}: matching, robot frame", x=0.01, ha="left")


def _counted(decisions: IntArray, truth: TruthRow | None) -> str:
    if truth is not None:
        return "  ".join(f"{name.upper()} {n}" for name, n in truth.counts().items())
    paired, new = int((decisions >= 0).sum()), int((decisions == NEW).sum())
    return f"{paired} paired, {new} new, {len(decisions) - paired - new} left out"


def _decided(ax: Axes, p: _Plane, decisions: IntArray, truth: TruthRow | None, *, all_numbers: bool) -> None:
    wrong = np.zeros(len(decisions), bool) if truth is None else ~np.array(truth.correct, bool)
    pairs = [(i, p.column.get(n, -1)) for i, n in enumerate(decisions.tolist()) if n >= 0]
    pairs = [(i, j) for i, j in pairs if j >= 0]  # a labelled landmark need not be a candidate
    _lines(ax, p, [q for q in pairs if not wrong[q[0]]], color=GOOD, linewidth=1.3, zorder=4)
    _lines(ax, p, [q for q in pairs if wrong[q[0]]], color=BAD, linewidth=1.3, linestyle=DASHES, zorder=4)
    if truth is not None:
        missed = [(int(i), p.column.get(int(truth.ground_truth[i]), -1)) for i in np.flatnonzero(wrong)]
        _lines(ax, p, [q for q in missed if q[1] >= 0], color=BAD, linewidth=0.9, linestyle=":", zorder=3.8)
    kinds = (("o", decisions >= 0, 3.0), ("*", decisions == NEW, 6.5), ("x", decisions < NEW, 4.5))
    for colour, group in ((GOOD, ~wrong), (BAD, wrong)):
        for marker, kind, size in kinds:
            ax.plot(*p.xy[kind & group].T, marker, color=colour, markersize=size, linestyle="none", zorder=5)
    named = np.arange(len(wrong)) if all_numbers else np.flatnonzero(wrong)
    write_numbers(
        ax, p.xy[named], [str(i) for i in named], "#202020" if all_numbers else BAD, 5.5 if all_numbers else 6.5
    )

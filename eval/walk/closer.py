"""One frame looked at from near, as a figure of the report: what could be paired, and what a method made of it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from data.inputs import IntArray
from data.se2 import Array
from eval.figures.paper.look import page_width
from eval.figures.style import drawing
from eval.walk.deciding import draw_decisions, scene_of_wrong, wrong_of
from eval.walk.marks import BAD, DASHES, DULL, FAINT, GOOD, HALO, LANDMARK, called, outlines, robot_axes, write_numbers
from eval.walk.plane import Matching, Plane, lines, plane_of

AROUND = 0.5
"""m, half the side of what is shown at least: the corridor's points stand 0.25 m apart."""
TALL, FLAT = 4.4, 3.3
"""in. Heights of a figure with two panels, and with one per method."""
SIZE = 7.0
"""pt, of the numbers."""


def closer_figure(m: Matching, method: str) -> Figure:
    """Compatibility and matching of one method in a frame, zoomed on its wrong decision (or on its most crowded spot).

    Beside each compatible pair in view stands its squared Mahalanobis distance d².
    """
    with drawing():
        p, decided = plane_of(m), m.decisions[method]
        assert not isinstance(decided, str)  # the frame is one that this method updates with
        truth = m.truth.get(method)
        middle, half = _region(p, decided, scene_of_wrong(p, decided, truth))
        fig = Figure(figsize=(page_width(), TALL))
        fig.set_layout_engine("none")
        left, right = (fig.add_axes((x, 0.215, 0.415, 0.415 * page_width() / TALL)) for x in (0.085, 0.575))
        for ax in (left, right):
            _scene(ax, p, middle, half, wrong_of(truth) if ax is left else None)
        d2 = m.expectation.individual_distances()
        for i, j in np.argwhere(p.near):
            at = 0.5 * (p.xy[i] + p.landmarks[j])
            if np.all(np.abs(at - middle) < 0.95 * half):
                left.annotate(
                    f"{d2[i, j]:.2g}", at, fontsize=5.5, color="#303030", path_effects=HALO, ha="center", va="center",
                    zorder=9,
                )  # fmt: skip
        draw_decisions(right, p, decided, truth, all_numbers=True, size=SIZE)
        robot_axes(left)
        robot_axes(right, left=False)
        left.set_title("compatibility: pairs inside the gate, with their d²", loc="left")
        counted = "" if truth is None else "  ".join(f"{name.upper()} {n}" for name, n in truth.counts().items())
        right.set_title(f"matching by {called(method)}: {counted}", loc="left")
        fig.legend(handles=_handles(m), loc="lower center", ncols=4)
        fig.suptitle(m.title, x=0.01, ha="left")
        return fig


def methods_figure(m: Matching, methods: Sequence[str]) -> Figure:
    """What several methods make of one frame, side by side, zoomed on what the first of them gets wrong."""
    with drawing():
        p, first = plane_of(m), m.decisions[methods[0]]
        scene = None if isinstance(first, str) else scene_of_wrong(p, first, m.truth.get(methods[0]))
        middle, half = _region(p, np.empty(0, np.int64) if isinstance(first, str) else first, scene)
        fig = Figure(figsize=(page_width(), FLAT))
        fig.set_layout_engine("none")
        wide = 0.925 / len(methods)
        for k, name in enumerate(methods):
            ax = fig.add_axes((0.075 + k * wide, 0.27, wide - 0.03, (wide - 0.03) * page_width() / FLAT))
            _scene(ax, p, middle, half, None)
            ax.tick_params(labelleft=k == 0)
            robot_axes(ax, left=k == 0)
            made = m.decisions[name]
            if isinstance(made, str):
                ax.set_title(f"{called(name)}: {made}", loc="left")
                continue
            truth = m.truth.get(name)
            draw_decisions(ax, p, made, truth, all_numbers=True, size=SIZE - 0.5)
            counted = "" if truth is None else "  ".join(f"{n.upper()} {c}" for n, c in truth.counts().items())
            ax.set_title(f"{called(name)}: {counted}", loc="left")
        fig.legend(handles=_handles(m), loc="lower center", ncols=4)
        fig.suptitle(m.title, x=0.01, ha="left")
        return fig


def _region(p: Plane, decisions: IntArray, scene: Array | None) -> tuple[Array, float]:
    """Middle (2,) and half side [m] of what is shown: a wrong decision, or else the spot with most compatible pairs."""
    if scene is None:
        crowded = int(p.near.sum(axis=1).argmax()) if p.near.size else 0
        scene = p.xy[[crowded]]
    low, high = scene.min(axis=0), scene.max(axis=0)
    return 0.5 * (low + high), max(0.9 * float((high - low).max()), AROUND)


def _scene(ax: Axes, p: Plane, middle: Array, half: float, wrong: IntArray | None) -> None:
    """Landmarks with numbers and ellipses, readings (where decisions are not drawn), compatible pairs."""
    ax.set(xlim=middle[0] + [-half, half], ylim=middle[1] + [-half, half])
    ax.set_aspect("equal")
    for axis in (ax.xaxis, ax.yaxis):
        axis.set_major_locator(MaxNLocator(5, steps=[1, 2, 5, 10]))
    outlines(ax, p.landmarks, p.Pl, DULL, 1.5, 0.1)
    outlines(ax, p.xy, p.P, GOOD, 2.0, 0.1)
    ax.plot(*p.landmarks.T, "+", color=DULL, markersize=7.0, markeredgewidth=1.0, zorder=3)
    lines(ax, p, [(int(i), int(j)) for i, j in np.argwhere(p.near)], color=FAINT, linewidth=0.9, zorder=2.5)
    seen = np.all(np.abs(p.landmarks - middle) <= half, axis=1)
    write_numbers(ax, p.landmarks[seen], [str(n) for n in p.number[seen]], LANDMARK, SIZE, (-3.0, -3.0))
    if wrong is not None:
        ax.plot(*p.xy.T, "o", color=GOOD, markersize=3.5, zorder=5)
        ax.plot(*p.xy[wrong].T, "o", color=BAD, markersize=3.5, zorder=5.1)
        write_numbers(ax, p.xy, [str(i) for i in range(len(p.xy))], "#202020", SIZE)


def _handles(m: Matching) -> list[Line2D | Patch]:
    handles: list[Line2D | Patch] = [
        Line2D([], [], marker="o", color=GOOD, linestyle="none", label="observation, its number black"),
        Line2D([], [], marker="+", color=DULL, linestyle="none", label="predicted landmark, 3σ"),
        Line2D([], [], marker="$7$", color=LANDMARK, linestyle="none", label="number of a landmark"),
        Line2D([], [], color=FAINT, linewidth=0.9, label="compatible pair"),
        Line2D([], [], color=GOOD, linewidth=1.3, label="pairing"),
    ]
    shapes = (("*", "NEW"), ("x", "left out"))
    handles += [Line2D([], [], marker=s, color=GOOD, linestyle="none", label=what) for s, what in shapes]
    if m.right is not None:
        handles += [
            Line2D([], [], color=BAD, marker="o", linewidth=1.3, linestyle=DASHES, label="wrong"),
            Line2D([], [], color=BAD, linewidth=0.9, linestyle=":", label="to the right landmark"),
        ]
    return handles

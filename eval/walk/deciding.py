"""Decisions drawn over a frame's problem, and enlarged where they are wrong."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes

from data.inputs import IntArray
from data.result import NEW
from data.se2 import Array
from eval.walk.marks import BAD, DASHES, DULL, FAINT, GOOD, LANDMARK, outlines, write_numbers
from eval.walk.plane import Plane, lines
from eval.walk.text import TruthRow

SHARE = 0.42
"""Of an inset in the side of its panel."""
LEAST = 0.2
"""m, half the side of what an inset shows at least."""


def draw_decisions(
    ax: Axes, p: Plane, decisions: IntArray, truth: TruthRow | None, *, all_numbers: bool, size: float = 5.5
) -> None:
    """Pairings as lines, shapes that say what was decided, colours whether it is right; wrong ones are numbered."""
    wrong = np.zeros(len(decisions), bool) if truth is None else ~np.array(truth.correct, bool)
    pairs = [(i, p.column.get(n, -1)) for i, n in enumerate(decisions.tolist()) if n >= 0]
    pairs = [(i, j) for i, j in pairs if j >= 0]  # a labelled landmark need not be a candidate
    lines(ax, p, [q for q in pairs if not wrong[q[0]]], color=GOOD, linewidth=1.3, zorder=4)
    lines(ax, p, [q for q in pairs if wrong[q[0]]], color=BAD, linewidth=1.3, linestyle=DASHES, zorder=4)
    if truth is not None:
        missed = [(int(i), p.column.get(int(truth.ground_truth[i]), -1)) for i in np.flatnonzero(wrong)]
        lines(ax, p, [q for q in missed if q[1] >= 0], color=BAD, linewidth=0.9, linestyle=":", zorder=3.8)
    kinds = (("o", decisions >= 0, 3.0), ("*", decisions == NEW, 6.5), ("x", decisions < NEW, 4.5))
    for colour, group in ((GOOD, ~wrong), (BAD, wrong)):
        for marker, kind, large in kinds:
            ax.plot(*p.xy[kind & group].T, marker, color=colour, markersize=large, linestyle="none", zorder=5)
    named = np.arange(len(wrong)) if all_numbers else np.flatnonzero(wrong)
    write_numbers(
        ax, p.xy[named], [str(i) for i in named], "#202020" if all_numbers else BAD, size if all_numbers else size + 1.0
    )


def wrong_of(truth: TruthRow | None) -> IntArray:
    """Readings decided wrongly."""
    return np.empty(0, np.int64) if truth is None else np.flatnonzero(~np.array(truth.correct, bool))


def scene_of_wrong(p: Plane, decisions: IntArray, truth: TruthRow | None) -> Array | None:
    """What a look at one wrong decision must show, points (k, 2): reading, landmark taken, landmark that is right.

    The wrong decision whose landmarks are nearest to each other is the one that needs it; None where none is wrong.
    """
    found: list[Array] = []
    for i in wrong_of(truth).tolist():
        numbers = [int(decisions[i])] + ([] if truth is None else [int(truth.ground_truth[i])])
        columns = [p.column[n] for n in numbers if n in p.column]
        if columns:
            found.append(np.concatenate([p.xy[[i]], p.landmarks[columns]]))
    # one landmark alone tells less than two that are confused
    return min(found, key=lambda points: (-len(points), float(np.ptp(points, axis=0).max())), default=None)


def inset_on_wrong(ax: Axes, p: Plane, decisions: IntArray, truth: TruthRow | None) -> Axes | None:
    """Enlarge one wrong decision in the corner of the panel that has most room; None where nothing is wrong."""
    scene = scene_of_wrong(p, decisions, truth)
    if scene is None:
        return None
    low, high = scene.min(axis=0), scene.max(axis=0)
    middle, half = 0.5 * (low + high), max(0.75 * float((high - low).max()), LEAST)
    inset = ax.inset_axes(_corner(ax, p), zorder=20)
    outlines(inset, p.landmarks, p.Pl, DULL, 1.5, 0.08)
    outlines(inset, p.xy, p.P, GOOD, 2.0, 0.08)
    inset.plot(*p.landmarks.T, "+", color=DULL, markersize=6.0, markeredgewidth=0.9, zorder=3)
    lines(inset, p, [(int(i), int(j)) for i, j in np.argwhere(p.near)], color=FAINT, linewidth=0.8, zorder=2.5)
    draw_decisions(inset, p, decisions, truth, all_numbers=True, size=6.0)
    inset.set(xlim=middle[0] + [-half, half], ylim=middle[1] + [-half, half])
    inset.set_aspect("equal")
    seen = np.all(np.abs(p.landmarks - middle) <= half, axis=1)
    write_numbers(inset, p.landmarks[seen], [str(n) for n in p.number[seen]], LANDMARK, 6.0, (-3.0, -3.0))
    inset.tick_params(labelleft=False, labelbottom=False, length=0.0)
    ax.indicate_inset_zoom(inset, edgecolor="#303030")
    for spine in inset.spines.values():
        spine.set(edgecolor=BAD, linewidth=0.9)
    return inset


def _corner(ax: Axes, p: Plane) -> tuple[float, float, float, float]:
    """Place of an inset in a panel's own units: the corner with the fewest readings and named landmarks below it."""
    points = ax.transData.transform(np.concatenate([p.xy, p.landmarks[p.named], np.zeros((1, 2))]))
    unit = ax.transAxes.inverted().transform(points)
    place = ax.get_window_extent()
    wide = SHARE * min(1.0, float(place.height / place.width))
    corners = [(x, y) for y in (0.985 - SHARE, 0.015) for x in (0.985 - wide, 0.015)]

    def covered(corner: tuple[float, float]) -> int:
        inside = (unit >= corner) & (unit <= np.add(corner, (wide, SHARE)))
        return int(inside.all(axis=1).sum())

    x, y = min(corners, key=covered)
    return x, y, wide, SHARE

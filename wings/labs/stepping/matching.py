"""Figures of a frame's association problem and its solutions, seen from the robot (x forward, y left).

Compatibility, and matching with a panel for each method, as in a walk; and an enlarged frame, as in the report.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from data.inputs import IntArray
from data.result import NEW
from data.se2 import Array
from eval.figures.style import drawing, page_width
from wings.labs.stepping.pictures import (
    BAD,
    DASHES,
    DULL,
    FAINT,
    GOOD,
    HALO,
    LANDMARK,
    SHOWN_WITHOUT_GATE,
    Plane,
    background,
    called,
    fit,
    legend,
    lines,
    make_panels,
    mark_robot,
    name_landmarks,
    picture_axes,
    plane_of,
    robot_axes,
    write_numbers,
)
from wings.labs.stepping.problem import Matching, TruthRow


def draw_decisions(
    ax: Axes, p: Plane, decisions: IntArray, truth: TruthRow | None, *, all_numbers: bool, size: float = 5.5
) -> None:
    """Pairings as lines; shapes show the decision, colours whether it is right; wrong ones are numbered."""
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
    colour, size = ("#202020", size) if all_numbers else (BAD, size + 1.0)
    write_numbers(ax, p.xy[named], named, colour, size, first=p.first)


def wrong_of(truth: TruthRow | None) -> IntArray:
    """Observations decided wrongly."""
    return np.empty(0, np.int64) if truth is None else np.flatnonzero(~np.array(truth.correct, bool))


def scene_of_wrong(p: Plane, decisions: IntArray, truth: TruthRow | None) -> Array | None:
    """Points (k, 2) of one wrong decision: observation, paired landmark, right landmark.

    Chosen is the wrong decision with the smallest extent; None if none is wrong.
    """
    found: list[Array] = []
    for i in wrong_of(truth).tolist():
        numbers = [int(decisions[i])] + ([] if truth is None else [int(truth.ground_truth[i])])
        columns = [p.column[n] for n in numbers if n in p.column]
        if columns:
            found.append(np.concatenate([p.xy[[i]], p.landmarks[columns]]))
    # two confused landmarks are more informative than one
    return min(found, key=lambda points: (-len(points), float(np.ptp(points, axis=0).max())), default=None)


def enlarge(ax: Axes, p: Plane, scene: Array) -> tuple[Array, float]:
    """The problem around some points (k, 2), its landmarks numbered; middle (2,) and half side [m] of what is shown."""
    low, high = scene.min(axis=0), scene.max(axis=0)
    middle, half = 0.5 * (low + high), max(0.8 * float((high - low).max()), AROUND)
    background(ax, p, SIZE)
    ax.set(xlim=middle[0] + [-half, half], ylim=middle[1] + [-half, half])
    ax.set_aspect("equal")
    seen = np.all(np.abs(p.landmarks - middle) <= half, axis=1)
    write_numbers(ax, p.landmarks[seen], p.number[seen], LANDMARK, SIZE, (-3.0, -3.0), first=p.first)
    return middle, half


def _mark(marker: str, label: str, colour: str = GOOD, **look: Any) -> Line2D:
    return Line2D([], [], marker=marker, color=colour, linestyle="none", label=label, **look)


def _stroke(label: str, colour: str = GOOD, **look: Any) -> Line2D:
    return Line2D([], [], color=colour, label=label, **{"linewidth": 1.3, **look})


def _background_handles(gate: float | None) -> list[Line2D | Patch]:
    inside = f"d² inside {SHOWN_WITHOUT_GATE:g} (no gate: every pair is compatible)"
    return [
        _mark("+", "predicted landmark, 3σ ellipse", DULL),
        _mark("$7$", "landmark number", LANDMARK, markersize=4.0),
        _stroke(inside if gate is None else "individually compatible pair", FAINT, linewidth=0.8),
    ]


def _handles(m: Matching) -> list[Line2D | Patch]:
    """What is drawn of decisions."""
    handles: list[Line2D | Patch] = [
        *(_mark(s, f"observation: {what}") for s, what in (("o", "paired"), ("*", "NEW"), ("x", "discarded"))),
        *_background_handles(m.gate),
        _stroke("pairing"),
    ]
    if m.right is not None:
        handles += [
            _stroke("wrong pairing", BAD, linestyle=DASHES),
            _mark("o", "wrong (FP or FN)", BAD),
            _stroke("to the right landmark", BAD, linewidth=0.9, linestyle=":"),
        ]
    return handles


def _problem(ax: Axes, p: Plane) -> None:
    """The problem, the robot in its middle, and the numbers of landmarks."""
    background(ax, p)
    mark_robot(ax, np.zeros(3), "black", "robot")
    fit(ax, p.shown, 0.1)
    name_landmarks(ax, p)


def paint_compatibility(fig: Figure, m: Matching) -> None:
    """All compatible pairs, and the right ones that are not compatible."""
    p, ax = plane_of(m), picture_axes(fig)
    _problem(ax, p)
    ax.plot(*p.xy.T, "o", color=GOOD, markersize=3.5, zorder=5)
    write_numbers(ax, p.xy, np.arange(len(p.xy)), "#202020", 7.0, first=p.first)
    right = [] if m.right is None else [(i, p.column[n]) for i, n in enumerate(m.right.tolist()) if n in p.column]
    bad = [pair for pair in right if not p.compatible[pair]]
    lines(ax, p, bad, color=BAD, linewidth=1.3, linestyle=DASHES, zorder=4)
    robot_axes(ax)
    ax.set_title(f"{m.title}: compatibility ({int(p.compatible.sum())} pairs), robot frame", loc="left")
    handles = [_mark("o", "observation, 3σ ellipse"), *_background_handles(m.gate)]
    handles += [_stroke("true pair that is not compatible", BAD, linestyle=DASHES)] if bad else []
    fig.legend(handles=handles, loc="lower left", ncols=3)


def paint_matching(fig: Figure, m: Matching) -> None:
    """Decisions of each method on the same expectation: shapes show the decision, colours whether it is right."""
    p, names = plane_of(m), list(m.decisions)
    panels, place = make_panels(fig, names)
    for at, (ax, name) in enumerate(zip(panels, names, strict=True)):
        _problem(ax, p)
        made, truth, update = m.decisions[name], m.truth.get(name), " (updates)" if name == m.chosen else ""
        if update:
            for spine in ax.spines.values():
                spine.set(linewidth=1.8, edgecolor="black")
        if not isinstance(made, str):
            draw_decisions(ax, p, made, truth, all_numbers=at == 0)
        ax.set_title(f"{called(name, names)}{update}: {made if isinstance(made, str) else _counted(made, truth)}")
        robot_axes(ax, left=at % 3 == 0, bottom=at >= len(names) - 3)
    legend(fig, place, _handles(m))
    fig.suptitle(f"{m.title}: matching, robot frame", x=0.01, ha="left")


def _tally(truth: TruthRow | None) -> str:
    return "" if truth is None else "  ".join(f"{name.upper()} {n}" for name, n in truth.counts.items())


def _counted(decisions: IntArray, truth: TruthRow | None) -> str:
    if truth is not None:
        return _tally(truth)
    paired, new = int((decisions >= 0).sum()), int((decisions == NEW).sum())
    return f"{paired} paired, {new} new, {len(decisions) - paired - new} discarded"


AROUND = 0.5  # m, smallest half side of the section: the corridor's points are 0.25 m apart
SIZE = 7.0  # pt, of the numbers
DISTANCE: dict[str, Any] = {"fontsize": 5.5, "color": "#303030", "path_effects": HALO, "ha": "center", "va": "center"}
"""Text style of the d² of a pair."""


def enlarged_figure(m: Matching, panels: Sequence[str], *, compatibility: bool = False) -> Figure:
    """Decisions of methods in a frame side by side, enlarged at a wrong decision of the first (or where it is crowded).

    `compatibility`: before them a panel of all compatible pairs, each in view with its squared Mahalanobis distance d².
    """
    with drawing():
        p, first = plane_of(m), m.decisions[panels[0]]
        scene = None if isinstance(first, str) else scene_of_wrong(p, first, m.truth.get(panels[0]))
        if scene is None:
            scene = p.xy[[int(p.near.sum(axis=1).argmax()) if p.near.size else 0]]
        names, by = (["", *panels], "matching by ") if compatibility else (list(panels), "")
        wide = 0.925 / len(names)
        high = (wide - 0.03) * page_width() + 1.5  # in
        fig = Figure(figsize=(page_width(), high))
        fig.set_layout_engine("none")
        for k, name in enumerate(names):
            ax = fig.add_axes((0.075 + k * wide, 0.9 / high, wide - 0.03, (wide - 0.03) * page_width() / high))
            middle, half = enlarge(ax, p, scene)
            for axis in (ax.xaxis, ax.yaxis):
                axis.set_major_locator(MaxNLocator(5, steps=[1, 2, 5, 10]))
            ax.tick_params(labelleft=k == 0)
            robot_axes(ax, left=k == 0)
            if not name:
                _distances(ax, m, p, middle, half, wrong_of(m.truth.get(panels[0])))
                continue
            made, truth = m.decisions[name], m.truth.get(name)
            if not isinstance(made, str):
                draw_decisions(ax, p, made, truth, all_numbers=True, size=SIZE)
            ax.set_title(f"{by}{called(name)}: {made if isinstance(made, str) else _tally(truth)}", loc="left")
        fig.legend(handles=_handles(m), loc="lower center", ncols=4)
        fig.suptitle(m.title, x=0.01, ha="left")
        return fig


def _distances(ax: Axes, m: Matching, p: Plane, middle: Array, half: float, wrong: IntArray) -> None:
    """All observations, and the d² of the compatible pairs in view."""
    ax.plot(*p.xy.T, "o", color=GOOD, markersize=3.5, zorder=5)
    ax.plot(*p.xy[wrong].T, "o", color=BAD, markersize=3.5, zorder=5.1)
    write_numbers(ax, p.xy, np.arange(len(p.xy)), "#202020", SIZE, first=p.first)
    d2 = m.expectation.individual_distances()
    for i, j in np.argwhere(p.near):
        at = 0.5 * (p.xy[i] + p.landmarks[j])
        if np.all(np.abs(at - middle) < 0.95 * half):
            ax.annotate(f"{d2[i, j]:.2g}", at, zorder=9, **DISTANCE)
    ax.set_title("compatibility: pairs inside the gate, with their d²", loc="left")

"""Figures of a frame's association problem and its solutions, seen from the robot (x forward, y left).

Compatibility and matching with a panel for each method, as in a walk; and an enlarged frame, as in the report.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from data.inputs import IntArray
from data.result import NEW
from data.se2 import Array, BoolArray
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
    plane_of,
    robot_axes,
    write_numbers,
)
from wings.labs.stepping.problem import Matching, TruthRow

SHARE = 0.42  # side of an inset over that of its panel
LEAST = 0.2  # m, smallest half side of an inset


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


def enlarge(ax: Axes, p: Plane, scene: Array, least: float, size: float) -> tuple[Array, float]:
    """The problem around some points (k, 2), its landmarks numbered; middle (2,) and half side [m] of what is shown."""
    low, high = scene.min(axis=0), scene.max(axis=0)
    middle, half = 0.5 * (low + high), max(0.8 * float((high - low).max()), least)
    background(ax, p, size)
    ax.set(xlim=middle[0] + [-half, half], ylim=middle[1] + [-half, half])
    ax.set_aspect("equal")
    seen = np.all(np.abs(p.landmarks - middle) <= half, axis=1)
    write_numbers(ax, p.landmarks[seen], p.number[seen], LANDMARK, size, (-3.0, -3.0), first=p.first)
    return middle, half


def inset_on_wrong(ax: Axes, p: Plane, decisions: IntArray, truth: TruthRow | None) -> Axes | None:
    """Enlarge one wrong decision in the emptiest corner of the panel; None if nothing is wrong."""
    scene = scene_of_wrong(p, decisions, truth)
    if scene is None:
        return None
    inset = ax.inset_axes(_corner(ax, p), zorder=20)
    enlarge(inset, p, scene, LEAST, 6.0)
    draw_decisions(inset, p, decisions, truth, all_numbers=True, size=6.0)
    inset.tick_params(labelleft=False, labelbottom=False, length=0.0)
    ax.indicate_inset_zoom(inset, edgecolor="#303030")
    for spine in inset.spines.values():
        spine.set(edgecolor=BAD, linewidth=0.9)
    return inset


def _corner(ax: Axes, p: Plane) -> tuple[float, float, float, float]:
    """Place of an inset in a panel's units: the corner with the fewest observations and named landmarks."""
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


def evidence(name: str, m: Matching) -> list[tuple[int, int]]:
    """Pairs (observation, candidate) that a method starts from.

    `truth`: the right ones; `known`: decisions by label; `nn`: the nearest of each observation; `ml`: the likeliest;
    `singles`: pairs without rivals; other methods: all compatible ones.
    """
    e, p = m.expectation, plane_of(m)
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
    "truth": "right pairs",
    "nn": "nearest of each",
    "ml": "likeliest of each",
    "singles": "pairs without rivals",
    "known": "pairs by label",
}


def _paint(
    fig: Figure,
    m: Matching,
    what: str,
    panel: Callable[[Axes, Plane, str, bool], str],
    handles: Sequence[Line2D | Patch],
) -> None:
    """A panel for each method; `panel` draws a method (the first one with all numbers) and returns its title."""
    p, names = plane_of(m), list(m.decisions)
    panels, place = make_panels(fig, names)
    for at, (ax, name) in enumerate(zip(panels, names, strict=True)):
        background(ax, p)
        mark_robot(ax, np.zeros(3), "black", "robot")
        fit(ax, p.shown, 0.1)
        name_landmarks(ax, p)
        ax.set_title(f"{called(name, names)}{panel(ax, p, name, at == 0)}")
        robot_axes(ax, left=at % 3 == 0, bottom=at >= len(names) - 3)
    legend(fig, place, handles)
    fig.suptitle(f"{m.title}: {what}, robot frame", x=0.01, ha="left")


def paint_compatibility(fig: Figure, m: Matching) -> None:
    """Compatible pairs in grey, and in colour those that each method starts from."""
    rest = "all compatible pairs" if m.gate is not None else f"all pairs; drawn: inside {SHOWN_WITHOUT_GATE:g}"

    def panel(ax: Axes, p: Plane, name: str, first: bool) -> str:
        pairs = evidence(name, m)
        good = [q for q in pairs if p.compatible[q]]
        bad = [q for q in pairs if not p.compatible[q]]
        lines(ax, p, good, color=GOOD, linewidth=1.3, zorder=4)
        lines(ax, p, bad, color=BAD, linewidth=1.3, linestyle=DASHES, zorder=4)
        without = ~np.isin(np.arange(len(p.xy)), [i for i, _ in pairs])
        ax.plot(*p.xy.T, "o", color=GOOD, markersize=3.5, markeredgewidth=0.8, zorder=5)
        ax.plot(*p.xy[without].T, "o", color="white", markersize=2.2, markeredgewidth=0.0, zorder=5.1)
        if first:
            write_numbers(ax, p.xy, np.arange(len(p.xy)), "#202020", 5.5, first=p.first)
        return f": {EVIDENCE.get(name, rest)} ({len(pairs)}{f', {len(bad)} incompatible' if bad else ''})"

    handles: list[Line2D | Patch] = [
        _mark("o", "observation, 3σ ellipse", markersize=4.0),
        _mark("o", "observation without such a pair", markerfacecolor="white", markersize=4.0),
        *_background_handles(m.gate),
        _stroke("pair that the method starts from"),
    ]
    if "truth" in m.decisions:
        handles.append(_stroke("true pair that is not compatible", BAD, linestyle=DASHES))
    _paint(fig, m, "compatibility", panel, handles)


def paint_matching(fig: Figure, m: Matching) -> None:
    """Decisions of each method on the same expectation: shapes show the decision, colours whether it is right."""

    def panel(ax: Axes, p: Plane, name: str, first: bool) -> str:
        made, truth, update = m.decisions[name], m.truth.get(name), ""
        if name == m.chosen:
            update = " (updates)"
            for spine in ax.spines.values():
                spine.set(linewidth=1.8, edgecolor="black")
        if isinstance(made, str):
            return f"{update}: {made}"
        draw_decisions(ax, p, made, truth, all_numbers=first)
        inset_on_wrong(ax, p, made, truth)
        return f"{update}: {_counted(made, truth)}"

    handles: list[Line2D | Patch] = [
        *(_mark(s, f"observation: {what}") for s, what in (("o", "paired"), ("*", "NEW"), ("x", "discarded"))),
        *_background_handles(m.gate),
        _stroke("pairing"),
    ]
    if m.right is not None:
        handles += [
            _stroke("wrong pairing", BAD, linestyle=DASHES),
            _mark("o", "wrong (FP or FN), numbered", BAD),
            _stroke("to the right landmark", BAD, linewidth=0.9, linestyle=":"),
        ]
    _paint(fig, m, "matching", panel, handles)


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
            middle, half = enlarge(ax, p, scene, AROUND, SIZE)
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
        seen = np.all(np.abs(p.xy - middle) <= half, axis=1)
        fig.legend(handles=_handles(m, panels, seen), loc="lower center", ncols=4)
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


def _handles(m: Matching, methods: Sequence[str], seen: BoolArray) -> list[Line2D | Patch]:
    """What is drawn of the decisions of some methods, of the observations (k,) that are in the picture."""
    made = {n: d[seen] for n in methods if not isinstance(d := m.decisions[n], str)}
    wrong = any(np.any(seen[wrong_of(m.truth.get(n))]) for n in made)
    handles: list[Line2D | Patch] = [
        _mark("o", "observation (number in black)"),
        _mark("+", "predicted landmark, 3σ", DULL),
        _mark("$7$", "landmark number", LANDMARK),
        _stroke("compatible pair", FAINT, linewidth=0.9),
        _stroke("pairing"),
    ]
    handles += [_mark("*", "NEW")] if any(np.any(d == NEW) for d in made.values()) else []
    handles += [_mark("x", "discarded")] if any(np.any(d < NEW) for d in made.values()) else []
    if wrong:
        handles.append(_stroke("wrong", BAD, marker="o", linestyle=DASHES))
        handles.append(_stroke("to the right landmark", BAD, linewidth=0.9, linestyle=":"))
    return handles

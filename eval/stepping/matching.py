"""The figures of a frame's problem and its solutions: compatibility and matching, a panel for each method.

Seen from the robot: x forward, y left.
"""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from data.inputs import IntArray
from data.result import NEW
from eval.walk.deciding import draw_decisions, inset_on_wrong
from eval.walk.marks import (
    BAD,
    DASHES,
    DULL,
    FAINT,
    GOOD,
    LANDMARK,
    SHOWN_WITHOUT_GATE,
    called,
    robot_axes,
    write_numbers,
)
from eval.walk.plane import Matching, background, legend, lines, make_panels, name_landmarks, plane_of
from eval.walk.text import TruthRow


def _background_handles(gate: float | None) -> list[Line2D | Patch]:
    inside = f"d² inside {SHOWN_WITHOUT_GATE:g} (no gate: every pair is compatible)"
    return [
        Line2D([], [], marker="+", color=DULL, linestyle="none", label="predicted landmark, 3σ ellipse"),
        Line2D([], [], marker="$7$", color=LANDMARK, linestyle="none", markersize=4.0, label="number of a landmark"),
        Line2D([], [], color=FAINT, linewidth=0.8, label=inside if gate is None else "individually compatible pair"),
    ]


def evidence(name: str, m: Matching) -> list[tuple[int, int]]:
    """Pairs (observation, candidate) on which a method builds.

    The right ones for `truth`, the decisions by label for `known`, the nearest of each observation for `nn`, the
    likeliest for `ml`, pairs without rivals for `singles`, and for other methods all that are compatible.
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
    "truth": "right pairs", "nn": "nearest of each", "ml": "likeliest of each", "singles": "pairs without rivals",
    "known": "pairs by label",
}  # fmt: skip


def paint_compatibility(fig: Figure, m: Matching) -> None:
    """What can be paired: compatible pairs in grey, and in colour those on which each method builds."""
    p, names = plane_of(m), list(m.decisions)
    panels, place = make_panels(fig, names)
    rest = "all compatible pairs" if m.gate is not None else f"all pairs; drawn: inside {SHOWN_WITHOUT_GATE:g}"
    for at, (ax, name) in enumerate(zip(panels, names, strict=True)):
        background(ax, p)
        name_landmarks(ax, p)
        pairs = evidence(name, m)
        good = [q for q in pairs if p.compatible[q]]
        bad = [q for q in pairs if not p.compatible[q]]
        lines(ax, p, good, color=GOOD, linewidth=1.3, zorder=4)
        lines(ax, p, bad, color=BAD, linewidth=1.3, linestyle=DASHES, zorder=4)
        without = ~np.isin(np.arange(len(p.xy)), [i for i, _ in pairs])
        ax.plot(*p.xy.T, "o", color=GOOD, markersize=3.5, markeredgewidth=0.8, zorder=5)
        ax.plot(*p.xy[without].T, "o", color="white", markersize=2.2, markeredgewidth=0.0, zorder=5.1)
        if at == 0:
            write_numbers(ax, p.xy, [str(i) for i in range(len(p.xy))], "#202020", 5.5)
        out = f", {len(bad)} incompatible" if bad else ""
        ax.set_title(f"{called(name, names)}: {EVIDENCE.get(name, rest)} ({len(pairs)}{out})")
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
    legend(fig, place, handles)
    fig.suptitle(f"{m.title}: compatibility, robot frame", x=0.01, ha="left")


def paint_matching(fig: Figure, m: Matching) -> None:
    """What each method decides on the same expectation: shapes say what, colours whether it is right."""
    p, names = plane_of(m), list(m.decisions)
    panels, place = make_panels(fig, names)
    for at, (ax, name) in enumerate(zip(panels, names, strict=True)):
        background(ax, p)
        name_landmarks(ax, p)
        made = m.decisions[name]
        update = " (updates)" if name == m.chosen else ""
        if isinstance(made, str):
            ax.set_title(f"{called(name, names)}{update}: {made}")
        else:
            ax.set_title(f"{called(name, names)}{update}: {_counted(made, m.truth.get(name))}")
            draw_decisions(ax, p, made, m.truth.get(name), all_numbers=at == 0)
            inset_on_wrong(ax, p, made, m.truth.get(name))
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
    legend(fig, place, handles)
    fig.suptitle(f"{m.title}: matching, robot frame", x=0.01, ha="left")


def _counted(decisions: IntArray, truth: TruthRow | None) -> str:
    if truth is not None:
        return "  ".join(f"{name.upper()} {n}" for name, n in truth.counts().items())
    paired, new = int((decisions >= 0).sum()), int((decisions == NEW).sum())
    return f"{paired} paired, {new} new, {len(decisions) - paired - new} left out"

"""Figures of association: outcomes of the decisions, a bar per run; and one revision, as decided at first and last."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.transforms import ScaledTranslation

from data.inputs import IntArray
from data.log import Log
from data.result import Run
from data.se2 import Array
from eval.figures.kinds import (
    SECTION,
    Facts,
    Variants,
    figure,
)
from eval.figures.style import NARROW, TRUTH_COLOUR, drawing, page_width, points, settle, style_of
from eval.referee.confusion import Confusion
from eval.referee.score import Trial, confusion_of

NUMBER = 22.0  # pt that a number of four digits takes, beside bars in a narrow figure
OUTCOME_COLOURS = {"tp": "#0072B2", "tn": "#A9CBE3", "fp": "#D55E00", "fn": "#F0E442"}
"""Right is blue, wrong is warm; within each pair one is dark and one is light (Okabe and Ito's, and a tint)."""


@dataclass(frozen=True)
class Part:
    """A stretch of a bar: a kind of outcome, its share of the colour's outcome, and its hatch."""

    key: str
    outcome: str
    label: str
    hatch: str = ""

    @property
    def look(self) -> dict[str, Any]:
        """As matplotlib draws it."""
        edge: dict[str, Any] = {"edgecolor": "#303030", "linewidth": 0.4, "hatch": self.hatch, "hatch_linewidth": 0.5}
        return {"facecolor": OUTCOME_COLOURS[self.outcome], **edge}


PARTS = (
    Part("tp", "tp", "TP: right landmark"),
    Part("tn", "tn", "TN: rightly none"),
    Part("wrong", "fp", "FP: another landmark (wrong)"),
    Part("spurious", "fp", "FP: though none is right (spurious)", "/////"),
    Part("duplicate", "fn", "FN: initialized a second one (duplicate)"),
    Part("missed", "fn", "FN: discarded (missed)", "....."),
)


@dataclass(frozen=True)
class Bar:
    """One association method, who decided so, and what came of it."""

    label: str
    counts: Confusion

    def length(self, key: str) -> int:
        """Observations in a part of the bar; a deferred decision counts as missed."""
        return int(getattr(self.counts, key)) + (self.counts.deferred if key == "missed" else 0)


def bars(trial: Trial, variants: Sequence[Trial] = ()) -> list[Bar]:
    """A bar per run that decided, variants included, and per phase if revised; runs with equal decisions share one."""
    found: list[Bar] = []
    for t in (trial, *variants):
        extra = t.log.name.removeprefix(trial.log.name).strip(":+ ")
        grouped: dict[tuple[str, bytes, bytes], list[Run]] = {}
        for run in t.runs:
            if run.association != "none" and run.failure is None:
                key = (run.association, run.decisions.tobytes(), run.final_decisions.tobytes())
                grouped.setdefault(key, []).append(run)
        for runs in grouped.values():
            first, names = runs[0], ", ".join(style_of(r.estimator).label for r in runs)
            label = f"{first.association} ({names})" + (f", {extra}" if extra and t is not trial else "")
            implausible = [style_of(r.estimator).label for r in runs if r.implausible is not None]
            label += f", implausible: {', '.join(implausible)}" if implausible else ""
            online, final = (confusion_of(first, t.log, phase) for phase in ("online", "final"))
            if online is None or final is None:
                continue
            if all(getattr(online, p.key) == getattr(final, p.key) for p in PARTS):
                found.append(Bar(label, online))
            else:
                found += [Bar(f"{label}, online", online), Bar(f"{label}, final", final)]
    return found


@drawing()
def confusion_figure(title: str, shown: Sequence[Bar]) -> Figure:
    """Stacked bars of observation counts, FP and FN in numbers beside them; same colours in every figure."""
    fig = Figure(figsize=(page_width(), 1.35 + 0.2 * len(shown)))
    ax = fig.add_subplot()
    rows = np.arange(len(shown))
    left = np.zeros(len(shown))
    present = [p for p in PARTS if any(b.length(p.key) for b in shown)]
    for part in present:
        width = np.array([b.length(part.key) for b in shown], float)
        ax.barh(rows, width, left=left, height=0.74, **part.look)
        left += width
    ax.set_yticks(rows, [b.label for b in shown])
    ax.set_ylim(len(shown) - 0.5, -0.5)
    ax.set_xlim(0.0, max(float(left.max(initial=0.0)), 1.0))
    ax.grid(axis="y", visible=False)
    ax.tick_params(axis="y", length=0)
    ax.set_xlabel("observations [–]")
    _numbers(ax, shown)
    ax.set_title(title, loc="left")
    fig.legend(handles=[Patch(label=p.label, **p.look) for p in present], loc="outside lower center", ncols=3)
    return fig


def _numbers(ax: Axes, shown: Sequence[Bar]) -> None:
    """FP and FN of each bar, in columns to the right of it."""
    for column, (place, key) in enumerate(((1.065, "fp"), (1.125, "fn")), start=1):
        above, variants = ax.transAxes, ax.get_yaxis_transform()
        if page_width() < NARROW:  # there a share of the axes has no room for four digits
            place, right = 1.0, ScaledTranslation(points(NUMBER) * column / 72.0, 0.0, ax.figure.dpi_scale_trans)
            above, variants = above + right, variants + right
        ax.text(place, 1.02, key.upper(), transform=above, ha="right", va="bottom", fontsize=points(7), weight="bold")
        for row, bar in enumerate(shown):
            text = str(getattr(bar.counts, key))
            ax.text(place, row, text, transform=variants, ha="right", va="center", fontsize=points(7))


BEFORE, AFTER, PATH = "#D55E00", "#0072B2", "#808080"
"""Decisions that were given up, those that stand, and the robot's path."""
MARGIN = 0.15  # of the extent, around what is shown
LEAST = 2.5  # m, half the width of what is shown


@dataclass(frozen=True)
class Example:
    """What one frame revised for one reason: rows (k,) of the log, with the landmarks (k,) before and after."""

    frame: int
    why: str
    rows: IntArray
    old: IntArray
    new: IntArray


@drawing()
def revision_figure(log: Log, run: Run, one: Example) -> Figure:
    """Two maps with one scale: as decided at first, along the path known then, and in the end."""
    width = page_width()
    assert run.online is not None  # who revises decides frame by frame
    last = run.online.pose if run.final is None else run.final.pose
    # landmarks that stay, seen by decisions that were never revised
    number = np.where(run.created >= 0, run.created, run.decisions)
    others = np.setdiff1d(np.flatnonzero(np.isin(number, one.new[one.new >= 0])), one.rows)
    panels = [
        (f"as decided before frame {one.frame}", run.online.pose, one.old, BEFORE),
        ("in the end", last, one.new, AFTER),
    ]
    fig = Figure(figsize=(width, 0.6 * width), layout="constrained")
    axes = fig.subplots(1, 2, sharex=True, sharey=True)
    boxes = []
    for ax, (title, path, decided, colour) in zip(axes, panels, strict=True):
        boxes.append(_panel(ax, log, run, one, path, decided, colour, others))
        ax.set_title(title)
        ax.set_xlabel("x [m]")
        ax.set_aspect("equal")
    axes[0].set_ylabel("y [m]")
    every = np.concatenate(boxes)
    low, high = every.min(axis=0), every.max(axis=0)
    half = max((0.5 + MARGIN) * float((high - low).max()), LEAST)
    for limit, middle in zip((axes[0].set_xlim, axes[0].set_ylim), 0.5 * (low + high), strict=True):
        limit(middle - half, middle + half)
    handles, labels = axes[0].get_legend_handles_labels()
    more = [(h, t) for h, t in zip(*axes[1].get_legend_handles_labels(), strict=True) if t not in labels]
    fig.legend([*handles, *(h for h, _ in more)], [*labels, *(t for _, t in more)], loc="outside lower center", ncols=3)
    settle(fig)
    return fig


def _panel(
    ax: Axes, log: Log, run: Run, one: Example, path: Array, decided: IntArray, colour: str, others: IntArray
) -> Array:
    """Draw one of both; returns points (p, 2) that should be in view."""
    o, sensor = log.recorded.observations, log.recorded.sensor

    def places(rows: IntArray) -> Array:
        each = [sensor.inverse(path[o.frame[i]], o.z[i : i + 1])[0][0] for i in rows.tolist()]
        return np.array(each, float).reshape(-1, 2)

    ax.plot(path[:, 0], path[:, 1], color=PATH, lw=0.6, zorder=1, label="path as known then")
    seen, stay = places(one.rows), places(others)
    shown = [seen, stay]
    if log.recorded.map is not None and run.task == "localization":
        known = log.recorded.map
        ax.plot(*known.xy.T, "+", color=TRUTH_COLOUR, ms=5, zorder=2, label="landmark of the map")
        held = dict(zip(known.id.tolist(), known.xy, strict=True))
    else:
        if run.map is not None:
            ax.plot(*run.map.xy.T, "o", color=PATH, ms=2, zorder=2, label="landmark of the final map")
        if len(stay):
            ax.plot(*stay.T, "o", mfc="none", mec=AFTER, ms=4, mew=0.7, zorder=3, label="of the landmark that stays")
        number = np.where(run.created >= 0, run.created, run.decisions)
        centres = {n: stay[number[others] == n].mean(axis=0) for n in np.unique(number[others]).tolist()}
        held = centres if decided is one.new else {}
    if np.all(one.new < 0):
        from_there = np.unique(np.append(o.frame[one.rows], one.frame))
        ax.plot(*path[from_there, :2].T, "^", color=PATH, ms=4, zorder=2)
        for i, xy in zip(one.rows.tolist(), seen, strict=True):
            ax.plot(*np.stack([path[o.frame[i], :2], xy]).T, color=PATH, lw=0.4, zorder=1)
        for k in from_there.tolist():
            x, y = path[k, :2].tolist()
            ax.annotate(
                f"frame {k}", (x, y), xytext=(4, -8), textcoords="offset points", fontsize=points(6), color=PATH
            )
        shown.append(path[from_there, :2])
    given_up = decided < 0
    if given_up.any():
        ax.plot(*seen[given_up].T, "x", color=PATH, ms=4, zorder=4, label="observation not used")
    if (~given_up).any():
        label = "observation, decision given up" if decided is one.old else "observation, decision made instead"
        ax.plot(*seen[~given_up].T, ".", color=colour, ms=4, zorder=4, label=label)
    for n in np.unique(decided[~given_up]).tolist():
        own = seen[decided == n]
        to = held.get(n, own.mean(axis=0))
        for xy in own:
            ax.plot([xy[0], to[0]], [xy[1], to[1]], color=colour, lw=0.5, zorder=3)
        ax.annotate(str(n), to, xytext=(3, 3), textcoords="offset points", color=colour, fontsize=points(6.5))
        shown.append(np.atleast_2d(to))
    return np.concatenate([s for s in shown if len(s)])


def has_outcomes(trial: Trial, variants: Variants = ()) -> bool:
    """Whether decisions were made (not only labels read) that can be scored."""
    return any(
        confusion_of(r, t.log, "online") is not None
        for t in (trial, *variants)
        for r in t.runs
        if r.association != "known" and r.failure is None
    )


@figure("association", has_outcomes, SECTION, quick=True)
def _association(trial: Trial, variants: Variants) -> tuple[Figure, Facts]:
    return confusion_figure(f"{trial.log.name}, {trial.task}: decisions", bars(trial, variants)), {}

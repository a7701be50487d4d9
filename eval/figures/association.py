"""The figure of association: outcomes of the decisions, a bar per run."""

from collections.abc import Sequence
from dataclasses import dataclass
from textwrap import fill
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.transforms import ScaledTranslation

from data.result import Run
from eval.figures import kinds
from eval.figures.style import NARROW, drawing, finish, page_width, points, style_of
from eval.referee.confusion import Confusion
from eval.referee.score import Trial, confusion_of

LETTERS = 24  # in a line of a bar's name in a narrow figure
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
        edge: dict[str, Any] = {"edgecolor": "#303030", "linewidth": 0.4, "hatch": self.hatch}
        return {"facecolor": OUTCOME_COLOURS[self.outcome], **edge}


PARTS = (
    Part("tp", "tp", "TP: right landmark"), Part("tn", "tn", "TN: rightly none"),
    Part("wrong", "fp", "FP: another landmark (wrong)"),
    Part("spurious", "fp", "FP: though none is right (spurious)", "/////"),
    Part("duplicate", "fn", "FN: initialized a second one (duplicate)"),
    Part("missed", "fn", "FN: discarded (missed)", "....."),
)  # fmt: skip


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
    names = [fill(b.label, LETTERS) if page_width() < NARROW else b.label for b in shown]
    height = 0.2 + 0.12 * max((n.count("\n") for n in names), default=0)
    fig = Figure(figsize=(page_width(), 1.35 + height * len(shown)))
    ax = fig.add_subplot()
    rows, left = np.arange(len(shown)), np.zeros(len(shown))
    present = [p for p in PARTS if any(b.length(p.key) for b in shown)]
    for part in present:
        width = np.array([b.length(part.key) for b in shown], float)
        ax.barh(rows, width, left=left, height=0.74, **part.look)
        left += width
    ax.set_yticks(rows, names)
    ax.set_ylim(len(shown) - 0.5, -0.5)
    ax.set_xlim(0.0, max(float(left.max(initial=0.0)), 1.0))
    ax.grid(axis="y", visible=False)
    ax.tick_params(axis="y", length=0)
    ax.set_xlabel("observations [–]")
    _numbers(ax, shown)
    finish(fig, title, [Patch(label=p.label, **p.look) for p in present], columns=3)
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


def has_outcomes(trial: Trial, variants: kinds.Variants = ()) -> bool:
    """Whether decisions were made (not only labels read) that can be scored."""
    each = ((r, t) for t in (trial, *variants) for r in t.runs if r.association != "known" and r.failure is None)
    return any(confusion_of(r, t.log, "online") is not None for r, t in each)


@kinds.figure("association", has_outcomes, kinds.SECTION, quick=True)
def _association(trial: Trial, variants: kinds.Variants) -> tuple[Figure, kinds.Facts]:
    return confusion_figure(f"{trial.log.name}, {trial.task}: decisions", bars(trial, variants)), {}

"""The figure of knowledge taken away: error and wrong decisions, from labels and map given to nothing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import LogLocator, NullLocator, StrMethodFormatter

from eval.figures.paper.look import page_width, points
from eval.figures.style import drawing, style_of

SHADE = "#F2F2F2"


@dataclass(frozen=True)
class Known:
    """A run on a recording of which some knowledge is given.

    Attributes:
        label: what it is called; given: what it knows; estimator: whose colour it has.
        tutorial: whether it is a tutorial's treatment.
        rmse: position RMSE [m], None where it has none; original: that of the tutorial's own program, if known.
        wrong: share of wrong decisions, None where none was made.
    """

    label: str
    given: str
    estimator: str
    tutorial: bool
    rmse: float | None
    original: float | None
    wrong: float | None


def knowledge_figure(title: str, rows: Sequence[Known]) -> Figure:
    """A row per run, in groups of what is given: position RMSE, logarithmic, and the share of wrong decisions.

    Rows stand in the order given, those of a group together.
    """
    with drawing():
        return _knowledge_figure(title, rows)


def _knowledge_figure(title: str, rows: Sequence[Known]) -> Figure:
    groups = list(dict.fromkeys(r.given for r in rows))
    place = np.array([i + 1.1 * (groups.index(r.given) + 1) for i, r in enumerate(rows)])
    fig = Figure(figsize=(page_width(), 1.1 + 0.19 * (float(place[-1]) + 1.0)))
    error, wrong = fig.subplots(1, 2, sharey=True, width_ratios=(2.0, 1.0))
    for row, y in zip(rows, place.tolist(), strict=True):
        style = style_of(row.estimator)
        if row.rmse is not None:
            error.plot(row.rmse, y, "s" if row.tutorial else style.marker, color=style.colour, linestyle="none")
        if row.original is not None:
            error.plot(row.original, y, "s", markersize=points(7.0), markerfacecolor="none", color="#000000")
        if row.wrong is not None:
            wrong.barh(y, 100.0 * row.wrong, height=0.7, color=style.colour, hatch="////" if row.tutorial else "",
                       edgecolor="#FFFFFF", linewidth=0.0)  # fmt: skip
    error.set_xscale("log")
    error.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    error.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    error.xaxis.set_minor_locator(NullLocator())
    error.set_xlabel("position RMSE [m]")
    wrong.set_xlabel("wrong decisions, FP and FN [%]")
    wrong.set_xlim(0.0, max(100.0 * max((r.wrong or 0.0 for r in rows), default=0.0) * 1.05, 1.0))
    error.set_yticks(place, [r.label for r in rows])
    error.set_ylim(float(place[-1]) + 0.8, -0.4)
    for ax in (error, wrong):
        ax.grid(axis="y", visible=False)
        ax.tick_params(axis="y", length=0)
        _shade(ax, rows, place)
    for given in groups:
        y = float(place[[r.given == given for r in rows]].min()) - 0.95
        error.text(0.01, y, f"given: {given}", transform=error.get_yaxis_transform(), va="center", weight="bold",
                   fontsize=points(7.0))  # fmt: skip
    error.set_title(title, loc="left")
    fig.legend(handles=_handles(rows), loc="outside lower center", ncols=4)
    return fig


def _shade(ax: Axes, rows: Sequence[Known], place: np.ndarray) -> None:
    for i, given in enumerate(dict.fromkeys(r.given for r in rows)):
        inside = place[[r.given == given for r in rows]]
        if i % 2:
            ax.axhspan(float(inside.min()) - 1.5, float(inside.max()) + 0.6, color=SHADE, zorder=0, linewidth=0.0)


def _handles(rows: Sequence[Known]) -> list[Line2D]:
    found = []
    for name in dict.fromkeys(r.estimator for r in rows if not r.tutorial):
        style = style_of(name)
        found.append(Line2D([], [], color=style.colour, marker=style.marker, linestyle="none", label=style.label))
    if any(r.tutorial for r in rows):
        style = style_of("ekf")
        found.append(
            Line2D([], [], color=style.colour, marker="s", linestyle="none", label="a tutorial's treatment, run here")
        )
    if any(r.original is not None for r in rows):
        found.append(
            Line2D([], [], color="#000000", marker="s", markersize=points(7.0), markerfacecolor="none",
                   linestyle="none", label="the tutorial's own program")
        )  # fmt: skip
    return found

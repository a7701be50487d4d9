"""Figure of the outlier study: error and consistency of each estimator against the rate of wrong associations."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from eval.figures.error import ticks
from eval.figures.paper.look import page_width
from eval.figures.style import LONG_HANDLE, drawing, style_of

LOG_RATIO = 12.0
"""A column's axes become logarithmic where its values span more than this factor."""
SPREAD = 0.6
"""Width over which the estimators of one rate are spread; 1 is the distance between rates."""
POSE_DOF = 3


class Panel(NamedTuple):
    """One column of the figure: which columns of the table, and the axis' label."""

    value: str
    lower: str
    upper: str
    label: str


PANELS = (
    Panel("rmse_position_m", "rmse_lower", "rmse_upper", "RMSE position [m]"),
    Panel("nees_pose", "nees_lower", "nees_upper", "pose NEES [–]"),
)


def outlier_figure(table: pd.DataFrame, title: str) -> Figure:
    """Position RMSE (left) and pose NEES (right) against the share of wrong associations, one row of panels per task.

    The rates studied stand side by side, not to scale, so that the estimators can be told apart at each of them.

    Args:
        table: columns task, estimator, rate (0 to 1), rmse_position_m, rmse_lower, rmse_upper, nees_pose, nees_lower,
            nees_upper; one row per task, estimator and rate. Bars are the intervals given; NaN values are gaps.
        title: what was studied, e.g. scenario and number of runs.
    """
    with drawing():
        tasks = list(dict.fromkeys(table["task"]))
        names = list(dict.fromkeys(table["estimator"]))
        rates = sorted({float(r) for r in table["rate"]})
        rows = max(len(tasks), 1)
        columns = min(len(names) + 1, 4)
        fig = Figure(figsize=(page_width(), 0.75 + 1.9 * rows + 0.13 * -(-(len(names) + 1) // columns)))
        axes = fig.subplots(rows, len(PANELS), sharex=True, squeeze=False)
        for row, task in zip(axes, tasks, strict=False):
            for ax, panel in zip(row, PANELS, strict=True):
                part = table[table["task"] == task]
                for i, name in enumerate(names):
                    offset = SPREAD * ((i + 0.5) / len(names) - 0.5)
                    _curve(ax, part[part["estimator"] == name], panel, rates, offset)
                if panel.value == "nees_pose":
                    ax.axhline(POSE_DOF, color="#505050", linewidth=0.8, linestyle="--", zorder=1.5)
                _scale(ax, part, panel)
                ax.set_title(task, loc="left")
                ax.set_ylabel(panel.label)
        for ax in axes[-1]:
            ax.set_xlabel("wrong associations [%]")
            ax.set_xticks(range(len(rates)), [f"{100.0 * r:g}" for r in rates])
        fig.suptitle(f"{title}: wrong associations put in", x=0.01, ha="left")
        handles = [
            Line2D([], [], color=s.colour, linestyle=s.line, marker=s.marker, label=s.label)
            for s in (style_of(n) for n in names)
        ]
        expected = f"expected NEES: {POSE_DOF}"
        handles.append(Line2D([], [], color="#505050", linewidth=0.8, linestyle="--", label=expected))
        fig.legend(handles=handles, loc="outside lower center", ncols=columns, handlelength=LONG_HANDLE)
        return fig


def _curve(ax: Axes, curve: pd.DataFrame, panel: Panel, rates: Sequence[float], offset: float) -> None:
    """One estimator, moved aside by `offset` so that bars of equal rate do not hide each other."""
    if curve.empty:
        return
    style, part = style_of(str(curve["estimator"].iloc[0])), curve.sort_values("rate")
    x = np.searchsorted(rates, part["rate"].to_numpy(float)) + offset
    y = part[panel.value].to_numpy(float)
    bars = np.abs(np.stack([y - part[panel.lower].to_numpy(float), part[panel.upper].to_numpy(float) - y]))
    ax.errorbar(
        x, y, np.where(np.isfinite(bars), bars, 0.0), color=style.colour, linestyle=style.line, marker=style.marker,
        markersize=3.5, elinewidth=0.8, capsize=1.2, zorder=2,
    )  # fmt: skip


def _scale(ax: Axes, part: pd.DataFrame, panel: Panel) -> None:
    """Linear from 0, or logarithmic where the values span more than `LOG_RATIO`."""
    values = part[panel.value].to_numpy(float)
    values = values[np.isfinite(values) & (values > 0.0)]
    if len(values) and values.max() > LOG_RATIO * values.min():
        ax.set_yscale("log")
        span = values.max() / values.min()
        subs = (1.0, 2.0, 5.0) if span < 100.0 else (1.0, 3.0) if span < 1e3 else (1.0,)
        ax.yaxis.set_major_locator(LogLocator(10.0, subs=subs))
        ax.yaxis.set_major_formatter(FuncFormatter(lambda y, _: f"{y:g}" if 1e-3 <= y < 1e5 else f"{y:.0e}"))
        ax.yaxis.set_minor_formatter(NullFormatter())
    else:
        ax.set_ylim(0.0, None)
        ax.yaxis.set_major_locator(ticks(5))

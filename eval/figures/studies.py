"""Figures of studies: what runs end with, rates of wrong associations."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd
import scipy
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from data.se2 import Array
from data.terminal import counted
from eval.figures.error import ticks
from eval.figures.style import EXPECTED, LONG_HANDLE, across, drawing, finish, key, page_width, points, style_of

MOST_COLUMNS = 4
LAST = 0.999  # the axis ends at this quantile of the chi-square law; what lies beyond is one bar of its own
EXPECTED_COLOUR = "#000000"
BEYOND_HATCH = "/////"


@drawing()
def run_end_figure(nees: Mapping[str, Array], dof: int, title: str) -> Figure:
    """Histogram of the run-end NEES (N,) of each estimator against the chi-square density with `dof`.

    The last, hatched bar holds every run beyond the axis. Runs without a NEES (NaN) are counted in the panel.
    """
    rows = max(math.ceil(len(nees) / across(MOST_COLUMNS)), 1)
    columns = max(math.ceil(len(nees) / rows), 1)
    fig = Figure(figsize=(page_width(), 0.85 + 1.55 * rows))
    axes = fig.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    end = float(np.ceil(scipy.stats.chi2.ppf(LAST, dof)))
    bins = int(np.clip(round(2.0 * math.sqrt(max((len(v) for v in nees.values()), default=0))), 8, 24))
    for ax, (name, values) in zip(axes.flat, nees.items(), strict=False):
        _histogram(ax, name, values, dof, np.linspace(0.0, end, bins + 1))
    for ax in axes.flat[max(len(nees), 1) :]:
        ax.set_visible(False)
    # a density without bound at 0 (dof 1) must not flatten the bars
    highest = max((p.get_height() for ax in axes.flat for p in ax.patches), default=0.0)
    first = axes.flat[0]
    first.set_ylim(0.0, 1.35 * max(highest, _peak(dof, end / bins)))
    first.yaxis.set_major_locator(ticks(4))
    first.xaxis.set_major_locator(ticks(4))
    for row in axes:
        row[0].set_ylabel("density [–]")
    for column in range(columns):
        lowest = [ax for ax in axes[:, column] if ax.get_visible()][-1]
        lowest.set_xlabel("run-end NEES [–]")
        lowest.tick_params(labelbottom=True)
    beyond = Patch(facecolor="white", edgecolor="#505050", hatch=BEYOND_HATCH, label=f"number of runs beyond {end:g}")
    expected = key(f"χ² density with dof {dof}", color=EXPECTED_COLOUR, linewidth=1.0)
    finish(fig, f"{title}: NEES at the end of each run, dof {dof}", [expected, beyond])
    return fig


def _peak(dof: int, width: float) -> float:
    """Highest mean of the chi-square density over a bin."""
    edges = width * np.arange(0.0, max(dof, 1.0) / width + 2.0)
    return float(np.diff(scipy.stats.chi2.cdf(edges, dof)).max() / width)


def _histogram(ax: Axes, name: str, values: Array, dof: int, edges: Array) -> None:
    style, known = style_of(name), values[np.isfinite(values)]
    width, end = float(edges[1]), float(edges[-1])
    scale = 1.0 / max(len(known) * width, 1e-300)
    counts = np.histogram(known, edges)[0]
    beyond = int(np.count_nonzero(known > end))
    ax.bar(edges[:-1], scale * counts, width, align="edge", color=style.colour, alpha=0.55, linewidth=0.0)
    look = dict[str, Any](color="white", edgecolor=style.colour, hatch=BEYOND_HATCH, linewidth=0.8)
    ax.bar(end + 0.6 * width, scale * beyond, 1.6 * width, align="edge", **look)
    ax.text(end + 1.4 * width, scale * beyond, f"{beyond}", ha="center", va="bottom", fontsize=points(7))
    x = np.linspace(edges[0], end, 400)[1:]
    ax.plot(x, scipy.stats.chi2.pdf(x, dof), color=EXPECTED_COLOUR, linewidth=1.0)
    ax.set_xlim(0.0, end + 2.9 * width)
    text = counted(len(known), "run") + (f"\n{len(values) - len(known)} without" if len(known) < len(values) else "")
    ax.text(0.97, 0.95, text, transform=ax.transAxes, ha="right", va="top", fontsize=points(7))
    ax.set_title(style.label, loc="left")


LOG_RATIO = 12.0  # a column's axes become logarithmic where its values span more than this factor
SPREAD = 0.6  # width over which the estimators of one rate are spread; 1 is the distance between rates
POSE_DOF = 3


PANELS = (
    ("rmse_position_m", "rmse_lower", "rmse_upper", "RMSE position [m]"),
    ("nees_pose", "nees_lower", "nees_upper", "pose NEES [–]"),
)  # value, bounds and label of each column of panels


@drawing()
def outlier_figure(table: pd.DataFrame, title: str) -> Figure:
    """Position RMSE and pose NEES with their intervals against the share of wrong associations, a row per task.

    Args:
        table: one row per task, estimator and rate, with the columns of `PANELS`; NaN values are gaps.
        title: what was studied.
    """
    tasks = list(dict.fromkeys(table["task"]))
    names = list(dict.fromkeys(table["estimator"]))
    rates = sorted({float(r) for r in table["rate"]})
    rows = max(len(tasks), 1)
    columns = min(len(names) + 1, 4)
    fig = Figure(figsize=(page_width(), 0.75 + 1.9 * rows + 0.13 * -(-(len(names) + 1) // columns)))
    axes = fig.subplots(rows, len(PANELS), sharex=True, squeeze=False)
    for row, task in zip(axes, tasks, strict=False):
        for ax, (value, lower, upper, label) in zip(row, PANELS, strict=True):
            part = table[table["task"] == task]
            for i, name in enumerate(names):
                offset = SPREAD * ((i + 0.5) / len(names) - 0.5)
                curve = part[part["estimator"] == name].sort_values("rate")
                y, low, high = (curve[c].to_numpy(float) for c in (value, lower, upper))
                x = np.searchsorted(rates, curve["rate"].to_numpy(float)) + offset
                bars = np.nan_to_num(np.abs(np.stack([y - low, high - y])), posinf=0.0)
                look = style_of(name).look
                ax.errorbar(x, y, bars, markersize=3.5, elinewidth=0.8, capsize=1.2, zorder=2, **look)
            if value == "nees_pose":
                ax.axhline(POSE_DOF, **EXPECTED, zorder=1.5)
            _scale(ax, part[value].to_numpy(float))
            ax.set_title(task, loc="left")
            ax.set_ylabel(label)
    for ax in axes[-1]:
        ax.set_xlabel("wrong associations [%]")
        ax.set_xticks(range(len(rates)), [f"{100.0 * r:g}" for r in rates])
    handles = [*(key(s.label, **s.look) for s in map(style_of, names)), key(f"expected NEES: {POSE_DOF}", **EXPECTED)]
    finish(fig, f"{title}: wrong associations put in", handles, columns, handlelength=LONG_HANDLE)
    return fig


def _scale(ax: Axes, values: Array) -> None:
    """Linear from 0, or logarithmic where the values span more than `LOG_RATIO`."""
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

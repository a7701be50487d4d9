"""The figure of a study of wrong associations: errors and NEES against their rate."""

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from data.se2 import Array
from eval.figures.error import ticks
from eval.figures.style import EXPECTED, LONG_HANDLE, drawing, finish, key, page_width, style_of

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

"""Figures of consistency: pose NEES of one run (a description), and NEES averaged over many runs with its band."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import FuncFormatter

from data.log import Log
from data.result import Run
from data.se2 import Array
from data.terminal import counted
from data.words import number
from eval.figures.error import heading_of, panels, thinned, ticks, time_axis
from eval.figures.paper import page_width
from eval.figures.style import BAND, LONG_HANDLE, drawing, style_of
from eval.referee.consistency import anees_band, mean_or_nan, nees
from eval.referee.given_runs import log_of

POSE_DOF = 3
MARKERS = 8  # about so many on a curve of many, staggered: in grey the lines alone are too alike
LOG_ABOVE = 10.0
"""The axis becomes logarithmic where a value in a thousand exceeds the band's upper end this many times."""


def _band(ax: Axes, lower: float, upper: float, dof: int) -> None:
    ax.axhspan(lower, upper, zorder=1, **BAND)
    ax.axhline(dof, color="#505050", linewidth=0.6, linestyle="--", zorder=1.5)


def _scale(axes: Sequence[Axes], curves: Sequence[Array], lower: float, upper: float) -> None:
    """Linear from 0, or logarithmic if the curves need it; the same for all axes."""
    finite = np.concatenate([c[np.isfinite(c)] for c in curves] or [np.empty(0)])
    highest = float(np.quantile(finite, 0.999)) if len(finite) else 0.0
    for ax in axes:
        if highest > LOG_ABOVE * upper:
            positive = finite[finite > 0.0]
            low = min(0.5 * lower, float(np.quantile(positive, 0.02)))
            ax.set_yscale("log")
            ax.set_ylim(max(low, 1e-3), 1.5 * float(finite.max()))
            if highest < 1e4:
                ax.yaxis.set_major_formatter(FuncFormatter(lambda y, _: f"{y:g}"))
        else:
            ax.set_ylim(0.0, 1.08 * max(highest, 1.2 * upper))
            ax.yaxis.set_major_locator(ticks(5))


@drawing()
def nees_figure(log: Log, runs: Sequence[Run]) -> Figure:
    """Pose NEES per frame of every phase, its mean, and the 95 % band of one value; it describes one run only."""
    shown, remark = panels(runs)
    rows = max(len(shown), 1)
    fig = Figure(figsize=(page_width(), 1.0 + 1.15 * rows))
    axes = list(fig.subplots(rows, 1, sharex=True, squeeze=False)[:, 0])
    lower, upper = anees_band(POSE_DOF, 1)
    curves = []
    for ax, s in zip(axes, shown, strict=False):
        t, own = s.trajectory, log_of(s.run, log)
        at, truth = own.recorded.time, own.truth.pose
        values = np.full(len(at), np.nan) if truth is None else nees(t.pose, t.covariance, truth, "pose")
        curves.append(values)
        _band(ax, lower, upper, POSE_DOF)
        keep = thinned(values)
        ax.plot(at[keep], values[keep], color=s.colour, linewidth=0.7, zorder=2)
        mean = mean_or_nan(values)
        measured = f"mean {number(mean)}" if np.isfinite(mean) else "nothing to compare with"
        ax.set_title(f"{heading_of(s)}: {measured}".replace("\n", ", "), loc="left")
        ax.set_ylabel("pose NEES [–]")
    _scale(axes, curves, lower, upper)
    time_axis(axes[-1], log.recorded)
    fig.suptitle(f"{log.name}: pose NEES, description, one run (no verdict){remark}", x=0.01, ha="left")
    handles = _handles(POSE_DOF, f"95 % of single values, χ² with dof {POSE_DOF}")
    fig.legend(handles=handles, loc="outside lower center", ncols=2)
    return fig


def _handles(dof: int, band: str) -> list[Line2D | Patch]:
    expected = f"expected of a consistent estimator: {dof}"
    return [Patch(label=band, **BAND), Line2D([], [], color="#505050", linewidth=0.6, linestyle="--", label=expected)]


@drawing()
def anees_figure(
    time: Array,
    average: Mapping[str, Array],
    dof: int,
    runs: int,
    *,
    quantity: str = "pose",
    title: str = "",
    time_is_index: bool = False,
) -> Figure:
    """NEES averaged over `runs` Monte Carlo runs at each instant (N,) by estimator, with its 95 % band."""
    fig = Figure(figsize=(page_width(), 2.7 + 0.13 * ((len(average) + 3) // 2)))
    ax = fig.add_subplot()
    lower, upper = anees_band(dof, runs)
    _band(ax, lower, upper, dof)
    handles: list[Line2D | Patch] = []
    few = max(len(time) // MARKERS, 1)
    for i, (name, values) in enumerate(average.items()):
        style, first = style_of(name), few * i // len(average)
        mean, known = mean_or_nan(values), values[np.isfinite(values)]
        outside = float(np.mean((known < lower) | (known > upper))) if len(known) else np.nan
        measured = f": mean {number(mean)}, {100.0 * outside:.0f} % outside" if len(known) else ""
        label = style.label + measured
        handles += ax.plot(time, values, markevery=(first, few), markersize=3.0, label=label, zorder=2, **style.look)
    _scale([ax], list(average.values()), lower, upper)
    ax.set(ylabel=f"average {quantity} NEES [–]", xlabel="frame" if time_is_index else "time [s]")
    if len(time) > 1:
        ax.set_xlim(time[0], time[-1])
    what = f"average {quantity} NEES over {counted(runs, 'run')}, dof {dof}"
    ax.set_title(f"{title}: {what}" if title else what[0].upper() + what[1:], loc="left")
    handles += _handles(dof, f"95 % band {lower:.2f} to {upper:.2f}: 5 % outside by design")
    fig.legend(handles=handles, loc="outside lower center", ncols=2, handlelength=LONG_HANDLE)
    return fig

"""Figure of the filter-smoother test: how far each online estimate is from the smoothed one, and how far it may be."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from data.log import Log
from data.result import Run
from data.se2 import Array, BoolArray
from eval.figures.error import COORDINATES, common_reach, draw_band, reach, thinned, ticks, time_label
from eval.figures.paper.look import page_width
from eval.figures.style import Style, drawing, style_of
from eval.referee.trust import Difference, difference


def filter_smoother_figure(log: Log, runs: Sequence[Run], smoother: Run) -> Figure:
    """Online less smoothed, d, in x, y and heading over time, with the ±3 sigma that filter and smoother allow it.

    `smoother` has a final path and the decisions of all `runs`, which have an online one. Sigma is the root of the
    diagonal of P_f - P_s, blank where later data took too little away to tell; see `eval.referee.trust.difference`.
    The largest excursion of each run, in these sigmas, is marked, and named in the legend.
    """
    with drawing():
        return _figure(log, runs, smoother)


def _figure(log: Log, runs: Sequence[Run], smoother: Run) -> Figure:
    assert smoother.final is not None
    found = [difference(r.online, smoother.final) for r in runs if r.online is not None]
    styles = [style_of(r.estimator) for r in runs if r.online is not None]
    fig = Figure(figsize=(page_width(), 4.6 + 0.13 * ((len(found) + 1) // 2)))
    axes: Sequence[Axes] = fig.subplots(3, 1, sharex=True)
    time = log.recorded.time
    for i, (ax, (name, unit, factor)) in enumerate(zip(axes, COORDINATES, strict=True)):
        ax.axhline(0.0, color="#909090", linewidth=0.5)
        for d, style in zip(found, styles, strict=True):
            bound = 3.0 * factor * d.sigma[:, i]
            draw_band(ax, time, bound, style.colour, -1.0)
            alone = _alone(bound)
            ax.vlines(time[alone], -bound[alone], bound[alone], color=style.colour, alpha=0.4, linewidth=0.8)
        for d, style in zip(found, styles, strict=True):
            curve = factor * d.d[:, i]
            keep = thinned(curve)
            ax.plot(time[keep], curve[keep], color=style.colour, linestyle=style.line, linewidth=0.8)
        limit = common_reach([_need(d, i, factor) for d in found])
        ax.set(ylim=(-limit, limit), ylabel=f"{name} [{unit}]")
        ax.yaxis.set_major_locator(ticks(6))
    handles = [_excursion(axes, time, d, style) for d, style in zip(found, styles, strict=True)]
    axes[-1].set_xlabel(time_label(log.recorded))
    if len(time) > 1:
        axes[0].set_xlim(time[0], time[-1])
    fig.align_ylabels(list(axes))
    title = f"{log.name}: online less smoothed ({style_of(smoother.estimator).label}), not an error"
    fig.suptitle(title, x=0.01, ha="left")
    band = Patch(facecolor="#D0D0D0", edgecolor="#606060", linewidth=0.5, label="±3σ that the difference may have")
    fig.legend(handles=[*handles, band], loc="outside lower center", ncols=2, numpoints=1)
    return fig


def _alone(bound: Array) -> BoolArray:
    """Which values (N,) are known between two that are not: a band cannot show them."""
    known = np.isfinite(np.concatenate([[np.nan], bound, [np.nan]]))
    result: BoolArray = known[1:-1] & ~known[:-2] & ~known[2:]
    return result


def _need(d: Difference, i: int, factor: float) -> float:
    """Half height that a run's curve and band need."""
    return factor * max(float(np.nanmax(np.abs(d.d[:, i]), initial=0.0)), reach([3.0 * d.sigma[:, i]]))


def _excursion(axes: Sequence[Axes], time: Array, d: Difference, style: Style) -> Line2D:
    """Mark where a run is furthest from the smoothed path in sigmas of the difference; returns its legend entry."""
    label = style.label
    in_sigmas = np.abs(d.d / d.sigma)
    marker = ""
    if np.isfinite(in_sigmas).any():
        frame, i = divmod(int(np.nanargmax(in_sigmas)), 3)
        name, _, factor = COORDINATES[i]
        axes[i].plot(
            time[frame], factor * d.d[frame, i], color="black", marker=style.marker, markerfacecolor=style.colour,
            markersize=5.0, markeredgewidth=0.7, clip_on=False, zorder=3,
        )  # fmt: skip
        marker = style.marker
        label += f": largest {in_sigmas[frame, i]:.3g}σ, {name}, frame {frame}"
    return Line2D(
        [], [], color=style.colour, linestyle=style.line, linewidth=0.9, marker=marker, markerfacecolor=style.colour,
        markeredgecolor="black", markersize=4.5, markeredgewidth=0.7, label=label,
    )  # fmt: skip

"""What runs claim over time: NIS per degree of freedom with its bounds, standard deviations of position and heading."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import FuncFormatter

from data.log import Log
from data.result import Run
from data.se2 import Array
from eval.figures.error import longest_sigma, sigmas, thinned, ticks, time_label
from eval.figures.paper.look import page_width
from eval.figures.style import BAND_COLOUR, drawing, series
from eval.referee.bounds import nis_bounds
from eval.referee.paths.given import log_of

WINDOWS = 40
"""Stretches that a log is cut into for its NIS; each has the same number of degrees of freedom, or nearly."""
LEAST = 20
"""Degrees of freedom of a stretch: fewer have bounds so wide that nothing is ever outside."""
BINS = 200
"""Stretches told apart in a curve of sigmas, which are smooth."""
LOG_ABOVE = 10.0
"""The axis of NIS becomes logarithmic where a stretch exceeds the upper bound this many times."""


class Stretches(NamedTuple):
    """NIS per degree of freedom (K,) of stretches that begin and end at the instants edge (K + 1,), bounds (K, 2)."""

    edge: Array
    nis: Array
    bounds: Array


def stretches_of(time: Array, run: Run, most: int = WINDOWS) -> Stretches | None:
    """Innovations of a run in stretches of equal degrees of freedom, with 95 % bounds that heed its gate.

    Sum of NIS over sum of dof, as in metrics.csv. None where no innovations were formed.
    """
    if run.innovations is None:
        return None
    nis, dof = run.innovations.nis, np.where(np.isfinite(run.innovations.nis), run.innovations.dof, 0)
    total = int(dof.sum())
    if total == 0:
        return None
    count = max(min(most, total // LEAST), 1)
    ends = np.searchsorted(np.cumsum(dof), total * np.arange(1, count + 1) / count)
    ends = np.unique(np.minimum(ends, len(nis) - 1))
    starts = np.concatenate([[0], ends[:-1] + 1])
    spent = np.add.reduceat(dof, starts)
    value = np.add.reduceat(np.nan_to_num(nis), starts) / np.maximum(spent, 1)
    bounds = np.array([nis_bounds(int(d), run.gated) if d else (np.nan, np.nan) for d in spent])
    return Stretches(np.concatenate([time[:1], time[ends]]), np.where(spent > 0, value, np.nan), bounds)


def claims_figure(log: Log, runs: Sequence[Run]) -> Figure:
    """NIS per dof over time, and the claimed standard deviations, one curve for each phase of a run; no truth is used.

    Standard deviations are those of the position along its least certain direction and of the heading.
    """
    with drawing():
        return _claims_figure(log, runs)


def _claims_figure(log: Log, runs: Sequence[Run]) -> Figure:
    shown = [s for s in series(runs) if s.run.estimator != "dead-reckoning"] or series(runs)
    fig = Figure(figsize=(page_width(), 4.6))
    top, middle, low = fig.subplots(3, 1, sharex=True, height_ratios=(1.3, 1.0, 1.0))
    time = log.recorded.time
    handles: list[Line2D | Patch] = []
    found: list[Stretches] = []
    for s in shown:
        own = log_of(s.run, log).recorded.time
        stretches = stretches_of(own, s.run) if s.phase == "online" else None
        label = s.label
        if stretches is not None:
            found.append(stretches)
            top.stairs(
                stretches.nis, stretches.edge, color=s.colour, linestyle=s.line, linewidth=0.9, baseline=None, zorder=3
            )  # fmt: skip
            inside = (stretches.nis >= stretches.bounds[:, 0]) & (stretches.nis <= stretches.bounds[:, 1])
            label += f": NIS inside in {int(inside.sum())} of {len(inside)} stretches"
        for ax, curve in ((middle, longest_sigma(s.trajectory)), (low, np.degrees(sigmas(s.trajectory)[:, 2]))):
            keep = thinned(curve, BINS)
            ax.plot(own[keep], curve[keep], color=s.colour, linestyle=s.line, linewidth=0.9)
        handles.append(Line2D([], [], label=label, color=s.colour, linestyle=s.line, linewidth=0.9))
    _nis_axis(top, found)
    for ax, name in ((middle, "position σ [m]"), (low, "heading σ [deg]")):
        ax.set_ylabel(name)
        ax.set_ylim(bottom=0.0)
        ax.yaxis.set_major_locator(ticks(4))
    low.set_xlabel(time_label(log.recorded))
    if len(time) > 1:
        low.set_xlim(time[0], time[-1])
    fig.align_ylabels([top, middle, low])
    fig.suptitle(f"{log.name}: what the runs say of themselves", x=0.01, ha="left")
    if found:
        handles.append(Patch(facecolor=BAND_COLOUR, alpha=0.45, linewidth=0.0, label="95 % bounds of NIS"))
        handles.append(Line2D([], [], color="#505050", linewidth=0.6, linestyle="--", label="expected NIS"))
    fig.legend(handles=handles, loc="outside lower center", ncols=2)
    return fig


def _nis_axis(ax: Axes, found: Sequence[Stretches]) -> None:
    """Bounds behind the curves, and a scale that shows both."""
    ax.set_ylabel("NIS per dof [–]")
    if not found:
        ax.text(0.5, 0.5, "no innovations were formed", transform=ax.transAxes, ha="center", va="center")
        return
    # stretches of the runs differ by a few frames; the widest bounds are those of the fewest degrees of freedom
    first = max(found, key=lambda s: float(np.nanmax(np.ptp(s.bounds, axis=1))))
    ax.stairs(
        first.bounds[:, 1], first.edge, baseline=first.bounds[:, 0], fill=True, color=BAND_COLOUR, alpha=0.45,
        linewidth=0.0,
    )  # fmt: skip
    expected = float(np.nanmean(first.bounds))
    ax.axhline(expected, color="#505050", linewidth=0.6, linestyle="--", zorder=1.5)
    values = np.concatenate([s.nis[np.isfinite(s.nis)] for s in found])
    upper = float(np.nanmax(first.bounds))
    if values.max() > LOG_ABOVE * upper:
        ax.set_yscale("log")
        ax.yaxis.set_major_formatter(FuncFormatter(lambda y, _: f"{y:g}"))
    else:
        ax.set_ylim(0.0, 1.08 * max(float(values.max()), upper))
        ax.yaxis.set_major_locator(ticks(4))

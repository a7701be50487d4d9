"""Figure of systematic errors over time: what filter and smoother make of each, how sure they are, and the truth."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from data.inputs import ERRORS, Systematic
from data.log import Log
from data.result import Run, Systematics
from eval.figures.error import thinned, ticks, time_label
from eval.figures.paper.look import page_width
from eval.figures.style import BAND_COLOUR, DASHED, SOLID, TRUTH_COLOUR, Line, drawing, style_of

HEIGHT = 1.25
"""in, of a row of panels."""
SETTLED = 0.2
"""Share of a log after which its estimates have to fit into their panel; before, they may leave it."""


def systematic_figure(log: Log, systematic: Systematic, runs: Sequence[Run]) -> Figure:
    """Each error over time: estimates online (dashed where there is a final one, too) and final, with ±3 sigma.

    Behind, as a band, ±3 sigma of what was known before; black, the true error of a simulated log.
    """
    with drawing():
        return _figure(log, systematic, runs)


def _figure(log: Log, systematic: Systematic, runs: Sequence[Run]) -> Figure:
    columns = min(2, len(systematic.names))
    rows = -(-len(systematic.names) // columns)
    fig = Figure(figsize=(page_width(), 0.9 + HEIGHT * rows))
    axes: list[Axes] = list(np.ravel(fig.subplots(rows, columns, sharex=True, squeeze=False)))
    drawn = [(r, e, line, when) for r in runs for e, line, when in _phases(r)]
    time, truth = log.recorded.time, log.truth.errors
    for i, (name, ax) in enumerate(zip(systematic.names, axes, strict=False)):
        before = 3.0 * float(systematic.sigma[i])
        ax.axhspan(-before, before, color=BAND_COLOUR, alpha=0.45, linewidth=0.0)
        ax.axhline(0.0, color="#909090", linewidth=0.5)
        reach = 0.0
        for run, errors, line, _ in drawn:
            mean, bound = errors.mean[:, i], 3.0 * errors.sigma[:, i]
            colour = style_of(run.estimator).colour
            keep = np.unique(np.concatenate([thinned(mean), thinned(bound)]))
            ax.fill_between(
                time[keep], (mean - bound)[keep], (mean + bound)[keep], color=colour, alpha=0.15, linewidth=0
            )
            ax.plot(time[keep], mean[keep], color=colour, linestyle=line, linewidth=0.9)
            late = slice(int(SETTLED * len(time)), None)
            reach = max(reach, float(np.nanmax(np.abs(mean[late]) + bound[late], initial=0.0)))
        if truth is not None:
            true = truth.mean[:, truth.names.index(name)] if name in truth.names else np.zeros(len(time))
            ax.plot(time, true, color=TRUTH_COLOUR, linewidth=0.8, linestyle=DASHED)
            reach = max(reach, float(np.abs(true).max()))
        limit = 1.1 * (reach or before)
        ax.set(ylim=(-limit, limit), ylabel=name if ERRORS[name] == "1" else f"{name} [{ERRORS[name]}]")
        ax.yaxis.set_major_locator(ticks(5))
    for ax in axes[len(systematic.names) :]:
        ax.set_visible(False)
    for ax in axes[max(0, len(systematic.names) - columns) : len(systematic.names)]:
        ax.tick_params(labelbottom=True)
        ax.set_xlabel(time_label(log.recorded))
    if len(time) > 1:
        axes[0].set_xlim(time[0], time[-1])
    fig.align_ylabels(axes)
    fig.suptitle(f"{log.name}: systematic errors as estimated along, with ±3σ", x=0.01, ha="left")
    handles = [
        Line2D(
            [], [], color=style_of(r.estimator).colour, linestyle=line, label=f"{style_of(r.estimator).label} ({when})"
        )
        for r, _, line, when in drawn
    ]
    if truth is not None:
        handles.append(Line2D([], [], color=TRUTH_COLOUR, linestyle=DASHED, linewidth=0.8, label="true error"))
    known = Patch(facecolor=BAND_COLOUR, alpha=0.45, label="known before (±3σ)")
    fig.legend(handles=[*handles, known], loc="outside lower center", ncols=4)
    return fig


def _phases(run: Run) -> list[tuple[Systematics, Line, str]]:
    both = run.errors_online is not None and run.errors_final is not None
    found: list[tuple[Systematics, Line, str]] = []
    if run.errors_online is not None:
        found.append((run.errors_online, DASHED if both else SOLID, "online"))
    if run.errors_final is not None:
        found.append((run.errors_final, SOLID, "final"))
    return found

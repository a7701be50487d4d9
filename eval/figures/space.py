"""Paths in space as two projections: seen from above (x, y), and from the side (x, z)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from data.result import Run
from data.se2 import Array
from eval.figures.paper import page_width
from eval.figures.style import SOLID, TRUTH_COLOUR, Line, drawing, series
from eval.referee.given.runs import GivenRun

VIEWS = ((0, 1, "y"), (0, 2, "z"))
LEAST = 0.25
"""Least extent of an axis, as a share of the largest, so that a flat path leaves no empty strip."""


@drawing()
def space_figure(runs: Sequence[Run]) -> Figure:
    """True and estimated positions of results in space [m], equal scales; lines break where no truth is known."""
    shown = [s for s in series(runs) if isinstance(s.run, GivenRun) and s.phase in s.run.space]
    both = [(s, s.run.space[s.phase]) for s in shown if isinstance(s.run, GivenRun)]
    every = np.concatenate([p for _, b in both for p in (b.estimate.position, b.truth.position)])
    low, high = np.nanmin(every, axis=0), np.nanmax(every, axis=0)
    size = np.maximum(high - low, LEAST * max(float(np.max(high - low)), 1e-9))
    wide = page_width()
    tall = [float(np.clip(wide * size[k] / size[0], 1.0, 4.5)) for _, k, _ in VIEWS]
    fig = Figure(figsize=(wide, sum(tall) + 0.9))
    axes = fig.subplots(2, 1, height_ratios=tall)
    for ax, (i, k, name) in zip(axes, VIEWS, strict=True):
        for s, b in both:
            _line(ax, b.truth.position[:, [i, k]], TRUTH_COLOUR, SOLID, 1.8, "true path" if s is shown[0] else "")
            _line(ax, b.estimate.position[:, [i, k]], s.colour, s.line, 1.0, s.label)
        middle, half = 0.5 * (low + high), 0.55 * size
        ax.set_xlim(middle[i] - half[i], middle[i] + half[i])
        ax.set_ylim(middle[k] - half[k], middle[k] + half[k])
        ax.set_aspect("equal", adjustable="box")
        ax.set_ylabel(f"{name} [m]")
    axes[-1].set_xlabel("x [m]")
    axes[0].set_title("from above")
    axes[1].set_title("from the side")
    axes[0].legend(loc="best")
    return fig


def _line(ax: Axes, xy: Array, colour: str, line: Line, width: float, label: str) -> None:
    ax.plot(*xy.T, color=colour, linestyle=line, linewidth=width, label=label or "_")

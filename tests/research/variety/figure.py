"""Figure of the variety: `jcbb-hindsight` against `jcbb` on every world, errors, wrong pairings and landmarks."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from eval.figures.style import BAND_COLOUR, DASHED, TRUTH_COLOUR, colour_of_method, drawing, page_width
from eval.replay.settings import HINDSIGHT
from tests.research.variety.goals import NEAR, WORSE, World
from tests.research.variety.measure import JCBB

KINDS = {"arena": ("#0072B2", "o"), "park": ("#E69F00", "^"), "corridor": ("#000000", "x")}
"""Colour and marker by kind of world: they differ in lightness and form, too."""
LEAST = 1e-2
"""Ratios below it are drawn at it."""
FEW = 0.05
"""%. Where FP of none are drawn on a logarithmic axis."""


def variety_figure(worlds: Sequence[World]) -> Figure:
    """Ratio of the RMSE over the worlds in its order; FP of both; landmarks by visible ones of both."""
    with drawing():
        fig = Figure(figsize=(page_width(), 2.7))
        rmse, fp, landmarks = fig.subplots(1, 3)
        _rmse(rmse, worlds)
        _fp(fp, worlds)
        _landmarks(landmarks, worlds)
        handles, labels = fp.get_legend_handles_labels()
        fig.legend(handles, labels, loc="outside lower center", ncols=len(labels))
        return fig


def _rmse(ax: Axes, worlds: Sequence[World]) -> None:
    order = sorted(worlds, key=lambda w: w.rmse_ratio)
    ratio = np.clip([w.rmse_ratio for w in order], LEAST, 1.0 / LEAST)
    ax.axhline(1.0, color=TRUTH_COLOUR, linewidth=0.6)
    ax.axhline(WORSE, color=TRUTH_COLOUR, linewidth=0.8, linestyle=DASHED)
    place = 100.0 * (np.arange(len(order)) + 0.5) / max(len(order), 1)
    for kind, (colour, marker) in KINDS.items():
        of = np.array([w.jcbb.world == kind for w in order], bool)
        ax.plot(place[of], ratio[of], color=colour, marker=marker, linestyle="", markersize=3.0)
    ax.set(yscale="log", xlabel="worlds, best first [%]", ylabel=f"RMSE / RMSE of {JCBB} [–]", xlim=(0.0, 100.0))


def _fp(ax: Axes, worlds: Sequence[World]) -> None:
    span = np.array([FEW, 100.0])
    ax.plot(span, span, color=TRUTH_COLOUR, linewidth=0.6)
    ax.plot(span, 0.2 * span, color=TRUTH_COLOUR, linewidth=0.8, linestyle=DASHED)
    for kind, (colour, marker) in KINDS.items():
        of = [w for w in worlds if w.jcbb.world == kind]
        x, y = (
            [max(100.0 * r.fp / max(r.readings, 1), FEW) for r in rows]
            for rows in ([w.jcbb for w in of], [w.hindsight for w in of])
        )
        ax.plot(x, y, color=colour, marker=marker, linestyle="", markersize=3.0, label=kind)
    limits = (0.8 * FEW, 130.0)
    ax.set(xscale="log", yscale="log", xlabel=f"FP of {JCBB} [%]", ylabel=f"FP of {HINDSIGHT} [%]")
    ax.set(xlim=limits, ylim=limits)
    ticks = [FEW, 1.0, 10.0, 100.0]
    ax.set_xticks(ticks, ["0", "1", "10", "100"])
    ax.set_yticks(ticks, ["0", "1", "10", "100"])
    ax.minorticks_off()


def _landmarks(ax: Axes, worlds: Sequence[World]) -> None:
    """Shares of worlds up to a ratio, a line for each method."""
    ax.axvspan(1.0 - NEAR, 1.0 + NEAR, color=BAND_COLOUR, linewidth=0.0)
    for method, rows, line in (
        (JCBB, [w.jcbb for w in worlds], DASHED),
        (HINDSIGHT, [w.hindsight for w in worlds], "-"),
    ):
        ratio = np.sort([r.landmarks / max(r.visible, 1) for r in rows if np.isfinite(r.rmse_m)])
        share = 100.0 * np.arange(1, len(ratio) + 1) / max(len(rows), 1)
        ax.step(
            np.maximum(ratio, 0.1), share, where="post", color=colour_of_method(method), linestyle=line, label=method
        )
    ax.set(xscale="log", xlabel="landmarks / visible ones [–]", ylabel="worlds up to here [%]", ylim=(0.0, 100.0))
    ax.set_xticks([0.5, 1.0, 2.0, 5.0, 10.0], ["0.5", "1", "2", "5", "10"])
    ax.minorticks_off()
    ax.set_xlim(0.3, 15.0)
    ax.legend(loc="lower right")

"""Figure of a power study: how often a test sees each fault, at each of its sizes, beside another test."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from matplotlib.figure import Figure

from eval.figures.paper.look import across, page_width
from eval.figures.style import drawing

COLOURS = ("#0072B2", "#D55E00")
"""Of the test and of the other one (Okabe and Ito)."""
COLUMNS = 4


@dataclass(frozen=True)
class Seen:
    """One fault: its sizes in words from small to large, and the shares [%] of logs in which each test sees it."""

    fault: str
    sizes: tuple[str, ...]
    share: tuple[float, ...]
    error: tuple[float, ...]
    other: tuple[float, ...]


def power_figure(faults: Sequence[Seen], tests: tuple[str, str], level: float, title: str) -> Figure:
    """A panel for each fault: share of the logs in which each test sees it, against its size; sizes are not to scale.

    Args:
        faults: what was found; `error` is the standard error of `share`, drawn as a bar.
        tests: what the two are called.
        level: the first one's share [%] on logs without a fault, as it should be.
        title: what was studied.
    """
    with drawing():
        most = across(COLUMNS)
        rows = max(-(-len(faults) // most), 1)
        fig = Figure(figsize=(page_width(), 0.7 + 1.35 * rows))
        axes = fig.subplots(rows, most, sharey=True, squeeze=False).ravel()
        for ax, f in zip(axes, faults, strict=False):
            place = range(len(f.sizes))
            ax.axhline(level, color="#505050", linewidth=0.6, linestyle="--", zorder=1.5)
            ax.errorbar(
                place, f.share, f.error, color=COLOURS[0], marker="o", markersize=3.5, elinewidth=0.8, label=tests[0]
            )
            ax.plot(
                place, f.other, color=COLOURS[1], marker="s", markersize=3.5, markerfacecolor="white", zorder=1.8,
                label=tests[1],
            )  # fmt: skip
            ax.set_xticks(place, f.sizes)
            ax.set_xlim(-0.4, len(f.sizes) - 0.6)
            ax.set_ylim(-6.0, 106.0)
            ax.set_title(f.fault, loc="left")
        for ax in axes[len(faults) :]:
            ax.set_visible(False)
        for ax in axes[::most]:
            ax.set_ylabel("logs [%]")
        fig.suptitle(title, x=0.01, ha="left")
        handles, labels = axes[0].get_legend_handles_labels()
        fig.legend(handles, labels, loc="outside lower center", ncols=2)
        return fig

"""Figures of run-end errors, one value per Monte Carlo run: NEES against the chi-square law, and coverage by level."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from scipy import stats

from data.se2 import Array
from data.terminal.words import counted
from eval.figures.error import ticks
from eval.figures.paper.look import across, page_width, points
from eval.figures.style import DASHED, drawing, style_of
from eval.referee.consistency import COVERAGE_LEVELS, coverage

MOST_COLUMNS = 4
LAST = 0.999
"""The axis ends at this quantile of the chi-square law; what lies beyond is one bar of its own."""
EXPECTED_COLOUR = "#000000"
BEYOND_HATCH = "/////"


def run_end_figure(nees: Mapping[str, Array], dof: int, title: str) -> Figure:
    """Histogram of the run-end NEES (N,) of each estimator against the chi-square density with `dof`.

    The last, hatched bar holds every run beyond the axis, with their number above it: its height is their share per
    bin width. Runs without a NEES (NaN) are counted in the panel.
    """
    with drawing():
        rows = max(math.ceil(len(nees) / across(MOST_COLUMNS)), 1)
        columns = max(math.ceil(len(nees) / rows), 1)
        fig = Figure(figsize=(page_width(), 0.85 + 1.55 * rows))
        axes = fig.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
        end = float(np.ceil(stats.chi2.ppf(LAST, dof)))
        bins = _bins(max((len(v) for v in nees.values()), default=0))
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
        fig.suptitle(f"{title}: NEES at the end of each run, dof {dof}", x=0.01, ha="left")
        handles = [
            Line2D([], [], color=EXPECTED_COLOUR, linewidth=1.0, label=f"χ² density with dof {dof}"),
            Patch(facecolor="white", edgecolor="#505050", hatch=BEYOND_HATCH, label=f"number of runs beyond {end:g}"),
        ]
        fig.legend(handles=handles, loc="outside lower center", ncols=2)
        return fig


def _bins(runs: int) -> int:
    return int(np.clip(round(2.0 * math.sqrt(runs)), 8, 24))


def _peak(dof: int, width: float) -> float:
    """Highest mean of the chi-square density over a bin."""
    edges = width * np.arange(0.0, max(dof, 1.0) / width + 2.0)
    return float(np.diff(stats.chi2.cdf(edges, dof)).max() / width)


def _histogram(ax: Axes, name: str, values: Array, dof: int, edges: Array) -> None:
    style, known = style_of(name), values[np.isfinite(values)]
    width, end = float(edges[1]), float(edges[-1])
    scale = 1.0 / max(len(known) * width, 1e-300)
    counts = np.histogram(known, edges)[0]
    beyond = int(np.count_nonzero(known > end))
    ax.bar(edges[:-1], scale * counts, width, align="edge", color=style.colour, alpha=0.55, linewidth=0.0)
    ax.bar(
        end + 0.6 * width, scale * beyond, 1.6 * width, align="edge", color="white", edgecolor=style.colour,
        hatch=BEYOND_HATCH, linewidth=0.8,
    )  # fmt: skip
    ax.text(end + 1.4 * width, scale * beyond, f"{beyond}", ha="center", va="bottom", fontsize=points(7))
    x = np.linspace(edges[0], end, 400)[1:]
    ax.plot(x, stats.chi2.pdf(x, dof), color=EXPECTED_COLOUR, linewidth=1.0)
    ax.set_xlim(0.0, end + 2.9 * width)
    said = counted(len(known), "run") + (f"\n{len(values) - len(known)} without" if len(known) < len(values) else "")
    ax.text(0.97, 0.95, said, transform=ax.transAxes, ha="right", va="top", fontsize=points(7))
    ax.set_title(style.label, loc="left")


def coverage_figure(nees: Mapping[str, Array], dof: int, title: str) -> Figure:
    """Share of run-end NEES (N,) inside the ellipse of each nominal level, with 95 % Clopper-Pearson bounds.

    Levels stand side by side, not to scale, as 90, 95 and 99 % would otherwise lie on each other; the diagonal is the
    staircase of bars that a consistent estimator's bounds should touch. Runs without a NEES (NaN) are left out, and the
    legend says how many.
    """
    with drawing():
        fig = Figure(figsize=(page_width(), 2.7 + 0.14 * math.ceil((len(nees) + 1) / MOST_COLUMNS)))
        ax = fig.add_subplot()
        place = np.arange(len(COVERAGE_LEVELS), dtype=float)
        nominal = 100.0 * np.array(COVERAGE_LEVELS)
        ax.plot(place, nominal, color=EXPECTED_COLOUR, linewidth=0.6, linestyle=DASHED, zorder=1.5)
        ax.hlines(nominal, place - 0.42, place + 0.42, color=EXPECTED_COLOUR, linewidth=1.2, zorder=1.6)
        handles = [Line2D([], [], color=EXPECTED_COLOUR, linewidth=1.2, label="expected: the nominal level")]
        lowest = 100.0 * min(COVERAGE_LEVELS)
        for i, (name, values) in enumerate(nees.items()):
            known, style = values[np.isfinite(values)], style_of(name)
            offset = 0.8 * ((i + 0.5) / len(nees) - 0.5)
            left_out = f", {len(values) - len(known)} without" if len(known) < len(values) else ""
            label = f"{style.label} ({counted(len(known), 'run')}{left_out})"
            handles.append(Line2D([], [], color=style.colour, marker=style.marker, linestyle="none", label=label))
            if len(known) < 2:
                continue
            verdicts = [coverage(known, dof, level) for level in COVERAGE_LEVELS]
            share = 100.0 * np.array([v.mean for v in verdicts])
            bounds = 100.0 * np.array([(v.lower, v.upper) for v in verdicts]).T
            lowest = min(lowest, float(bounds.min()))
            ax.errorbar(
                place + offset, share, np.abs(bounds - share), color=style.colour, marker=style.marker,
                linestyle="none", elinewidth=1.0, capsize=1.5, markersize=3.5, zorder=2,
            )  # fmt: skip
        ax.set_xticks(place, [f"{n:g}" for n in nominal])
        ax.grid(visible=False, axis="x")
        for boundary in place[:-1] + 0.5:
            ax.axvline(boundary, color="#E4E4E4", linewidth=0.5, zorder=0.5)
        ax.set(xlim=(-0.5, len(place) - 0.5), ylim=(max(0.0, lowest - 4.0), 102.0))
        ax.set(xlabel="nominal level of the ellipse [%]", ylabel="run ends inside [%]")
        ax.set_title(f"{title}: coverage at the end of the run, dof {dof}, 95 % bounds", loc="left")
        fig.legend(handles=handles, loc="outside lower center", ncols=MOST_COLUMNS if len(nees) > 3 else 2)
        return fig

"""What a legend shows looks as it does in the picture; curves stand out from bands and reference lines behind them."""

from dataclasses import replace
from functools import cache

import numpy as np
import pandas as pd
import pytest
from matplotlib.colors import to_hex, to_rgba
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from data.result import Innovations
from eval.figures.claims import anees_figure, claims_figure, growth_figure, nees_figure, outlier_figure
from eval.figures.error import difference_figure, error_figure
from eval.figures.map import log_figure, map_figure
from tests.eval.handmade import FRAMES, SIGMA, circle_log, run_with_error
from wings.laser.report import loop_picture
from wings.laser.scans.constraints import Loops

OFF = np.array([0.1, -0.1, 0.02])
ONLINE = run_with_error(OFF)
FINAL = run_with_error(0.5 * OFF, estimator="batch", phases=("final",))
WITH_INNOVATIONS = replace(
    ONLINE, innovations=Innovations(np.full(FRAMES, 4.0), np.full(FRAMES, 4), np.zeros(FRAMES), np.zeros((4, 2)))
)
OUTLIERS = pd.DataFrame([
    {"task": "slam", "estimator": "ekf", "rate": r, "rmse_position_m": 1.0, "rmse_lower": 0.9, "rmse_upper": 1.1,
     "nees_pose": 3.0, "nees_lower": 2.5, "nees_upper": 3.5} for r in (0.0, 0.1)
])  # fmt: skip
REFERENCE = {"#505050", "#909090"}
"""Colours of lines at a value that is expected."""


def loops():
    ends = np.array([4, 8, 12, 16])
    return loop_picture(
        circle_log().truth.pose,
        Loops(np.arange(4), ends, np.zeros((4, 3)), np.zeros((4, 3, 3)), np.ones(4), np.array([4, 4, 4, -1])),
        np.array([1.0, 0.0, 0.9, 0.5]), name="here", false=np.array([False, False, True, False]),
    )  # fmt: skip


FIGURES = {
    "map of a filter": lambda: map_figure(circle_log(), [ONLINE]),
    "error": lambda: error_figure(circle_log(), [ONLINE, FINAL]),
    "nees": lambda: nees_figure(circle_log(), [ONLINE, FINAL]),
    "difference": lambda: difference_figure(circle_log(truth=False), [ONLINE], FINAL),
    "claims": lambda: claims_figure(circle_log(truth=False), [WITH_INNOVATIONS, FINAL]),
    "average nees": lambda: anees_figure(np.arange(20.0), {"ekf": np.full(20, 3.0)}, 3, 50),
    "growth": lambda: growth_figure(circle_log(), [ONLINE]), "log": lambda: log_figure(circle_log()),
    "outliers": lambda: outlier_figure(OUTLIERS, "arena"), "loops": loops,
}  # fmt: skip


@cache
def drawn_once(kind):
    fig = FIGURES[kind]()
    fig.draw_without_rendering()
    return fig


def legend_of(fig):
    return [h for legend in fig.legends for h in legend.legend_handles if isinstance(h, Line2D)]


def drawn_in(fig):
    return [line for ax in fig.axes for line in ax.lines]


def is_line(line) -> bool:
    return line.get_linestyle() != "None"


@pytest.mark.parametrize("kind", FIGURES)
def test_lines_and_markers_in_the_legend_are_about_as_large_as_those_they_stand_for(kind):
    fig = drawn_once(kind)
    drawn = drawn_in(fig)
    for shown in legend_of(fig):
        twins = [d for d in drawn if to_rgba(d.get_color()) == to_rgba(shown.get_color())]
        twins = [d for d in twins if d.get_linestyle() == shown.get_linestyle()]
        if is_line(shown) and twins:
            assert min(abs(np.log(d.get_linewidth() / shown.get_linewidth())) for d in twins) < np.log(1.45), shown
        twins = [d for d in drawn if d.get_marker() == shown.get_marker()]
        if shown.get_marker() not in ("", "None", None) and twins:
            assert min(abs(np.log(d.get_markersize() / shown.get_markersize())) for d in twins) < np.log(1.6), shown


@pytest.mark.parametrize("kind", FIGURES)
def test_nothing_is_drawn_so_thick_or_so_thin_that_it_hides_or_is_hidden(kind):
    fig = drawn_once(kind)
    for line in drawn_in(fig):
        if is_line(line):
            truth = line.get_label() == "true path"
            assert 0.4 <= line.get_linewidth() <= (2.0 if truth else 1.3), line
        if line.get_marker() not in ("", "None", None):
            assert 1.0 <= line.get_markersize() <= 9.0
    for text in fig.findobj(lambda a: hasattr(a, "get_fontsize") and a.get_text()):
        assert 5.0 <= text.get_fontsize() <= 9.0, text


@pytest.mark.parametrize("kind", FIGURES)
def test_a_line_at_the_expected_value_is_thinner_than_the_curves_and_behind_them(kind):
    for ax in drawn_once(kind).axes:
        expected = [x for x in ax.lines if to_hex(x.get_color()) in REFERENCE and len(np.unique(x.get_ydata())) == 1]
        curves = [x for x in ax.lines if x not in expected and len(x.get_xdata()) > 10]
        for line in expected if curves else ():
            assert line.get_linewidth() < max(c.get_linewidth() for c in curves)
            order = sorted(ax.lines, key=lambda x: x.get_zorder())  # stable: of equals the one drawn later is above
            assert order.index(line) < min(order.index(c) for c in curves if c.get_linewidth() > 0.5)


@pytest.mark.parametrize("kind", ["nees", "average nees", "claims"])
def test_the_band_of_what_is_expected_is_in_the_legend_as_it_is_drawn_and_behind_everything(kind):
    fig = drawn_once(kind)
    (shown,) = (h for h in fig.legends[0].legend_handles if isinstance(h, Patch) and h.get_alpha() is not None)
    bands = [p for ax in fig.axes for p in ax.patches if p.get_alpha() is not None]
    assert bands
    for band in bands:
        assert (band.get_alpha(), band.get_linewidth()) == (shown.get_alpha(), shown.get_linewidth()) == (0.45, 0.0)
        assert to_hex(band.get_facecolor()) == to_hex(shown.get_facecolor())
        assert all(band.get_zorder() <= line.get_zorder() for line in band.axes.lines)


def test_the_axis_of_errors_holds_the_bound_with_a_tenth_of_room():
    axes = drawn_once("error").axes[::2]
    heights = [ax.get_ylim()[1] for ax in axes]
    assert heights == pytest.approx(1.1 * 3.0 * np.array([*SIGMA[:2], np.degrees(SIGMA[2])]))

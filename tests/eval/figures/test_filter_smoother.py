"""The figure of the filter-smoother test: the difference, its ±3 sigma, the largest excursion; nothing is cut."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from data.result import Trajectory
from eval.figures.claims import filter_smoother_figure
from tests.eval.figures.looks import within
from tests.eval.handmade import FRAMES, SIGMA, circle_log, run_with_error
from tests.quick import slow

P = np.diag(SIGMA**2)


def smoother(share=0.25):
    """Batch on the true path; its variance is this share (a number, or by frame) of the filter's."""
    run = run_with_error(np.zeros(3), estimator="batch", phases=("final",))
    covariance = np.broadcast_to(share, FRAMES)[:, None, None] * P
    return replace(run, final=Trajectory(run.final.pose, covariance))


def excursion():
    error = np.tile([0.05, -0.05, 0.01], (FRAMES, 1))
    error[12, 1] = 1.2
    return run_with_error(error)


def test_the_difference_is_drawn_with_the_sigma_it_may_have():
    ax = filter_smoother_figure(circle_log(), [excursion()], smoother()).axes[1]
    curve = max(ax.lines, key=lambda line: np.max(np.abs(line.get_ydata())) * (len(line.get_xdata()) == FRAMES))
    assert curve.get_ydata()[12] == pytest.approx(1.2)
    # 3 sqrt(0.2² - 0.25 · 0.2²)
    bounds = [line.get_ydata() for line in ax.lines if np.allclose(np.abs(line.get_ydata()), 0.6 * np.sqrt(0.75))]
    assert len(bounds) == 2


def test_the_largest_excursion_is_marked_and_named_in_claimed_sigmas():
    fig = filter_smoother_figure(circle_log(), [excursion()], smoother())
    # 1.2 / (0.2 sqrt(0.75)) = 6.93
    assert next(t.get_text() for t in fig.legends[0].get_texts()) == "EKF: largest 6.93σ, y, frame 12"
    marked = [line for line in fig.axes[1].lines if line.get_marker() == "o"]
    assert [float(line.get_xdata()[0]) for line in marked] == [6.0]


def test_the_largest_excursion_is_sought_where_the_difference_has_a_sigma():
    share = np.full(FRAMES, 1.0)
    share[20] = 0.25
    fig = filter_smoother_figure(circle_log(), [excursion()], smoother(share))
    # 0.05 / (0.1 sqrt(0.75)) = 0.577; what y does in frame 12 has nothing to be compared with
    assert fig.legends[0].get_texts()[0].get_text() == "EKF: largest 0.577σ, x, frame 20"
    (mark,) = (line for ax in fig.axes for line in ax.lines if len(line.get_xdata()) == 1)
    assert mark.axes is fig.axes[0]
    assert (mark.get_xdata()[0], mark.get_ydata()[0]) == pytest.approx((10.0, 0.05))


def test_where_later_data_add_nothing_there_is_no_band_but_a_line_for_a_lonely_frame():
    share = np.full(FRAMES, 0.999)
    share[20] = 0.25
    ax = filter_smoother_figure(circle_log(), [excursion()], smoother(share)).axes[0]
    (lonely,) = (c.get_segments() for c in ax.collections if hasattr(c, "get_segments") and len(c.get_segments()))
    assert [segment[0, 0] for segment in lonely] == [10.0]


@pytest.mark.parametrize("names", [
    slow(()), slow(("ekf", "isam2")), ("ekf", "ekf-iterated", "ekf-fej", "ekf-invariant", "isam2")
])  # fmt: skip
def test_nothing_is_cut_and_no_text_is_covered(names):
    runs = [replace(excursion(), estimator=name) for name in names]
    fig = filter_smoother_figure(replace(circle_log(), name="victoria-park"), runs, smoother())
    fig.draw_without_rendering()
    assert [ax.get_ylabel() for ax in fig.axes] == ["x [m]", "y [m]", "heading [deg]"]
    assert fig.axes[-1].get_xlabel() == "time [s]"
    (legend,) = fig.legends
    for ax in fig.axes:
        assert within(ax.get_tightbbox(), fig.bbox)
        assert not legend.get_window_extent().overlaps(ax.get_tightbbox())
    assert within(legend.get_window_extent(), fig.bbox)

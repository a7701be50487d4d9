"""Figures for logs without truth: filter-smoother test, NIS with bounds, claimed sigmas, the fate of every reading."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from data.result import DISCARD, NEW, Innovations, Trajectory
from eval.figures.claims import claims_figure, filter_smoother_figure, stretches_of
from eval.figures.log import loop_state_figure, loop_states
from eval.referee.score import Trial
from eval.report.publish import draw, kinds
from tests.eval.handmade import FRAMES, SIGMA, circle_log, run_with_error

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


def test_the_difference_is_drawn_with_its_sigma_and_its_largest_excursion():
    ax = filter_smoother_figure(circle_log(), [excursion()], smoother()).axes[1]
    curve = max(ax.lines, key=lambda line: np.max(np.abs(line.get_ydata())) * (len(line.get_xdata()) == FRAMES))
    assert curve.get_ydata()[12] == pytest.approx(1.2)
    # 3 sqrt(0.2² - 0.25 · 0.2²)
    bounds = [line.get_ydata() for line in ax.lines if np.allclose(np.abs(line.get_ydata()), 0.6 * np.sqrt(0.75))]
    assert len(bounds) == 2
    fig = filter_smoother_figure(circle_log(), [excursion()], smoother())
    # 1.2 / (0.2 sqrt(0.75)) = 6.93
    assert next(t.get_text() for t in fig.legends[0].get_texts()) == "EKF: largest 6.93σ, y, frame 12"
    marked = [line for line in fig.axes[1].lines if line.get_marker() == "o"]
    assert [float(line.get_xdata()[0]) for line in marked] == [6.0]
    share = np.full(FRAMES, 1.0)
    share[20] = 0.25
    fig = filter_smoother_figure(circle_log(), [excursion()], smoother(share))
    # 0.05 / (0.1 sqrt(0.75)) = 0.577; what y does in frame 12 has nothing to be compared with
    assert fig.legends[0].get_texts()[0].get_text() == "EKF: largest 0.577σ, x, frame 20"
    (mark,) = (line for ax in fig.axes for line in ax.lines if len(line.get_xdata()) == 1)
    assert mark.axes is fig.axes[0]
    assert (mark.get_xdata()[0], mark.get_ydata()[0]) == pytest.approx((10.0, 0.05))
    share = np.full(FRAMES, 0.999)
    share[20] = 0.25
    ax = filter_smoother_figure(circle_log(), [excursion()], smoother(share)).axes[0]
    (lonely,) = (c.get_segments() for c in ax.collections if hasattr(c, "get_segments") and len(c.get_segments()))
    assert [segment[0, 0] for segment in lonely] == [10.0]


OFF = np.array([0.1, -0.1, 0.02])


def with_innovations(run, nis, dof):
    n = len(nis)
    return replace(run, innovations=Innovations(np.asarray(nis, float), np.asarray(dof), np.zeros(n), np.zeros((4, 2))))


def texts(fig):
    return [t.get_text() for legend in fig.legends for t in legend.get_texts()]


def test_stretches_have_equal_degrees_of_freedom_and_add_up_to_the_nis_of_the_table():
    rng = np.random.default_rng(0)
    dof = 2 * rng.integers(0, 4, 500)
    nis = np.where(dof > 0, rng.chisquare(np.maximum(dof, 1)), np.nan)
    time = np.arange(500.0)
    found = stretches_of(time, with_innovations(run_with_error(OFF), nis, dof))
    spent = [dof[(time > a) & (time <= b)].sum() for a, b in zip(found.edge[:-1], found.edge[1:], strict=True)]
    spent[0] += dof[0]
    assert max(spent) - min(spent) <= 2 * 6
    assert (found.nis * spent).sum() == pytest.approx(np.nansum(nis))
    # bounds by the law of a sum of squares, and honest innovations inside them
    low, high = chi2.ppf([0.025, 0.975], spent[3]) / spent[3]
    assert found.bounds[3] == pytest.approx([low, high], rel=0.02)
    inside = (found.nis > found.bounds[:, 0]) & (found.nis < found.bounds[:, 1])
    assert inside.mean() > 0.85


def test_innovations_outside_their_bounds_are_counted_and_their_absence_is_said():
    run = run_with_error(OFF)
    assert stretches_of(np.arange(float(FRAMES)), run) is None
    fig = claims_figure(circle_log(truth=False), [run])
    assert "no innovations" in fig.axes[0].texts[0].get_text()
    dof = np.full(FRAMES, 4)
    run = with_innovations(run_with_error(OFF), np.full(FRAMES, 40.0), dof)
    fig = claims_figure(circle_log(truth=False), [run, run_with_error(OFF, estimator="batch", phases=("final",))])
    stretches = stretches_of(circle_log().recorded.time, run)
    assert stretches.nis == pytest.approx(np.full(len(stretches.nis), 10.0))
    assert any(f"NIS inside in 0 of {len(stretches.nis)} stretches" in t for t in texts(fig))
    honest = with_innovations(run_with_error(OFF), np.full(FRAMES, 4.0), dof)
    told = texts(claims_figure(circle_log(truth=False), [honest]))
    assert any(f"NIS inside in {len(stretches.nis)} of {len(stretches.nis)} stretches" in t for t in told)
    # claimed sigmas as handmade: the position's, and the heading's in degrees
    position = fig.axes[1].lines[0].get_ydata()
    assert position == pytest.approx(np.full(len(position), SIGMA[:2].max()))


def test_every_reading_has_one_fate():
    run = replace(
        run_with_error(OFF), decisions=np.array([NEW, 0, DISCARD, 0]), final_decisions=np.array([NEW, 0, DISCARD, 1])
    )
    found = loop_states(run)
    assert {name: rows.tolist() for name, rows in found.items()} == {
        "paired": [False, True, False, False],
        "new": [True, False, False, False],
        "discarded": [False, False, True, False],
        "revised": [False, False, False, True],
    }
    fig = loop_state_figure(circle_log(truth=False), [run])
    assert "1 paired, 1 new, 1 discarded, 1 revised" in fig.axes[0].get_title(loc="left")
    # a reading stands where the path puts it
    log = circle_log()
    o, pose = log.recorded.observations, run.online.pose[1]
    angle = pose[2] + o.z[1, 1]
    expected = pose[:2] + o.z[1, 0] * np.array([np.cos(angle), np.sin(angle)])
    paired = next(line for line in fig.axes[0].lines if line.get_marker() == ".")
    assert np.ravel(paired.get_xydata()) == pytest.approx(expected)


def test_they_are_drawn_where_there_is_no_truth_and_only_there(tmp_path):
    run = with_innovations(run_with_error(OFF, association="jcbb-hindsight"), np.full(FRAMES, 4.0), np.full(FRAMES, 4))
    blind = Trial(circle_log(truth=False), "slam", (run,))
    assert {"claims", "fate"} <= set(kinds(blind))
    assert not {"claims", "fate"} & set(kinds(Trial(circle_log(), "slam", (run,))))
    assert not {"claims", "fate"} & set(kinds(blind, quick=True))
    for kind in ("claims", "fate"):
        picture = draw(tmp_path, blind, kind)
        assert blind.log.name in picture.caption
        assert (tmp_path / "figures" / f"{picture.stem}.png").exists()

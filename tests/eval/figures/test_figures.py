"""Figures: what they show of hand-made runs, with and without truth, and that nothing is cut or squashed."""

import re
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.path import Path as Outline

from data.notice import stopped
from data.result import Failure, MapEstimate
from eval.figures.claims import anees_figure, nees_figure
from eval.figures.error import MOST_BINS, difference_figure, error_figure, longest_sigma, sigmas, thinned
from eval.figures.map import map_figure
from eval.figures.plane import View, ellipses, enlargement
from tests.eval.figures.looks import within
from tests.eval.handmade import FRAMES, SIGMA, circle_log, run_with_error, true_path

ZERO = np.zeros(3)
OFF = np.array([0.1, -0.1, 0.02])
STOPPED = Failure("diverged", 15, stopped("covariance not positive semidefinite"))


def truth_with_holes():
    log, pose = circle_log(), true_path()
    pose[10:20] = np.nan
    return replace(log, truth=replace(log.truth, pose=pose))


def frame_numbers():
    log = circle_log(truth=False, landmarks=False)
    return replace(log, recorded=replace(log.recorded, time_is_index=True))


FILTER = run_with_error(OFF)
SMOOTHER = run_with_error(0.5 * OFF, estimator="batch", phases=("final",))
SITUATIONS = {
    "truth": (circle_log(), [FILTER, SMOOTHER]),
    "known map": (circle_log(known_map=True), [run_with_error(OFF, task="localization", mapped=False)]),
    "no truth": (frame_numbers(), [FILTER, SMOOTHER]),
    "truth with holes": (truth_with_holes(), [FILTER, SMOOTHER]),
    "a run stopped": (circle_log(), [run_with_error(OFF, failure=STOPPED), SMOOTHER]),
    "a run never started": (circle_log(), [run_with_error(OFF, failure=STOPPED._replace(frame=0)), SMOOTHER]),
    "dead reckoning alone": (circle_log(), [run_with_error(OFF, estimator="dead-reckoning", mapped=False)]),
    "six phases": (
        circle_log(),
        [
            FILTER, run_with_error(OFF, estimator="isam2", phases=("online", "final")), SMOOTHER,
            run_with_error(OFF, estimator="batch-cauchy", phases=("final",)), run_with_error(OFF, association="jcbb"),
        ],
    ),
    "nothing ran": (circle_log(truth=False, landmarks=False), []),
}  # fmt: skip
FIGURES = {
    "map": map_figure, "narrow map": lambda log, runs: map_figure(log, runs, width=3.4), "error": error_figure,
    "nees": nees_figure, "difference": lambda log, runs: difference_figure(log, runs, SMOOTHER),
}  # fmt: skip
# kinds that look alike in the other situations
SHOWN = {
    "narrow map": ("no truth", "six phases"),
    "nees": ("no truth", "truth with holes", "a run stopped", "six phases", "nothing ran"),
    "difference": ("truth with holes", "a run stopped", "a run never started", "six phases", "nothing ran"),
}


@pytest.mark.parametrize(
    ("kind", "situation"),
    [
        # two situations of three of a figure in the slow tests
        pytest.param(k, s, marks=[] if i % 3 == 0 else pytest.mark.slow)
        for k in FIGURES
        for i, s in enumerate(s for s in SITUATIONS if s in SHOWN.get(k, SITUATIONS))
    ],
)
def test_every_figure_is_drawn_in_every_situation_with_units_and_nothing_cut(kind, situation):
    log, runs = SITUATIONS[situation]
    fig = FIGURES[kind](log, runs)
    fig.draw_without_rendering()
    paper = fig.bbox
    panels = [ax.get_tightbbox() for ax in fig.axes]
    for ax, panel in zip(fig.axes, panels):
        for label in (ax.get_xlabel(), ax.get_ylabel()):
            assert label == "" or label == "frame" or re.search(r"\[(m|s|deg|–)\]$", label)
        assert within(panel, paper)
    assert any(ax.get_xlabel() for ax in fig.axes)
    for legend in fig.legends:
        box = legend.get_window_extent()
        assert within(box, paper)
        assert not any(box.overlaps(panel) for panel in panels)


def test_three_sigma_ellipses_and_longest_sigmas_are_what_theory_says():
    covariance = np.array([[0.5, 0.3], [0.3, 0.4]])
    samples = np.random.default_rng(5).multivariate_normal([1.0, -2.0], covariance, size=200_000)
    outline = ellipses(np.array([[1.0, -2.0]]), covariance[None], count=720)[0]
    assert Outline(outline).contains_points(samples).mean() == pytest.approx(0.98889, abs=0.0008)
    slightly = np.diag([-1e-18, 0.04, 0.01])
    path = replace(run_with_error(ZERO).trajectory("online"), covariance=np.tile(slightly, (FRAMES, 1, 1)))
    assert sigmas(path)[0] == pytest.approx([0.0, 0.2, 0.1])
    assert longest_sigma(path)[0] == pytest.approx(0.2)
    assert np.isfinite(ellipses(np.zeros((1, 2)), slightly[None, :2, :2])).all()
    a, b = np.cos(0.7), np.sin(0.7)
    R = np.array([[a, -b], [b, a]])
    P = np.zeros((FRAMES, 3, 3))
    P[:, :2, :2] = R @ np.diag([0.09, 0.01]) @ R.T
    assert longest_sigma(replace(run_with_error(ZERO).trajectory("online"), covariance=P)) == pytest.approx(0.3)


def test_what_runs_away_is_cut_and_the_rest_of_the_map_is_shown():
    away = run_with_error(np.outer(np.arange(FRAMES), [50.0, 0.0, 0.0]), estimator="ekf-fej")
    ax = map_figure(circle_log(), [FILTER, away]).axes[0]
    # truth and landmarks span 12 m; a quarter more on the side where the path leaves, and the margin
    assert np.ptp(ax.get_xlim()) < 12.0 * 1.25 * 1.1 + 0.1
    assert "not shown in full: first-estimates EKF (online)" in ax.get_title(loc="left")
    far = MapEstimate(
        number=np.array([0, 1, 2]), xy=np.array([[6.1, 0.1], [7.5, 0.0], [900.0, 0.0]]),
        covariance=np.tile(0.01 * np.eye(2), (3, 1, 1)), first_frame=np.zeros(3), times_seen=np.ones(3),
    )  # fmt: skip
    ax = map_figure(circle_log(), [replace(FILTER, map=far)]).axes[0]
    assert 7.8 < ax.get_xlim()[1] < 9.0
    assert "not shown in full: map of EKF (online)" in ax.get_title(loc="left")


def test_ellipses_too_small_to_see_are_enlarged_by_a_round_factor_that_the_legend_states():
    view = View(np.zeros(2), np.array([100.0, 60.0]))
    assert enlargement(view, np.array([5.0, 5.0])) == 1
    assert enlargement(view, np.array([0.1, 0.1, 0.1])) == 20  # 1.2 % of 100 m is 1.2 m: 0.1 m needs a factor of 12
    assert enlargement(view, np.empty(0)) == 1
    # 3 mm against 1.2 % of 14 m
    certain = replace(FILTER.trajectory("online"), covariance=1e-6 * np.tile(np.eye(3), (FRAMES, 1, 1)))
    fig = map_figure(circle_log(), [replace(FILTER, online=certain, map=None)])
    assert "3σ ellipses, drawn 100 times larger" in [t.get_text() for t in fig.legends[0].get_texts()]
    drawn = np.concatenate([p.vertices for c in fig.axes[0].collections for p in c.get_paths()[:1]])
    assert np.ptp(drawn, axis=0) == pytest.approx(2 * 3.0 * 1e-3 * 100, rel=0.01)


def test_a_long_curve_is_thinned_without_losing_an_extreme_or_a_gap():
    curve = np.random.default_rng(2).normal(size=50_000)
    curve[31_234], curve[1_111] = 90.0, -80.0
    curve[20_030] = np.nan
    keep = thinned(curve)
    assert len(keep) < 5 * MOST_BINS
    assert keep[0] == 0
    assert keep[-1] == 49_999
    assert {31_234, 1_111} <= set(keep.tolist())
    assert np.isnan(curve[keep]).any()
    assert len(thinned(curve[: 4 * MOST_BINS])) == 4 * MOST_BINS


def test_errors_are_wrapped_in_degrees_in_four_columns_and_say_who_stopped():
    log = circle_log()
    heading = error_figure(log, [run_with_error(np.array([0.0, 0.0, 2.0 * np.pi - 0.01]))]).axes[2]
    assert heading.lines[-1].get_ydata() == pytest.approx(np.degrees(-0.01))
    assert heading.lines[0].get_ydata() == pytest.approx(3.0 * np.degrees(SIGMA[2]))
    log, runs = SITUATIONS["six phases"]
    fig = error_figure(log, runs)
    assert len(fig.axes) == 12
    assert "not shown: batch, Cauchy, known (final), EKF, jcbb (online)" in fig.get_suptitle()
    fig = error_figure(*SITUATIONS["a run stopped"])
    assert "diverged at frame 15" in fig.axes[0].get_title()
    legend = map_figure(*SITUATIONS["a run stopped"]).legends[0]
    assert any("diverged at frame 15" in t.get_text() for t in legend.get_texts())


def test_nees_and_difference_are_those_computed_by_hand():
    fig = nees_figure(circle_log(), [run_with_error(SIGMA)])
    assert fig.axes[0].lines[-1].get_ydata() == pytest.approx(3.0)
    assert "mean 3" in fig.axes[0].get_title(loc="left")
    assert "pose NEES of one run" in fig.get_suptitle()
    log = circle_log(truth=False)
    off = run_with_error(np.array([0.3, 0.4, 0.0]))
    fig = difference_figure(log, [off, SMOOTHER], replace(SMOOTHER, final=run_with_error(ZERO).trajectory("online")))
    assert fig.axes[0].lines[-1].get_ydata() == pytest.approx(0.5)
    assert fig.axes[0].lines[0].get_ydata() == pytest.approx(3.0 * SIGMA[1])
    assert "not an error" in fig.get_suptitle()


def test_average_nees_states_its_band_and_how_much_lies_outside():
    values = np.full(20, 3.0)
    values[:5] = 9.0
    fig = anees_figure(np.arange(20.0), {"ekf": values}, 3, 50, title="arena")
    fig.draw_without_rendering()
    labels = [t.get_text() for t in fig.legends[0].get_texts()]
    # chi-square with 150 degrees of freedom, 2.5 % and 97.5 %, from tables: 117.98 and 185.80
    assert labels[1] == "95 % band 2.36 to 3.72: 5 % outside by design"
    assert labels[0] == "EKF: mean 4.50, 25 % outside" or labels[0] == "EKF: mean 4.5, 25 % outside"
    assert fig.axes[0].get_title(loc="left") == "arena: average pose NEES over 50 runs, dof 3"

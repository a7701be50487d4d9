"""Figures without truth, of studies and of associations: what they show of runs counted by hand; nothing is cut."""

import itertools
import re
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from data.result import Innovations
from eval.figures.claims import anees_figure, claims_figure, outlier_figure, stretches_of
from eval.figures.style import STYLES
from eval.referee.score import Trial
from eval.report.publish import draw, kinds
from tests.eval.figures.looks import within
from tests.eval.handmade import FRAMES, SIGMA, circle_log, run_with_error
from tests.quick import slow

OFF = np.array([0.1, -0.1, 0.02])


def with_innovations(run, nis, dof):
    n = len(nis)
    return replace(run, innovations=Innovations(np.asarray(nis, float), np.asarray(dof), np.zeros(n), np.zeros((4, 2))))


def texts(fig):
    return [t.get_text() for legend in fig.legends for t in legend.get_texts()]


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


def test_claims_are_drawn_where_there_is_no_truth_and_only_there(tmp_path):
    run = with_innovations(run_with_error(OFF, association="jcbb-hindsight"), np.full(FRAMES, 4.0), np.full(FRAMES, 4))
    blind = Trial(circle_log(truth=False), "slam", (run,))
    assert "claims" in kinds(blind)
    assert "claims" not in kinds(Trial(circle_log(), "slam", (run,)))
    assert "claims" not in kinds(blind, quick=True)
    picture = draw(tmp_path, blind, "claims")
    assert blind.log.name in picture.caption
    assert (tmp_path / "figures" / f"{picture.stem}.png").exists()


EIGHT = ["ekf", "ekf-iterated", "ekf-fej", "ekf-invariant", "batch", "isam2", "fixed-lag", "gnc"]
RATES = [0.0, 0.01, 0.05, 0.1, 0.2]


def averages(names, factor=1.0):
    rng = np.random.default_rng(4)
    return {name: factor**i * rng.chisquare(150, 200) / 50 for i, name in enumerate(names)}


def outliers(names, tasks=("localization", "slam"), growth=4.0):
    rows = [
        (task, name, rate, m := 0.05 * (1 + growth * i * rate), 0.9 * m, 1.2 * m, 60 * m, 50 * m, 70 * m)
        for task in tasks
        for i, name in enumerate(names)
        for rate in RATES
    ]
    columns = "task estimator rate rmse_position_m rmse_lower rmse_upper nees_pose nees_lower nees_upper"
    return pd.DataFrame(rows, columns=columns.split())


FIGURES = {
    "average, eight": lambda: anees_figure(np.arange(200.0), averages(EIGHT), 3, 50, title="circle"),
    "average, apart": lambda: anees_figure(np.arange(200.0), averages(EIGHT, 3.0), 3, 50, title="circle"),
    "outliers": lambda: outlier_figure(outliers(["ekf", "batch", "batch-huber", "batch-cauchy", "gnc"]), "arena"),
    "outliers, eight": lambda: outlier_figure(outliers(EIGHT, ("slam",), 400.0), "arena"),
}


@pytest.mark.parametrize("kind", [kind if "eight" in kind else slow(kind) for kind in FIGURES])
def test_nothing_is_cut_and_no_panel_title_or_legend_lies_on_another(kind):
    fig = FIGURES[kind]()
    fig.draw_without_rendering()
    shown = [ax for ax in fig.axes if ax.get_visible()]
    boxes = [ax.get_tightbbox() for ax in shown] + [legend.get_window_extent() for legend in fig.legends]
    assert all(within(box, fig.bbox) for box in boxes)
    for a, b in itertools.combinations(boxes, 2):
        assert min(a.x1, b.x1) - max(a.x0, b.x0) < 1.0 or min(a.y1, b.y1) - max(a.y0, b.y0) < 1.0
    for label in (text for ax in shown for text in (ax.get_xlabel(), ax.get_ylabel())):
        assert label == "" or re.search(r"\[(m|s|%|–)\]$", label), label


def test_curves_of_average_nees_carry_markers_at_different_times_on_an_axis_with_plain_ticks():
    lines = anees_figure(np.arange(200.0), averages(EIGHT), 3, 50).axes[0].lines[1:]
    assert [line.get_marker() for line in lines] == [STYLES[name].marker for name in EIGHT]
    places = [set(range(*slice(line.get_markevery()[0], 200, line.get_markevery()[1]).indices(200))) for line in lines]
    assert all(len(p) >= 7 for p in places)
    assert not any(a & b for a, b in itertools.combinations(places, 2))
    ax = FIGURES["average, apart"]().axes[0]
    assert ax.get_yscale() == "log"
    assert [ax.yaxis.get_major_formatter()(y) for y in (0.1, 1.0, 1000.0)] == ["0.1", "1", "1000"]


def test_outliers_have_a_row_per_task_gaps_where_nothing_was_measured_and_log_axes_if_they_must():
    table = outliers(["ekf", "gnc"])
    fig = outlier_figure(table.sample(frac=1.0, random_state=1).sort_values("task"), "arena")
    assert [ax.get_title(loc="left") for ax in fig.axes] == ["localization", "localization", "slam", "slam"]
    assert [t.get_text() for t in fig.axes[2].get_xticklabels()] == ["0", "1", "5", "10", "20"]
    drawn = {c.lines[0].get_marker(): c.lines[0] for c in fig.axes[0].containers}
    expected = table[(table.task == "localization") & (table.estimator == "gnc")]
    assert drawn[STYLES["gnc"].marker].get_ydata() == pytest.approx(expected.rmse_position_m.to_numpy())
    assert np.diff(drawn[STYLES["gnc"].marker].get_xdata()) == pytest.approx(1.0)
    even = outlier_figure(outliers(["ekf", "gnc"]), "arena").axes
    assert [ax.get_yscale() for ax in even] == ["linear"] * 4
    apart = outlier_figure(outliers(EIGHT, ("slam",), 400.0), "arena").axes
    assert [ax.get_yscale() for ax in apart] == ["log"] * 2
    assert [np.asarray(line.get_ydata()).tolist() for line in apart[1].lines if len(line.get_ydata()) == 2] == [[3, 3]]
    table = outliers(["ekf", "gnc"], ("slam",))
    table.loc[table.rate == 0.05, ["rmse_position_m", "rmse_lower", "rmse_upper"]] = np.nan
    table.loc[table.rate == 0.1, ["rmse_lower", "rmse_upper"]] = np.nan
    fig = outlier_figure(table, "arena")
    fig.draw_without_rendering()
    line, _, (bars,) = fig.axes[0].containers[0].lines
    assert np.isnan(line.get_ydata()).tolist() == [False, False, True, False, False]
    assert np.ptp(bars.get_segments()[3][:, 1]) == 0.0

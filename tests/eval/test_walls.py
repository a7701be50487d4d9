"""Walls from replay to figures: what runs, what is refused with its reason, and that nothing takes them for points."""

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.collections import PolyCollection

from data.errors import UsageError
from data.formats.g2o import graph_text, labelled
from data.inputs import Systematic
from data.notice import Code
from data.result import MapEstimate
from ekf.filter import FilterOptions
from eval.compare import compare
from eval.figures.map import log_figure, map_figure
from eval.figures.plane import chords
from eval.plan.calibrate import every
from eval.referee import lost
from eval.referee.plausibility import implausibility
from eval.referee.score import association_row, metrics_row
from eval.replay.estimators import lack_with_sensor
from eval.replay.map_management import Parking
from eval.replay.run import step_by_step
from eval.replay.settings import Setup
from tests.ekf.lines.world import line_log, walls
from tests.eval.handmade import circle_log

WAYS = ("nn", "ml", "singles", "gnn", "jcbb-first", "jcbb")


@pytest.fixture(scope="module")
def log():
    return line_log(3, seconds=110.0)


@pytest.fixture(scope="module")
def run(log):
    return compare(log.inputs(labels=True), "slam", ["ekf"])[0]


@pytest.mark.parametrize(("task", "way"), [
    ("slam", "nn"), ("slam", "jcbb"), ("localization", "gnn"), ("localization", "ml-ratio"),
    *(
        pytest.param(task, w, marks=pytest.mark.slow) for task in ("localization", "slam") for w in WAYS
        if (task, w) not in {("slam", "nn"), ("slam", "jcbb"), ("localization", "gnn")}
    ),
])  # fmt: skip
def test_every_method_without_hindsight_pairs_walls_rightly(log, task, way):
    """All but the ratio test in SLAM, which takes two of three readings for new, whatever landmarks are."""
    (found,) = compare(log.recorded, task, ["ekf"], way)
    assert found.status == "ok"
    row = association_row(found, "online", log)
    assert row["wrong"] + row["spurious"] <= 0.02 * row["tp"]
    assert row["tp"] > 100
    assert metrics_row(found, "online", log, None)["rmse_position_m"] < 0.2


@pytest.mark.parametrize(("name", "task", "way", "reason"), [
    ("ekf-invariant", "slam", "known", "moves landmarks as points"),
    ("ekf-invariant", "slam", "jcbb", "moves landmarks as points"),
    ("ekf", "slam", "jcbb-hindsight", "walls can be paired by jcbb"),
    ("ekf", "localization", "jcbb-hindsight", "walls can be paired by jcbb"),
])  # fmt: skip
def test_what_walls_forbid_is_incomplete_with_its_reason_and_others_go_on(log, name, task, way, reason):
    runs = compare(log.inputs(labels=way == "known"), task, [name, "dead-reckoning"], way)
    assert [r.status for r in runs] == ["incomplete", "ok"]
    assert reason in runs[0].failure.why


@pytest.mark.parametrize(("name", "task", "way", "options", "reason"), [
    ("ekf", "slam", "jcbb", None, None),
    ("ekf", "localization", "known", None, None),
    ("ekf", "localization", "jcbb-hindsight", None, "knows landmarks as points, walls can be paired by jcbb"),
    ("isam2", "slam", "jcbb-hindsight", None, "knows landmarks as points, walls can be paired by jcbb"),
    ("isam2", "slam", "jcbb", None, None),
    ("ekf-invariant", "slam", "jcbb", None, "moves landmarks as points"),
    ("ekf-invariant", "localization", "jcbb", None, None),
    ("ekf-invariant", "slam", "jcbb", FilterOptions(), None),
    ("ekf", "slam", "jcbb", FilterOptions(invariant=True), "moves landmarks as points"),
    ("isam2", "slam", "jcbb", FilterOptions(invariant=True), "moves landmarks as points"),
    ("ekf", "slam", "nn", FilterOptions(new_variance=0.1), "have no variance in common"),
    ("ekf", "localization", "nn", FilterOptions(new_variance=0.1), None),
])  # fmt: skip
def test_before_a_run_it_is_said_why_walls_forbid_it(log, name, task, way, options, reason):
    why = lack_with_sensor(name, task, way, log.recorded, options)
    assert why is None if reason is None else reason in str(why)
    assert lack_with_sensor(name, task, way, circle_log().recorded, options) is None, "of points nothing is forbidden"


@pytest.mark.parametrize("name", ["range", "bearing"])
def test_errors_of_the_sensor_are_refused_with_their_reason(log, name):
    inputs = replace(log.inputs(labels=True), systematic=Systematic((name,), np.array([0.1])))
    (found,) = compare(inputs, "slam", ["ekf"])
    assert found.status == "incomplete"
    assert "with walls only odometry's errors can be estimated" in found.failure.why
    assert not set(every(inputs)) & {"range", "bearing"}


def test_a_wall_has_no_position_no_end_and_is_doubted_beyond_all_that_was_seen(log, run, monkeypatch):
    row = metrics_row(run, "online", log, None)
    assert row["landmarks"] == len(run.map) >= 8
    assert np.isnan(row["rmse_landmark_m"])
    assert np.isnan(row["rmse_landmark_majority_m"])
    assert "sse_landmark_m2" not in row
    assert association_row(run, "online", log)["share_within"] is None
    assert row["rmse_position_m"] > 0.0
    assert "lost_frame" not in row
    monkeypatch.setattr(lost, "former_observations", lambda *_: pytest.fail("a wall was expected to be in view"))
    assert lost.lost(run, log.recorded) is None
    xy = run.map.xy.copy()
    xy[0, 0] += 500.0
    far = replace(run, map=MapEstimate(run.map.number, xy, run.map.covariance, run.map.first_frame, run.map.times_seen))
    found = implausibility(far, log.inputs(labels=True)).notice
    assert (found.code, found.named["landmarks"]) == (Code.LANDMARKS_TOO_FAR, 1)


def test_walls_that_leave_the_state_come_back_before_they_are_paired(log, monkeypatch):
    every_time: list[int] = []
    own = Parking._restore
    monkeypatch.setattr(Parking, "_restore", lambda p, n: (every_time.append(len(n)), own(p, n))[1])
    setup = Setup(gate=0.9999)
    plain = step_by_step("ekf", log.recorded.without_map(), "slam", "jcbb", setup)
    parked = step_by_step("ekf", log.recorded.without_map(), "slam", "jcbb", replace(setup, deactivate_after=5.0))
    assert 0 < sum(every_time) <= 3 * len(plain.map), "not all of them in every frame"
    np.testing.assert_array_equal(parked.decisions, plain.decisions)
    np.testing.assert_allclose(parked.online.pose, plain.online.pose, atol=1e-7)
    assert parked.state_size.sum() < 0.9 * plain.state_size.sum()


def test_a_chord_is_what_a_rectangle_holds_of_a_straight_line():
    lines = np.array([[1.0, 0.0], [0.0, 0.25 * np.pi], [9.0, 1.0], [-2.0, -0.5 * np.pi]])
    rows, ends = chords(lines, np.array([-1.0, -2.0]), np.array([3.0, 4.0]))
    assert rows.tolist() == [0, 1, 3]
    for (rho, alpha), chord in zip(lines[rows], ends, strict=True):
        np.testing.assert_allclose(chord @ [np.cos(alpha), np.sin(alpha)], rho, atol=1e-12)
        assert np.all(chord >= [-1.0 - 1e-9, -2.0 - 1e-9])
        assert np.all(chord <= [3.0 + 1e-9, 4.0 + 1e-9])
        assert (np.isclose(chord, [-1.0, -2.0]) | np.isclose(chord, [3.0, 4.0])).any(axis=1).all()
    np.testing.assert_allclose(np.sort(ends[0][:, 1]), [-2.0, 4.0])


def test_the_map_shows_walls_as_lines_across_it_and_no_ellipses_of_them(log, run):
    ax = map_figure(log, [run]).axes[0]
    (x0, x1), (y0, y1) = ax.get_xlim(), ax.get_ylim()
    assert -2.0 < x0 < 0.0 < 10.0 < x1 < 12.0
    assert -2.0 < y0 < 0.0 < 6.0 < y1 < 8.0
    drawn = [line.get_xydata() for line in ax.lines if len(line.get_xdata()) == 2]
    for rho, alpha in walls()[1]:
        assert min([np.abs(d @ [np.cos(alpha), np.sin(alpha)] - rho).max() for d in drawn]) < 1e-9
    assert len(drawn) == len(walls()[1]) + len(run.map)
    ellipses = [c for c in ax.collections if isinstance(c, PolyCollection)]
    assert len(ellipses) == 2, "those along the path, filled and outlined"


def test_the_picture_of_the_log_stays_in_the_room(log):
    ax = log_figure(log).axes[0]
    assert np.ptp(ax.get_xlim()) < 20.0
    assert np.ptp(ax.get_ylim()) < 20.0
    assert sum(len(line.get_xdata()) == 2 for line in ax.lines) >= 8


def test_g2o_has_no_vertex_for_a_wall(log):
    with pytest.raises(UsageError, match="walls, which g2o has no vertex for"):
        graph_text(log.recorded, labelled(log))

"""Runs with physically impossible values are marked; runs with large errors alone are not."""

from dataclasses import replace

import numpy as np
import pytest

from data.inputs import LabelledObservations, LandmarkMap
from data.logs import open_log
from data.notice import Code, notice
from data.result import DISCARD, MapEstimate, Trajectory
from data.sensors import Line, RangeBearing
from eval.compare import compare
from eval.referee.plausibility import ABSURD, farthest_observed, first_misfit, judged, suspicions, with_plausibility
from tests.builders.logs import NOTHING, increments_of, inputs_of
from tests.eval.handmade import FRAMES, circle_log, run_with_error, true_path

INPUTS = circle_log().recorded
WAY = 2.0 * np.pi * 4.0
POINTS, WALLS = RangeBearing(max_range=8.0), Line(max_range=8.0)


def smoother(error=0.0, **changes):
    run = run_with_error(np.full(3, error), estimator="batch", phases=("final",))
    return replace(run, total_nis=(8.0, 8), **changes)


def with_map(run, xy, sigma=0.2):
    return replace(run, map=MapEstimate(np.array([0]), np.array([xy]), sigma**2 * np.eye(2)[None], run.map.first_frame,
                                        run.map.times_seen))  # fmt: skip


def test_a_cost_ten_times_as_large_as_claimed_is_implausible_and_twice_a_notice():
    assert with_plausibility(replace(smoother(), total_nis=(ABSURD * 8, 8)), INPUTS).implausible is None
    marked = with_plausibility(replace(smoother(), total_nis=(1.01 * ABSURD * 8, 8)), INPUTS)
    assert marked.status == "implausible"
    assert marked.flaw == marked.implausible
    assert marked.implausible.notice.code is Code.NIS
    assert marked.implausible.notice.named["per_dof"] == pytest.approx(101.0)
    assert list(suspicions(replace(smoother(), total_nis=(16.0, 8)), INPUTS)) == []
    (run,) = judged([replace(smoother(), total_nis=(20.0, 8))], INPUTS)
    assert run.status == "ok"
    assert run.notes[-1] == notice(Code.COST, per_dof=2.5)


def test_labels_left_out_by_the_gate_have_a_notice_from_a_tenth_on():
    log = circle_log()
    o = log.recorded.observations
    m = len(o.frame)
    inputs = replace(log.recorded, observations=LabelledObservations(o.frame, o.z, o.R, np.zeros(m, np.int64)))
    final = np.zeros(m, np.int64)
    run = replace(smoother(), association="known", final_decisions=final)
    assert list(suspicions(run, inputs)) == []
    final[: m // 2] = DISCARD
    (found,) = suspicions(replace(run, final_decisions=final), inputs)
    assert (found.code, found.named["share"]) == (Code.LABELS_LEFT_OUT, pytest.approx(0.5, abs=0.01))


def test_the_frame_is_the_first_that_does_not_fit_or_that_is_farther_than_was_driven():
    path = true_path()
    path[20:, 0] += 5.0  # a jump that the odometry, known to a centimetre, does not have
    run = replace(smoother(), final=Trajectory(path, np.tile(np.eye(3), (FRAMES, 1, 1))), total_nis=(1e4, 8))
    assert first_misfit(run, INPUTS) == 20
    assert with_plausibility(run, INPUTS).implausible.frame == 20
    path = true_path()
    path[25:, 1] += 4.0 * WAY
    run = replace(smoother(), final=Trajectory(path, np.tile(0.01 * np.eye(3), (FRAMES, 1, 1))))
    assert with_plausibility(run, INPUTS).implausible.frame == 25
    path[25:, 1] -= 3.5 * WAY
    run = replace(run, final=Trajectory(path, run.final.covariance))
    assert with_plausibility(run, INPUTS).implausible is None


def test_a_landmark_where_the_sensor_cannot_have_seen_it_is_implausible():
    seen = farthest_observed(INPUTS)
    assert 16.0 < seen < 18.0  # twice the range of 8 m, and noise
    beyond = [4.0 + seen + 1.0, 0.0]  # of the first poses, which saw it
    assert with_plausibility(with_map(smoother(), beyond), INPUTS).implausible.notice.code is Code.LANDMARKS_UNSEEN
    assert with_plausibility(with_map(smoother(), [4.0 + seen - 1.0, 0.0]), INPUTS).implausible is None
    # where a filter's landmark was seen from is known only as it was believed then
    assert with_plausibility(with_map(run_with_error(np.zeros(3)), beyond), INPUTS).implausible is None
    assert with_plausibility(with_map(run_with_error(np.zeros(3)), [1e4, 0.0]), INPUTS).status == "implausible"
    assert with_plausibility(with_map(run_with_error(np.zeros(3)), [np.inf, 0.0]), INPUTS).status == "implausible"


def test_a_covariance_larger_than_the_world_is_implausible_and_dead_reckonings_is_not():
    for run in (with_map(smoother(), [6.0, 0.0], 1e3), replace(
        smoother(), final=Trajectory(true_path(), np.tile(1e6 * np.eye(3), (FRAMES, 1, 1)))
    )):  # fmt: skip
        marked = with_plausibility(run, INPUTS)
        assert marked.status == "implausible"
        assert marked.implausible.notice.code is Code.COVARIANCE_TOO_LARGE
        assert marked.implausible.notice.named["sigma"] == pytest.approx(1000.0)
    vague = np.array(INPUTS.increments.covariance)
    vague[1:, 2, 2] = 1e3  # rad^2: the stated sigma of the position is far larger than the distance driven
    inputs = replace(INPUTS, increments=replace(INPUTS.increments, covariance=vague))
    (reckoned,) = compare(inputs, "slam", ["dead-reckoning"])
    assert np.sqrt(reckoned.online.covariance[-1, 0, 0]) > 2.0 * (WAY + 40.0)
    assert replace(smoother(), final=reckoned.online, association="known").implausible is None
    assert not judged([replace(smoother(), final=reckoned.online, map=None)], inputs)[0].implausible


@pytest.mark.parametrize(("name", "marked"), [
    ("arena:0", set()), ("corridor:0:people", set()),
    pytest.param("corridor:0:no-odometry", {"ekf"}, marks=pytest.mark.slow),
    ("corridor:0:no-odometry+forward", {"ekf"}),
])  # fmt: skip
def test_diverged_runs_on_simulated_logs_are_marked(name, marked):
    runs = compare(open_log(name).inputs(labels=True), "slam", ["ekf", "isam2", "batch"])
    assert {r.estimator for r in runs if r.status == "implausible"} == marked
    for run in runs:
        assert (run.total_nis[0] > 100.0 * run.total_nis[1]) == (run.estimator in marked)


def way_at_frame_20(landmarks=None, sensor=POINTS):
    """From (5, -3), 1 m a frame, sigmas 0.2 m, 0.5 m at first: by frame 20 in 20 (1 + 3 * 0.2) + 3 * 0.5 = 33.5 m."""
    known = None if landmarks is None else LandmarkMap(np.arange(len(landmarks)), np.array(landmarks))
    mean = np.tile([1.0, 0.0, 0.0], (FRAMES, 1))
    steps, spread = increments_of(mean, np.diag([0.04, 0.01, 1e-4])), np.diag([0.01, 0.25, 1e-4])
    return inputs_of(steps, NOTHING, sensor, known, start=[5.0, -3.0, 0.0], spread=spread)


@pytest.mark.parametrize(("task", "landmarks", "sensor", "reach"), [
    ("slam", None, POINTS, 33.5),
    ("localization", [[35.0, 37.0], [5.0, -2.0]], POINTS, 33.5 + 50.0),
    ("localization", np.empty((0, 2)), POINTS, 33.5),
    ("slam", [[35.0, 37.0], [5.0, -2.0]], POINTS, 33.5),
    # the corner of a room is farther than its walls
    ("localization", [[45.0, 0.0], [2.0, np.pi]], WALLS, 33.5 + np.sqrt(2.0) * 40.0),
    ("localization", [[45.0, 0.0], [47.0, -np.pi / 2.0]], WALLS, 33.5 + np.sqrt(2.0) * 44.0),
])  # fmt: skip
def test_a_robot_may_be_within_the_distance_driven_and_anywhere_in_its_map(task, landmarks, sensor, reach):
    inputs = way_at_frame_20(landmarks, sensor)
    most = 2.0 * (reach + 8.0)  # and the range of the sensor
    for away, marked in ((most - 0.1, False), (most + 0.1, True)):
        path = np.column_stack([5.0 + np.arange(FRAMES), np.full(FRAMES, -3.0), np.zeros(FRAMES)])
        path[20] = 5.0 + 0.6 * away, -3.0 + 0.8 * away, 0.0
        final = Trajectory(path, np.tile(0.01 * np.eye(3), (FRAMES, 1, 1)))
        decisions = np.empty(0, np.int64)
        run = smoother(final=final, task=task, map=None, decisions=decisions, final_decisions=decisions)
        found = with_plausibility(run, inputs).implausible
        assert (found is not None) == marked
    assert found.frame == 20
    assert found.notice.code is Code.PATH_TOO_FAR
    assert found.notice.named == pytest.approx({"phase": "final", "away": away, "driven": reach})

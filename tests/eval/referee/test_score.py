"""Rows of metrics.csv: implausible runs, optimizers, true ids by majority, filters against smoothers, NEES, lag 1."""

import math
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from data import se2
from data.logs import open_log
from data.notice import stopped
from data.result import Failure, MapEstimate, Trajectory
from data.worlds.arena import Arena, simulate
from eval.referee.consistency import THIN, lag1, lag1_correlation, nearly_singular, nis_bounds
from eval.referee.errors import along
from eval.referee.score import Trial, score
from eval.replay.run import compare
from eval.studies.montecarlo import sample
from eval.studies.scenario import load_scenario
from tests.eval.handmade import LANDMARKS, circle_log, run_with_error

DOUBT = Failure("implausible", 3, stopped("NIS per degree of freedom is 400"))
EKF = run_with_error(np.array([0.3, 0.0, 0.0]))
BATCH = replace(
    run_with_error(np.array([0.1, 0.0, 0.0]), estimator="batch", phases=("final",)), iterations=7, last_step_sigma=2e-5
)


def rows(*runs, log=None):
    scores = score([Trial(log or circle_log(), "slam", runs)])
    return {r["estimator"]: r for r in scores.metrics.to_dict("records")}, scores


def test_its_numbers_are_shown_and_nothing_is_measured_against_it():
    sound, with_both = rows(EKF, BATCH)
    assert sound["ekf"]["rms_from_batch_m"] == pytest.approx(0.2)
    assert len(with_both.differences) == 1
    marked, scores = rows(EKF, replace(BATCH, implausible=DOUBT))
    assert marked["batch"]["status"] == "implausible"
    assert marked["batch"]["rmse_position_m"] == pytest.approx(0.1)
    assert pd.isna(marked["ekf"]["rms_from_batch_m"])
    assert not len(scores.differences)
    assert len(scores.association) == 4


def test_how_the_optimization_ended_stands_in_the_final_row_of_a_smoother():
    found, _ = rows(EKF, BATCH)
    assert (found["batch"]["iterations"], found["batch"]["last_step_sigma"]) == (7, 2e-5)
    assert pd.isna(found["ekf"]["iterations"])
    table = rows(replace(BATCH, estimator="isam2", online=EKF.online))[1].metrics
    assert table["iterations"].fillna(-1).tolist() == [-1, 7]


def test_landmarks_named_by_majority_have_the_most_frequent_true_id():
    first_wrong = np.array([7, 3, 3, 3])
    log = circle_log()
    log = replace(log, truth=replace(log.truth, landmark_of=first_wrong))
    there = MapEstimate(np.array([0]), LANDMARKS.xy[:1], 0.04 * np.eye(2)[None], np.array([0]), np.array([4]))
    found, scores = rows(replace(EKF, map=there), log=log)
    assert found["ekf"]["rmse_landmark_m"] == pytest.approx(12.0)  # from 3 at (6, 0) to 7 at (-6, 0)
    assert found["ekf"]["rmse_landmark_majority_m"] == 0.0
    assert scores.association["fp"].tolist() == [3, 3]
    assert scores.association["majority_agreement"].tolist() == [1.0, 1.0]
    unknown, scores = rows(EKF, log=replace(log, truth=replace(log.truth, landmark_of=None)))
    assert pd.isna(unknown["ekf"]["rmse_landmark_majority_m"])
    assert not len(scores.association)


@pytest.fixture(scope="module")
def scores():
    log = open_log("arena:0")
    runs = compare(log.inputs(labels=True), "localization", ["ekf", "ekf-iterated", "isam2", "batch"])
    return score([Trial(log, "localization", tuple(runs))])


def test_every_filter_is_compared_with_every_smoothers_final_path(scores):
    rows = scores.differences.to_dict("records")
    assert [(r["a"], r["b"]) for r in rows] == [
        (a, b) for a in ("ekf", "ekf-iterated") for b in ("isam2", "batch")
    ]  # fmt: skip
    assert {(r["phase_a"], r["phase_b"], r["association"]) for r in rows} == {("online", "final", "known")}


def test_a_row_holds_the_differences_of_the_metrics_with_an_interval_about_them(scores):
    row = scores.differences.to_dict("records")[1]
    metrics = {(r["estimator"], r["phase"]): r for r in scores.metrics.to_dict("records")}
    for name in ("rmse_position_m", "nees_pose"):
        difference = metrics["ekf", "online"][name] - metrics["batch", "final"][name]
        assert row[name] == pytest.approx(difference, rel=1e-9)
    assert row["rmse_position_lower"] < row["rmse_position_m"] < row["rmse_position_upper"]
    assert row["nees_pose_lower"] < row["nees_pose"] < row["nees_pose_upper"]
    assert row["rmse_position_p"] < 0.01 < row["nees_pose_p"]
    assert all(pd.isna(row[c]) for c in ("rmse_position_why", "nees_pose_why"))
    assert 1.0 <= row["block_frames"] <= 20.0


def test_slam_has_no_interval_of_one_log_and_compares_paths_after_alignment(monkeypatch):
    """One log shows one draw of the frame's error: measured, 4 and 13 % of such intervals held the mean of 60 logs."""
    monkeypatch.setattr("tests.eval.handmade.FRAMES", 400)
    rng = np.random.default_rng(3)
    noise = [np.array([s, s, 0.0]) * rng.standard_normal((400, 3)) for s in (0.1, 0.05)]
    filtered = run_with_error(noise[0], task="localization")
    smoothed = run_with_error(noise[1], estimator="batch", phases=("final",), task="localization")
    assert filtered.online is not None
    off = replace(filtered.online, pose=se2.compose(np.array([3.0, 1.0, 0.5]), filtered.online.pose))
    mapped = (replace(filtered, task="slam", online=off), replace(smoothed, task="slam"))
    tables = {
        "localization": score([Trial(circle_log(), "localization", (filtered, smoothed))]),
        "slam": score([Trial(circle_log(), "slam", mapped)]),
    }
    for task, scored in tables.items():
        slam, (row,) = task == "slam", scored.differences.to_dict("records")
        bounds = ["rmse_position_lower", "rmse_position_upper", "nees_pose_lower", "nees_pose_upper", "block_frames"]
        assert scored.metrics[bounds].isna().to_numpy().all() == slam
        assert scored.metrics[bounds].notna().to_numpy().all() != slam
        assert row["rmse_position_m"] == pytest.approx(0.05 * 2**0.5, abs=0.01), "its frame is none"
        assert row["rmse_position_p"] < 0.05
        assert pd.isna(row["nees_pose_p"]) == slam
        assert ("one draw" in str(row["nees_pose_why"])) == slam


def test_a_frame_as_thin_as_the_floor_is_in_no_nees_and_no_score():
    run = run_with_error(np.array([0.1, 0.0, 0.0]))
    covariance = run.online.covariance.copy()
    covariance[0] = 1e-9 * np.eye(3)
    thin = replace(run, online=Trajectory(run.online.pose, covariance))
    path = along(thin, "online", circle_log())
    assert np.flatnonzero(np.isnan(path.nees["pose"])).tolist() == np.flatnonzero(path.thin).tolist() == [0]
    sound, row = (score([Trial(circle_log(), "slam", (r,))]).metrics.iloc[0] for r in (run, thin))
    assert row["log_score"] == pytest.approx(sound["log_score"])


def test_an_exact_prior_is_left_out_and_bounds_of_nis_are_lower_behind_a_gate():
    floor = 1e-10  # Seen: one frame after an exact prior, NEES 15 725, of a run whose median is 1.8.
    P = np.tile(np.diag([1e-4, 2e-10, 1e-4]), (3, 1, 1))
    P[1, 1, 1] = 2.0 * THIN * floor
    P[2] = np.nan
    assert nearly_singular(P, floor).tolist() == [True, False, False]
    assert nis_bounds(100) == pytest.approx((0.7422, 1.2956), abs=1e-4)
    lower, upper = nis_bounds(1000, (0.9535, 1.567))
    assert lower < 0.9535 < upper < 1.04
    assert nis_bounds(1000)[0] < lower + 0.06
    assert all(np.isnan(nis_bounds(0)))


WORLD = Arena(frames=60, field_of_view=2 * math.pi, landmarks=12)


def with_stated_noise(factor):
    """A log whose stated variances, of motion and of observations, are `factor` times the true ones."""
    log = simulate(WORLD, 3)
    r = log.recorded
    increments = replace(r.increments, covariance=factor * r.increments.covariance)
    observations = replace(r.observations, R=factor * r.observations.R)
    return replace(log, recorded=replace(r, increments=increments, observations=observations))


def innovations(log, task="localization"):
    (run,) = compare(log.inputs(labels=True), task, ("ekf",), "known")
    return run, Trial(log, task, (run,))


@pytest.mark.parametrize("factor", [1e-4, 1.0, 1e4])
def test_the_column_is_a_correlation_whatever_noise_is_stated(factor):
    row = score([innovations(with_stated_noise(factor))[1]]).metrics.iloc[0]
    assert -1.0 <= row["innovation_lag1"] <= 1.0
    assert 0.0 < row["innovation_lag1_se"] < 1.0


def test_a_constant_innovation_is_fully_correlated_and_one_without_spread_is_left_out():
    white = np.tile([30.0, -7.0], (9, 1))
    frame, number = np.arange(9), np.zeros(9, int)
    assert lag1(white, frame, number)[0] == pytest.approx((30.0**2 + 7.0**2) / 2)
    assert lag1_correlation(white, frame, number)[0] == pytest.approx(1.0)
    frame, number = np.arange(3), np.zeros(3, int)
    flat = np.array([[1.0, 0.0], [-1.0, 0.0], [1.0, 0.0]])
    assert lag1_correlation(flat, frame, number) == pytest.approx((-1.0, math.sqrt(0.5)))
    for nothing in (0.0 * flat, flat[:0]):
        assert all(math.isnan(v) for v in lag1_correlation(nothing, frame[: len(nothing)], number[: len(nothing)]))


def test_the_verdict_of_studies_keeps_the_unit_of_the_claim():
    log = with_stated_noise(0.04)
    run, trial = innovations(log)
    assert run.flaw is None
    seen = sample(run, "online", log, load_scenario("arena")).means["whiteness"]
    assert seen == lag1(run.innovations.white, log.recorded.observations.frame, run.decisions)[0]
    assert seen != pytest.approx(score([trial]).metrics.iloc[0]["innovation_lag1"])

"""Filters against smoothers on one log: pairs, values and missing intervals."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from data import se2
from data.logs import open_log
from data.notice import stopped
from data.result import Failure, Trajectory
from eval.referee.errors import along
from eval.referee.score import Trial, score
from eval.replay.run import compare
from tests.eval.handmade import circle_log, run_with_error


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


def test_a_short_log_has_scores_and_differences_without_intervals_and_says_why():
    runs = (
        run_with_error(np.array([0.1, 0.0, 0.0])),
        run_with_error(np.zeros(3), estimator="batch", phases=("final",)),
    )
    scored = score([Trial(circle_log(), "localization", tuple(replace(r, task="localization") for r in runs))])
    (row,) = scored.differences.to_dict("records")
    assert row["rmse_position_m"] == pytest.approx(0.1)
    assert all(pd.isna(row[c]) for c in ("rmse_position_lower", "rmse_position_p", "nees_pose_p"))
    assert "40 frames with truth are too few" in row["rmse_position_why"]
    first = scored.metrics.to_dict("records")[0]
    assert all(pd.isna(first[c]) for c in ("rmse_position_lower", "block_frames"))
    assert first["energy_score_m"] > 0.0


def test_runs_that_failed_other_associations_and_logs_without_truth_are_not_compared():
    error = np.zeros(3)
    filtered, smoothed = run_with_error(error), run_with_error(error, estimator="batch", phases=("final",))
    failed = run_with_error(error, failure=Failure("diverged", 5, stopped("covariance not positive definite")))
    other = run_with_error(error, association="jcbb")
    assert len(score([Trial(circle_log(), "slam", (failed, smoothed))]).differences) == 0
    assert len(score([Trial(circle_log(), "slam", (other, smoothed))]).differences) == 0
    assert len(score([Trial(circle_log(truth=False), "slam", (filtered, smoothed))]).differences) == 0

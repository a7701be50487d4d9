"""Rows of metrics.csv: implausible runs, optimizers, true ids of landmarks by majority."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from data.notice import stopped
from data.result import Failure, MapEstimate
from eval.referee.score import Trial, score
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
    both = replace(BATCH, estimator="isam2", online=EKF.online)
    table = rows(both)[1].metrics
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

"""RMSE, alignment and landmark errors, computed by hand."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from data.inputs import LandmarkMap
from data.sensors import Line, RangeBearing
from data.truth import Truth
from data.worlds.arena import Arena, simulate
from eval.referee import errors

TRUTH = np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0], [3, 0, 0]])


def test_position_rmse_is_the_root_of_the_mean_square_over_frames_with_truth():
    pose = TRUTH + [[3, 4, 0], [0, 0, 0], [0, 0, 0], [0, 0, 0]]
    assert errors.rms(errors.position_distance(pose, TRUTH)) == pytest.approx(math.sqrt(25 / 4))
    hidden = TRUTH.copy()
    hidden[1:3] = np.nan
    assert errors.rms(errors.position_distance(pose, hidden)) == pytest.approx(math.sqrt(25 / 2))


def test_nothing_to_measure_is_nan_not_zero():
    nothing = np.full_like(TRUTH, np.nan)
    assert math.isnan(errors.rms(errors.position_distance(TRUTH, nothing)))
    assert math.isnan(errors.aligned_rmse(TRUTH, nothing))
    assert math.isnan(errors.time_weighted_rmse(TRUTH, nothing, np.arange(4.0)))


def test_headings_just_across_the_seam_are_close():
    pose = TRUTH + [0, 0, math.radians(359)]
    assert errors.heading_rmse_deg(pose, TRUTH) == pytest.approx(1.0)


def test_time_weighting_counts_seconds_not_frames():
    time = np.array([0.0, 0.1, 0.2, 10.0])
    pose = TRUTH + [[1, 0, 0], [1, 0, 0], [1, 0, 0], [0, 0, 0]]
    weights = np.array([0.05, 0.1, 4.95, 4.9])
    assert errors.frame_weights(time) == pytest.approx(weights)
    assert errors.time_weighted_rmse(pose, TRUTH, time) == pytest.approx(math.sqrt(5.1 / 10.0))


def test_alignment_undoes_a_rigid_motion_but_not_a_mirror_or_a_scale():
    rng = np.random.default_rng(0)
    truth = np.column_stack([rng.normal(size=(30, 2)), np.zeros(30)])
    c, s = math.cos(2.0), math.sin(2.0)
    moved = truth.copy()
    moved[:, :2] = truth[:, :2] @ np.array([[c, -s], [s, c]]).T + [5, -7]
    assert errors.aligned_rmse(moved, truth) < 1e-12
    assert errors.aligned_rmse(truth * [1, -1, 1], truth) > 0.3
    assert errors.aligned_rmse(truth * [2, 2, 1], truth) > 0.3


def test_landmarks_are_compared_by_the_true_id_of_their_founding_observation():
    truth = Truth(
        landmarks=LandmarkMap(np.array([3, 8]), np.array([[1.0, 1], [2, 2]])), landmark_of=np.array([8, 3, 8, -1, 99])
    )
    created = np.array([0, 1, -1, 2, 3])
    ids = errors.landmark_true_ids(created, truth, np.array([0, 1, 2, 3]))
    assert ids.tolist() == [8, 3, -1, 99]
    off = errors.landmark_errors(np.array([[2.0, 3], [1, 1], [0, 0], [9, 9]]), ids, truth, RangeBearing())
    assert off[:2].tolist() == [[0, 1], [0, 0]]
    assert np.isnan(off[2:]).all(), "clutter and ids without a surveyed position have no error"
    assert np.isnan(errors.landmark_errors(np.array([[2.0, 3]]), ids[:1], truth, Line())).all(), "nor have walls"


@pytest.mark.parametrize(
    ("sensed", "true", "ids"), [(False, None, [8, 3, 3]), (True, None, None), (False, [3, 8, 8], [3, 8, 8])]
)
def test_labels_of_the_author_stand_for_missing_true_ids(sensed, true, ids):
    log = simulate(Arena(frames=3, landmarks=4), 0)
    truth = replace(log.truth, landmark_of=None if true is None else np.array(true))
    found = errors.identified(
        replace(log, truth=truth, label=np.array([8, 3, 3]), labels_are_sensed=sensed)
    ).landmark_of
    assert (found if ids is None else found.tolist()) == ids

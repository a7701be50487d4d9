"""The firewall: estimators get read-only inputs without truth, and labels only when they are granted."""

import numpy as np
import pytest

from data.inputs import CLUTTER, LabelledObservations, LandmarkMap
from data.motion.velocity import floor_covariances
from data.worlds.arena import Arena, simulate

WORLD = Arena(landmarks=6, frames=10, clutter=1.0)


def test_inputs_have_no_labels_unless_granted():
    log = simulate(WORLD, 0)
    assert not hasattr(log.inputs().observations, "label")
    granted = log.inputs(labels=True).observations
    assert isinstance(granted, LabelledObservations)
    assert np.array_equal(granted.label, log.truth.landmark_of)
    assert (granted.label == CLUTTER).any()


def test_inputs_cannot_be_written_to():
    inputs = simulate(WORLD, 0).inputs(labels=True)
    for array in (
        inputs.time, inputs.increments.mean, inputs.observations.z, inputs.observations.label, inputs.prior.mean,
        inputs.map.xy,
    ):  # fmt: skip
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1
    with pytest.raises(AttributeError):
        inputs.time = np.zeros(3)


def test_singular_increments_get_the_floor_once_and_are_counted():
    C = np.zeros((4, 3, 3))
    C[1] = np.eye(3)
    C[3] = np.diag([1.0, 0.0, 1.0])
    floored, count = floor_covariances(C, 1e-10)
    assert count == 2, "row 0 is no motion and stays zero"
    assert not floored[0].any()
    assert np.array_equal(floored[1], np.eye(3))
    assert np.linalg.eigvalsh(floored[2])[0] == pytest.approx(1e-10)
    again, count = floor_covariances(floored, 1e-10)
    assert count == 0
    assert np.array_equal(again, floored)
    assert floor_covariances(C, 0.0)[1] == 0


def test_landmarks_are_looked_up_by_id():
    known = LandmarkMap(np.array([2, 5, 9]), np.array([[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]]))
    ids = np.array([9, CLUTTER, 5, 3, 2, 10])
    assert known.rows(ids).tolist() == [2, -1, 1, -1, 0, -1]
    nowhere = [np.nan, np.nan]
    wanted = np.array([known.xy[2], nowhere, known.xy[1], nowhere, known.xy[0], nowhere])
    assert np.array_equal(known.positions(ids), wanted, equal_nan=True)
    nothing = LandmarkMap(np.empty(0, np.int64), np.empty((0, 2)))
    assert nothing.rows(ids).tolist() == [-1] * 6
    assert np.isnan(nothing.positions(ids)).all()
    assert known.rows(np.empty(0, np.int64)).tolist() == []

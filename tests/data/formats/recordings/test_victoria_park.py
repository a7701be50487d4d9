"""Victoria Park: the bundled log loads as counted from its text, and faults in such a file are named."""

from __future__ import annotations

import importlib.util

import numpy as np
import pytest

from data.errors import DataError
from data.formats.recordings.victoria_park import bundled_file, load_victoria_park
from data.sensors import RelativePoint


@pytest.fixture(scope="module")
def park():
    return load_victoria_park()


def test_frames_readings_and_landmarks_are_those_of_the_file(park):
    lines = bundled_file().read_text().splitlines()
    steps = [line.split() for line in lines if line.startswith("ODOMETRY")]
    seen = [line.split() for line in lines if line.startswith("LANDMARK")]
    assert (len(steps) + 1, len(seen), len({s[2] for s in seen})) == (6969, 3640, 151)
    inputs, truth = park.recorded, park.truth
    assert len(inputs) == 6969
    assert inputs.observations.z.shape == (3640, 2)
    assert truth.landmark_of is not None
    assert truth.landmark_of.tolist() == [int(s[2]) for s in seen]
    np.testing.assert_array_equal(inputs.increments.mean[1:], np.array([s[3:6] for s in steps], float))
    np.testing.assert_array_equal(inputs.observations.z, np.array([s[3:5] for s in seen], float))
    # pose numbers have gaps where landmarks took theirs; frames have none
    frame_of = {pose: k for k, pose in enumerate(["0", *(s[2] for s in steps)])}
    assert inputs.observations.frame.tolist() == [frame_of[s[1]] for s in seen]


def test_the_stated_field_of_view_holds_every_reading(park):
    sensor, z = park.recorded.sensor, park.recorded.observations.z
    assert isinstance(sensor, RelativePoint)
    assert sensor.in_view(z).all()
    assert np.hypot(*z.T).max() > 0.8 * sensor.max_range


def test_without_gtsam_the_error_says_what_to_install(monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(DataError, match=r"victoria_park\.txt: gtsam is not installed"):
        load_victoria_park()

"""Victoria Park: the bundled log loads as counted from its text, and faults in such a file are named."""

from __future__ import annotations

import importlib.util

import numpy as np
import pytest

from data.errors import DataError
from data.formats.recordings.victoria_park import bundled_file, load_victoria_park
from data.sensors import RelativePoint

SMALL = """\
ODOMETRY 0 1 0.5 0.01 0.02 0.01 0.001 0.002 0.03 0.003 0.04
LANDMARK 1 2 11.5 -3.2 0.4 0.1 0.5
LANDMARK 1 3 9.5 3.2 0.4 0 0.4
ODOMETRY 1 4 0.6 0 0 0.0001 0 0 0.000004 0 0.000004
LANDMARK 4 2 10.9 -3.1 0.4 0 0.4
ODOMETRY 4 5 0 0 0 0.0001 0 0 0.000004 0 0.000004
"""


@pytest.fixture
def load(tmp_path):
    def run(text):
        path = tmp_path / "park.txt"
        path.write_text(text)
        return load_victoria_park(path)

    return run


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


def test_covariances_are_the_rows_own(load, park):
    recorded = load(SMALL).recorded
    np.testing.assert_array_equal(recorded.increments.covariance[0], np.zeros((3, 3)))
    np.testing.assert_array_equal(
        recorded.increments.covariance[1], [[0.01, 0.001, 0.002], [0.001, 0.03, 0.003], [0.002, 0.003, 0.04]]
    )
    np.testing.assert_array_equal(recorded.observations.R[0], [[0.4, 0.1], [0.1, 0.5]])
    assert recorded.observations.frame.tolist() == [1, 1, 2]
    np.testing.assert_array_equal(np.unique(park.recorded.observations.R, axis=0), [np.diag([0.4, 0.4])])


def test_the_stated_field_of_view_holds_every_reading(park):
    sensor, z = park.recorded.sensor, park.recorded.observations.z
    assert isinstance(sensor, RelativePoint)
    assert sensor.in_view(z).all()
    assert np.hypot(*z.T).max() > 0.8 * sensor.max_range


def test_without_gtsam_the_error_says_what_to_install(monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(DataError, match=r"victoria_park\.txt: gtsam is not installed"):
        load_victoria_park()


@pytest.mark.parametrize(
    ("line", "text", "words"),
    [
        (2, "LANDMARK 1 2 11.5 -3.2 0.4 0.1", ("6 numbers", "7 are needed")),
        (3, "LANDMARK 1 3 9.5 nan 0.4 0 0.4", ("column y", "'nan'")),
        (3, "LANDMARK 1 3.5 9.5 1 0.4 0 0.4", ("column l", "whole number")),
        (3, "LANDMARK 0 3 9.5 1 0.4 0 0.4", ("column i", "not the newest pose")),
        (4, "ODOMETRY 1 1 0.6 0 0 0.0001 0 0 0.000004 0 0.000004", ("column j", "does not come after")),
        (4, "ODOMETRY 1 4 0.6 0 0 0.0001 1 0 0.000004 0 0.000004", ("positive semidefinite",)),
        (3, "LANDMARK 1 3 9.5 1 0.4 0.4 0.4", ("positive definite",)),
        (5, "VERTEX 1 2 3", ("starts with 'VERTEX'",)),
    ],
)
def test_a_wrong_line_is_named(load, line, text, words):
    lines = SMALL.splitlines()
    lines[line - 1] = text
    with pytest.raises(DataError) as caught:
        load("\n".join(lines) + "\n")
    message = str(caught.value)
    assert f"park.txt:{line}" in message
    assert "\n" not in message
    for word in words:
        assert word in message


def test_a_file_without_odometry_is_refused(load):
    with pytest.raises(DataError, match="no ODOMETRY line"):
        load("LANDMARK 0 2 11.5 -3.2 0.4 0.1 0.5\n")

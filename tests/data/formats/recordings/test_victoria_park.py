"""Victoria Park: the bundled log loads as counted from its text, and faults in such a file are named."""

from __future__ import annotations

import importlib.util
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from data.errors import DataError
from data.formats.recordings.victoria_park import bundled_file, load_victoria_park
from data.log import Log
from data.sensors import RelativePoint


@pytest.fixture(scope="module")
def park() -> Log:
    return load_victoria_park()


def test_frames_readings_and_landmarks_are_those_of_the_file(park: Log) -> None:
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


def test_it_has_no_truth_no_map_no_stamps_and_an_exact_start(park: Log) -> None:
    inputs = park.recorded
    assert park.name == "victoria-park"
    assert park.truth.pose is None
    assert park.truth.landmarks is None
    assert inputs.map is None
    assert inputs.time_is_index
    assert inputs.time.tolist() == list(range(6969))
    assert not park.labels_are_sensed
    assert not inputs.prior.mean.any()
    assert not inputs.prior.covariance.any()
    assert inputs.floored == 0


def test_covariances_are_the_rows_own(park: Log) -> None:
    steps = [line.split() for line in bundled_file().read_text().splitlines() if line.startswith("ODOMETRY")]
    np.testing.assert_array_equal(park.recorded.increments.covariance[0], np.zeros((3, 3)))
    entries = park.recorded.increments.covariance[1:, [0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]]
    np.testing.assert_array_equal(entries, np.array([s[6:] for s in steps], float))
    np.testing.assert_array_equal(np.unique(park.recorded.observations.R, axis=0), [np.diag([0.4, 0.4])])


def test_the_stated_field_of_view_holds_every_reading(park: Log) -> None:
    sensor, z = park.recorded.sensor, park.recorded.observations.z
    assert isinstance(sensor, RelativePoint)
    assert sensor.in_view(z).all()
    assert np.hypot(*z.T).max() > 0.8 * sensor.max_range


@pytest.mark.slow
def test_gtsam_is_found_without_being_imported() -> None:
    code = (
        "import sys; from data.formats.recordings.victoria_park import load_victoria_park; load_victoria_park(); "
        "sys.exit('gtsam' in sys.modules)"
    )
    root = Path(__file__).parents[4]
    assert subprocess.run([sys.executable, "-c", code], env={**os.environ, "PYTHONPATH": str(root)}).returncode == 0


def test_without_gtsam_the_error_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(DataError, match=r"victoria_park\.txt: gtsam is not installed"):
        load_victoria_park()


def test_a_gtsam_without_the_file_is_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    class Spec:
        submodule_search_locations = (str(tmp_path),)

    monkeypatch.setattr(importlib.util, "find_spec", lambda name: Spec())
    with pytest.raises(DataError, match=r"victoria_park\.txt: no such file"):
        load_victoria_park()

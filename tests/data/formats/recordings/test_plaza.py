"""Recorded data sets as their authors describe them: Plaza, DLR's circle, SLAM courses, Victoria Park."""

import importlib.util

import gtsam
import numpy as np
import pytest
import scipy.io

from data import se2
from data.convert.__main__ import main
from data.errors import DataError
from data.formats.open_log import load_folder
from data.formats.recordings.plaza import load_plaza
from data.formats.recordings.tagged import is_course, load_course, load_dlr
from data.formats.recordings.victoria_park import bundled_file, load_victoria_park
from data.log import Log
from data.sensors import RelativePoint


@pytest.fixture(scope="module", params=[1, 2])
def plaza(request: pytest.FixtureRequest) -> tuple[int, Log]:
    return request.param, load_plaza(request.param)


def test_every_range_has_its_beacon_and_its_instant(plaza):
    number, log = plaza
    table = np.loadtxt(gtsam.findExampleDataFile(f"Plaza{number}_TD.txt"))
    r, o = log.recorded, log.recorded.observations
    assert len(o.frame) == len(table)
    assert np.sort(r.time[o.frame] + log.clock) == pytest.approx(np.sort(table[:, 0]), abs=1e-6)
    assert sorted(set(log.label.tolist())) == r.map.id.tolist() == [0, 1, 5, 6]
    assert np.sort(1.07 * o.z[:, 0]) == pytest.approx(np.sort(table[:, 3]))
    assert not o.z[:, 1].any()


def test_ranges_are_the_true_distances_within_the_stated_noise_and_headings_point_where_the_robot_drives(plaza):
    _, log = plaza
    o, truth = log.recorded.observations, log.truth
    off = o.z[:, 0] - np.linalg.norm(truth.pose[o.frame, :2] - truth.landmarks.positions(log.label), axis=1)
    assert abs(off.mean()) < 0.1
    assert off.std() == pytest.approx(0.5, abs=0.05)
    step = np.diff(truth.pose[:, :2], axis=0)
    ahead = step[:, 0] * np.cos(truth.pose[:-1, 2]) + step[:, 1] * np.sin(truth.pose[:-1, 2])
    assert ahead.sum() > 0.95 * np.hypot(*step.T).sum()


def test_the_odometry_is_the_dead_reckoned_path_of_the_file():
    """Plaza 2; that of Plaza 1 is of another odometry."""
    log = load_plaza(2)
    path = scipy.io.loadmat(gtsam.findExampleDataFile("Plaza2_.mat"))["DRp"]
    ours = se2.dead_reckoned(path[0, 1:], log.recorded.increments.mean)
    there = se2.interpolate(path[:, 0], path[:, 1:], log.recorded.time + log.clock)
    assert np.abs(ours - there)[:, :2].max() < 0.1


def test_the_command_writes_a_log_of_one_sensor_of_ranges(tmp_path, capsys, refused):
    assert main(["plaza", "2", str(tmp_path / "plaza"), "--range-scale", "1", "--range-sigma", "3"]) == 0
    assert "Ranges are divided by 1 (--range-scale)" in capsys.readouterr().out
    log = load_folder(tmp_path / "plaza")
    assert (log.recorded.sensor.name, log.recorded.sensor.label, log.labels_are_sensed) == ("range", "radio", True)
    assert log.recorded.observations.R[0].tolist() == [[9.0, 0.0], [0.0, 1.0]]
    assert "--range-scale 0: a number from 1e-06 to 1000 is needed" in refused(
        main, ["plaza", "2", str(tmp_path / "plaza"), "--range-scale", "0"]
    )


STEP = "STEP a.png 0.1 -0.2 0.05 1e-4 2e-5 3e-4 4e-5 5e-5 6e-4\r\n"
SEEN = "LANDMARK_C 1 -1 0.7 0.01 0 0.02 -1\r\n"
TEXT = f"# comment\r\n\r\n{STEP}LANDMARK_C 0.5 -2 0.9 0.01 0.001 0.02 17\r\n{SEEN}{STEP}"


def test_steps_and_circles_are_read(tmp_path):
    (tmp_path / "map.circles").write_text(TEXT)
    log = load_dlr(tmp_path / "map.circles", "dlr")
    r = log.recorded
    assert r.increments.mean[1].tolist() == [0.1, -0.2, 0.05]
    assert r.increments.covariance[1] == pytest.approx(
        np.array([[1e-4, 2e-5, 4e-5], [2e-5, 3e-4, 5e-5], [4e-5, 5e-5, 6e-4]])
    )
    assert (r.observations.frame.tolist(), log.truth.landmark_of.tolist()) == ([1, 1], [17, -2])
    assert r.observations.R[0].tolist() == [[0.01, 0.001], [0.001, 0.02]]
    (tmp_path / "bad").write_text(TEXT + "LANDMARK_C 1 2\n")
    with pytest.raises(DataError, match="bad:7"):
        load_dlr(tmp_path / "bad", "dlr")


STEPS = (
    "ODOMETRY 0.1 1 0.2\nSENSOR 3 2 0.5\nSENSOR 1 1 -0.5\nODOMETRY -0.3 0.5 0\nSENSOR 3 1.5 0.25\nSENSOR 4 -0.01 2\n"
)


def test_turn_drive_and_turn_of_a_course_are_an_increment(tmp_path):
    (tmp_path / "sensor_data.dat").write_text(STEPS)
    (tmp_path / "world.dat").write_text("3 2 1\n1 0.5 -4\n")
    assert is_course(tmp_path / "sensor_data.dat")
    assert not is_course(tmp_path / "world.dat")
    sigma = np.array([0.01, 0.02, 0.03])
    log = load_course(tmp_path / "sensor_data.dat", "course", tmp_path / "world.dat", sigma, (0.1, 0.2))
    r = log.recorded
    assert r.increments.mean[1] == pytest.approx([np.cos(0.1), np.sin(0.1), 0.3])
    drawn = np.array([0.1, 1.0, 0.2]) + sigma * np.random.default_rng(0).standard_normal((200_000, 3))
    moved = np.stack([drawn[:, 1] * np.cos(drawn[:, 0]), drawn[:, 1] * np.sin(drawn[:, 0]), drawn[:, 0] + drawn[:, 2]])
    assert r.increments.covariance[1] == pytest.approx(np.cov(moved), abs=6e-6)
    assert (r.observations.frame.tolist(), r.map.id.tolist()) == ([1, 1, 2], [1, 3])
    assert log.granted.tolist() == [3, 1, 3]
    assert r.observations.R[0] == pytest.approx(np.diag([0.01, 0.04]))
    (tmp_path / "sensor_data.dat").write_text("ODOMETRY 0 1 0\nSENSOR 0 2 0\nSENSOR 0 3 1\n")
    log = load_course(tmp_path / "sensor_data.dat", "course", None, sigma, (0.1, 0.2))
    assert log.truth.landmark_of is None
    assert log.notes == ("Ids name no landmarks: 1 of 2 repeat one of their frame.",)


@pytest.mark.parametrize(("steps", "world", "said"), [
    ("SENSOR 1 2\n", "", "sensor_data.dat:7: .*SENSOR id range bearing is needed"),
    ("SENSOR 1.5 2 0\n", "", "sensor_data.dat:7: column id: 1.5 is not a whole number"),
    ("", "1 2\n", "world.dat:1: '1 2'; id x y is needed"),
    ("", "1 2 3\n1 4 5\n", "world.dat:2: column id: 1 is the id of two landmarks"),
])  # fmt: skip
def test_lines_that_a_course_does_not_have_are_refused_by_number(tmp_path, steps, world, said):
    (tmp_path / "sensor_data.dat").write_text(STEPS + steps)
    (tmp_path / "world.dat").write_text(world)
    with pytest.raises(DataError, match=said):
        load_course(
            tmp_path / "sensor_data.dat", "course", tmp_path / "world.dat" if world else None, np.ones(3), (1, 1)
        )


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

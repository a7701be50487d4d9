"""The Plaza range-only logs: their odometry, ranges and truth agree as the data set's authors describe them."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest
import scipy.io

from data import se2
from data.convert.__main__ import main
from data.formats.open_log import load_folder
from data.formats.recordings.plaza import load_plaza
from data.log import Log


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


def test_ranges_are_the_true_distances_within_the_stated_noise(plaza):
    _, log = plaza
    o, truth = log.recorded.observations, log.truth
    off = o.z[:, 0] - np.linalg.norm(truth.pose[o.frame, :2] - truth.landmarks.positions(log.label), axis=1)
    assert abs(off.mean()) < 0.1
    assert off.std() == pytest.approx(0.5, abs=0.05)


def test_true_headings_point_where_the_robot_drives(plaza):
    _, log = plaza
    step = np.diff(log.truth.pose[:, :2], axis=0)
    ahead = step[:, 0] * np.cos(log.truth.pose[:-1, 2]) + step[:, 1] * np.sin(log.truth.pose[:-1, 2])
    assert ahead.sum() > 0.95 * np.hypot(*step.T).sum()


def test_the_odometry_is_the_dead_reckoned_path_of_the_file():
    """Plaza 2; that of Plaza 1 is of another odometry."""
    log = load_plaza(2)
    path = scipy.io.loadmat(gtsam.findExampleDataFile("Plaza2_.mat"))["DRp"]
    ours = se2.dead_reckoned(path[0, 1:], log.recorded.increments.mean)
    there = se2.interpolate(path[:, 0], path[:, 1:], log.recorded.time + log.clock)
    assert np.abs(ours - there)[:, :2].max() < 0.1


def test_the_command_writes_a_log_of_one_sensor_of_ranges(tmp_path, capsys):
    assert main(["plaza", "2", str(tmp_path / "plaza"), "--range-scale", "1", "--range-sigma", "3"]) == 0
    assert "Ranges are divided by 1 (--range-scale)" in capsys.readouterr().out
    log = load_folder(tmp_path / "plaza")
    assert (log.recorded.sensor.name, log.recorded.sensor.label, log.labels_are_sensed) == ("range", "radio", True)
    assert log.recorded.observations.R[0].tolist() == [[9.0, 0.0], [0.0, 1.0]]
    assert main(["plaza", "2", str(tmp_path / "plaza"), "--range-scale", "0"]) == 2
    assert "--range-scale 0: a number above 0 is needed" in capsys.readouterr().err

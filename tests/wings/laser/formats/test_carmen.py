"""A CARMEN log is read line by line as its text says: frames, times, scans, scanner and relations."""

from __future__ import annotations

import gzip
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from data.formats.recordings.laser import increments_of, made_increasing
from data.log import Log
from tests.wings.laser.formats.carmen_text import SMALL, flaser, odom, robotlaser
from wings.laser.carmen import beams_of, largest_range, load_carmen

HERE = (0.0, 0.0, 0.0)
RELATIONS = "row2,y,row1,x,theta,why\n2,0.1,0,0.2,0.3,9\n0,0,3,1,-0.5,9\n"


@pytest.fixture
def load(tmp_path: Path) -> Callable[..., Log]:
    def run(text: str, name: str = "small.log") -> Log:
        content = text.encode()
        (tmp_path / name).write_bytes(gzip.compress(content) if name.lower().endswith(".gz") else content)
        return load_carmen(tmp_path / name)

    return run


@pytest.mark.parametrize("name", ["small.log", "small.clf", "small.log.gz", "small.gz", "small.CLF.GZ"])
def test_plain_and_packed_files_give_the_same_log_of_the_same_name(load, name):
    log = load(SMALL, name)
    assert log.name == "small"
    assert len(log.recorded) == 4
    assert log.recorded.scans.frame.tolist() == [0, 2]


def test_every_odom_line_is_a_frame_and_its_increment_is_in_the_body_of_the_one_before(load):
    log = load(SMALL)
    recorded, scanner = log.recorded, log.recorded.scans.scanner
    assert recorded.prior.mean.tolist() == [1.0, 2.0, 0.5]
    assert not recorded.prior.covariance.any()
    c, s = math.cos(0.5), math.sin(0.5)
    assert recorded.increments.mean[1] == pytest.approx([0.1 * c, -0.1 * s, 0.1])
    assert recorded.increments.mean[2].tolist() == [0.0, 0.0, 0.0]
    assert len(recorded.observations.z) == 0
    assert recorded.floored == 1
    assert np.diagonal(recorded.increments.covariance[2]).tolist() == [1e-10] * 3
    # a reading of the reach or more and a zero are no return
    assert recorded.scans.ranges.tolist() == [[1.0, 2.5, 0.0], [0.0, 3.0, 0.0]]
    assert scanner.translation == (-0.25, 0.0)  # p_scanner = p_body + T: the laser itself is its own origin
    assert scanner.rotation == 0.0
    assert "Lines left out: 1 NEFF, 1 SYNC." in log.notes
    assert "1 of 4 stamps do not increase; line order is used." in log.notes


def test_times_increase_by_a_microsecond_where_stamps_do_not(load):
    assert load(SMALL).recorded.time.tolist() == [10.0, 10.5, 10.5 + 1e-6, 11.0]
    assert made_increasing(np.array([5.0, 5.0, 4.0, 5.0000015])).tolist() == [5.0, 5.000001, 5.000002, 5.000003]
    assert (np.diff(made_increasing(np.array([1e12, 1e12, 3.0]))) > 0.0).all()  # a microsecond is lost to rounding


def test_of_two_scans_without_odometry_between_the_first_stays_and_early_ones_go(load):
    lines = [flaser([9.0], HERE, 0.0), odom(0, 0, 0, 1.0), flaser([1.0], HERE, 1.0), flaser([2.0], HERE, 1.1)]
    log = load("\n".join(lines))
    assert log.recorded.scans.ranges.tolist() == [[1.0]]
    assert "1 of 3 scans before the first ODOM line: left out." in log.notes
    assert "1 of 3 scans after another without an ODOM line between: left out." in log.notes


def test_without_odom_lines_every_scan_is_a_frame_at_the_pose_of_its_line(load):
    log = load("\n".join(flaser([1.0 + k], (float(k), 0.0, 0.0), 3.0 - k) for k in range(3)))
    assert log.recorded.scans.frame.tolist() == [0, 1, 2]
    assert log.recorded.increments.mean[1:].tolist() == [[1.0, 0.0, 0.0]] * 2
    assert log.recorded.time[0] == 3.0


@pytest.mark.parametrize(
    ("beams", "first", "last", "step"),
    [(180, -90, 89, 1), (181, -90, 90, 1), (360, -90, 89.5, 0.5), (361, -90, 90, 0.5), (401, -50, 50, 0.25)],
)
def test_the_number_of_beams_says_where_they_point(beams, first, last, step):
    low, between = np.degrees(beams_of(beams))
    assert [low, low + (beams - 1) * between, between] == pytest.approx([first, last, step])


def test_robotlaser_lines_state_their_own_geometry_and_place(load):
    # the laser 0.3 m ahead and 0.1 m to the left of the robot, looking back
    laser, robot = (2.0 - 0.1, 5.0 + 0.3, -0.5 * math.pi), (2.0, 5.0, 0.5 * math.pi)
    log = load(robotlaser([1.0, 5.6, 2.0], laser, robot, 4.0, remissions=[7, 8]))
    scans = log.recorded.scans
    s = scans.scanner
    assert (s.angle_min, s.angle_step, s.max_range, s.sigma) == (-2.0, 0.5, 5.6, 0.03)
    assert scans.ranges.tolist() == [[1.0, 0.0, 2.0]]
    assert log.recorded.prior.mean.tolist() == list(robot)
    c, r = math.cos(s.rotation), math.sin(s.rotation)
    seen = np.array([[c, -r], [r, c]]) @ [0.3, 0.1] + s.translation
    assert seen == pytest.approx([0.0, 0.0], abs=1e-12)
    assert abs(s.rotation) == pytest.approx(math.pi)


def test_where_each_scan_is_written_twice_the_line_that_states_more_is_taken(load):
    log = load("\n".join([odom(0, 0, 0, 1.0), flaser([1.0], HERE, 1.0), robotlaser([2.0], HERE, HERE, 1.0)]))
    assert log.recorded.scans.ranges.tolist() == [[2.0]]
    assert "Lines left out: 1 FLASER." in log.notes


def test_the_reach_is_where_readings_pile_up():
    ranges = np.random.default_rng(1).uniform(1.0, 12.0, (50, 40))
    assert largest_range(ranges, None)[0] == 80.0
    ranges[:, 3] = 40.0
    assert largest_range(ranges, None)[0] == 40.0
    ranges[:, 4] = np.linspace(39.7, 39.9, 50)  # a wall just below: the largest is a reading like others
    assert largest_range(ranges, None)[0] == 80.0
    assert largest_range(ranges, 15.0)[0] == 15.0


def test_noise_of_wheels_does_not_depend_on_how_often_odometry_is_logged():
    # straight ahead, where covariances of parts add up coordinate by coordinate but for the lever of the heading
    once, _ = increments_of(np.array([[0.0, 0, 0], [2.0, 0, 0]]))
    often, _ = increments_of(np.linspace([0.0, 0, 0], [2.0, 0, 0], 101))
    assert often.covariance.sum(axis=0) == pytest.approx(once.covariance.sum(axis=0))
    assert np.diagonal(once.covariance[1]) == pytest.approx([0.05**2 * 2, 0.05**2 * 2, 0.075**2 * 2])


def test_relations_beside_the_log_are_read_by_name_with_the_stamps_as_recorded(load, tmp_path):
    (tmp_path / "small.relations.csv").write_text(RELATIONS)
    relations = load(SMALL, "small.log.gz").truth.relations
    assert relations.row1.tolist() == [0, 3]
    assert relations.row2.tolist() == [2, 0]
    assert relations.relative.tolist() == [[0.2, 0.1, 0.3], [1.0, 0.0, -0.5]]
    assert relations.exact is None
    assert relations.stamp is None
    # a frame with a scan has the scan's stamp, to which references tie relations
    assert relations.frame_stamp.tolist() == [10.02, 10.5, 10.3, 11.0]

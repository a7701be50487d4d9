"""ROS bags of every form become the same laser log, and what is wrong with one is one line."""

import math

import numpy as np
import pytest

from data.errors import DataError, UsageError
from data.formats.bags import laser_log
from data.formats.recognize import what_to_type
from data.formats.recordings.mending import Mending
from data.formats.results.reading import read_path
from tests.data.formats.recordings.ros.bags import FORMS, START, Maker

LEVEL = np.arange(0.0, 3.01, 0.5)


@pytest.fixture
def maker() -> Maker:
    made = Maker("mcap")
    made.drive(LEVEL)
    made.scan(1.0, [1.0, 2.0, 3.0])
    return made


@pytest.mark.parametrize("form", FORMS)
def test_scans_are_frames_with_the_odometry_between_its_messages(form, tmp_path):
    made = Maker(form)
    made.drive(LEVEL)
    made.mounting("base_link", "laser", 0.25, 0.0, 0.0)
    made.scan(0.75, [1.0, 0.125, 8.0])  # below range_min, not below range_max
    made.scan(2.25, [math.inf, 2.0, math.nan])
    log = laser_log(made.save(tmp_path))
    recorded = log.recorded
    assert recorded.prior.mean == pytest.approx([0.75, 0.0, 0.075])
    assert recorded.time == pytest.approx([START + 0.75, START + 2.25], abs=1e-6)
    c, s = math.cos(0.075), math.sin(0.075)
    assert recorded.increments.mean[1] == pytest.approx([1.5 * c, -1.5 * s, 0.15])
    assert recorded.scans.ranges.tolist() == [[1, 0, 0], [0, 2, 0]]
    scanner = recorded.scans.scanner
    assert (scanner.angle_min, scanner.angle_step, scanner.max_range) == (-0.5, 0.5, 8.0)
    assert scanner.translation == (-0.25, 0.0)


def test_a_bag_of_ros_2_is_read_by_its_metadata_renamed_or_without_them(tmp_path):
    made = Maker("sqlite3")
    made.drive(LEVEL)
    folder = made.save(tmp_path)
    for name in ("metadata.yaml", "small.db3", ""):
        assert len(read_path(str(folder / name)).time) == len(LEVEL)
        assert "a ROS bag" in what_to_type(folder / name)
        with pytest.raises(UsageError, match=r"no LaserScan; .*/small.*:/odom TRUTH"):
            laser_log(folder / name)
        if name:
            (folder / name).rename(folder / f"other{name[-4:]}")
    (folder / "small.db3").touch()
    with pytest.raises(DataError, match=r"several bags without metadata\.yaml: other\.db3, small"):
        laser_log(folder)


def test_a_laser_upside_down_looks_the_other_way_round(maker, tmp_path):
    maker.mounting("base_link", "laser", 0.5, 0.25, 0.5 * math.pi, upside_down=True)
    scanner = laser_log(maker.save(tmp_path)).recorded.scans.scanner
    # its first beam points to -0.5 rad of its own x axis: seen from above to +0.5
    assert (scanner.angle_min, scanner.angle_step) == (0.5, -0.5)
    assert scanner.rotation == pytest.approx(-0.5 * math.pi)
    assert scanner.translation == pytest.approx((-0.25, 0.5))


def test_what_is_not_known_or_left_out_is_said(maker, tmp_path):
    maker.scan(-2.0, [1.0, 2.0, 3.0])
    maker.scan(4.0, [1.0, 2.0, 3.0])
    log = laser_log(maker.save(tmp_path))
    assert len(log.recorded) == 1
    assert set(log.origins) == {"odometry_noise", "range_noise", "sensor_pose"}
    assert "2 of 3 scans outside the span of the odometry: left out." in log.notes


def test_of_several_topics_one_is_chosen(maker, tmp_path):
    maker.scan(1.5, [4.0, 5.0], "/rear")
    path = maker.save(tmp_path)
    assert laser_log(path, "/rear").recorded.scans.ranges.tolist() == [[4.0, 5.0]]
    with pytest.raises(UsageError, match=r"--scan /odom: its messages are nav_msgs/msg/Odometry"):
        laser_log(path, "/odom")


@pytest.mark.parametrize(("changed", "ranges", "message"), [
    ({}, [], "message 1 of /scan: .* with 0 beams is no scan"),
    ({"angle_increment": 0.0}, [1.0, 2.0, 3.0], "message 1 of /scan: .* is no scan"),
    ({"range_max": math.nan}, [1.0, 2.0, 3.0], "message 1 of /scan: range_max nan; 8.0 is needed"),
])  # fmt: skip
def test_a_scan_unlike_the_first_is_named(maker, tmp_path, changed, ranges, message):
    maker.scan(2.0, ranges, **changed)
    with pytest.raises(DataError, match=message):
        laser_log(maker.save(tmp_path))


def test_odometry_that_is_no_number_or_of_another_time_is_named(maker, tmp_path):
    made = Maker("ros1")
    made.drive(LEVEL + 10.0)
    made.scan(1.0, [1.0, 2.0, 3.0])
    with pytest.raises(DataError, match="at least one scan within the odometry"):
        laser_log(made.save(tmp_path))
    maker.odometry(2.75, (0.0, math.nan, 0.0))
    with pytest.raises(DataError, match=r"message 6 of /odom: .* finite numbers"):
        laser_log(maker.save(tmp_path))


@pytest.mark.parametrize("form", FORMS)
def test_a_broken_bag_is_named_and_one_whose_recorder_was_stopped_told_how_to_mend_it(form, tmp_path):
    made = Maker(form)
    made.drive(LEVEL)
    made.scan(1.0, [1.0, 2.0, 3.0])
    path = made.save(tmp_path)
    file = path if path.is_file() else next(p for p in path.iterdir() if p.suffix != ".yaml")
    whole = file.read_bytes()
    for kept in (0, 10, len(whole) // 2):
        file.write_bytes(whole[:kept])
        with pytest.raises(DataError, match=f"{path.name}.*: not a bag that can be read"):
            laser_log(path)
    if form == "ros1":
        at = whole.index(b"index_pos=") + len(b"index_pos=")
        file.write_bytes(whole[:at] + bytes(8) + whole[at + 8 :])
        with pytest.raises(DataError, match="rosbag reindex"):
            laser_log(path)


@pytest.mark.parametrize("below", ["odom", "base_footprint"])
def test_without_a_topic_of_odometry_the_moving_transform_is_it(below, tmp_path):
    made = Maker("mcap")
    made.mounting("base_link", "laser", 0.25, 0.0, 0.0)
    for t in LEVEL.tolist():
        made.transform(t, "odom", "base_footprint", (1e-9 * t, 0.0, np.round(t) * 2.0 * np.pi))  # q and -q are one turn
        made.transform(t, below, "base_link", (t, 0.0, 0.1 * t))
        made.transform(t, "map", "odom", (0.5, 0.0, 0.0))
    made.scan(0.75, [1.0, 2.0, 3.0])
    made.scan(2.25, [1.0, 2.0, 3.0])
    log = laser_log(made.save(tmp_path))
    assert log.recorded.prior.mean == pytest.approx([0.75, 0.0, 0.075])
    assert log.recorded.scans.scanner.translation == (-0.25, 0.0)


def test_a_bag_of_scans_alone_is_refused_or_read_without_odometry(tmp_path):
    made = Maker("mcap")
    for t in (0.75, 2.25):
        made.scan(t, [1.0, 2.0, 3.0])
    path = made.save(tmp_path)
    with pytest.raises(DataError, match=r"slamref convert rosbag .*/small LOG --no-odometry"):
        laser_log(path)
    log = laser_log(path, mending=Mending(odometry=False))
    assert (len(log.recorded), "odometry" in log.source, "tf" in " ".join(log.notes)) == (2, False, False)
    assert log.recorded.increments.covariance[1, 0, 0] > 0.01


def test_scans_of_other_lengths_are_resampled(maker, tmp_path):
    maker.scan(1.5, [1.0, 2.0, 3.0])
    maker.scan(2.0, [1.0, 1.0], angle_increment=1.0)
    log = laser_log(maker.save(tmp_path))
    assert log.recorded.scans.ranges.tolist() == [[1, 2, 3], [1, 2, 3], [1, 1, 1]]
    assert any("1 of 3 scans with other beams" in note for note in log.notes)

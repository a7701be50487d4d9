"""Bags with detections, fixes and truth become the log that their messages describe; what is wrong is one line."""

import math
import re
import sqlite3
from pathlib import Path
from types import SimpleNamespace as Message
from typing import Any

import numpy as np
import pytest

from data import se2
from data.convert.__main__ import main
from data.formats.bags import FLAT_BOXES, TAGS, detections
from data.formats.open_log import load_folder
from data.formats.results.path import Manner
from data.formats.results.reading import read_path
from data.log import Log
from data.pose_measurements import FixKind
from data.sensors import Bearing, Range, RangeBearing, RelativePoint
from tests.data.formats.bags.made import START, Full

TIMES, POINT = np.arange(0.0, 4.01, 0.5), "apriltag_msgs/msg/Point"
JOINTS = "sensor_msgs/msg/JointState"


@pytest.fixture
def maker() -> Full:
    made = Full()
    made.drive(TIMES)
    made.mounting("base_link", "camera", 0.25, 0.1, 0.5)
    return made


def load(maker: Full, tmp_path: Path, *words: str) -> Log:
    bag = maker.save(tmp_path)
    assert main(["bag", str(bag), str(tmp_path / "out"), *words]) == 0
    return load_folder(tmp_path / "out")


def test_points_of_a_camera_are_seen_in_the_body_frame(maker, tmp_path):
    maker.poses(1.25, [(2.0, 0.5), (1.0, -1.0)])
    maker.markers(2.0, [(7, 3.0, 0.0)])
    maker.boxes(2.0, [("12", 1.0, 0.0), ("person", 2.0, 0.0)])
    log = load(maker, tmp_path, "--point-sigma", "5cm")
    r, o = log.recorded, log.recorded.observations
    assert [(type(s), s.label) for s in r.sensors] == [
        (RelativePoint, "boxes"), (RelativePoint, "cones"), (RelativePoint, "markers")
    ]  # fmt: skip
    assert r.time[o.frame].tolist() == [1.25, 1.25, 2.0, 2.0, 2.0]
    assert o.sensor.tolist() == [1, 1, 0, 0, 2]
    camera = np.array([0.25, 0.1, 0.5])
    seen = se2.transform_points(camera, np.array([[2.0, 0.5], [1.0, -1.0], [1.0, 0.0], [2.0, 0.0], [3.0, 0.0]]))
    assert o.z == pytest.approx(seen)
    assert np.allclose(o.R, 0.0025 * np.eye(2))
    assert log.label.tolist() == [-2, -2, 12, -2, 7]
    assert log.labels_are_sensed
    assert log.clock == START


def test_pixels_are_directions_by_the_camera_s_model(maker, tmp_path):
    maker.optical(0.5, -0.25, 0.75)
    maker.camera()
    maker.tags(1.5, [(3, 320.0), (4, 720.0)])
    log = load(maker, tmp_path, "--bearing-sigma", "1deg")
    r, o = log.recorded, log.recorded.observations
    assert (type(r.sensor), r.sensor.translation) == (Bearing, (-0.5, 0.25))
    assert o.z == pytest.approx(np.array([[0.0, 0.75], [0.0, 0.75 - math.pi / 4]]))
    assert o.R[0] == pytest.approx(np.diag([1.0, math.radians(1.0) ** 2]))
    assert log.label.tolist() == [3, 4]


def test_satellite_fixes_are_metres_east_and_north_of_the_first(maker, tmp_path):
    maker.mounting("base_link", "antenna", 0.3, 0.0, 0.0)
    maker.mounting("base_link", "imu", 0.0, 0.0, 0.25)
    for k, t in enumerate((0.25, 1.25, 2.25)):
        maker.satellites(t, (48.0 + 1e-5 * k, 11.0 - 2e-5 * k), 0.25 if k else 0.0)
    maker.satellites(2.75, (0.0, 0.0), fix=False)
    for t in np.arange(0.0, 4.0, 0.125).tolist():
        maker.inertial(t, 1.0, 0.01)
    log = load(maker, tmp_path, "--position-sigma", "3")
    r, fixes = log.recorded, log.recorded.fixes
    assert [(s.name, s.lever, s.rotation) for s in fixes.sources] == [
        ("gps", (0.3, 0.0), 0.0), ("imu", (0.0, 0.0), pytest.approx(0.25))
    ]  # fmt: skip
    place, turn = fixes.kind == FixKind.POSITION, fixes.kind == FixKind.HEADING
    assert r.time[fixes.frame[place]].tolist() == [0.25, 1.25, 2.25]
    # metres of a degree at 48 degrees north, from the series of the National Geospatial-Intelligence Agency
    north, east = 111132.92 - 559.82 * math.cos(math.radians(96)) + 1.175 * math.cos(math.radians(192)), 74625.0
    assert fixes.z[place][2, :2] == pytest.approx([-4e-5 * east, 2e-5 * north], rel=2e-3)
    assert [np.diag(P).tolist() for P in fixes.covariance[place]] == [[9, 9, 0], [0.25, 1, 0], [0.25, 1, 0]]
    assert r.time[fixes.frame[turn]].tolist() == [0.0, 1.0, 2.0, 3.0]
    assert fixes.covariance[turn][0, 2, 2] == pytest.approx(0.01)
    c, s = math.cos(0.75), math.sin(0.75)
    assert r.prior.mean == pytest.approx([-0.3 * c, -0.3 * s, 0.75])
    assert log.source["datum"] == [48.0, 11.0, 10.0]


def test_poses_with_covariance_are_fixes_or_the_truth(maker, tmp_path):
    for t in TIMES.tolist():
        maker.pose(t, (t + 5.0, 1.0, 0.1 * t), variance=0.04)
    log = load(maker, tmp_path)
    fixes = log.recorded.fixes
    assert (fixes.kind == FixKind.POSE).all()
    assert fixes.z[2] == pytest.approx([6.0, 1.0, 0.1])
    assert np.diag(fixes.covariance[0]) == pytest.approx([0.04, 0.08, 0.02])
    assert log.recorded.prior.mean == pytest.approx([5.0, 1.0, 0.0])
    assert log.truth.pose is None


@pytest.mark.parametrize("topic", ["/mocap", "/prism", "/vector"])
def test_a_truth_without_headings_is_one_of_positions(maker, tmp_path, topic):
    for t in TIMES.tolist():
        maker.bare_pose(t, (2.0, t, 0.0))
        maker.place(t, (2.0, t))
        maker._send(t, "/vector", "geometry_msgs/msg/Vector3", x=2.0, y=t)
    maker.poses(1.25, [(2.0, 0.5)])
    flags = ("--truth", topic, "--point-sigma", "0.1")
    log = load(maker, tmp_path, *flags, "--prior", "2,0,0", "--prior-sigma", "0.1,0.1,0.1")
    truth = log.truth.pose
    assert truth[log.recorded.observations.frame[0], :2] == pytest.approx([2.0, 1.25])
    assert np.isnan(truth[:, 2]).all()
    assert any("positions alone are scored" in note for note in log.notes)
    assert log.origins["prior"] == "given"


def test_the_truth_is_what_the_flag_names(maker, tmp_path):
    for t in TIMES.tolist():
        maker.bare_pose(t, (t, 2.0, 0.1 * t))
    maker.poses(1.25, [(2.0, 0.5)])
    log = load(maker, tmp_path, "--truth", "/mocap", "--point-sigma", "0.1")
    assert log.truth.pose[log.recorded.observations.frame[0]] == pytest.approx([1.25, 2.0, 0.125])
    assert log.recorded.prior.mean == pytest.approx([0.0, 2.0, 0.0])
    assert log.recorded.fixes is None


def test_ranges_of_any_type_and_their_anchors(maker, tmp_path, capsys):
    """The truth begins after the odometry; markers in its frame are the map."""
    anchors = {3: (5.0, 1.0), 8: (-2.0, 4.0)}
    for t in TIMES[1:].tolist():
        maker.bare_pose(t, (t, 2.0, 0.0))
        maker.markers(t, [(k, *place) for k, place in anchors.items()], frame="map")
        for k, (x, y) in anchors.items():
            far = round(1000.0 * math.hypot(x - t, y - 2.0))
            maker._send(t, "/uwb", "uwb_msgs/msg/Ranging", anchorId=k, tagId=0, range=far, rss=-80.0)
    log = load(maker, tmp_path, "--truth", "/mocap")
    r, o, said = log.recorded, log.recorded.observations, capsys.readouterr().out
    assert "assumed: --range-unit mm" in said
    assert "measures at the robot's origin" in said
    assert (r.map.id.tolist(), r.map.xy.tolist(), type(r.sensor)) == ([3, 8], [*map(list, anchors.values())], Range)
    expected = np.hypot(*(np.array([anchors[k] for k in log.label.tolist()]) - log.truth.pose[o.frame, :2]).T)
    assert o.z[:, 0] == pytest.approx(expected, abs=1e-3)
    assert len(o.z) == 2 * len(TIMES[1:])
    assert "The truth begins 0.5 s after the odometry; so does the log." in log.notes
    assert main(["bag", str(tmp_path / "small"), "--list"]) == 0
    listed = capsys.readouterr().out
    assert "observations: ranges (range of anchorId)" in listed


def test_ranges_in_their_unit_from_their_place(maker, tmp_path):
    maker._send(1.0, "/uwb", "uwb_msgs/msg/Ranging", anchorId=3, tagId=0, range=250, rss=-80.0)
    log = load(maker, tmp_path, "--range-unit", "cm", "--range-sigma", "5cm")
    o = log.recorded.observations
    assert (o.z[0, 0], o.R[0, 0, 0], log.recorded.map) == (pytest.approx(2.5), pytest.approx(0.0025), None)
    assert main(["bag", str(tmp_path / "small"), str(tmp_path / "out2"), "--range-unit", "cn"]) == 2


def test_ranges_within_a_list_are_read_with_their_place_and_what_is_left_out_is_said(maker, tmp_path, capsys):
    one, radar = (maker.store.types[f"uwb_msgs/msg/{name}"] for name in ("One", "Radar"))
    for t, far in ((1.0, 0.0), (2.0, 3.0)):
        seen = {"sensor_pose_on_robot": maker._pose(0.25, 0.5), "seen": [one(far, 7), one(4.0, 8)]}
        maker._send(t, "/beacon", "uwb_msgs/msg/Many", header=maker._header("uwb", t), **seen)
    maker._send(2.0, "/radar", "uwb_msgs/msg/Radars", seen=[radar(9, 5.0, 0.5)])
    maker._send(2.0, "/word", POINT, x=1.0, y=2.0)
    log = load(maker, tmp_path, "--range-sigma", "0.2", "--bearing-sigma", "0.01")
    o, sensors = log.recorded.observations, log.recorded.sensors
    assert [(type(s), s.translation) for s in sensors] == [(Range, (-0.25, -0.5)), (RangeBearing, (0.0, 0.0))]
    assert (log.label.tolist(), o.z[:, 0].tolist(), o.z[3, 1]) == ([8, 7, 8, 9], [4.0, 3.0, 4.0, 5.0], 0.5)
    assert np.diagonal(o.R, axis1=1, axis2=2)[[0, 3]] == pytest.approx(np.array([[0.04, 1.0], [0.04, 1e-4]]))
    assert ": /word." in capsys.readouterr().out


def test_scans_and_detections_share_their_frames(maker, tmp_path):
    maker.mounting("base_link", "laser", 0.1, 0.0, 0.0)
    maker.scan(1.0, [1.0, 2.0, 3.0])
    maker.scan(2.0, [2.0, 2.0, 2.0])
    maker.scan(-9.0, [2.0, 2.0, 2.0])
    maker.poses(1.5, [(2.0, 0.5)])
    r = (log := load(maker, tmp_path, "--point-sigma", "0.1")).recorded
    assert "1 of 3 scans outside the span of the odometry: left out." in log.notes
    assert r.time[r.scans.frame].tolist() == [1.0, 2.0]
    assert r.time[r.observations.frame].tolist() == [1.5]
    assert r.scans.scanner.translation == (-0.1, 0.0)


@pytest.mark.parametrize(("flags", "way"), [((), 4.0), (("--odom", "/plane"), 8.0)])
def test_without_a_topic_of_odometry_transforms_tell_the_motion_or_poses_that_are_named(tmp_path, flags, way):
    made = Full()
    for t in TIMES.tolist():
        made._send(t, "/plane", "geometry_msgs/msg/Pose2D", x=2.0 * t)
        made.transform(t, "odom", "base_link", (t, 0.0, 0.0))
    made.mounting("base_link", "camera", 0.0, 0.0, 0.0)
    made.poses(2.0, [(2.0, 0.5)])
    r = load(made, tmp_path, "--point-sigma", "0.1", *flags).recorded
    assert r.increments.mean[:, 0].sum() == pytest.approx(way)


def test_the_list_says_what_each_topic_becomes_and_writes_nothing(maker, tmp_path, capsys):
    maker.poses(1.25, [(2.0, 0.5)])
    maker.satellites(1.0, (48.0, 11.0))
    maker.bare_pose(1.0, (0.0, 0.0, 0.0))
    maker.odometry(1.0, (0.0, 0.0, 0.0), "/visual_odom")
    maker._send(1.0, "/cmd_vel", "geometry_msgs/msg/Twist")
    maker.empty = [("/odometry/filtered", "nav_msgs/msg/Odometry"), ("/scan", "sensor_msgs/msg/LaserScan")]
    bag = maker.save(tmp_path).rename(tmp_path / "small.bag")  # as a user may name a folder of ROS 2
    assert main(["bag", str(bag), "--list", "--odom", "/odom"]) == 0
    said = {line.split()[0]: " ".join(line.split()[4:]) for line in capsys.readouterr().out.splitlines()}
    assert main(["bag", str(bag), "--list"]) == 0  # which odometry is not said: both are listed
    assert "odometry (if --odom /visual_odom)" in capsys.readouterr().out
    assert said == {
        "/cmd_vel": "- (a table: slamref convert table BAG:/TOPIC LOG)",
        "/cones": "observations: points",
        "/gps": "position fixes",
        "/mocap": "- (--truth /mocap makes it the truth)",
        "/odom": "odometry",
        "/odometry/filtered": "- (no message)",
        "/scan": "- (no message)",
        "/tf_static": "transforms",
        "/visual_odom": "- (--odom /odom is used; --truth /visual_odom makes it the truth, --second-odom /visual_odom "
        "closures)",
    }
    assert sorted(p.name for p in tmp_path.iterdir()) == ["small.bag"]


def test_detections_that_nothing_mounts_on_the_robot_are_left_out_and_said(maker, tmp_path):
    maker.poses(1.0, [(2.0, 0.5)])
    maker.markers(1.0, [(1, 2.0, 0.5)], frame="map")
    log = load(maker, tmp_path)
    assert log.origins["observation_noise"] == "assumed"
    assert "assumed: --point-sigma 0.1m" in log.notes
    assert any("/markers: 1 detection in 'map', which tf does not mount on 'base_link'" in note for note in log.notes)
    assert len(log.recorded.observations.frame) == 1


@pytest.mark.parametrize(("add", "words", "said"), [
    (lambda m: (m.markers(1.0, [(1, 2, 0)], frame="map"), m.boxes(1.0, [("1", 1, 0)], frame="map")), (),
     "/boxes: .*: left out; /markers: 1 detection .*: left out; --list names"),
    (lambda m: None, (), "nothing beside the odometry: no topic of scans, detections or fixes"),
    (lambda m: m.poses(1.0, [(2, 1)]), ("--odom", "/odo"), "no such topic in .*did you mean /odom"),
    (lambda m: m.poses(1.0, [(2, 1)]), ("--range-sigma", "1"), "--range-sigma 1: no topic of observations: ranges"),
    (lambda m: m._send(1.0, "/w", POINT, x=1.0, y=2.0), ("--skip", "/w"), "--skip /w: it is left out without it"),
    (lambda m: m._send(1.0, "/w", POINT, x=1.0, y=2.0), ("--odom", "/w"), "suit slamref convert table BAG:/TOPIC"),
    (lambda m: m._send(1.0, "/joint", POINT, x=1.0, y=2.0), ("--odom", "tf"), "/odom, or /joint: ticks left"),
    (lambda m: m.odometry(1.0, (0, 0, 0), "/other"), (), "--odom TOPIC is needed; topics of odometry: /odom"),
    (lambda m: m.satellites(1.0, (48.0, 11.0), 1.0), (), "the first heading in the frame of the fixes is unknown"),
    (lambda m: m.pose(1.0, (0, 0, 0)), (), "/amcl_pose: messages without a covariance; --truth /amcl_pose"),
    (lambda m: m.tags(1.0, [(1, 2.0)]), ("--bearing-sigma", "1"), "in 'optical', which tf does not mount"),
    (lambda m: (m.poses(1.0, [(2, 1)]), m.bare_pose(-START, (0, 0, 0))), ("--truth", "/mocap"),
     "/mocap: stamps of its messages are 0, and no frame"),
])  # fmt: skip
def test_one_line_says_what_is_wrong(maker, convert, tmp_path, add, words, said):
    add(maker)
    found = convert({}, "bag", maker.save(tmp_path), "out", *words, status=2)
    assert re.search(said.replace("(", r"\("), found)


@pytest.mark.parametrize(("kind", "names"), [(POINT, "v=x,omega=y"), (JOINTS, "v=velocity_1,omega=velocity_2")])
def test_numbers_of_a_topic_are_a_table(maker, convert, tmp_path, kind, names):
    """Of any type, of joints also undefined in the bag, whose odometry is the truth; topics of a number are joined."""
    for t in TIMES:
        maker._send(t + 0.01, "/right", "std_msgs/msg/Float64", data=0.6)
        maker._send(t, "/left", "std_msgs/msg/Float64", data=0.4)
        maker.scan(t, np.linspace(t, t + 1.0, 101), angle_increment=0.01)
        maker._send(
            t, "/wheels", kind, **{"velocity": np.array([0.5, 0.2])} if kind == JOINTS else {"x": 0.5, "y": 0.2}
        )
    maker.form = "sqlite" if kind == JOINTS else maker.form
    maker._send(1.0, "/other", POINT, x=0.5, y=0.2)
    bag = maker.save(tmp_path)
    for file in bag.glob("*.db3"):  # as in bags of ROS 2 until 2023
        with sqlite3.connect(file) as rows:
            rows.execute("delete from message_definitions")
    said = convert({}, "table", f"{bag}:/other", "out", status=2)
    assert ("does not define apriltag_msgs/msg/Point" in said) == (kind == JOINTS)
    columns = {role: pair.partition("=")[2] for role, pair in zip("xy", names.split(","), strict=True)}
    assert read_path(f"{bag}:/wheels", Manner(columns=columns)).pose[:, :2] == pytest.approx(
        np.tile([0.5, 0.2], (9, 1))
    )
    names += ",truth.x=pose.pose.position.x,truth.y=pose.pose.position.y"
    log, _ = convert({}, "table", f"{bag}:/wheels", "out", "--truth", f"{bag}:/odom", "--columns", names)
    step = float(np.diff(TIMES)[0])
    assert log.recorded.time - START == pytest.approx(TIMES)
    assert log.recorded.increments.mean[1] == pytest.approx(
        se2.along_arcs(np.array([0.5 * step]), np.array([0.2 * step]))[0]
    )
    assert np.isfinite(log.truth.pose[:, :2]).all()
    wheels = ("--ticks", "rate", "--metres-per-tick", "1", "--track-width", "1", "--scans", f"{bag}:/scan")
    joined, _ = convert({}, "table", f"{bag}:/left+{f'{bag}:' * (kind == JOINTS)}/right", "out", *wheels)
    assert joined.recorded.increments.mean[1] == pytest.approx(log.recorded.increments.mean[1])
    assert joined.recorded.scans.ranges[:, 100] == pytest.approx(TIMES + 1.0)
    assert f"slamref convert table {bag}:/TOPIC" in convert({}, "table", str(bag), "out", status=2)
    assert "no topic /none; it has " in convert({}, "table", f"{bag}:/none", "out", status=2)


def test_satellites_tell_the_heading_at_the_start(maker, tmp_path, capsys):
    """At the equator, of an antenna 0.3 m ahead; the world's origin is its first place."""
    maker.mounting("base_link", "antenna", 0.3, 0.0, 0.0)
    pose = se2.compose(np.array([0.0, 0.0, 2.0]), np.column_stack([TIMES, 0.0 * TIMES, 0.1 * TIMES]))
    for t, (x, y, _) in zip(TIMES, se2.compose(pose, np.array([0.3, 0.0, 0.0])), strict=True):
        maker.satellites(t, np.degrees([y / 6335449.0, x / 6378147.0]), 1e-4)
    log = load(maker, tmp_path)
    assert log.recorded.prior.mean == pytest.approx([-0.3 * math.cos(2.0), -0.3 * math.sin(2.0), 2.0], abs=1e-4)
    assert log.origins["prior"] == "inferred"
    assert "inferred: --prior=0.1248,-0.2728,115deg" in capsys.readouterr().out


def test_a_bag_of_ros_1_is_read_as_one_of_ros_2(tmp_path):
    made = Full("ros1")
    made.drive(TIMES)
    made.mounting("base_link", "camera", 0.25, 0.1, 0.5)
    made.poses(1.25, [(2.0, 0.5)])
    made.markers(2.0, [(7, 3.0, 0.0)])
    for t in (0.0, 1.0):
        made.satellites(t, (48.0, 11.0), 0.25)
        made.inertial(t, 1.0, 0.01)
    log = load(made, tmp_path, "--point-sigma", "0.1")
    assert log.recorded.time[log.recorded.observations.frame].tolist() == [1.25, 2.0]
    assert log.label.tolist() == [-2, 7]
    assert len(log.recorded.fixes) == 4


def tag(*numbers: int) -> Any:
    pose = Message(pose=Message(position=Message(x=1.0, y=2.0, z=3.0)))
    return Message(id=numbers, pose=Message(header=Message(frame_id=""), pose=pose))


def box(centre: Any) -> Any:
    return Message(header=Message(frame_id=""), bbox=Message(center=centre), id="8")


@pytest.mark.parametrize(("kind", "one", "number", "at"), [
    (TAGS, tag(4), 4, (1.0, 2.0, 3.0)),
    (TAGS, tag(5, 6), -1, (1.0, 2.0, 3.0)),  # a bundle has no number of its own
    (FLAT_BOXES, box(Message(x=3.0, y=4.0)), 8, (3.0, 4.0, math.nan)),
    (FLAT_BOXES, box(Message(position=Message(x=3.0, y=4.0))), 8, (3.0, 4.0, math.nan)),
])  # fmt: skip
def test_tags_and_boxes_of_either_version(kind, one, number, at):
    header = Message(frame_id="/camera", stamp=Message(sec=5, nanosec=0))
    (seen,) = detections(kind, Message(header=header, detections=[one]), 9.0)
    assert seen[:3] == (5.0, "camera", number)
    assert seen.at == pytest.approx(at, nan_ok=True)

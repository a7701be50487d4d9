"""Several sensors in tables of another program: `--sensor NAME=FILE`."""

import numpy as np
import pytest

from data.inputs import UNLABELLED
from data.sensors import Range, RangeBearing

TABLE, MAPPING = ("table", "odo.csv", "out"), ("table", "robot.toml", "out")
VELOCITIES = "t,v,omega\n0,1,0\n1,1,0.1\n2,1,0\n3,1,0\n"
POSES = "t,x,y,theta\n0,0,0,0\n1,1,0,0\n2,2,0,0\n3,3,0,0\n"
OF = {VELOCITIES: ("--odometry-sigma", "0.1,0.1"), POSES: ("--odometry-sigma", "0.1,0.1,0.1,0.1")}
CONES = "t,dist,angle,label\n0.5,2,10,1\n2,4,-20,\n1,3,20,2\n"
BEACONS = "t,range,true_id\n1,5,7\n2,6,7\n"
WORDS = (
    "--columns", "lidar.range=dist,lidar.bearing=angle", "--unit", "lidar.bearing=deg",
    "--observation-sigma", "lidar=0.1,2deg", "--observation-sigma", "radio=0.3",
    "--sensor-pose", "lidar=0.2,0,90deg", "--view", "lidar=-60deg,60deg", "--max-range", "40", "--max-range", "lidar=8",
)  # fmt: skip


def two(odometry):
    files = {"odo.csv": odometry, "cones.csv": CONES, "beacons.csv": BEACONS}
    return files, (*OF[odometry], "--sensor", "lidar=cones.csv", "--sensor", "radio=beacons.csv", *WORDS)


def assert_same(one, other):
    for field in ("frame", "z", "R", "sensor"):
        np.testing.assert_array_equal(getattr(one.observations, field), getattr(other.observations, field))
    assert one.sensors == other.sensors
    np.testing.assert_array_equal(one.time, other.time)
    np.testing.assert_array_equal(one.increments.mean, other.increments.mean)


@pytest.mark.parametrize("odometry", [VELOCITIES, POSES])
def test_each_sensor_has_its_file_columns_units_noise_place_and_view(convert, odometry):
    files, words = two(odometry)
    log, said = convert(files, *TABLE, *words)
    r = log.recorded
    sensors = [(type(s), s.label, s.max_range) for s in r.sensors]
    assert sensors == [(RangeBearing, "lidar", 8.0), (Range, "radio", 40.0)]
    assert (r.sensors[0].min_angle, r.sensors[0].max_angle) == pytest.approx((-np.pi / 3, np.pi / 3))
    assert r.sensors[0].rotation == pytest.approx(-np.pi / 2)
    assert r.sensors[0].translation == pytest.approx((0.0, 0.2))
    o = r.observations
    assert r.time[o.frame].tolist() == [0.5, 1.0, 1.0, 2.0, 2.0]
    assert o.sensor.tolist() == [0, 0, 1, 0, 1]
    z = np.array([[2, np.radians(10)], [3, np.radians(20)], [5, 0], [4, np.radians(-20)], [6, 0]])
    assert o.z == pytest.approx(z)
    assert np.sqrt(o.R[:, 0, 0]).tolist() == pytest.approx([0.1, 0.1, 0.3, 0.1, 0.3])
    assert np.sqrt(o.R[o.sensor == 0, 1, 1]) == pytest.approx(np.radians(2.0))
    assert log.label.tolist() == [1, 2, UNLABELLED, UNLABELLED, UNLABELLED]
    assert log.truth.landmark_of[o.sensor == 1].tolist() == [7, 7]
    assert "cones.csv: 1 observations were stamped before the one above; sorted" in said


def test_a_mapping_file_says_the_same_as_flags_and_flags_win(convert):
    files, words = two(POSES)
    by_flags = convert(files, *TABLE, *words)[0].recorded
    mapping = """
odometry = "odo.csv"
odometry_sigma = [0.1, 0.1, 0.1, 0.1]
max_range = 40
[columns]
"lidar.range" = "dist"
lidar.bearing = "angle"
[unit]
lidar.bearing = "deg"
[sensor.lidar]
file = "cones.csv"
observation_sigma = "9,9deg"
sensor_pose = ["0.2", "0", "90deg"]
view = "-60deg,60deg"
max_range = 8
[sensor.radio]
file = "beacons.csv"
observation_sigma = 0.3
"""
    log, _ = convert({"robot.toml": mapping}, *MAPPING, "--observation-sigma", "lidar=0.1,2deg")
    assert_same(log.recorded, by_flags)


def test_a_kind_of_landmark_is_what_a_sensor_sees(convert):
    files, words = two(POSES)
    files["map.csv"] = "id,x,y,what\n7,1,2,beacon\n1,3,4,cone\n2,5,6,cone\n"
    more = ("--map", "map.csv", "--columns", "map.kind=what", "--sees", "lidar=cone", "--sees", "radio=beacon")
    prior = ("--prior", "0,0,0", "--prior-sigma", "1,1,1")
    r = convert(files, *TABLE, *words, *more, *prior)[0].recorded
    assert (r.map.id.tolist(), r.map.kind) == ([1, 2, 7], ("cone", "cone", "beacon"))
    assert [s.sees for s in r.sensors] == ["cone", "beacon"]


TREES = "t,range,bearing,dm,class\n1,5,0.1,31,oak\n2,6,0.2,,\n"
SEEN = ("--observations", "trees.csv", "--observation-sigma", "0.1,2deg", *OF[POSES], "--columns", "descriptor=dm")
LOOKS = (*SEEN, "--descriptor-sigma", "2", "--class-error", "0.05")


def test_a_survey_tells_what_landmarks_look_like(convert):
    files = {"odo.csv": POSES, "trees.csv": TREES, "map.csv": "id,x,y,dm,class\n7,5,1,,ash\n3,6,1,29.5,oak\n"}
    start = ("--prior", "0,0,0", "--prior-sigma", "0,0,0")
    r = convert(files, *TABLE, *LOOKS, "--map", "map.csv", *start)[0].recorded
    assert r.map.appearance.names == r.observations.appearance.names == ("ash", "oak")
    assert r.map.appearance.category.tolist() == [1, 0]
    assert r.map.appearance.descriptor.tolist() == pytest.approx([29.5, np.nan], nan_ok=True)
    assert r.observations.appearance.descriptor.tolist() == pytest.approx([31.0, np.nan], nan_ok=True)
    assert r.observations.appearance.category.tolist() == [1, -1]


@pytest.mark.parametrize(("trees", "words", "message"), [
    (TREES, (*SEEN, "--descriptor-sigma", "0"), "--descriptor-sigma 0: must be more than 0"),
    (TREES.replace("31", "x"), LOOKS, "trees.csv:2: column dm: 'x' is not a number"),
    (TREES.replace("oak", '"o""k"'), LOOKS, "trees.csv:2: column class: "),
])  # fmt: skip
def test_bad_appearance_is_named_in_a_line(convert, trees, words, message):
    assert message in convert({"odo.csv": POSES, "trees.csv": trees}, *TABLE, *words, status=2)


def test_columns_without_noise_are_not_used_and_that_is_said(convert):
    log, said = convert({"odo.csv": POSES, "trees.csv": TREES}, *TABLE, *SEEN[:-2])
    assert "trees.csv: column class is not used; --class-error uses it" in said
    assert log.recorded.observations.appearance is None


ONE = {"odo.csv": POSES, "cones.csv": "t,x,y\n0.5,1,2\n"}
LIDAR = ("--sensor", "lidar=cones.csv")


@pytest.mark.parametrize(("words", "said"), [
    (("--sensor", "cones.csv"), "--sensor cones.csv: NAME=FILE is needed"),
    (("--sensor", "map=cones.csv"), "--sensor map=cones.csv: a name other than odometry, observations, map"),
    ((*LIDAR, *LIDAR), "--sensor: lidar is named twice"),
    ((*LIDAR, "--observations", "cones.csv"), "--observations beside --sensor: name this one, too"),
    ((*LIDAR, "--observation-sigma", "1,1", "--columns", "lider.x=x"), "'lider.x' (did you mean lidar?)"),
    (("--view", "lidar=0,1", "--observations", "cones.csv"), "'lidar' is no sensor; --sensor lidar=FILE names one"),
    ((*LIDAR, "--observation-sigma", "1,1", "--sees", "cone", "--map", "map.csv"), "lidar=cone: not in the map"),
])  # fmt: skip
def test_one_line_says_what_is_wrong(convert, words, said):
    files = {**ONE, "map.csv": "id,x,y\n1,2,3\n"}
    prior = ("--prior", "0,0,0", "--prior-sigma", "1,1,1")
    assert said in convert(files, *TABLE, *OF[POSES], *prior, *words, status=2)


@pytest.mark.parametrize(("table", "said"), [
    ("sensor = 3\n", "robot.toml: sensor: a table is needed, as [sensor.lidar]"),
    ("[sensor]\nlidar = 3\n", "robot.toml: [sensor.lidar]: no file"),
    ("[sensor.lidar]\nsees = \"cone\"\n", "robot.toml: [sensor.lidar]: no file"),
    ("[sensor.lidar]\nfile = \"cones.csv\"\nreach = 3\n", "robot.toml: [sensor.lidar]: key 'reach': unknown"),
    ("[sensor.lidar]\nfile = \"cones.csv\"\nview = true\n", "robot.toml: [sensor.lidar] view = True: a text"),
])  # fmt: skip
def test_one_line_says_what_is_wrong_in_a_mapping_file(convert, table, said):
    mapping = f'odometry = "odo.csv"\nodometry_sigma = [1, 1, 1, 1]\n{table}'
    assert said in convert({**ONE, "robot.toml": mapping}, *MAPPING, status=2)

"""Several sensors in a log folder, and bearings or ranges alone."""

from dataclasses import replace

import numpy as np
import pytest

from data.formats.open_log import contents, load_folder, write_folder
from data.questions.summary import summarize
from data.sensors import Bearing, Range, RangeBearing
from tests.data.formats.open_log.same_log import assert_same_log, load
from tests.data.formats.open_log.test_faults import refused, refused_field

TOML = """\
format = 2
name = "small"
[prior]
mean = [0, 0, 0]
sigma = [0, 0, 0]
[[sensor]]
name = "lidar"
kind = "range_bearing"
sees = "tree"
max_range = 8.0
sigma = [0.1, 0.02]
[[sensor]]
name = "camera"
kind = "bearing"
rotation = 0.5
sigma = [0.03]
[[sensor]]
name = "radio"
kind = "range"
sees = "beacon"
translation = [0.1, 0.2]
"""
OBSERVATIONS = """\
{key},sensor,z1,z2,r11,r12,r22,true_id
{0},radio,5.5,,0.04,,,9
{0},camera,-0.25,,,,,3
{0},,2.5,0.5,,,,3
{1},camera,1.5,,0.0025,,,-1
{1},lidar,3.5,0.25,0.01,0.001,0.02,4
"""
LANDMARKS = "id,x,y,kind\n9,7,1,beacon\n3,2,1,tree\n4,3,1.5,tree\n"
FRAMES = "t,dx,dy,dtheta,c_xx,c_xy,c_xt,c_yy,c_yt,c_tt\n0,0,0,0,0,0,0,0,0,0\n0.5,1,0,0,0.01,0,0,0.01,0,0.01\n"
ODOMETRY = "t,v,omega\n0,1,0\n1,1,0\n"
MOTION = '[motion]\nnoise = "density"\nsigma = [0.1, 0.1]\n'


def files_of(source: str) -> dict[str, str]:
    by_stamp = source == "odometry"
    at = ("0.25", "0.75") if by_stamp else ("0", "1")
    return {
        "log.toml": TOML + MOTION * by_stamp, f"{source}.csv": ODOMETRY if by_stamp else FRAMES,
        "observations.csv": OBSERVATIONS.format(*at, key="t" if by_stamp else "frame"), "landmarks.csv": LANDMARKS,
    }  # fmt: skip


@pytest.mark.parametrize("source", ["frames", "odometry"])
def test_each_row_is_of_its_sensor_and_the_log_comes_back_bit_for_bit(save, tmp_path, source):
    log = load_folder(save(tmp_path / "log", files_of(source)))
    r, o = log.recorded, log.recorded.observations
    assert [(type(s), s.label, s.sees) for s in r.sensors] == [
        (RangeBearing, "lidar", "tree"), (Bearing, "camera", ""), (Range, "radio", "beacon"),
    ]  # fmt: skip
    assert r.sensor == r.sensors[0]
    assert (r.sensors[1].rotation, r.sensors[2].translation) == (0.5, (0.1, 0.2))
    assert o.sensor.tolist() == [0, 1, 2, 0, 1]
    assert o.z.tolist() == [[2.5, 0.5], [0, -0.25], [5.5, 0], [3.5, 0.25], [0, 1.5]]
    assert np.allclose(o.R[[0, 1, 2, 4]], [np.diag(v) for v in ([0.01, 4e-4], [1, 9e-4], [0.04, 1], [1, 0.0025])])
    assert o.R[3].tolist() == [[0.01, 0.001], [0.001, 0.02]]
    assert log.truth.landmark_of.tolist() == [3, 3, 9, 4, -1]
    assert (r.map.id.tolist(), r.map.kind) == ([3, 4, 9], ("tree", "tree", "beacon"))
    write_folder(log, tmp_path / "again" / "small")
    assert_same_log(load(tmp_path / "again" / "small"), log)


@pytest.mark.parametrize(("kind", "z"), [("bearing", [[0, 0.5], [0, -2.0]]), ("range", [[0.5, 0], [2.0, 0]])])
def test_one_sensor_of_one_number_needs_no_name_and_no_second_column(save, tmp_path, kind, z):
    toml = TOML[: TOML.index("[[sensor]]")] + f'[sensor]\nkind = "{kind}"\nsigma = [0.1]\n'
    number = max(z[1], key=abs)
    rows = f"frame,z1\n0,0.5\n1,{number}\n"
    log = load_folder(save(tmp_path / "log", {"log.toml": toml, "frames.csv": FRAMES, "observations.csv": rows}))
    assert log.recorded.observations.z.tolist() == z
    assert (log.recorded.sensors, log.recorded.observations.sensor) == ((), None)
    write_folder(log, tmp_path / "again" / "small")
    assert_same_log(load(tmp_path / "again" / "small"), log)


def test_a_sensor_that_has_a_name_or_sees_one_kind_is_of_format_2(save, tmp_path, small_log_files):
    log = load_folder(save(tmp_path / "log", small_log_files("frames", "range_bearing")))
    for more in ({"label": "lidar"}, {"sees": "tree"}):
        named = replace(log, recorded=replace(log.recorded, sensor=replace(log.recorded.sensor, **more)))
        assert "format = 2\n" in contents(named, "a")["log.toml"]
        assert_same_log(write_folder(named, tmp_path / "small"), replace(named, name="small"))


# line, field, new value, what the message must say
FIELDS = [
    (2, 1, "radar", ":2: column sensor: 'radar' is unknown.*known: lidar, camera, radio"),
    (2, 2, "-1", ":2: column z1: -1 is a negative range"),
    (2, 3, "0.5", ":2: column z2: a value, but range does not measure it; leave the field blank"),
    (4, 3, "", ":4: column z2: blank, but range_bearing measures it; a number is needed"),
    (2, 4, "", r":2: column r11: blank, and no sigma in \[\[sensor\]\] 'radio' of log.toml"),
    (5, 5, "0.1", ":5: column r12: a value, but bearing does not measure it"),
    (6, 0, "2", ":(4|6): column frame: 2 is out of range"),
]


@pytest.mark.parametrize(("line", "field", "new", "message"), FIELDS)
def test_a_bad_field_is_named_with_file_line_column_and_value(save, tmp_path, line, field, new, message):
    refused_field(save, tmp_path, files_of("frames"), "observations.csv", line, field, new, message)


@pytest.mark.parametrize(("old", "new", "message"), [
    ("format = 2", "format = 1", r"\[sensor\] name = 'lidar': format = 2 is needed"),
    ('name = "camera"\n', "", r"\[sensor\] name: missing"),
    ('name = "camera"', 'name = "lidar"', r"\[sensor\] name = 'lidar': the name of two tables"),
    ('kind = "bearing"', 'kind = "line"\nmax_range = 3', r"\[sensor\] sigma = \[0.03\]: two numbers > 0 are needed"),
    ("sigma = [0.03]", "sigma = [0.03, 0.1]", r"\[sensor\] sigma = \[0.03, 0.1\]: one number > 0 is needed"),
    ('kind = "bearing"\nrotation = 0.5\nsigma = [0.03]', 'kind = "line"', r"\[\[sensor\]\]: lines beside points"),
])  # fmt: skip
def test_a_bad_sensor_is_named(save, tmp_path, old, new, message):
    refused(save, tmp_path, files_of("frames"), old, new, message)


def test_the_summary_has_a_line_for_each_sensor(save, tmp_path):
    said = summarize(load_folder(save(tmp_path / "log", files_of("frames"))))
    assert [text.split(",")[0] for what, text in said if what == "sensor"] == [
        "lidar: range_bearing", "camera: bearing", "radio: range"
    ]  # fmt: skip
    assert [text.split(";")[0] for what, text in said if what == "measured"] == [
        "lidar: 2, range 2.5 to 3.5 m, bearing 14.32 to 28.65 deg",
        "camera: 2, bearing -14.32 to 85.94 deg",
        "radio: 1, range 5.5 to 5.5 m",
    ]
    assert not any("label repeated" in text for what, text in said if what == "check")

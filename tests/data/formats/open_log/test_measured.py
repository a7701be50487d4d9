"""Fixes and closures of an open log folder: read as stated, and refused in a line where they are wrong."""

from __future__ import annotations

import re

import numpy as np
import pytest

from data.errors import DataError
from data.formats.open_log.reader import load_folder
from data.formats.open_log.writer import contents, write_folder
from data.log import Log
from data.pose_measurements import FixKind
from tests.data.formats.open_log.measured import CLOSURE, FIX, measured_files
from tests.data.formats.open_log.same_log import assert_same_log, load
from tests.data.formats.open_log.test_faults import edit


@pytest.mark.parametrize("source", ["frames", "odometry"])
def test_fixes_are_read_with_their_sources(save, tmp_path, source):
    log = load_folder(save(tmp_path / "log", measured_files(source)))
    fixes = log.recorded.fixes
    assert [(s.name, s.lever, s.rotation) for s in fixes.sources] == [
        ("gps", (0.3, -0.1), 0.0),
        ("compass", (0.0, 0.0), 0.2),
    ]
    assert fixes.kind.tolist() == [FixKind.POSITION, FixKind.HEADING, FixKind.POSE, FixKind.POSITION]
    assert fixes.source.tolist() == [0, 1, 0, 0]
    assert fixes.z.tolist() == [[1.5, 2.25, 0], [0, 0, 0.75], [1.75, 2.5, 0.5], [2.5, 3, 0]]
    assert np.allclose(fixes.covariance[0], np.diag([0.25, 0.0625, 0]))
    assert np.allclose(fixes.covariance[1], np.diag([0, 0, 0.0025]))
    assert fixes.covariance[2].tolist() == [[0.04, 0.01, 0], [0.01, 0.09, 0], [0, 0, 0.01]]
    assert fixes.covariance[3].tolist() == [[0.25, 0.1, 0], [0.1, 0.16, 0], [0, 0, 0]]
    assert log.truth.fix_inlier.tolist() == [1, -1, 0, -1]


@pytest.mark.parametrize("source", ["frames", "odometry"])
def test_closures_are_sorted_by_their_later_frame(save, tmp_path, source):
    log = load_folder(save(tmp_path / "log", measured_files(source)))
    closures = log.recorded.closures
    assert closures.relative.tolist() == [[0.25, 0.01, 0.1], [-0.75, 0.25, 3.25]]
    assert closures.frame1[0] == closures.frame2[1] == closures.earlier[1]
    assert closures.later.tolist() == sorted(closures.later.tolist())
    assert [closures.sources[k] for k in closures.source] == ["camera", "laser"]
    assert closures.covariance[1].tolist() == [[0.01, 0.001, 0], [0.001, 0.02, 0], [0, 0, 0.001]]
    assert log.truth.closure_inlier.tolist() == [1, 0]


def test_only_a_log_with_fixes_or_closures_is_of_format_2(save, tmp_path, small_log_files):
    plain = load_folder(save(tmp_path / "plain", small_log_files("frames", "range_bearing")))
    assert "format = 1\n" in contents(plain, "plain")["log.toml"]
    assert "format = 2\n" in contents(load_folder(save(tmp_path / "b", measured_files("frames"))), "b")["log.toml"]


@pytest.mark.parametrize("kept", ["fixes.csv", "closures.csv"])
def test_a_log_of_odometry_and_fixes_or_closures_needs_no_sensor(save, tmp_path, kept):
    files = measured_files("frames")
    toml = files["log.toml"]
    toml = toml.replace(CLOSURE if kept == "fixes.csv" else FIX, "")
    toml = toml[: toml.index("[sensor]")] + toml[toml.index("[source]") :]
    log = load_folder(save(tmp_path, {"log.toml": toml, "frames.csv": files["frames.csv"], kept: files[kept]}))
    assert len(log.recorded.observations.frame) == 0
    write_folder(log, tmp_path / "again" / "small")
    assert_same_log(load(tmp_path / "again" / "small"), log)


def test_without_fixes_or_closures_a_sensor_is_needed(save, tmp_path):
    files = {k: v for k, v in measured_files("frames").items() if k in ("log.toml", "frames.csv")}
    files["log.toml"] = files["log.toml"][: files["log.toml"].index("[sensor]")]
    with pytest.raises(DataError, match=r"log.toml: no \[sensor\] table"):
        load_folder(save(tmp_path, files))


# file, line, field, new value, what the message must say
FIELDS = [
    ("fixes.csv", 2, 0, "4", ":2: column frame: 4 is out of range; there are frames 0 to 3"),
    ("fixes.csv", 2, 1, "place", ":2: column kind: 'place' is unknown.*known: position, heading, pose"),
    ("fixes.csv", 3, 2, "compas", r":3: column source: 'compas' is unknown \(did you mean compass\?\)"),
    ("fixes.csv", 2, 3, "", ":2: column x: blank, but position measures it"),
    ("fixes.csv", 2, 5, "0.5", ":2: column theta: a value, but position does not measure it"),
    ("fixes.csv", 3, 2, "gps", r":3: column theta: no covariance, and no sigma of it in \[\[fix\]\] 'gps'"),
    ("fixes.csv", 4, 9, "", ":4: column c_yy: blank, but pose measures it"),
    ("fixes.csv", 5, 7, "0.2", ":5: column c_xx to c_tt: the covariance is not positive definite"),
    ("fixes.csv", 4, 12, "2", ":4: column true_inlier: 2 is neither 0 nor 1 nor blank"),
    ("closures.csv", 2, 1, "3", ":2: column frame2: 3 is frame1, too; two frames are needed"),
    ("closures.csv", 2, 6, "0.1", ":2: column c_xx to c_tt: the covariance is not positive definite"),
    ("closures.csv", 3, 11, "lidar", r":3: column source: 'lidar' is unknown.*known: laser, camera"),
]


@pytest.mark.parametrize(("file", "line", "field", "new", "message"), FIELDS)
def test_a_bad_field_is_named_with_file_line_column_and_value(save, tmp_path, file, line, field, new, message):
    files = measured_files("frames")
    files[file] = edit(files[file], line, field, new)
    with pytest.raises(DataError, match=rf"{re.escape(str(tmp_path / file))}{message}"):
        load_folder(save(tmp_path, files))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("format = 2", "format = 1", r"\[\[fix\]\] in format 1; format = 2 is needed"),
        ("lever = [0.3, -0.1]", "lever = [0.3]", r"\[fix\] lever = \[0.3\]: two numbers"),
        ("sigma = [0.5, 0.25]", "sigma = [0.5, 0.0]", r"\[fix\] sigma.*numbers > 0"),
        ('name = "compass"', 'name = "gps"', r"\[fix\] name = 'gps': the name of two tables"),
        ("sigma = [0.1, 0.2, 0.01]", "sigma = [0.1, 0.2]", r"\[closure\] sigma.*three numbers"),
    ],
)
def test_a_bad_source_is_named(save, tmp_path, old, new, message):
    files = measured_files("frames")
    assert old in files["log.toml"]
    files["log.toml"] = files["log.toml"].replace(old, new, 1)
    with pytest.raises(DataError, match=rf"log\.toml: {message}"):
        load_folder(save(tmp_path, files))


@pytest.mark.parametrize(("gone", "table"), [("fixes.csv", "fix"), ("closures.csv", "closure")])
def test_a_source_without_its_file_is_refused(save, tmp_path, gone, table):
    files = measured_files("frames")
    del files[gone]
    with pytest.raises(DataError, match=rf"{gone}: no such file; \[\[{table}\]\] of log.toml needs it"):
        load_folder(save(tmp_path, files))


def test_a_file_of_format_2_in_a_folder_of_format_1_is_refused(save, tmp_path, small_log_files):
    files = small_log_files("frames", "range_bearing") | {"fixes.csv": measured_files("frames")["fixes.csv"]}
    with pytest.raises(DataError, match=r"fixes.csv: in a folder of format 1; format = 2 in log.toml is needed"):
        load_folder(save(tmp_path, files))


def test_closures_without_covariances_take_the_sigma_of_their_source(save, tmp_path):
    files = measured_files("frames")
    files["closures.csv"] = "frame1,frame2,dx,dy,dtheta,source\n0,2,1,2,0.5,laser\n"
    log = load_folder(save(tmp_path / "a", files))
    assert np.allclose(log.recorded.closures.covariance, [np.diag([0.01, 0.04, 0.0001])])
    files["closures.csv"] = "frame1,frame2,dx,dy,dtheta,source\n0,2,1,2,0.5,camera\n"
    with pytest.raises(DataError, match=r":2: column c_xx: no such column, and no sigma in \[\[closure\]\] 'camera'"):
        load_folder(save(tmp_path / "b", files))


def test_arrays_make_the_log_that_a_folder_does(save, tmp_path):
    folder = load_folder(save(tmp_path / "log", measured_files("frames")))
    r = folder.recorded
    blank = np.nan
    log = Log.from_arrays(
        "small",
        ([1.0, 2.0, 0.5], [0.1, 0.1, 0.05]),
        {"kind": "range_bearing", "sigma": [0.1, 0.1]},
        [],
        increments=r.increments.mean,
        covariance=r.increments.covariance,
        fixes={
            "frame": [0, 0],
            "kind": ["position", "heading"],
            "source": ["", "compass"],
            "x": [1.5, blank],
            "y": [2.25, blank],
            "theta": [blank, 0.75],
            "sources": [
                {"name": "gps", "lever": np.array([0.3, -0.1]), "sigma": [0.5, 0.25]},
                {"name": "compass", "rotation": 0.2, "sigma": [0.05]},
            ],
        },
        closures={"frame1": [3], "frame2": 0, "dx": -0.75, "dy": 0.25, "dtheta": 3.25, "sources": [
            {"name": "laser", "sigma": [0.1, 0.2, 0.01]}]},
    )  # fmt: skip
    assert_same_log(log.recorded.fixes, r.fixes.before(1))
    assert log.recorded.closures.relative.tolist() == [[-0.75, 0.25, 3.25]]
    with pytest.raises(DataError, match=r"m: fixes:0: column y: blank, but position measures it"):
        Log.from_arrays("m", (np.zeros(3), np.ones(3)), {"kind": "range_bearing", "sigma": [0.1, 0.1]}, [],
                        increments=np.zeros((2, 3)), covariance=[1.0, 1.0, 1.0],
                        fixes={"frame": [1], "kind": "position", "x": 2.0})  # fmt: skip
    with pytest.raises(DataError, match=r"m: closures: no dtheta; frame1, frame2, dx, dy, dtheta are needed"):
        Log.from_arrays("m", (np.zeros(3), np.ones(3)), {"kind": "range_bearing", "sigma": [0.1, 0.1]}, [],
                        increments=np.zeros((2, 3)), covariance=[1.0, 1.0, 1.0],
                        closures={"frame1": [1], "frame2": 0, "dx": 2.0, "dy": 0.0})  # fmt: skip

"""Fixes, closures and motion priors of an open log folder: read as stated, refused in a line where wrong."""

import math

import numpy as np
import pytest

from data.errors import DataError
from data.formats.open_log import contents, load_folder, write_folder
from data.log import Log
from data.motion.motion_prior import ConstantVelocityPrior, ForwardPrior
from data.pose_measurements import FixKind
from tests.data.formats.open_log.measured import CLOSURE, FIX, measured_files
from tests.data.formats.open_log.same_log import assert_same_log, load
from tests.data.formats.open_log.test_faults import refused, refused_field


@pytest.mark.parametrize("source", ["frames", "odometry"])
def test_fixes_are_read_with_their_sources_and_closures_sorted_by_their_later_frame(save, tmp_path, source):
    log = load_folder(save(tmp_path / "log", measured_files(source)))
    fixes = log.recorded.fixes
    told = [(s.name, s.lever, s.rotation) for s in fixes.sources]
    assert told == [("gps", (0.3, -0.1), 0.0), ("compass", (0.0, 0.0), 0.2)]
    assert fixes.kind.tolist() == [FixKind.POSITION, FixKind.HEADING, FixKind.POSE, FixKind.POSITION]
    assert fixes.source.tolist() == [0, 1, 0, 0]
    assert fixes.z.tolist() == [[1.5, 2.25, 0], [0, 0, 0.75], [1.75, 2.5, 0.5], [2.5, 3, 0]]
    assert np.allclose(fixes.covariance[0], np.diag([0.25, 0.0625, 0]))
    assert np.allclose(fixes.covariance[1], np.diag([0, 0, 0.0025]))
    assert fixes.covariance[2].tolist() == [[0.04, 0.01, 0], [0.01, 0.09, 0], [0, 0, 0.01]]
    assert fixes.covariance[3].tolist() == [[0.25, 0.1, 0], [0.1, 0.16, 0], [0, 0, 0]]
    assert log.truth.fix_inlier.tolist() == [1, -1, 0, -1]
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
    ("fixes.csv", 3, 2, "gps", r":3: column c_xx: blank, and no sigma in \[\[fix\]\] 'gps'"),
    ("fixes.csv", 4, 9, "", ":4: column c_yy: blank, but pose measures it"),
    ("fixes.csv", 5, 7, "0.2", ":5: column c_xx to c_tt: the covariance is not positive definite"),
    ("fixes.csv", 4, 12, "2", ":4: column true_inlier: 2 is neither 0 nor 1 nor blank"),
    ("closures.csv", 2, 1, "3", ":2: column frame2: 3 is frame1, too; two frames are needed"),
    ("closures.csv", 2, 6, "0.1", ":2: column c_xx to c_tt: the covariance is not positive definite"),
    ("closures.csv", 3, 11, "lidar", r":3: column source: 'lidar' is unknown.*known: laser, camera"),
]


@pytest.mark.parametrize(("file", "line", "field", "new", "message"), FIELDS)
def test_a_bad_field_is_named_with_file_line_column_and_value(save, tmp_path, file, line, field, new, message):
    refused_field(save, tmp_path, measured_files("frames"), file, line, field, new, message)


@pytest.mark.parametrize(("old", "new", "message"), [
    ("format = 2", "format = 1", r"\[\[fix\]\] in format 1; format = 2 is needed"),
    ("lever = [0.3, -0.1]", "lever = [0.3]", r"\[fix\] lever = \[0.3\]: two numbers"),
    ("sigma = [0.5, 0.25]", "sigma = [0.5, 0.0]", r"\[fix\] sigma.*numbers > 0"),
    ('name = "compass"', 'name = "gps"', r"\[fix\] name = 'gps': the name of two tables"),
    ("sigma = [0.1, 0.2, 0.01]", "sigma = [0.1, 0.2]", r"\[closure\] sigma.*three numbers"),
])  # fmt: skip
def test_a_bad_source_is_named(save, tmp_path, old, new, message):
    refused(save, tmp_path, measured_files("frames"), old, new, message)


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


TIMES = np.array([0.0, 0.5, 1.25, 2.0])
FORWARD = """[motion]
prior = "forward"
step_mean = 0.5
step_sigma = 0.4
lateral_sigma = 0.1
turn_sigma = 1.0
"""
STEADY = """[motion]
prior = "constant_velocity"
velocity = 0.8
velocity_sigma = 0.2
lateral_sigma = 0.1
turn_rate = 0.0
turn_rate_sigma = 0.5
"""


def primed(small_log_files, motion):
    """A small folder without odometry: frames.csv has times alone, the motion is stated."""
    files = small_log_files("frames", "relative_point")
    assert "[prior]" in files["log.toml"]
    stamps = [line.split(",")[0] for line in files["frames.csv"].splitlines()]
    return files | {
        "frames.csv": "\n".join(stamps) + "\n",
        "log.toml": files["log.toml"].replace("[prior]", motion + "[prior]"),
    }


def test_forward_states_the_same_step_whatever_the_time():
    got = ForwardPrior(0.5, 0.4, 0.1, 1.0).increments(TIMES)
    assert got.mean.tolist() == [[0, 0, 0], *[[0.5, 0, 0]] * 3]
    assert not got.covariance[0].any()
    for k in (1, 2, 3):
        assert got.covariance[k] == pytest.approx(np.diag([0.16, 0.01, 1.0]))


def test_constant_velocity_straight_ahead_scales_with_the_time():
    got = ConstantVelocityPrior(2.0, 0.3, 0.1, 0.0, 0.4).increments(TIMES)
    assert got.mean.tolist() == [[0, 0, 0], [1.0, 0, 0], [1.5, 0, 0], [1.5, 0, 0]]
    # sigmas in proportion to the time, and a turn shifts the end sideways by half of it times the way
    dt, way = 0.75, 1.5
    turn = (0.4 * dt) ** 2
    expected = [
        [(0.3 * dt) ** 2, 0, 0],
        [0, (0.1 * dt) ** 2 + turn * way**2 / 4, turn * way / 2],
        [0, turn * way / 2, turn],
    ]
    assert got.covariance[2] == pytest.approx(np.array(expected))


def test_constant_velocity_on_an_arc_is_what_samples_of_its_velocity_give():
    """Monte Carlo of velocity, sideways drift and turn rate about the stated ones."""
    prior, dt = ConstantVelocityPrior(1.0, 0.02, 0.01, 1.2, 0.03), 0.8
    rng = np.random.default_rng(5)
    v, w = 1.0 + 0.02 * rng.standard_normal(100_000), 1.2 + 0.03 * rng.standard_normal(100_000)
    drift = 0.01 * dt * rng.standard_normal(100_000)
    x = v / w * np.sin(w * dt) - drift * math.sin(0.6 * dt)
    y = v / w * (1.0 - np.cos(w * dt)) + drift * math.cos(0.6 * dt)
    samples = np.stack([x, y, w * dt])
    got = prior.increments(np.array([0.0, dt]))
    assert got.mean[1] == pytest.approx(samples.mean(axis=1), abs=5e-4)
    assert got.covariance[1] == pytest.approx(np.cov(samples), abs=0.03 * np.cov(samples).max())


@pytest.mark.parametrize(("motion", "prior"), [
    (FORWARD, ForwardPrior(0.5, 0.4, 0.1, 1.0)), (STEADY, ConstantVelocityPrior(0.8, 0.2, 0.1, 0.0, 0.5)),
])  # fmt: skip
def test_a_folder_states_a_prior_in_place_of_increments(small_log_files, save, tmp_path, motion, prior):
    log = load_folder(save(tmp_path / "in", primed(small_log_files, motion)))
    expected = prior.increments(TIMES)
    assert np.array_equal(log.recorded.increments.mean, expected.mean)
    assert log.recorded.increments.covariance == pytest.approx(expected.covariance, abs=1e-8)
    assert any("motion prior" in note for note in log.notes)
    assert log.recorded.observations.frame.tolist() == [0, 1, 1, 3]
    # written, the increments stand in frames.csv
    write_folder(log, tmp_path / "out")
    again = load_folder(tmp_path / "out")
    assert np.array_equal(again.recorded.increments.mean, log.recorded.increments.mean)
    assert np.array_equal(again.recorded.increments.covariance, log.recorded.increments.covariance)
    assert again.notes == log.notes


@pytest.mark.parametrize(("old", "new", "message"), [
    ('"forward"', '"backward"', r"\[motion\] prior = 'backward': unknown; known: forward, constant_velocity"),
    ('"forward"', '"constant_velocity"', r"\[motion\] step_mean = 0.5: prior = 'constant_velocity' takes velocity,"),
    ("step_mean = 0.5", "", r"\[motion\] step_mean: missing; a number is needed"),
    ("step_sigma = 0.4", "step_sigma = -0.4", r"\[motion\] step_sigma = -0.4: a number >= 0"),
])  # fmt: skip
def test_a_bad_prior_is_named_with_key_and_value(small_log_files, save, tmp_path, old, new, message):
    files = primed(small_log_files, FORWARD.replace(old, new, 1))
    with pytest.raises(DataError, match=rf"log\.toml: {message}"):
        load_folder(save(tmp_path, files))


def test_a_prior_stands_beside_neither_increments_nor_odometry(small_log_files, save, tmp_path):
    files = small_log_files("frames", "relative_point")
    stated = files["log.toml"].replace("[prior]", FORWARD + "[prior]")
    with pytest.raises(DataError, match=r"frames\.csv:1: column dx: \[motion\] prior in log\.toml states"):
        load_folder(save(tmp_path / "both", files | {"log.toml": stated}))
    driven = small_log_files("odometry", "relative_point")
    begin, end = driven["log.toml"].index("[motion]"), driven["log.toml"].index("[prior]")
    driven["log.toml"] = driven["log.toml"][:begin] + FORWARD + driven["log.toml"][end:]
    with pytest.raises(DataError, match=r"odometry\.csv: log\.toml states a \[motion\] prior instead"):
        load_folder(save(tmp_path / "driven", driven))

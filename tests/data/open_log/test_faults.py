"""Whatever is wrong with a log folder is a `DataError` that says where, never another exception or a silent NaN."""

from __future__ import annotations

import math
import re
import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from data.errors import DataError
from data.inputs import CLUTTER, UNLABELLED, IntArray
from data.log import Log
from data.open_log.reader import FILES, load_folder
from data.sensors import RangeBearing
from data.truth import UNKNOWN_ID


def edit(text: str, line: int, field: int, new: str) -> str:
    """Replace one field; line 1 is the header, field counts from 0."""
    lines = text.split("\n")
    fields = lines[line - 1].split(",")
    fields[field] = new
    lines[line - 1] = ",".join(fields)
    return "\n".join(lines)


# source, file, line, field, new value, what the message must say
FIELDS = [
    ("frames", "frames.csv", 3, 0, "two", "line 3, column t: 'two' is not a number"),
    ("frames", "frames.csv", 3, 0, "", "line 3, column t: blank"),
    ("frames", "frames.csv", 3, 0, "1_0", "line 3, column t: '1_0' is not a number"),
    ("frames", "frames.csv", 3, 0, "0", "line 3, column t: 0 follows 0.0; t must increase"),
    ("frames", "frames.csv", 4, 0, "0.25", "line 4, column t: 0.25 follows 0.5"),
    ("frames", "frames.csv", 4, 1, "nan", "line 4, column dx: nan"),
    ("frames", "frames.csv", 4, 9, "inf", "line 4, column c_tt: inf"),
    ("frames", "frames.csv", 4, 2, "1e300", r"line 4, column dy: 1e\+300"),
    ("frames", "frames.csv", 4, 2, "1e999", "line 4, column dy: inf"),
    ("frames", "frames.csv", 2, 3, "0.1", "line 2, column dtheta: 0.1 in row 0"),
    ("frames", "frames.csv", 2, 4, "0.1", "line 2, column c_xx: 0.1 in row 0"),
    ("frames", "frames.csv", 3, 5, "0.1", "line 3, column c_xx to c_tt: the covariance is not positive semidefinite"),
    ("frames", "frames.csv", 4, 4, "-1e-9", "line 4, column c_xx to c_tt: the covariance is not positive semidefinite"),
    ("frames", "observations.csv", 5, 0, "4", "line 5, column frame: 4 is out of range; there are frames 0 to 3"),
    ("frames", "observations.csv", 2, 0, "-1", "line 2, column frame: -1 is not a whole number from 0 up"),
    ("frames", "observations.csv", 3, 0, "0.5", "line 3, column frame: 0.5 is not a whole number"),
    ("frames", "observations.csv", 4, 0, "0", "line 4, column frame: 0 follows 1.0; frame must not decrease"),
    ("frames", "observations.csv", 4, 1, "-0.5", "line 4, column z1: -0.5 is a negative range"),
    ("frames", "observations.csv", 4, 2, "-inf", "line 4, column z2: -inf"),
    ("frames", "observations.csv", 4, 2, "9;5", "line 4, column z2: '9;5' is not a number"),
    ("frames", "observations.csv", 4, 3, "0", "line 4, column r11: variance 0 must be positive"),
    ("frames", "observations.csv", 4, 5, "-0.1", "line 4, column r22: variance -0.1 must be positive"),
    ("frames", "observations.csv", 2, 4, "0.0142", "line 2, column r12: 0.0142 is too large for r11 and r22"),
    ("frames", "observations.csv", 2, 5, "", "line 2, column r22: blank"),
    ("frames", "observations.csv", 2, 6, "-2", "line 2, column true_id: -2 is not a whole number from -1 up"),
    ("frames", "observations.csv", 2, 6, "3.5", "line 2, column true_id: 3.5 is not a whole number"),
    ("frames", "observations.csv", 2, 7, "-2", "line 2, column label: -2 is not a whole number"),
    ("frames", "observations.csv", 2, 7, "A", "line 2, column label: 'A' is not a number"),
    ("frames", "truth.csv", 2, 2, "east", "line 2, column theta: 'east' is not a number"),
    ("frames", "truth.csv", 2, 2, "inf", "line 2, column theta: inf .* leave the field blank"),
    ("frames", "landmarks.csv", 2, 0, "-7", "line 2, column id: -7 is not a whole number from 0 up"),
    ("frames", "landmarks.csv", 3, 0, "7", "line 3, column id: 7 stands for two landmarks"),
    ("frames", "landmarks.csv", 3, 0, "nan", "line 3, column id: nan"),
    ("frames", "landmarks.csv", 3, 2, "", "line 3, column y: blank"),
    ("frames", "landmarks.csv", 3, 4, "-1", "line 3, column sy: -1 is a negative standard deviation"),
    ("odometry", "odometry.csv", 4, 0, "10.5", "line 4, column t: 10.5 follows 10.5"),
    ("odometry", "odometry.csv", 6, 0, "2e6", "line 6, column t: 2000000 s is more than 1e\\+06 s"),
    ("odometry", "odometry.csv", 3, 1, "nan", "line 3, column v: nan"),
    ("odometry", "odometry.csv", 3, 2, "?", "line 3, column omega: '\\?' is not a number"),
    ("odometry", "observations.csv", 4, 0, "10", "line 4, column t: 10 follows 10.25"),
    ("odometry", "observations.csv", 5, 0, "1e9", "line 5, column t: 1000000000 s is more than"),
    ("odometry", "observations.csv", 5, 0, "", "line 5, column t: blank"),
    ("odometry", "truth.csv", 3, 0, "10", "line 3, column t: 10 follows 10.0"),
    ("odometry", "truth.csv", 3, 0, "", "line 3, column t: blank"),
]


@pytest.mark.parametrize(("source", "file", "line", "field", "new", "message"), FIELDS)
def test_a_bad_field_is_named_with_file_line_column_and_value(
    small_log_files, save, tmp_path, source, file, line, field, new, message
):
    files = small_log_files(source, "range_bearing")
    files[file] = edit(files[file], line, field, new)
    with pytest.raises(DataError, match=rf"{re.escape(str(tmp_path / file))}: {message}"):
        load_folder(save(tmp_path, files))


@pytest.mark.parametrize("source", ["frames", "odometry"])
@pytest.mark.parametrize("file", [*FILES, "motion.csv"])
def test_a_missing_file_is_named_if_it_is_needed(small_log_files, save, tmp_path, source, file):
    files = small_log_files(source, "range_bearing")
    needed = file in files and file not in ("truth.csv", "landmarks.csv")
    files.pop(file, None)
    folder = save(tmp_path, files)
    if not needed:
        load_folder(folder)
        return
    named = "frames.csv" if file == "odometry.csv" else file
    with pytest.raises(DataError, match=rf"{named}: no such file"):
        load_folder(folder)


def test_a_path_that_is_no_folder_is_named(tmp_path):
    with pytest.raises(DataError, match=r"nowhere: no such folder"):
        load_folder(tmp_path / "nowhere")
    with pytest.raises(DataError, match=r"no such folder"):
        load_folder(tmp_path / ("x" * 5000))
    (tmp_path / "file").write_text("")
    with pytest.raises(DataError, match=r"file: not a folder"):
        load_folder(tmp_path / "file")
    (tmp_path / "empty").mkdir()
    with pytest.raises(DataError, match=r"log\.toml: no such file"):
        load_folder(tmp_path / "empty")


def test_a_folder_where_a_file_should_be_is_named(small_log_files, save, tmp_path):
    folder = save(tmp_path, small_log_files("frames", "range_bearing"))
    (folder / "landmarks.csv").unlink()
    (folder / "landmarks.csv").mkdir()
    with pytest.raises(DataError, match=r"landmarks\.csv: cannot be read"):
        load_folder(folder)


def test_frames_and_odometry_together_are_ambiguous(small_log_files, save, tmp_path):
    files = small_log_files("odometry", "range_bearing") | {"frames.csv": "t"}
    with pytest.raises(DataError, match=r"odometry\.csv: there is frames\.csv as well"):
        load_folder(save(tmp_path, files))


@pytest.mark.parametrize(
    ("file", "old", "new", "message"),
    [
        ("frames.csv", "c_yt,", "", "line 1, column c_yt: no such column"),
        ("frames.csv", "t,dx", "dx,dx", "line 1, column t: no such column; found 'dx,dx"),
        ("frames.csv", "c_tt\n", "c_tt,dx\n", "line 1, column dx: two columns of that name"),
        ("frames.csv", "0.5,0.25,", "0.5,", "line 3: 9 fields where the header names 10$"),
        ("frames.csv", "0.5,0.25,", "0.5,0.25,1,", "line 3: 11 fields where the header names 10$"),
        ("frames.csv", "2,0,0,0,0,0,0,0,0,0\n", "2,0,0,0", "line 5: 4 fields .* was it cut off"),
        ("frames.csv", "2,0,0,0,0,0,0,0,0,0\n", "# the end\n", "line 5: 1 field where"),
        ("frames.csv", "\n1.25", "\n\n1.25", "line 4: blank line between rows"),
        ("frames.csv", None, "", "line 1, column t: no such column; the line is blank"),
        ("frames.csv", None, "t,dx,dy,dtheta,c_xx,c_xy,c_xt,c_yy,c_yt,c_tt\n", "line 1: no rows"),
        ("observations.csv", "r12", "r_12", "line 1, column r12: no such column; r11,r12,r22 come together"),
        ("observations.csv", "r11,r12,r22", "a,b,c", r"no columns r11,r12,r22, and no sigma in \[sensor\]"),
        ("observations.csv", "frame,", "t,", "line 1, column frame: no such column"),
        ("truth.csv", "nan,nan,nan\n", "", "line 4: 3 rows for 4 frames"),
        ("truth.csv", "nan,nan,nan\n", "1,1,1\n2,2,2\n", "line 6: 5 rows for 4 frames"),
        ("truth.csv", ",,\n", "\n", "line 4: blank line between rows; a row of unknown values keeps its commas"),
        ("truth.csv", "x,y,theta", "x;y;theta", "line 1, column x: no such column"),
    ],
)
def test_a_broken_table_is_named_with_the_line(small_log_files, save, tmp_path, file, old, new, message):
    files = small_log_files("frames", "range_bearing")
    assert old is None or old in files[file]
    files[file] = new if old is None else files[file].replace(old, new, 1)
    with pytest.raises(DataError, match=rf"{re.escape(file)}: {message}"):
        load_folder(save(tmp_path, files))


MEAN = "mean = [1.0, 2.0, 0.5]"
KIND = 'kind = "range_bearing"'
SIGMA = "sigma = [0.1, 0.05]"
VIEW = "field_of_view = 3.0"
PRIOR = "sigma = [0.1, 0.1, 0.05]"


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("format = 1", "format = 2", "format = 2: unknown format number; format = 1 is needed"),
        ("format = 1", "format = true", "format = True: unknown format number"),
        ("format = 1", "", "no format number"),
        ("format = 1", "format = ", "not valid TOML"),
        ("small", "a/b", "name = 'a/b': the name becomes a folder name"),
        ("small", "..", "name = '..'"),
        ("small", " ", "name = ' ': a name"),
        ('name = "small"', "", "name: a name"),
        ('name = "small"', 'nom = "small"', "unknown key 'nom' at the top; known: format, name, "),
        ('maker = "hand"', 'maker = "hand"\n[motor]', "unknown key 'motor' at the top"),
        ("labels_are_sensed = true", "labels_are_sensed = 1", "labels_are_sensed = 1: true or false"),
        ("labels_are_sensed = true", "time_is_index = 'no'", "time_is_index = 'no': true or false"),
        ('["made by hand"]', '"made by hand"', "notes = 'made by hand': a list"),
        (MEAN, "mean = [1.0, 2.0]", r"\[prior\] mean = \[1.0, 2.0\]: three numbers"),
        (MEAN, "mean = [1.0, 2.0, nan]", r"\[prior\] mean = \[1.0, 2.0, nan\]: three numbers"),
        (MEAN, "mean = [1.0, 2.0, true]", r"\[prior\] mean = .*: three numbers"),
        (MEAN, "", r"\[prior\] mean: missing"),
        (PRIOR, "", r"\[prior\] sigma: missing; sigma or covariance"),
        (PRIOR, "sigma = [0.1, 0.1, -0.05]", r"\[prior\] sigma = .*: three numbers >= 0"),
        (PRIOR, PRIOR + "\ncovariance = []", r"\[prior\] sigma = .*: either sigma or covariance"),
        (PRIOR, "covariance = 3", r"\[prior\] covariance = 3: three rows"),
        (PRIOR, "covariance = [[1, 0, 0], [0, 1, 0], [0, 0]]", r"\[prior\] covariance = \[0, 0\]: three rows of three"),
        (PRIOR, "covariance = [[1, 0, 0], [0.1, 1, 0], [0, 0, 1]]", r"\[prior\] covariance = .*: not symmetric"),
        (
            PRIOR,
            "covariance = [[1, 2, 0], [2, 1, 0], [0, 0, 1]]",
            r"\[prior\] covariance = .*: not positive semidefinite",
        ),
        ("[prior]", "[[prior]]", r"prior = \[\{.*: this must be a table"),
        (KIND, 'kind = "sonar"', r"\[sensor\] kind = 'sonar': unknown; known: range_bearing, relative_point"),
        (KIND, "kind = 1", r"\[sensor\] kind = 1: unknown; known"),
        (KIND, "", r"\[sensor\] kind: missing; known"),
        (SIGMA, "sigma = [0.1]", r"\[sensor\] sigma = \[0.1\]: two numbers > 0"),
        (SIGMA, "sigma = [0.1, 0]", r"\[sensor\] sigma = \[0.1, 0\]: two numbers > 0"),
        (SIGMA, "sigma = 0.1", r"\[sensor\] sigma = 0.1: two numbers > 0"),
        (KIND, KIND + "\ncolour = 3", r"unknown key 'colour' in \[sensor\]; known: kind, sigma"),
        (KIND, KIND + "\ncovariance_floor = 0", r"unknown key 'covariance_floor' in \[sensor\]; it belongs to the top"),
        ("max_range = 8.0", "max_range = 0", r"\[sensor\] max_range = 0: a range > 0"),
        ("max_range = 8.0", "max_range = nan", r"\[sensor\] max_range = nan"),
        (VIEW, "field_of_view = 180", r"\[sensor\] field_of_view = 180: an opening angle"),
        (VIEW, "field_of_view = 0", r"\[sensor\] field_of_view = 0: an opening angle"),
        (VIEW, VIEW + "\nmin_angle = -1", r"\[sensor\] field_of_view = 3.0: give it or min_angle and max_angle"),
        (VIEW, "min_angle = 1\nmax_angle = 1", r"\[sensor\] min_angle = 1: min_angle \(1.0\) must be smaller"),
        (VIEW, "max_angle = -4", r"\[sensor\] max_angle = -4: min_angle .* must be smaller"),
        (VIEW, "min_angle = -90\nmax_angle = 90", r"\[sensor\] min_angle = -90: .*radians"),
        (VIEW, "min_angle = -inf", r"\[sensor\] min_angle = -inf: a finite angle"),
        ("rotation = 0.1", "rotation = 'left'", r"\[sensor\] rotation = 'left': a finite angle"),
        ("translation = [0.2, -0.1]", "translation = [0.2]", r"\[sensor\] translation = \[0.2\]: two numbers"),
        (
            "[source]",
            "[sensor.extrinsic]\nrotation = 1\n[source]",
            r"\[sensor\] extrinsic: give rotation and translation here or",
        ),
        (
            "[source]",
            "[sensor.extrinsic]\nangle = 1\n[source]",
            r"unknown key 'angle' in \[sensor.extrinsic\]; known: rotation",
        ),
        ('[source]\nmaker = "hand"', "", None),
        ("[motion]", "[[motion]]", r"motion = \[\{.*: this must be a table"),
        (
            'model = "unicycle"',
            'model = "bicycle"',
            r"\[motion\] model = 'bicycle': unknown; known: unicycle, half_angle",
        ),
        ('model = "unicycle"', "", None),
        ('noise = "density"', "", r"\[motion\] noise: missing; known: velocity, displacement, density"),
        ('noise = "density"', 'noise = "white"', r"\[motion\] noise = 'white': unknown"),
        ('noise = "density"', 'noise = "displacement"', r"\[motion\] sigma = .*: noise = 'displacement' takes alphas"),
        ("sigma = [0.05, 0.02]", "alphas = [1, 1, 1, 1]", r"\[motion\] alphas = .*: noise = 'density' takes sigma"),
        ("sigma = [0.05, 0.02]", "sigma = [0.05, -0.02]", r"\[motion\] sigma = .*: two numbers >= 0"),
        ("sigma = [0.05, 0.02]", "", r"\[motion\] sigma: missing; two numbers"),
    ],
)
def test_a_bad_header_is_named_with_key_and_value(small_log_files, save, tmp_path, old, new, message):
    files = small_log_files("odometry", "range_bearing")
    assert old in files["log.toml"]
    files["log.toml"] = files["log.toml"].replace(old, new, 1)
    folder = save(tmp_path, files)
    if message is None:
        load_folder(folder)
        return
    with pytest.raises(DataError, match=rf"log\.toml: {message}"):
        load_folder(folder)


def test_odometry_needs_a_motion_table_and_a_floor_cannot_be_negative(small_log_files, save, tmp_path):
    toml = small_log_files("frames", "range_bearing")["log.toml"]
    files = small_log_files("odometry", "range_bearing") | {"log.toml": toml}
    with pytest.raises(DataError, match=r"log\.toml: no \[motion\] table; odometry\.csv needs one"):
        load_folder(save(tmp_path, files))
    files["log.toml"] = toml.replace("covariance_floor = 1e-9", "covariance_floor = -1")
    with pytest.raises(DataError, match=r"log\.toml: covariance_floor = -1: a number >= 0"):
        load_folder(save(tmp_path, files))


def test_a_header_that_is_no_text_or_nested_without_end_is_not_valid_toml(small_log_files, save, tmp_path):
    files = small_log_files("frames", "range_bearing")
    for content in (b"format = 1\nname = '\xff'", b"format = 1\nx = " + b"[" * 100_000, b"format = " + b"9" * 10_000):
        with pytest.raises(DataError, match=r"log\.toml: (not valid TOML|format = 9)"):
            load_folder(save(tmp_path, files | {"log.toml": content}))


# --- anything at all --------------------------------------------------------------------------------------------------


def assert_sound(log: Log) -> None:
    """Every promise that estimators and referee rely on."""
    inputs = log.recorded
    o, n, m = inputs.observations, len(inputs.time), len(inputs.observations.frame)
    assert n >= 1
    assert np.isfinite(inputs.time).all()
    assert (np.diff(inputs.time) > 0).all()
    for covariance, count, d in (
        (inputs.prior.covariance[None], 1, 3),
        (inputs.increments.covariance, n, 3),
        (o.R, m, 2),
    ):
        assert covariance.shape == (count, d, d)
        assert np.isfinite(covariance).all()
        assert np.array_equal(covariance, covariance.transpose(0, 2, 1))
        assert (np.linalg.eigvalsh(covariance) >= -2e-12 * np.trace(covariance, axis1=1, axis2=2)[:, None]).all()
    assert (
        np.linalg.det(o.R / np.sqrt(o.R[:, [0, 1], [0, 1]][:, :, None] * o.R[:, [0, 1], [0, 1]][:, None, :])) > 0
    ).all()
    assert inputs.prior.mean.shape == (3,)
    assert inputs.increments.mean.shape == (n, 3)
    assert o.z.shape == (m, 2)
    for array in (inputs.prior.mean, inputs.increments.mean, o.z):
        assert np.isfinite(array).all()
    assert not inputs.increments.mean[0].any()
    assert not inputs.increments.covariance[0].any()
    assert (np.diff(o.frame) >= 0).all()
    assert ((o.frame >= 0) & (o.frame < n)).all()
    if isinstance(inputs.sensor, RangeBearing):
        assert (o.z[:, 0] >= 0).all()
    assert inputs.sensor.max_range > 0
    assert inputs.sensor.min_angle < inputs.sensor.max_angle
    assert math.isfinite(inputs.sensor.rotation)
    assert np.isfinite(inputs.sensor.translation).all()
    for landmarks in (inputs.map, log.truth.landmarks):
        if landmarks is not None:
            assert (landmarks.id >= 0).all()
            assert (np.diff(landmarks.id) > 0).all()
            assert np.isfinite(landmarks.xy).all()
    assert log.truth.pose is None or (log.truth.pose.shape == (n, 3) and not np.isinf(log.truth.pose).any())
    ids: list[tuple[IntArray | None, int]] = [(log.truth.landmark_of, UNKNOWN_ID), (log.label, UNLABELLED)]
    for claimed, blank in ids:
        assert claimed is None or (claimed.shape == (m,) and ((claimed >= CLUTTER) | (claimed == blank)).all())


junk = st.one_of(
    st.sampled_from(
        ["", "nan", "inf", "-inf", "-1", "0", "1e-320", "1e30", "-1e300", "1e999", "9" * 400, "x", "1_0", '"1"']
    ),
    st.sampled_from(["0.5", "1,", "\u0663", "\x00", "#", "1e5", "true", "-0.0", "1e14", "-1e-3", "[1, 2]", "[]", "{}"]),
    st.floats().map(repr),
    st.integers(-(10**18), 10**18).map(str),
    st.text(max_size=5),
)


@st.composite
def corruptions(draw, files: dict[str, str]) -> dict[str, bytes]:
    """The files with one to three faults of any sort."""
    broken = {name: text.encode() for name, text in files.items()}
    for _ in range(draw(st.integers(1, 3))):
        name = draw(st.sampled_from(sorted(broken)))
        content = broken[name]
        lines = content.split(b"\n")
        i, j = draw(st.integers(0, len(lines) - 1)), draw(st.integers(0, len(lines) - 1))
        new = draw(junk).encode("utf-8", "replace")
        fault = draw(
            st.sampled_from(
                ["field", "field", "field", "delete", "column", "cut", "twice", "swap", "truncate", "append", "bytes"]
            )
        )
        separator = b"=" if name == "log.toml" and draw(st.booleans()) else b","
        if fault == "delete":
            if len(broken) > 1:
                del broken[name]
            continue
        if fault == "field":
            fields = lines[i].split(separator)
            fields[draw(st.integers(0, len(fields) - 1))] = new
            lines[i] = separator.join(fields)
        elif fault == "column":
            k = draw(st.integers(0, lines[0].count(b",")))
            lines = [b",".join(f for c, f in enumerate(line.split(b",")) if c != k) for line in lines]
        elif fault == "cut":
            lines[i] = lines[i][: draw(st.integers(0, len(lines[i])))]
        elif fault == "twice":
            lines.insert(i, lines[i])
        elif fault == "swap":
            lines[i], lines[j] = lines[j], lines[i]
        content = b"\n".join(lines)
        if fault == "truncate":
            content = content[: draw(st.integers(0, len(content)))]
        elif fault == "append":
            content += new
        elif fault == "bytes":
            at = draw(st.integers(0, len(content)))
            content = content[:at] + draw(st.binary(max_size=4)) + content[at + draw(st.integers(0, 4)) :]
        broken[name] = content
    return broken


@pytest.mark.parametrize("source", ["frames", "odometry"])
@pytest.mark.parametrize("sensor", ["range_bearing", "relative_point"])
@pytest.mark.parametrize("examples", [100, pytest.param(400, marks=pytest.mark.slow)])
def test_a_corrupted_folder_is_refused_with_its_place_or_read_soundly(small_log_files, save, source, sensor, examples):
    files = small_log_files(source, sensor)

    @given(corruptions(files))
    @settings(max_examples=examples, deadline=None)
    def check(broken):
        with tempfile.TemporaryDirectory() as temporary:
            folder = save(Path(temporary) / "log", broken)
            try:
                log = load_folder(folder)
            except DataError as error:
                message = str(error)
                assert "\n" not in message
                named = [name for name in FILES if message.startswith(f"{folder / name}: ")]
                assert len(named) == 1
                # a fault inside a table has a line
                if named[0].endswith(".csv") and (folder / named[0]).exists() and "sigma in [sensor]" not in message:
                    assert re.match(rf"{re.escape(str(folder / named[0]))}: line \d+", message)
            else:
                assert_sound(log)

    check()

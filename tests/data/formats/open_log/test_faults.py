"""Whatever is wrong with a log folder is a `DataError` that says where, never another exception or a silent NaN."""

import re

import pytest

from data.errors import DataError
from data.formats.open_log import FILES, load_folder


def edit(text: str, line: int, field: int, new: str) -> str:
    """Replace one field; line 1 is the header, field counts from 0."""
    lines = text.split("\n")
    fields = lines[line - 1].split(",")
    fields[field] = new
    lines[line - 1] = ",".join(fields)
    return "\n".join(lines)


def refused(save, tmp_path, files, old, new, message, file="log.toml"):
    """A folder of these files, with one text of one (None: all of it) changed, is refused in a line."""
    assert old is None or old in files[file]
    files[file] = new if old is None else files[file].replace(old, new, 1)
    with pytest.raises(DataError, match=rf"{re.escape(file)}: ?{message}") as error:
        load_folder(save(tmp_path, files))
    assert "\n" not in str(error.value)


def refused_field(save, tmp_path, files, file, line, field, new, message):
    files[file] = edit(files[file], line, field, new)
    with pytest.raises(DataError, match=rf"{re.escape(str(tmp_path / file))}{message}"):
        load_folder(save(tmp_path, files))


# source, file, line, field, new value, what the message must say
FIELDS = [
    ("frames", "frames.csv", 3, 0, "two", ":3: column t: 'two' is not a number"),
    ("frames", "frames.csv", 3, 0, "0", ":3: column t: 0 follows 0.0; t must increase"),
    ("frames", "frames.csv", 4, 9, "inf", ":4: column c_tt: inf"),
    ("frames", "frames.csv", 4, 2, "1e300", r":4: column dy: 1e\+300"),
    ("frames", "frames.csv", 2, 3, "0.1", ":2: column dtheta: 0.1 in row 0"),
    ("frames", "frames.csv", 3, 5, "0.1", ":3: column c_xx to c_tt: the covariance is not positive semidefinite"),
    ("frames", "observations.csv", 5, 0, "4", ":5: column frame: 4 is out of range; there are frames 0 to 3"),
    ("frames", "observations.csv", 2, 0, "-1", ":2: column frame: -1 is not a whole number from 0 up"),
    ("frames", "observations.csv", 4, 0, "0", ":4: column frame: 0 follows 1.0; frame must not decrease"),
    ("frames", "observations.csv", 4, 1, "-0.5", ":4: column z1: -0.5 is a negative range"),
    ("frames", "observations.csv", 4, 3, "0", ":4: column r11 to r22: the covariance is not positive definite"),
    ("frames", "observations.csv", 2, 4, "0.0142", ":2: column r11 to r22: the covariance is not positive definite"),
    ("frames", "observations.csv", 2, 6, "-2", ":2: column true_id: -2 is not a whole number from -1 up"),
    ("frames", "truth.csv", 2, 2, "inf", ":2: column theta: inf .* leave the field blank"),
    ("frames", "landmarks.csv", 2, 0, "-7", ":2: column id: -7 is not a whole number from 0 up"),
    ("frames", "landmarks.csv", 3, 0, "7", ":3: column id: 7 is the id of two landmarks"),
    ("frames", "landmarks.csv", 3, 4, "-1", ":3: column sy: -1 is a negative standard deviation; 0 or blank is"),
    ("frames", "landmarks.csv", 2, 3, "inf", ":2: column sx: inf is not a number"),
    ("frames", "landmarks.csv", 1, 4, "other", ":1: column sy: no such column; sx and sy come together"),
    ("odometry", "odometry.csv", 6, 0, "2e6", ":6: column t: 2000000 s is more than 1e\\+06 s"),
    ("odometry", "odometry.csv", 3, 2, "?", ":3: column omega: '\\?' is not a number"),
    ("odometry", "observations.csv", 4, 0, "10", ":4: column t: 10 follows 10.25"),
]


@pytest.mark.parametrize(("source", "file", "line", "field", "new", "message"), FIELDS)
def test_a_bad_field_is_named_with_file_line_column_and_value(
    small_log_files, save, tmp_path, source, file, line, field, new, message
):
    refused_field(save, tmp_path, small_log_files(source, "range_bearing"), file, line, field, new, message)


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
    (tmp_path / "file").write_text("")
    (tmp_path / "empty").mkdir()
    for name, said in (
        ("nowhere", "nowhere: no such folder"), ("x" * 5000, "no such folder"),
        ("file", "file: not a folder"), ("empty", r"log\.toml: no such file"),
    ):  # fmt: skip
        with pytest.raises(DataError, match=said):
            load_folder(tmp_path / name)


@pytest.mark.parametrize(("file", "old", "new", "message"), [
    ("frames.csv", "c_yt,", "", ":1: column c_yt: no such column"),
    ("frames.csv", "c_tt\n", "c_tt,dx\n", ":1: column dx: two columns of that name"),
    ("frames.csv", "0.5,0.25,", "0.5,", ":3: 9 fields where the header names 10$"),
    ("frames.csv", "2,0,0,0,0,0,0,0,0,0\n", "2,0,0,0", ":5: 4 fields .* was it cut off"),
    ("frames.csv", "\n1.25", "\n\n1.25", ":4: blank line between rows"),
    ("frames.csv", None, "", ":1: column t: no such column; the line is blank"),
    ("frames.csv", None, "t,dx,dy,dtheta,c_xx,c_xy,c_xt,c_yy,c_yt,c_tt\n", ":1: no rows"),
    ("observations.csv", "r12", "r_12", ":1: column r12: no such column; r11,r12,r22 come together"),
    ("observations.csv", "r11,r12,r22", "a,b,c", r":2: column r11: no such column, and no sigma in \[sensor\]"),
    ("truth.csv", "nan,nan,nan\n", "", ":4: 3 rows for 4 frames"),
    ("truth.csv", ",,\n", "\n", ":4: blank line between rows; a row of unknown values keeps its commas"),
])  # fmt: skip
def test_a_broken_table_is_named_with_the_line(small_log_files, save, tmp_path, file, old, new, message):
    refused(save, tmp_path, small_log_files("frames", "range_bearing"), old, new, message[1:], file)


MEAN = "mean = [1.0, 2.0, 0.5]"
KIND = 'kind = "range_bearing"'
SIGMA = "sigma = [0.1, 0.05]"
VIEW = "field_of_view = 3.0"
PRIOR = "sigma = [0.1, 0.1, 0.05]"


@pytest.mark.parametrize(("old", "new", "message"), [
    ("format = 1", "format = 3", "format = 3: unknown format number; format = 1 or 2 is needed"),
    ("format = 1", "format = ", "not valid TOML"),
    ("small", "a/b", "name = 'a/b': the name becomes a folder name"),
    ('name = "small"', 'nom = "small"', "unknown key 'nom' at the top; known: format, name, "),
    ("labels_are_sensed = true", "labels_are_sensed = 1", "labels_are_sensed = 1: true or false"),
    ('["made by hand"]', '"made by hand"', "notes = 'made by hand': a list"),
    (MEAN, "mean = [1.0, 2.0]", r"\[prior\] mean = \[1.0, 2.0\]: three numbers"),
    (MEAN, "", r"\[prior\] mean: missing"),
    (PRIOR, "", r"\[prior\] sigma: missing; sigma or covariance"),
    (PRIOR, "sigma = [0.1, 0.1, -0.05]", r"\[prior\] sigma = .*: three numbers >= 0"),
    (PRIOR, PRIOR + "\ncovariance = []", r"\[prior\] sigma = .*: either sigma or covariance"),
    (PRIOR, "covariance = [[1, 0, 0], [0.1, 1, 0], [0, 0, 1]]", r"\[prior\] covariance = .*: not symmetric"),
    (PRIOR, "covariance = [[1, 2, 0], [2, 1, 0], [0, 0, 1]]", r"\[prior\] covariance = .*: not positive semidefinite"),
    ("[prior]", "[[prior]]", r"prior = \[\{.*: this must be a table"),
    (KIND, 'kind = "sonar"', r"\[sensor\] kind = 'sonar': unknown; known: range_bearing, relative_point"),
    (SIGMA, "sigma = [0.1, 0]", r"\[sensor\] sigma = \[0.1, 0\]: two numbers > 0"),
    (KIND, KIND + "\ncovariance_floor = 0", r"unknown key 'covariance_floor' in \[sensor\]; it belongs to the top"),
    ("max_range = 8.0", "max_range = 0", r"\[sensor\] max_range = 0: a range > 0"),
    (VIEW, "field_of_view = 180", r"\[sensor\] field_of_view = 180: an opening angle"),
    (VIEW, VIEW + "\nmin_angle = -1", r"\[sensor\] field_of_view = 3.0: give it or min_angle and max_angle"),
    (VIEW, "min_angle = -90\nmax_angle = 90", r"\[sensor\] min_angle = -90: .*radians"),
    ("rotation = 0.1", "rotation = 'left'", r"\[sensor\] rotation = 'left': a finite angle"),
    ("[source]", "[sensor.extrinsic]\nrotation = 1\n[source]",
     r"\[sensor\] extrinsic: give rotation and translation here or"),
    ('[source]\nmaker = "hand"', "", None),
    ('model = "unicycle"', 'model = "bicycle"',
     r"\[motion\] model = 'bicycle': unknown \(did you mean unicycle\?\); known: unicycle, half_angle"),
    ('model = "unicycle"', "", None),
    ('noise = "density"', "", r"\[motion\] noise: missing; known: velocity, displacement, density, textbook"),
    ('noise = "density"', 'noise = "textbook"', r"\[motion\] sigma = .*: noise = 'textbook' takes alphas"),
    ('noise = "density"\nsigma = [0.05, 0.02]', 'noise = "textbook"\nalphas = [1, 1, 1, 1, 1]',
     r".*alphas.*four or six"),
    ('noise = "density"\nsigma = [0.05, 0.02]', 'noise = "textbook"\nalphas = [0, 0, 1, 1, 0.5, 0.5]', None),
    ("sigma = [0.05, 0.02]", "sigma = [0.05, -0.02]", r"\[motion\] sigma = .*: two numbers >= 0"),
])  # fmt: skip
def test_a_bad_header_is_named_with_key_and_value(small_log_files, save, tmp_path, old, new, message):
    files = small_log_files("odometry", "range_bearing")
    if message is not None:
        refused(save, tmp_path, files, old, new, message)
        return
    assert old in files["log.toml"]
    load_folder(save(tmp_path, files | {"log.toml": files["log.toml"].replace(old, new, 1)}))


def test_odometry_needs_a_motion_table_and_no_frames_and_a_floor_cannot_be_negative(small_log_files, save, tmp_path):
    toml = small_log_files("frames", "range_bearing")["log.toml"]
    files = small_log_files("odometry", "range_bearing")
    with pytest.raises(DataError, match=r"odometry\.csv: there is frames\.csv as well"):
        load_folder(save(tmp_path / "both", files | {"frames.csv": "t"}))
    files["log.toml"] = toml
    with pytest.raises(DataError, match=r"log\.toml: no \[motion\] table; odometry\.csv needs one"):
        load_folder(save(tmp_path, files))
    files["log.toml"] = toml.replace("covariance_floor = 1e-9", "covariance_floor = -1")
    with pytest.raises(DataError, match=r"log\.toml: covariance_floor = -1: a number >= 0"):
        load_folder(save(tmp_path, files))

"""Whatever is wrong with the header of a log folder is a `DataError` that names key and value."""

from __future__ import annotations

import pytest

from data.errors import DataError
from data.formats.open_log.reader import load_folder

MEAN = "mean = [1.0, 2.0, 0.5]"
KIND = 'kind = "range_bearing"'
SIGMA = "sigma = [0.1, 0.05]"
VIEW = "field_of_view = 3.0"
PRIOR = "sigma = [0.1, 0.1, 0.05]"


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
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
        (
            PRIOR,
            "covariance = [[1, 2, 0], [2, 1, 0], [0, 0, 1]]",
            r"\[prior\] covariance = .*: not positive semidefinite",
        ),
        ("[prior]", "[[prior]]", r"prior = \[\{.*: this must be a table"),
        (KIND, 'kind = "sonar"', r"\[sensor\] kind = 'sonar': unknown; known: range_bearing, relative_point"),
        (SIGMA, "sigma = [0.1, 0]", r"\[sensor\] sigma = \[0.1, 0\]: two numbers > 0"),
        (KIND, KIND + "\ncovariance_floor = 0", r"unknown key 'covariance_floor' in \[sensor\]; it belongs to the top"),
        ("max_range = 8.0", "max_range = 0", r"\[sensor\] max_range = 0: a range > 0"),
        (VIEW, "field_of_view = 180", r"\[sensor\] field_of_view = 180: an opening angle"),
        (VIEW, VIEW + "\nmin_angle = -1", r"\[sensor\] field_of_view = 3.0: give it or min_angle and max_angle"),
        (VIEW, "min_angle = -90\nmax_angle = 90", r"\[sensor\] min_angle = -90: .*radians"),
        ("rotation = 0.1", "rotation = 'left'", r"\[sensor\] rotation = 'left': a finite angle"),
        (
            "[source]",
            "[sensor.extrinsic]\nrotation = 1\n[source]",
            r"\[sensor\] extrinsic: give rotation and translation here or",
        ),
        ('[source]\nmaker = "hand"', "", None),
        (
            'model = "unicycle"',
            'model = "bicycle"',
            r"\[motion\] model = 'bicycle': unknown \(did you mean unicycle\?\); known: unicycle, half_angle",
        ),
        ('model = "unicycle"', "", None),
        ('noise = "density"', "", r"\[motion\] noise: missing; known: velocity, displacement, density, textbook"),
        ('noise = "density"', 'noise = "textbook"', r"\[motion\] sigma = .*: noise = 'textbook' takes alphas"),
        (
            'noise = "density"\nsigma = [0.05, 0.02]',
            'noise = "textbook"\nalphas = [1, 1, 1, 1, 1]',
            r".*alphas.*four or six",
        ),
        ('noise = "density"\nsigma = [0.05, 0.02]', 'noise = "textbook"\nalphas = [0, 0, 1, 1, 0.5, 0.5]', None),
        ("sigma = [0.05, 0.02]", "sigma = [0.05, -0.02]", r"\[motion\] sigma = .*: two numbers >= 0"),
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

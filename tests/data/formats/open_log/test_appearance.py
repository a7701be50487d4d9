"""Descriptors and classes in an open log folder."""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from data.appearance import UNREAD, Appearance, drawn, misread, spread
from data.errors import DataError
from data.formats.open_log import load_folder, write_folder
from data.inputs import LandmarkMap
from data.log import Log, shortened
from data.questions.summary import summarize
from data.worlds.registry import named_log
from eval.plan.provenance import input_digest
from tests.data.formats.open_log.same_log import assert_same_log
from tests.data.formats.open_log.test_corruption import refused_or_sound
from tests.quick import examples as quick
from tests.quick import slow

HEADER = """format = 2
name = "small"
[prior]
mean = [0, 0, 0]
sigma = [0.1, 0.1, 0.02]
[sensor]
kind = "range_bearing"
sigma = [0.1, 0.02]
descriptor_sigma = 0.05
class_error = 0.1
"""


def files_of(header=HEADER):
    return {
        "log.toml": header,
        "frames.csv": "t,dx,dy,dtheta,c_xx,c_xy,c_xt,c_yy,c_yt,c_tt\n0,0,0,0,0,0,0,0,0,0\n1,1,0,0,.01,0,0,.01,0,.001\n",
        "observations.csv": "frame,z1,z2,descriptor,descriptor_sigma,class,class_error\n"
        "0,2,0.5,0.31,,oak,\n0,3,0.1,,,elm,0.2\n1,2,0.2,0.42,0.01,,\n",
        "landmarks.csv": "id,x,y,descriptor,class\n4,2,1,,oak\n2,3,1,0.4,ash\n",
    }


def test_noise_is_that_of_the_row_or_else_of_the_sensor(save, tmp_path):
    log = load_folder(save(tmp_path, files_of()))
    looks, known = log.recorded.observations.appearance, log.recorded.map.appearance
    assert looks.names == known.names == ("ash", "elm", "oak")
    assert [looks.names[c] if c >= 0 else "" for c in looks.category] == ["oak", "elm", ""]
    assert looks.sigma[[0, 2]].tolist() == [0.05, 0.01]
    assert looks.error[:2].tolist() == [0.1, 0.2]
    assert np.isnan(looks.descriptor).tolist() == [False, True, False]
    assert known.category.tolist() == [0, 2]  # by id
    assert known.descriptor[0] == 0.4
    assert log.truth.landmarks is log.recorded.map
    text = dict(summarize(log))
    assert text["appearance"] == "3 classes: ash 0, elm 1, oak 1"


def test_it_comes_back_and_counts_in_the_digest(save, tmp_path):
    log = load_folder(save(tmp_path / "a", files_of()))
    write_folder(log, tmp_path / "small")
    assert_same_log(load_folder(tmp_path / "small").recorded, log.recorded)
    bare = replace(log, recorded=log.recorded.without_appearance())
    assert input_digest(bare) != input_digest(log)
    assert len(shortened(log, 1).recorded.observations.appearance) == 2
    assert len(log.recorded.frame(1).appearance) == 1


def test_format_1_ignores_the_columns(save, tmp_path):
    header = HEADER.replace("format = 2", "format = 1").replace("descriptor_sigma = 0.05\nclass_error = 0.1\n", "")
    log = load_folder(save(tmp_path, files_of(header)))
    assert log.recorded.observations.appearance is None
    assert "observations.csv: columns not used: descriptor, descriptor_sigma, class, class_error" in log.notes


@pytest.mark.parametrize(
    ("file", "old", "new", "message"),
    [
        ("log.toml", "= 0.05", "= 0", r"log.toml: \[sensor\] descriptor_sigma = 0: a number > 0 is needed"),
        ("log.toml", "= 0.1\n", "= 0.5\n", "class_error = 0.5: a probability above 0 and below 0.5 is needed"),
        ("log.toml", "format = 2", "format = 1", r"\[sensor\] descriptor_sigma = 0.05: format = 2 is needed"),
        ("log.toml", "descriptor_sigma = 0.05", "", "csv:2: column descriptor: a value, but no descriptor_sigma here"),
        ("log.toml", "class_error = 0.1", "", "csv:2: column class: a value, but no class_error here or in"),
        ("observations.csv", ",0.31,", ",x,", "csv:2: column descriptor: 'x' is not a number"),
        ("observations.csv", ",0.31,", ",inf,", "csv:2: column descriptor: inf is not a number between"),
        ("observations.csv", ",0.01,", ",-0.01,", "csv:4: column descriptor_sigma: -0.01 is no standard deviation > 0"),
        ("observations.csv", ",0.2\n", ",0.7\n", "csv:3: column class_error: 0.7 is no probability above 0"),
        ("observations.csv", ",oak,", ',"oak",', "csv:2: column class: '\"oak\"' holds a quote; a plain name"),
        ("landmarks.csv", ",0.4,", ",1e99,", "csv:3: column descriptor: 1e"),
        ("landmarks.csv", ",ash", ',a"', "csv:3: column class: 'a\"' holds a quote"),
    ],
)
def test_bad_appearance_is_named_in_a_line(save, tmp_path, file, old, new, message):
    files = files_of()
    assert old in files[file]
    files[file] = files[file].replace(old, new, 1)
    with pytest.raises(DataError, match=message) as error:
        load_folder(save(tmp_path, files))
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("count", [30, slow(10_000)])
def test_a_corrupted_folder_is_refused_with_its_place_or_read_soundly(save, count):
    refused_or_sound(files_of(), save, count)


@given(st.integers(0, 2**32), st.booleans(), st.booleans(), st.booleans())
@settings(max_examples=quick(20), deadline=None)
def test_any_appearance_comes_back_bit_for_bit(seed, described, classed, mapped):
    rng = np.random.default_rng(seed)
    log = named_log("arena:0:frames=3")

    def looks(n, noise):
        z = rng.normal(size=n) * 10.0 ** rng.uniform(-9, 9)
        z[rng.random(n) < 0.3] = np.nan
        read = rng.integers(-1, 3, n)
        read[:3] = [0, 1, 2]
        if not described:
            z[:] = np.nan
        if not classed:
            read[:] = UNREAD
        sigma = np.where(np.isnan(z), 1.0, 10.0 ** rng.uniform(-9, 9, n)) if noise else np.zeros(n)
        error = np.where(read < 0, 0.5, rng.uniform(1e-6, 0.49, n)) if noise else np.zeros(n)
        return Appearance(z, sigma, read, error, ("b c", "d", "Ä") if classed else ())

    o, known = log.recorded.observations, log.truth.landmarks
    places = LandmarkMap(known.id, known.xy, appearance=looks(len(known.id), noise=False) if mapped else None)
    recorded = replace(log.recorded, observations=replace(o, appearance=looks(len(o.z), noise=True)), map=places)
    dressed = replace(log, recorded=recorded, truth=replace(log.truth, landmarks=places))
    with tempfile.TemporaryDirectory() as folder:
        back = write_folder(dressed, Path(folder) / "log")
    if not (described or classed):
        assert back.recorded.observations.appearance is None
        return
    assert_same_log(back.recorded.observations, dressed.recorded.observations)
    assert_same_log(back.recorded.map, dressed.recorded.map)


def test_arrays_make_the_log_that_a_folder_does(save, tmp_path):
    folder = load_folder(save(tmp_path, files_of()))
    sensor = {"kind": "range_bearing", "sigma": [0.1, 0.02], "descriptor_sigma": 0.05, "class_error": 0.1}
    more = {
        "increments": folder.recorded.increments.mean,
        "covariance": [0.1, 0.1, 0.03],
        "landmarks": [[4, 2, 1], [2, 3, 1]],
        "landmark_descriptor": [np.nan, 0.4],
        "landmark_classes": ["oak", "ash"],
        "descriptor": [0.31, np.nan, 0.42],
        "classes": ["oak", "elm", ""],
    }
    prior, observations = (np.zeros(3), np.zeros(3)), [[0, 2, 0.5], [0, 3, 0.1], [1, 2, 0.2]]
    log = Log.from_arrays("small", prior, sensor, observations, **more)
    assert_same_log(log.recorded.map, folder.recorded.map)
    ours, theirs = log.recorded.observations.appearance, folder.recorded.observations.appearance
    assert_same_log(replace(ours, sigma=theirs.sigma, error=theirs.error), theirs)
    with pytest.raises(DataError, match=r"small: descriptor has shape \(2,\); \(3,\) is needed"):
        Log.from_arrays("small", prior, sensor, observations, **{**more, "descriptor": [1.0, 2.0]})


def test_the_summary_tells_the_noise_that_labels_show():
    log = named_log("arena:0:descriptor_sigma=0.2+classes=4+class_error=0.1")
    looks, label = log.recorded.observations.appearance, log.granted
    found = spread(looks, label)
    assert (found.within, found.successive) == pytest.approx((0.2, 0.2), rel=0.1)
    assert found.between == pytest.approx(1.0, rel=0.4)
    assert misread(looks, label) == pytest.approx(0.1, abs=0.03)
    assert sum("by label" in text for what, text in summarize(log) if what == "appearance") == 2


def test_errors_that_persist_hide_between_one_reading_and_the_next():
    rng = np.random.default_rng(0)
    landmark = np.tile(np.arange(50), 40)
    persistent = np.cumsum(0.1 * rng.normal(size=(40, 50)), axis=0)
    z = (rng.normal(size=50) * 5.0 + persistent + 0.05 * rng.normal(size=(40, 50))).ravel()
    n = len(z)
    found = spread(Appearance(z, np.ones(n), np.full(n, UNREAD), np.full(n, 0.5)), landmark)
    assert found.successive == pytest.approx(np.sqrt(0.5 * 0.01 + 0.0025), rel=0.1)
    about = z.reshape(40, 50) - z.reshape(40, 50).mean(axis=0)
    assert found.within == pytest.approx(np.sqrt((about**2).sum() / (n - 50)))
    assert found.within > 3.0 * found.successive
    assert found.between == pytest.approx(5.0, rel=0.3)
    nothing = spread(Appearance(z[:2], np.ones(2), np.full(2, UNREAD), np.full(2, 0.5)), np.array([-1, 4]))
    assert np.isnan(nothing).all()


def test_simulated_readings_have_the_stated_noise():
    log = named_log("arena:0:descriptor_sigma=0.2+classes=4+class_error=0.1+clutter=2")
    o, t = log.recorded.observations, log.truth
    looks, rows = o.appearance, t.landmarks.rows(t.landmark_of)
    seen = rows >= 0
    off = looks.descriptor[seen] - t.landmarks.appearance.descriptor[rows[seen]]
    n = len(off)
    assert np.std(off) == pytest.approx(0.2, rel=4 / np.sqrt(2 * n))
    wrong = np.mean(looks.category[seen] != t.landmarks.appearance.category[rows[seen]])
    assert wrong == pytest.approx(0.1, abs=4 * np.sqrt(0.09 / n))
    plain = named_log("arena:0:clutter=2")
    assert plain.recorded.observations.appearance is None
    assert o.z.tolist() == plain.recorded.observations.z.tolist()


def test_drawn_readings_are_new_only_where_the_landmark_is_known():
    like = Appearance(
        np.array([5.0, np.nan, 7.0]), np.full(3, 0.1), np.array([0, 1, UNREAD]), np.full(3, 0.01), ("a", "b")
    )
    landmark = Appearance(np.array([1.0]), np.zeros(1), np.array([1]), np.zeros(1), ("a", "b"))
    new = drawn(like, landmark, np.array([0, 0, -1]), np.random.default_rng(0))
    assert abs(new.descriptor[0] - 1.0) < 0.5
    assert np.isnan(new.descriptor[1])
    assert new.descriptor[2] == 7.0
    assert new.category.tolist() == [1, 1, UNREAD]

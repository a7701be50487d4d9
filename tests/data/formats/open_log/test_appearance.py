"""Descriptors and classes in an open log folder."""

import re
from dataclasses import replace

import numpy as np
import pytest

from data.errors import DataError
from data.formats.open_log import load_folder, write_folder
from data.log import shortened
from data.questions.summary import summarize
from data.worlds.registry import named_log
from eval.plan.provenance import input_digest
from tests.data.formats.open_log.same_log import assert_same_log
from tests.data.formats.open_log.test_faults import refused

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


@pytest.mark.parametrize(("file", "old", "new", "message"), [
    ("log.toml", "= 0.05", "= 0", r"\[sensor\] descriptor_sigma = 0: a number > 0 is needed"),
    ("log.toml", "format = 2", "format = 1", r"\[sensor\] descriptor_sigma = 0.05: format = 2 is needed"),
    ("observations.csv", ",0.31,", ",x,", "2: column descriptor: 'x' is not a number"),
    ("observations.csv", ",0.31,", ",inf,", "2: column descriptor: inf is not a number between"),
    ("observations.csv", ",0.2\n", ",0.7\n", "3: column class_error: 0.7 is no probability above 0"),
    ("observations.csv", ",oak,", ',"oak",', "2: column class: '\"oak\"' holds a quote; a plain name"),
    ("landmarks.csv", ",0.4,", ",1e99,", "3: column descriptor: 1e"),
    ("landmarks.csv", ",ash", ',a"', "3: column class: 'a\"' holds a quote"),
])  # fmt: skip
def test_bad_appearance_is_named_in_a_line(save, tmp_path, file, old, new, message):
    refused(save, tmp_path, files_of(), old, new, message, file)


def test_a_class_needs_its_error(save, tmp_path):
    with pytest.raises(DataError, match="csv:2: column class: a value, but no class_error here or in"):
        load_folder(save(tmp_path, files_of(HEADER.replace("class_error = 0.1\n", ""))))


def test_the_summary_tells_the_noise_that_labels_show():
    log = named_log("arena:0:descriptor_sigma=0.2+classes=4+class_error=0.1")
    (text,) = (text for what, text in summarize(log) if what == "appearance" and "by label" in text)
    assert float(re.findall(r"by label (\S+) about", text)[0]) == pytest.approx(0.2, rel=0.1)

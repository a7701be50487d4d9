"""A log folder is replaced whole or not at all, and nothing is written that could not be read."""

from __future__ import annotations

import dataclasses
import math
import tomllib
from pathlib import Path

import numpy as np
import pytest

from data.errors import DataError
from data.formats.open_log.writer import write_folder
from data.inputs import LandmarkMap, Observations
from data.log import Log
from data.truth import Truth
from tests.data.formats.open_log.same_log import load


@pytest.fixture
def log(small_log_files, save, tmp_path) -> Log:
    return load(save(tmp_path / "given", small_log_files("frames", "range_bearing")))


def test_a_log_folder_is_replaced_whole(log, tmp_path):
    target = tmp_path / "out"
    write_folder(log, target)
    write_folder(dataclasses.replace(log, truth=Truth(), recorded=log.recorded.without_map()), str(target) + "/")
    assert sorted(p.name for p in target.iterdir()) == ["frames.csv", "log.toml", "observations.csv"]
    assert sorted(p.name for p in tmp_path.iterdir()) == ["given", "out"]


@pytest.mark.parametrize(
    ("inside", "named"), [(["thesis.tex"], "not a log folder"), (["log.toml", "thesis.tex"], "'thesis.tex'")]
)
def test_a_folder_that_holds_anything_else_is_left_alone(log, tmp_path, inside, named):
    target = tmp_path / "precious"
    target.mkdir()
    for name in inside:
        (target / name).write_text("work")
    with pytest.raises(DataError, match=named) as raised:
        write_folder(log, target)
    assert str(target) in str(raised.value)
    assert sorted(p.name for p in target.iterdir()) == sorted(inside)


def test_a_file_or_a_link_in_the_way_is_left_alone(log, tmp_path):
    (tmp_path / "file").write_text("work")
    (tmp_path / "link").symlink_to(tmp_path / "given")
    for name in ("file", "link"):
        with pytest.raises(DataError, match="not a folder"):
            write_folder(log, tmp_path / name)
    assert (tmp_path / "file").read_text() == "work"
    assert (tmp_path / "given" / "log.toml").exists()


def test_a_log_that_could_not_be_read_again_is_not_written(log, tmp_path):
    z = log.recorded.observations.z.copy()
    z[0, 0] = math.nan
    o = log.recorded.observations
    broken = dataclasses.replace(
        log, recorded=dataclasses.replace(log.recorded, observations=Observations(o.frame, z, o.R))
    )
    with pytest.raises(DataError, match=r"observations.csv:2: column z1: nan"):
        write_folder(broken, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_map_without_a_true_landmark_has_no_place_in_the_format(log, tmp_path):
    less = LandmarkMap(log.recorded.map.id[1:], log.recorded.map.xy[1:])
    with pytest.raises(DataError, match="lacks some of its true landmarks"):
        write_folder(dataclasses.replace(log, recorded=dataclasses.replace(log.recorded, map=less)), tmp_path / "out")


def test_the_header_is_plain_toml_whatever_the_source_holds(log, tmp_path):
    source = {
        "seed": np.int64(3),
        "sigma": np.array([0.1, 0.2]),
        "file": Path("a") / "b",
        "no": None,
        'odd "key"': "\x7f\n\\é",
    }
    write_folder(dataclasses.replace(log, source=source), tmp_path / "out")
    with (tmp_path / "out" / "log.toml").open("rb") as file:
        written = tomllib.load(file)["source"]
    assert written == {"seed": 3, "sigma": [0.1, 0.2], "file": str(Path("a") / "b"), 'odd "key"': "\x7f\n\\é"}

"""Laser logs where a person meets them: found in folders, converted, inspected, and told apart by their digest."""

import dataclasses
import gzip
from pathlib import Path

import pytest

from data.convert.__main__ import main as convert
from data.errors import UsageError
from data.formats.open_log import load_folder
from data.logs import find_logs, open_log
from data.questions.summary import summarize
from eval.plan.experiments import make_plan
from eval.plan.flags.options import read_options
from tests.data.formats.open_log.same_log import assert_same_log
from tests.wings.laser.formats.carmen_text import SMALL
from wings.laser.carmen import load_carmen

RELATIONS = "row1,row2,x,y,theta,exact,stamp1,stamp2\n0,2,0.3,0.4,0,1,10.02,10.3\n1,3,0,0,0,0,10.5,11\n"


@pytest.fixture
def small(tmp_path: Path) -> Path:
    (tmp_path / "small.log.gz").write_bytes(gzip.compress(SMALL.encode()))
    (tmp_path / "small.relations.csv").write_text(RELATIONS)
    return tmp_path / "small.log.gz"


def found(folder: Path) -> tuple[list[str], list[str]]:
    said: list[str] = []
    return [load().name for load in find_logs(folder, said.append)], said


def test_carmen_logs_are_found_and_those_with_relations_stand_for_the_others(small):
    folder = small.parent
    (folder / "other.clf").write_text(SMALL)
    (folder / "run.log").write_text("a program's log, without scans")
    names, said = found(folder)
    assert names == ["small"]
    assert [line.partition(":")[0].rpartition("/")[2] for line in said] == ["other.clf", "run.log"]
    assert "no relations beside it, unlike other logs there" in said[0]
    assert "not a known dataset" in said[1]
    (folder / "small.relations.csv").unlink()
    assert found(folder)[0] == ["other", "small"]


def test_a_converted_log_is_the_same_but_for_its_name(small, tmp_path, capsys):
    assert convert(["carmen", str(small), str(tmp_path / "out")]) == 0
    assert "frames: 4 (1.0 s)" in (said := capsys.readouterr().out)
    assert "scans: 2 of 3 beams" in said
    assert "reference relations: 2" in said
    assert_same_log(load_folder(tmp_path / "out"), dataclasses.replace(open_log(str(small)), name="out"))


def test_a_converted_log_takes_the_relations_asked_for_and_undoes_corrections(small, tmp_path, capsys):
    (tmp_path / "mine.csv").write_text("row1,row2,x,y,theta\n0,3,1,2,3\n")
    flags = ["--relations", str(tmp_path / "mine.csv"), "--undo-correction"]
    assert convert(["carmen", str(small), str(tmp_path / "out"), *flags]) == 0
    assert "Raw odometry recovered" in capsys.readouterr().out
    assert load_folder(tmp_path / "out").truth.relations.row2.tolist() == [3]


def test_the_summary_tells_of_scans_and_relations(small):
    lines = dict(summarize(load_carmen(small)))
    assert lines["scanner"] == (
        "3 beams from -90 to 90 deg, up to 80 m, sigma 0.01 m; p_scanner = R(0 deg) p_body + (-0.25, 0) m"
    )
    assert lines["scans"] == (
        "in 2 of 4 (50.0 %) frames; 3 of 6 (50.0 %) ranges are no return, the others 1 to 3 m, median 2.5 m"
    )
    assert lines["relations"] == "2 relations between 4 frames, 1 exact, with stamps; up to 0.5 m apart"


@pytest.mark.parametrize("logs", [[], ["--log", "arena:0", "--log", "arena:1"]])
def test_relations_belong_to_one_log(logs):
    with pytest.raises(UsageError, match=r"--relations r.csv: belongs to one log; name one log"):
        make_plan(read_options([*logs, "--relations", "r.csv"]), print)

"""Whatever is wrong with a CARMEN log or its relations is one line with file, line and value."""

from __future__ import annotations

import gzip
from pathlib import Path

import pytest

from data.errors import DataError, UsageError
from data.logs import Reading, open_log
from tests.wings.laser.formats.carmen_text import SMALL, flaser, odom, robotlaser
from wings.laser.carmen import load_carmen

HERE = (0.0, 0.0, 0.0)
FIRST, SECOND = flaser([1, 2, 3], HERE, 1.0), flaser([1, 2, 3], HERE, 2.0)
LASER = robotlaser([1, 2, 3], HERE, HERE, 2.0)


@pytest.mark.parametrize(
    ("line", "message"),
    [
        (SECOND.rsplit(" ", 1)[0], r":2: FLASER with 13 fields; 3 beams, two poses and stamps take 14 .*cut off"),
        ("FLASER 3 1 2", r":2: FLASER with 4 fields; 3 beams, .* take 14 .*cut off"),
        ("FLASER", ":2: FLASER line ends before its number of beams"),
        (SECOND.replace("FLASER 3", "FLASER 4"), ":2: FLASER with 14 fields; 4 beams, .* take 15"),
        (SECOND.replace("FLASER 3", "FLASER 2"), ":2: FLASER with 14 fields; 2 beams, .* take 13"),
        (SECOND.replace("FLASER 3", "FLASER three"), ":2: FLASER with 'three' beams; a whole number"),
        (SECOND.replace("FLASER 3", "FLASER -3"), ":2: FLASER with '-3' beams; a whole number"),
        (flaser([], HERE, 2.0), ":2: FLASER without beams"),
        (flaser([1, "nan", 3], HERE, 2.0), ":2: column range 2: nan is not a range; a number from 0 up"),
        (flaser([1, 2, -3.5], HERE, 2.0), ":2: column range 3: -3.5 is not a range"),
        (flaser([1, "2;0", 3], HERE, 2.0), ":2: column range 2: '2;0' is not a number"),
        (flaser([1, "2_0", 3], HERE, 2.0), ":2: column range 2: '2_0' is not a number"),
        (SECOND.replace("2.0 host", "noon host"), ":2: column stamp: 'noon' is not a number"),
        (SECOND.replace("2.0 host", "nan host"), ":2: column stamp: nan"),
        (SECOND.replace("0.0", "inf", 1), ":2: column x: inf"),
        ("ODOM 1 2 3 0 0 0 now host 1", ":2: column stamp: 'now' is not a number"),
        ("ODOM 1 2 east 0 0 0 5 host 1", ":2: column theta: 'east' is not a number"),
        ("ODOM 1 2 1e99 0 0 0 5 host 1", r":2: column theta: 1e\+99"),
        ("ODOM 1 2 3 0 0", ":2: ODOM with 6 fields; 10 are needed"),
    ],
)
def test_a_fault_in_a_line_is_named(tmp_path, line, message):
    (tmp_path / "bad.log").write_text("\n".join([FIRST, line, odom(0, 0, 0, 3.0), ""]))
    with pytest.raises(DataError, match=f"^{tmp_path / 'bad.log'}{message}") as raised:
        load_carmen(tmp_path / "bad.log")
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize(
    ("line", "message"),
    [
        (
            LASER.replace(" 3 1 2 3 0 ", " 3 1 2 3 2 "),
            ":2: ROBOTLASER1 with 27 fields; 3 beams, 2 remissions, .* 29",
        ),
        ("ROBOTLASER1 0 -2 4 0.5 5.6 0.01 0 3 1 2", ":2: ROBOTLASER1 line ends before its number of remissions"),
        (LASER.replace(" 5.6 ", " 0 "), ":2: column max_range: 0 m; a number above 0"),
        (LASER.replace(" 0.5 ", " 0 "), ":2: column resolution: 0 rad between beams"),
        (LASER.replace(" 4.0 ", " wide "), ":2: column fov: 'wide' is not a number"),
    ],
)
def test_a_fault_in_a_line_with_its_own_geometry_is_named(tmp_path, line, message):
    (tmp_path / "bad.log").write_text(f"{LASER}\n{line}\n")
    with pytest.raises(DataError, match=message):
        load_carmen(tmp_path / "bad.log")


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("none.log", odom(0, 0, 0, 1.0).encode(), "no line of a laser scan; FLASER or ROBOTLASER1"),
        ("empty.log", b"", "no line of a laser scan"),
        ("late.log", f"{FIRST}\n{odom(0, 0, 0, 1.0)}\n".encode(), "no scan after the first ODOM line"),
        ("plain.log.gz", SMALL.encode(), "not a gzip file; compress it"),
        ("cut.log.gz", gzip.compress(SMALL.encode(), mtime=0)[:-20], "the gzip file is broken or cut off"),
        ("bent.log.gz", gzip.compress(SMALL.encode(), mtime=0)[:10] + bytes(40), "the gzip file is broken or cut off"),
        ("noise.log", bytes(range(256)), "no line of a laser scan"),
    ],
)
def test_a_file_that_is_no_laser_log_is_named(tmp_path, name, content, message):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(DataError, match=f"{name}: {message}"):
        load_carmen(tmp_path / name)


def test_missing_files_are_named(tmp_path):
    with pytest.raises(DataError, match=r"none.log: cannot be read: No such file"):
        load_carmen(tmp_path / "none.log")
    (tmp_path / "small.log").write_text(SMALL)
    with pytest.raises(DataError, match=r"none.csv: no such file"):
        load_carmen(tmp_path / "small.log", Path(tmp_path / "none.csv"))


def test_a_file_of_another_name_and_relations_of_another_log_are_usage_errors(tmp_path):
    (tmp_path / "small.dat").write_text(SMALL)
    with pytest.raises(
        UsageError, match=r"small.dat: a file of unknown type; expected an open log folder, a CARMEN log"
    ):
        open_log(str(tmp_path / "small.dat"))
    with pytest.raises(
        UsageError, match=r"--relations r.csv: arena:0 takes none; name a CARMEN log or an open log folder"
    ):
        open_log("arena:0", Reading(relations=Path("r.csv")))

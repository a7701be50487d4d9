"""Laser logs as open log folders: read, written, and whatever is wrong in them named."""

import io
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from data.errors import DataError
from data.formats.open_log import load_folder, write_folder
from data.inputs import Scanner, Scans
from data.log import Log, shortened
from data.logs import Reading, open_log
from data.truth import Relations
from tests.data.formats.open_log.same_log import assert_same_log

TOML = """\
format = 1
name = "laser"
[prior]
mean = [1.0, 2.0, 0.5]
sigma = [0.0, 0.0, 0.0]
[scanner]
angle_min = -1.5
angle_step = 0.5
max_range = 8.0
sigma = 0.01
"""
FRAMES = "t,dx,dy,dtheta,c_xx,c_xy,c_xt,c_yy,c_yt,c_tt\n0,0,0,0,0,0,0,0,0,0\n" + "".join(
    f"{k},0.5,0,0.1,1e-3,0,0,1e-3,0,1e-4\n" for k in range(1, 5)
)
FRAME = np.array([0, 2, 3])
RANGES = np.array([[1.0, 0.0, 2.0], [np.nan, 8.0, 9.0], [3.0, 7.999, 0.5]])


def npz(**arrays: Any) -> bytes:
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)
    return buffer.getvalue()


GOOD = {"log.toml": TOML.encode(), "frames.csv": FRAMES.encode(), "scans.npz": npz(frame=FRAME, ranges=RANGES)}


@pytest.fixture
def folder(save: Callable[..., Path], tmp_path: Path) -> Callable[..., Path]:
    """`folder(name=content, ...)`: a good folder with some files replaced, or left out (None)."""

    def make(**changed: bytes | None) -> Path:
        files: dict[str, bytes | None] = {**GOOD, **{k.replace("_", "."): v for k, v in changed.items()}}
        return save(tmp_path / "laser", {k: v for k, v in files.items() if v is not None})

    return make


def test_a_laser_log_needs_neither_observations_nor_a_sensor(folder):
    recorded = load_folder(folder()).recorded
    assert recorded.scans.frame.tolist() == [0, 2, 3]
    assert recorded.scans.scanner == Scanner(-1.5, 0.5, 8.0, 0.01)
    assert len(recorded.observations.z) == 0
    assert load_folder(folder()).truth.landmark_of is None
    # NaN, and the largest range and more, are no return
    assert recorded.scans.ranges.tolist() == [[1, 0, 2], [0, 0, 0], [3, 7.999, 0.5]]


@pytest.mark.parametrize(("content", "message"), [
    (b"", "not an npz file of plain arrays"), (npz(frame=FRAME), "column ranges: no such array; found frame"),
    (npz(frame=FRAME, ranges=RANGES, extra=FRAME), "column extra: unknown array; known: frame, ranges"),
    (npz(frame=FRAME, ranges=RANGES.astype(object)), "not an npz file of plain arrays .*pickle"),
    (npz(frame=FRAME, ranges=RANGES[:2]), r"column ranges: float64 of shape \(2, 3\); numbers \(3, B\)"),
    (npz(frame=FRAME, ranges=RANGES[:, :0]), r"column ranges: float64 of shape \(3, 0\)"),
    (npz(frame=FRAME.astype(float), ranges=RANGES), r"column frame: float64 of shape \(3,\); whole numbers"),
    (npz(frame=FRAME + 2, ranges=RANGES), "column frame: scan 2: 5 is out of range; there are frames 0 to 4"),
    (npz(frame=FRAME[[0, 2, 1]], ranges=RANGES), "column frame: scan 2: 2 follows 3; frames must increase"),
    (npz(frame=FRAME, ranges=-RANGES), "column ranges: scan 0, beam 0: -1.0 is not a range"),
    (npz(frame=FRAME, ranges=np.where(RANGES == 9, np.inf, RANGES)), "column ranges: scan 1, beam 2: inf is not"),
])  # fmt: skip
def test_a_fault_in_the_scans_is_named(folder, content, message):
    with pytest.raises(DataError, match=f"scans.npz: {message}") as raised:
        load_folder(folder(scans_npz=content))
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize(("old", "new", "message"), [
    ("angle_min = -1.5\n", "", r"\[scanner\] angle_min: missing"),
    ("angle_step = 0.5", "angle_step = 0", r"\[scanner\] angle_step = 0: an angle other than 0"),
    ("max_range = 8.0", "max_range = inf", r"\[scanner\] max_range = inf: a finite range > 0"),
    ("sigma = 0.01", "sigma = 0.0", r"\[scanner\] sigma = 0.0: a number > 0"),
    ("[scanner]", "[sensor]\nkind = 'range_bearing'\n[motor]", "unknown key 'motor'"),
])  # fmt: skip
def test_a_fault_in_the_scanner_is_named(folder, old, new, message):
    with pytest.raises(DataError, match=f"log.toml: {message}"):
        load_folder(folder(log_toml=TOML.replace(old, new, 1).encode()))


def test_scans_and_scanner_come_together_and_with_frames(folder, save, tmp_path):
    with pytest.raises(DataError, match=r"scans.npz: cannot be read: No such file"):
        load_folder(folder(scans_npz=None))
    bare = TOML[: TOML.index("[scanner]")]
    sensor = bare + '[sensor]\nkind = "range_bearing"\nsigma = [1, 1]\n'
    files = {**GOOD, "log.toml": sensor, "observations.csv": "frame,z1,z2\n"}
    with pytest.raises(DataError, match=r"log.toml: no \[scanner\] table; scans.npz needs one"):
        load_folder(save(tmp_path / "bare", files))
    with pytest.raises(DataError, match=r"log.toml: no \[sensor\] table"):
        load_folder(save(tmp_path / "none", {**GOOD, "log.toml": bare}))
    motion = TOML + '[motion]\nnoise = "density"\nsigma = [0.1, 0.1]\n'
    files = {"log.toml": motion, "odometry.csv": "t,v,omega\n0,1,0\n1,1,0\n", "scans.npz": GOOD["scans.npz"]}
    with pytest.raises(
        DataError, match=r"scans.npz: scans belong to frames; frames.csv is needed instead of odometry.csv"
    ):
        load_folder(save(tmp_path / "stamped", files))


@pytest.mark.parametrize("full", [True, False])
def test_a_laser_log_comes_back_bit_for_bit(folder, tmp_path, full):
    rng = np.random.default_rng(3)
    given = load_folder(folder())
    scanner = Scanner(-1.0, 1 / 3, 30.0, 0.02, 0.1, (0.2, -1 / 7))
    scans = Scans(scanner, np.array([1, 4]), rng.uniform(0.0, 30.0, (2, 7)))
    P = np.array([[0.5, 0.1, 0.0], [0.1, 0.4, 0.02], [0.0, 0.02, 0.3]]) * np.array([1.0, 2.0])[:, None, None]
    relations = Relations(np.array([0, 3]), np.array([4, 1]), rng.normal(size=(2, 3)), covariance=P)
    if full:
        times = np.array([3.0, 1, 2, 1, 1 / 3])
        relations = replace(relations, exact=np.array([1, 0]), stamp=rng.normal(size=(2, 2)), frame_stamp=times)
    truth = replace(given.truth, relations=relations)
    log = replace(given, recorded=replace(given.recorded, scans=scans), truth=truth, name="out")
    write_folder(log, tmp_path / "out")
    assert_same_log(load_folder(tmp_path / "out"), log)
    first = {p.name: p.read_bytes() for p in (tmp_path / "out").iterdir()}
    write_folder(log, tmp_path / "out")
    assert {p.name: p.read_bytes() for p in (tmp_path / "out").iterdir()} == first


def test_relations_of_a_folder_are_its_own_or_those_asked_for(folder, tmp_path):
    path = folder(relations_csv=b"row1,row2,x,y,theta\n0,1,1,0,0\n")
    assert open_log(str(path)).truth.relations.row2.tolist() == [1]
    (tmp_path / "mine.csv").write_text("row1,row2,x,y,theta\n0,4,1,0,0\n")
    assert open_log(str(path), Reading(relations=tmp_path / "mine.csv")).truth.relations.row2.tolist() == [4]
    (path / "relations.csv").write_text("row1,row2,x,y,theta\n0,5,1,0,0\n")
    with pytest.raises(DataError, match=r"relations.csv:2: column row2: 5 is not a row of the log"):
        open_log(str(path))


def test_a_shortened_log_has_the_scans_and_relations_of_its_frames(folder):
    log: Log = load_folder(folder(relations_csv=b"row1,row2,x,y,theta,exact\n0,1,1,0,0,1\n2,0,2,0,0,0\n1,4,3,0,0,1\n"))
    short = shortened(log, 3)
    assert short.recorded.scans.frame.tolist() == [0, 2]
    assert len(short.recorded.scans.ranges) == 2
    assert short.truth.relations.relative[:, 0].tolist() == [1, 2]
    assert short.truth.relations.exact.tolist() == [1, 0]
    assert shortened(log, 5) is log

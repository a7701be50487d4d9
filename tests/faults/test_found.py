"""Faults that broken files once met, each in its smallest form."""

import gzip
import io
import struct
import tracemalloc
import zipfile
import zlib

import numpy as np
import pytest
from scipy.io import savemat

from data.errors import DataError, UsageError
from data.formats.matlab import load
from data.formats.mrclam import load_mrclam
from data.formats.results.reading import read_path
from data.formats.results.tables import companions
from data.formats.text import read_table
from data.logs import open_log
from eval.plan.flags.options import read_options
from graph import engine as window
from tests.data.formats.open_log.test_scans import GOOD
from tests.faults.mutations import npy_header
from tests.faults.soak import soaked
from tests.wings.camera.lab.handmade import lab
from tests.wings.laser.formats.carmen_text import SMALL
from wings.camera.lab.folder import open_lab


def save(folder, files):
    folder.mkdir()
    for name, content in files.items():
        (folder / name).write_bytes(content if isinstance(content, bytes) else content.encode())
    return folder


def peak(read, *args):
    """Bytes at most in use while `read` refuses, and what it says."""
    tracemalloc.start()
    try:
        with pytest.raises(DataError) as error:
            read(*args)
        return tracemalloc.get_traced_memory()[1], str(error.value)
    finally:
        tracemalloc.stop()


@pytest.fixture
def laser(tmp_path):
    def make(scans):
        return str(save(tmp_path / "laser", {**GOOD, "scans.npz": scans}))

    return make


def archive(entries, method=zipfile.ZIP_DEFLATED):
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", method) as z:
        for name, content in entries.items():
            z.writestr(name, content)
    return buffer.getvalue()


def test_keys_of_many_parts_take_no_gigabytes(tmp_path):
    folder = save(tmp_path / "log", {"log.toml": "deep" + ".a" * 20_000 + " = 1\n"})
    most, said = peak(open_log, str(folder))
    assert "a key of more than 100 parts" in said
    assert most < 4 << 20
    (tmp_path / "run.toml").write_text("deep" + ".a" * 20_000 + " = 1\n")
    with pytest.raises(UsageError, match="a key of more than 100 parts"):
        read_options(["--config", str(tmp_path / "run.toml")])


def test_an_array_that_says_it_is_larger_than_it_is_gets_no_room(laser):
    false = npy_header((10**9, 360), "<f8") + bytes(100)
    frame = io.BytesIO()
    np.save(frame, np.arange(3))
    most, said = peak(open_log, laser(archive({"frame.npy": frame.getvalue(), "ranges.npy": false})))
    assert "100 are there" in said
    assert most < 4 << 20


@pytest.mark.parametrize("method", [zipfile.ZIP_LZMA, zipfile.ZIP_BZIP2])
def test_other_compressions_are_named(laser, tmp_path, method):
    _, said = peak(open_log, laser(archive({"frame.npy": b"1"}, method)))
    assert f"compressed by method {method}" in said
    (tmp_path / "lab").mkdir()
    folder = lab(tmp_path / "lab", form="log.npz")
    (folder / "log.npz").write_bytes(archive({"rgb.npy": b"1"}, method))
    assert f"compressed by method {method}" in peak(open_lab, folder)[1]


def test_an_image_of_few_bytes_and_many_pixels_gets_no_room(tmp_path):
    (tmp_path / "lab").mkdir()
    folder = lab(tmp_path / "lab", form="log.npy")
    image = next((folder / "landmark").iterdir())
    content = image.read_bytes()
    for side in (8_000, 12_000, 30_000):
        head = content[12:16] + struct.pack(">II", side, side) + content[24:29]
        image.write_bytes(content[:12] + head + struct.pack(">I", zlib.crc32(head)) + content[33:])
        with pytest.raises(DataError, match=r"more than 5e\+07 pixels|at most 5e\+07 are read"):
            open_lab(folder)


def test_a_laser_log_is_no_bomb_and_a_damaged_run_or_result_is_said_in_few_words(tmp_path):
    (tmp_path / "a.log").write_text(SMALL.replace("robot_frontlaser_offset 0.25", "robot_frontlaser_offset 1e309"))
    assert ":2: PARAM robot_frontlaser_offset is 1e309" in peak(open_log, str(tmp_path / "a.log"))[1]
    (tmp_path / "b.log.gz").write_bytes(gzip.compress(bytes(80 << 20), mtime=0))
    assert "unpack to more than" in peak(open_log, str(tmp_path / "b.log.gz"))[1]
    (tmp_path / "a.csv").write_text("t,x,y,theta\n")
    assert "a header and no rows" in peak(read_path, str(tmp_path / "a.csv"))[1]
    (tmp_path / "b.tum").write_text("0 0 0 0 0 0 0 1\n1 " + "9" * 100_000 + " 0 0 0 0 0 1\n")
    assert len(peak(read_path, str(tmp_path / "b.tum"))[1]) < 300
    savemat(tmp_path / "results.mat", {"v_m": np.ones((4, 1))})  # scipy's reader may end the process.
    (tmp_path / "results.mat").write_bytes((tmp_path / "results.mat").read_bytes()[:-9])
    assert "results.mat" in peak(load, tmp_path / "results.mat", ["v_m"])[1]


def test_a_field_too_long_a_great_number_and_odd_file_names_are_one_line(tmp_path):
    (tmp_path / "landmarks.csv").write_text("landmark,x,y\n1000000000000000,1,2\n3,1,2\n")
    assert companions(tmp_path).landmarks.number.tolist() == [1000000000000000, 3]
    (tmp_path / "landmarks.csv").write_text("landmark,x,y\n1e19,1,2\n")
    assert "1e+19 is not a whole number" in peak(companions, tmp_path)[1]
    (tmp_path / "landmarks.csv").write_text("landmark,x,y\n5,1,2\n3,1,2\n5,1,1\n")
    assert ":4: column landmark: 5 is repeated" in peak(companions, tmp_path)[1]
    for name in ("one", "two\nlines\x1b[31m"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "Barcodes.dat").write_text("# no rows\n")
    _, said = peak(load_mrclam, tmp_path, 1)
    assert said.isprintable()
    assert r"two\nlines\x1b[31m" in said
    (tmp_path / "robot.csv").write_text("t,v\n0," + "9" * 200_000 + "\n")
    assert ":2: more than 131072 characters" in peak(read_table, tmp_path / "robot.csv")[1]
    assert "not a file name" in peak(read_table, tmp_path / "a\0b.csv")[1]


@pytest.mark.parametrize("many", [100, 1 << 17])
def test_what_has_left_a_fixed_lag_leaves_nothing_behind(many, monkeypatch):
    """However many factors there were, and wherever gtsam keeps those that are there: the estimate is the same."""
    monkeypatch.setattr(window, "MANY", many)
    found = soaked("slam-fixed-lag", 200).estimator
    engine = found._window
    assert len(engine._factors) == len(engine._slot) == len(engine._handle) < 200
    assert len(found._time) <= 23
    assert (engine.isam.getFactorsUnsafe().size() < 300) == (many == 100)
    other = soaked("slam-isam2", 200).estimator
    np.testing.assert_allclose(found.estimate().mean, other.estimate().mean, atol=0.02)

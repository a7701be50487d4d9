"""Faults that broken bags once met, each in its smallest form."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest

from data.errors import DataError, UsageError

pytest.importorskip("rosbags", reason="rosbags is not installed: pip install 'slamref[ros]'")
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode

from data.formats.bags import laser_log
from data.formats.recordings import ros_bounded as bounds
from data.formats.recordings.ros_bounded import REPLACED, TooLargeError, _zstd, bounded, unpacked, unpacking, zstd
from tests.data.formats.recordings.ros.bags import Maker
from tests.quick import slow

ZSTD = CompressionFormat.ZSTD
PACKED = {
    "ros1, bz2": ("ros1", Writer1.CompressionFormat.BZ2),
    "ros1, lz4": ("ros1", Writer1.CompressionFormat.LZ4),
    "sqlite3, messages": ("sqlite3", CompressionMode.MESSAGE, ZSTD),
    "sqlite3, file": ("sqlite3", CompressionMode.FILE, ZSTD),
    "mcap, file": ("mcap", CompressionMode.FILE, ZSTD),
    "mcap, chunks": ("mcap", CompressionMode.STORAGE, ZSTD),
}


def small(form):
    made = Maker(form)
    made.drive(np.arange(0.0, 3.01, 0.5))
    made.scan(1.0, [1.0, 2.0, 3.0])
    return made


def refused(path):
    """Bytes at most in use while a bag is refused, and what is said."""
    tracemalloc.start()
    try:
        with pytest.raises(DataError, match="not a bag that can be read") as error:
            laser_log(path)
        return tracemalloc.get_traced_memory()[1], str(error.value)
    finally:
        tracemalloc.stop()


def test_a_record_or_file_longer_than_it_is_takes_little_memory(tmp_path):
    path = small("mcap").save(tmp_path)
    (file,) = path.glob("*.mcap")
    content = file.read_bytes()
    file.write_bytes(content[:9] + (1 << 40).to_bytes(8, "little") + content[17:])
    most, said = refused(file)
    assert most < 8 << 20
    assert "expected 1099511627776 bytes" in said


def test_a_file_that_unpacks_without_end_takes_little_memory(tmp_path):
    path = small("mcap").save(tmp_path, CompressionMode.FILE, ZSTD)
    (file,) = path.glob("*.mcap.zstd")
    file.write_bytes(zstd.compress(bytes(80 << 20)))
    most, said = refused(path)
    assert most < 8 << 20
    assert "unpack to more than 67108864" in said


@pytest.mark.parametrize("form", [form if "bz2" in form or "zstd" in form else slow(form) for form in PACKED])
def test_whatever_is_packed_is_unpacked_within_bounds(form, tmp_path, monkeypatch):
    """All of it: when there is room for nothing, nothing can be read."""
    kind, *packing = PACKED[form]
    path = small(kind).save(tmp_path, *packing)
    assert len(laser_log(path).recorded.scans.ranges) == 1
    monkeypatch.setattr(bounds, "LARGE", 0)
    monkeypatch.setattr(bounds, "DENSEST", 0)
    assert "unpack to" in refused(path)[1]


def names():
    return [getattr(module, name) for module, name, _ in REPLACED]


def test_the_library_has_its_own_names_back_after_whatever_happens(tmp_path):
    own = names()
    assert not any(a is instead for a, (_, _, instead) in zip(own, REPLACED, strict=True))
    path = small("mcap").save(tmp_path)
    laser_log(path)
    assert names() == own
    (path / "metadata.yaml").write_text("[")
    refused(path)
    assert names() == own
    with bounded():
        with pytest.raises(KeyboardInterrupt), bounded():
            raise KeyboardInterrupt
        assert names() == [instead for *_, instead in REPLACED]
    assert names() == own


@pytest.mark.parametrize(("module", "name", "instead"), REPLACED)
def test_a_version_of_the_library_without_a_name_is_refused_and_left_as_it_is(
    module, name, instead, tmp_path, monkeypatch
):
    path = small("mcap").save(tmp_path)
    monkeypatch.delattr(module, name)
    before = [vars(m).get(n) for m, n, _ in REPLACED]
    with pytest.raises(UsageError, match=rf"rosbags .* within bounds: {module.__name__} has no {name}; version 0\.11"):
        laser_log(path)
    assert [vars(m).get(n) for m, n, _ in REPLACED] == before


def test_bytes_unpack_to_what_they_say_and_no_further():
    packed = zstd.compress(bytes(1 << 20))
    assert unpacked(_zstd, packed + zstd.compress(b"x")) == bytes(1 << 20) + b"x"
    twice = packed + zstd.compress(b"x" * 1000)
    pieces = [twice[i : i + 7] for i in range(0, len(twice), 7)]
    assert b"".join(unpacking(_zstd, pieces, 1 << 21)) == bytes(1 << 20) + b"x" * 1000
    with pytest.raises(TooLargeError, match="unpack to more than 1000"):
        unpacked(_zstd, packed, 1000)
    with pytest.raises(TooLargeError, match="say they unpack to"):
        unpacked(_zstd, packed, 1 << 30)
    with pytest.raises(EOFError):
        unpacked(_zstd, packed[:-5])


def test_metadata_nested_without_end_takes_no_seconds(tmp_path):
    path = small("sqlite3").save(tmp_path)
    (path / "metadata.yaml").write_text("rosbag2_bagfile_information: " + "[" * 50_000)
    assert "nested deeper than 100" in refused(path)[1]


@pytest.mark.parametrize("angle", [np.nan, np.inf, -1e30])
@pytest.mark.parametrize("name", ["angle_min", "angle_increment"])
def test_a_later_scan_without_finite_angles_is_one_line(tmp_path, name, angle):
    """It cannot be resampled to the angles of the others."""
    maker = Maker("mcap")
    maker.drive(np.arange(0.0, 3.01, 0.5))
    for at, changed in ((0.75, {}), (1.0, {}), (1.5, {name: angle})):
        maker.scan(at, [1.0, 0.125, 8.0, 2.0], **changed)
    with pytest.raises(DataError, match=r"message 2.*is no scan") as error:
        laser_log(maker.save(tmp_path), "/scan", "/odom")
    assert "\n" not in str(error.value)

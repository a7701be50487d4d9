"""Faults that broken bags once met, each in its smallest form."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest

from data.errors import DataError

pytest.importorskip("rosbags", reason="rosbags is not installed: pip install 'slamref[ros]'")
from data.recordings.ros.bag import read_bag
from data.recordings.ros.bounded import TooLargeError, _zstd, unpacked, zstd
from tests.data.recordings.ros.bags import Maker


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
            read_bag(path)
        return tracemalloc.get_traced_memory()[1], str(error.value)
    finally:
        tracemalloc.stop()


def test_a_record_that_says_it_is_longer_than_the_file_gets_no_room(tmp_path):
    path = small("mcap").save(tmp_path)
    (file,) = path.glob("*.mcap")
    content = file.read_bytes()
    file.write_bytes(content[:9] + (1 << 40).to_bytes(8, "little") + content[17:])
    most, said = refused(file)
    assert most < 8 << 20
    assert "expected 1099511627776 bytes" in said


def test_bytes_unpack_to_what_they_say_and_no_further():
    packed = zstd.compress(bytes(1 << 20))
    assert unpacked(_zstd, packed + zstd.compress(b"x")) == bytes(1 << 20) + b"x"
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


def test_a_database_cut_within_is_one_line(tmp_path):
    path = small("sqlite3").save(tmp_path)
    (file,) = path.glob("*.db3")
    content = bytearray(file.read_bytes())
    content[4096:] = bytes(len(content) - 4096)
    file.write_bytes(content)
    refused(file)

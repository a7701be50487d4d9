"""ROS bags of both versions, broken: one clear error or a right load, at once, in little memory; nothing else."""

import dataclasses
from contextlib import ExitStack
from functools import cache
from pathlib import Path
from types import CodeType
from typing import Any
from unittest.mock import patch

import numpy as np
import pytest

pytest.importorskip("rosbags", reason="rosbags is not installed: pip install 'slamref[ros]'")
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode
from rosbags.serde import utils

from data.formats.bags import Wanted, chosen, collect, laser_log, log_of_bag, topics_of
from data.formats.results.reading import read_path
from data.log import Log
from tests.data.formats.bags.made import Full
from tests.data.formats.open_log.same_log import assert_sound
from tests.data.formats.recordings.ros.bags import Maker
from tests.faults.mutations import BYTES, TABLE, Fault, Files
from tests.faults.readers import Reader, made, sound_path, try_faults

BZ2, LZ4, ZSTD = Writer1.CompressionFormat.BZ2, Writer1.CompressionFormat.LZ4, CompressionFormat.ZSTD


def faults_of(name: str) -> list[Fault]:
    return TABLE if name.endswith((".txt", ".yaml")) else BYTES


def small(form: str, *compression: Any) -> Files:
    """A bag with a laser that is not at the origin, three scans and a drive."""
    maker = Maker(form)
    maker.drive(np.arange(0.0, 3.01, 0.5))
    maker.mounting("base_link", "laser", 0.25, 0.0, 0.1)
    for at in (0.75, 1.5, 2.25):
        maker.scan(at, [1.0, 0.125, 8.0, 2.0])
    return made(lambda folder: maker.save(folder, *compression))


def full() -> Files:
    """A bag with detections of a camera, satellite fixes, headings, pose fixes and a second odometry."""
    maker = Full()
    maker.drive(np.arange(0.0, 3.01, 0.5))
    for t in np.arange(0.0, 2.6, 0.5):
        maker.odometry(t, (t, 0.1 * t, 0.0), "/vo", 0.01)
    maker.mounting("base_link", "camera", 0.25, 0.1, 0.5)
    maker.mounting("base_link", "antenna", 0.1, 0.0, 0.0)
    for t in (0.75, 1.5):
        maker.poses(t, [(2.0, 0.5), (1.0, -1.0)])
        maker.satellites(t, (48.0 + 1e-5 * t, 11.0), 0.25)
        maker.inertial(t, 0.1 * t, 0.01)
        maker.pose(t, (t, 0.0, 0.1 * t), variance=0.04)
    return made(maker.save)


def inside(folder: Path) -> Path:
    found = [p for p in sorted(folder.iterdir()) if p.is_dir() or p.suffix in (".bag", ".mcap", ".db3")]
    return found[0] if found else folder / "small"


def read(folder: Path) -> Log:
    return laser_log(inside(folder), "/scan", "/odom")


def read_full(folder: Path) -> Log:
    path = inside(folder)
    topics = chosen(path, topics_of(path), odometry="/odom", second="/vo")
    stated = Wanted(np.zeros(3), np.ones(3), 0.1, 0.1, 1.0, 0.1)
    return log_of_bag(path, "bag", topics, collect(path, topics), stated)


def sound(log: Log) -> None:
    assert_sound(log)
    scans = log.recorded.scans
    assert scans is not None
    assert np.isfinite(scans.ranges).all()
    assert (scans.ranges >= 0.0).all()
    assert np.isfinite([scans.scanner.angle_min, scans.scanner.angle_step, scans.scanner.max_range]).all()


READERS = {
    "ROS 1": Reader(lambda: [small("ros1"), small("ros1", BZ2), small("ros1", LZ4)], read, sound, faults_of),
    "SQLite": Reader(
        lambda: [small("sqlite3"), small("sqlite3", CompressionMode.MESSAGE, ZSTD)], read, sound, faults_of
    ),
    "MCAP": Reader(lambda: [small("mcap"), small("mcap", CompressionMode.STORAGE, ZSTD)], read, sound, faults_of),
    "detections and fixes": Reader(lambda: [full()], read_full, assert_sound, faults_of),
    "result": Reader(
        lambda: [small("ros1"), small("sqlite3"), small("mcap")],
        lambda folder: (read_path(f"{inside(folder)}:/odom"),),
        sound_path,
        faults_of,
    ),
}


code = cache(lambda text: compile(text, "<string>", "exec"))


def compiled_once(text: str | CodeType, *spaces: Any) -> None:
    """The library compiles the same code for every type whenever a bag is opened."""
    exec(code(text) if isinstance(text, str) else text, *spaces)


@pytest.mark.slow
@pytest.mark.parametrize("name", READERS)
def test_a_broken_bag_is_refused_in_one_line_or_read_right_at_once_and_in_little_memory(name):
    with ExitStack() as stack:
        for module in (dataclasses, utils):
            stack.enter_context(patch.object(module, "exec", compiled_once, create=True))
        try_faults(name, READERS[name], 300)

"""ROS bags that are fuzzed: of both versions, in every storage and compression that is read."""

from __future__ import annotations

import dataclasses
from contextlib import ExitStack
from functools import cache
from pathlib import Path
from types import CodeType
from typing import Any
from unittest.mock import patch

import numpy as np
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode
from rosbags.serde import utils

from data.formats.bags.log import Wanted, log_of_bag
from data.formats.bags.reading import chosen, collect, topics_of
from data.formats.recordings.ros import log_of, read_bag
from data.formats.results.path import GivenPath
from data.formats.results.reading import read_path
from data.log import Log
from tests.data.formats.bags.made import Full
from tests.data.formats.open_log.test_corruption import assert_sound
from tests.data.formats.recordings.ros.bags import Maker
from tests.faults.bags2 import BAGS
from tests.faults.mutations import BYTES, TABLE, Fault, Files
from tests.faults.readers import Reader, made, sound_path


def faults_of(name: str) -> list[Fault]:
    ending = name.rpartition(".")[2]
    return BAGS.get(ending, TABLE if ending == "txt" else BYTES)


def small(form: str, *compression: Any) -> Files:
    """A bag with a laser that is not at the origin, three scans and a drive."""
    maker = Maker(form)
    maker.drive(np.arange(0.0, 3.01, 0.5))
    maker.mounting("base_link", "laser", 0.25, 0.0, 0.1)
    for at in (0.75, 1.5, 2.25):
        maker.scan(at, [1.0, 0.125, 8.0, 2.0])
    return made(lambda folder: maker.save(folder, *compression))


def unsummed(files: Files) -> Files:
    """MCAP files whose footer names no summary."""
    return {n: c[:-28] + bytes(8) + c[-20:] if n.endswith("mcap") else c for n, c in files.items()}


def alone(files: Files) -> Files:
    """The file of a folder of ROS 2 without its metadata."""
    return {Path(n).name: c for n, c in files.items() if not n.endswith("yaml")}


def ros1() -> list[Files]:
    formats = Writer1.CompressionFormat
    return [small("ros1"), small("ros1", formats.BZ2), small("ros1", formats.LZ4)]


def sqlite() -> list[Files]:
    modes = [(mode, CompressionFormat.ZSTD) for mode in (CompressionMode.MESSAGE, CompressionMode.FILE)]
    plain = small("sqlite3")
    return [plain, *(small("sqlite3", *mode) for mode in modes), alone(plain)]


def mcap() -> list[Files]:
    plain = small("mcap")
    packed = small("mcap", CompressionMode.STORAGE, CompressionFormat.ZSTD)
    whole = small("mcap", CompressionMode.FILE, CompressionFormat.ZSTD)
    return [plain, packed, whole, alone(packed), alone(unsummed(plain)), alone(unsummed(packed))]


def of_each() -> list[Files]:
    """One of every storage."""
    return [ros1()[0], sqlite()[0], mcap()[0]]


def seeing() -> Files:
    """A bag with points of one camera and pixels of another."""
    maker = Full()
    maker.drive(np.arange(0.0, 3.01, 0.5))
    maker.mounting("base_link", "camera", 0.25, 0.1, 0.5)
    maker.optical(0.2, 0.0, 0.1)
    maker.camera()
    for t in (0.75, 1.5):
        maker.poses(t, [(2.0, 0.5), (1.0, -1.0)])
        maker.tags(t, [(3, 320.0), (4, 700.0)])
    return made(maker.save)


def marked() -> Files:
    """A bag with markers and objects."""
    maker = Full()
    maker.drive(np.arange(0.0, 3.01, 0.5))
    maker.mounting("base_link", "camera", 0.25, 0.1, 0.5)
    for t in (0.75, 1.5):
        maker.markers(t, [(7, 3.0, 0.0)])
        maker.boxes(t, [("12", 1.0, 0.0)])
    return made(maker.save)


def fixed() -> Files:
    """A bag with satellite fixes, headings, pose fixes and a second odometry."""
    maker = Full("sqlite3")
    maker.drive(np.arange(0.0, 3.01, 0.5))
    for t in np.arange(0.0, 2.6, 0.5):
        maker.odometry(t, (t, 0.1 * t, 0.0), "/vo", 0.01)
    maker.mounting("base_link", "antenna", 0.1, 0.0, 0.0)
    for t in (0.75, 1.5):
        maker.satellites(t, (48.0 + 1e-5 * t, 11.0), 0.25)
        maker.inertial(t, 0.1 * t, 0.01)
        maker.pose(t, (t, 0.0, 0.1 * t), variance=0.04)
    return made(maker.save)


def read_full(folder: Path) -> Log:
    path = _inside(folder)
    every = topics_of(path)
    second = "/vo" if any(t.name == "/vo" for t in every) else None
    topics = chosen(path, every, odometry="/odom" if second else None, second=second)
    stated = Wanted(np.zeros(3), np.ones(3), 0.1, 0.1, 1.0, 0.1)
    return log_of_bag(path, "bag", topics, collect(path, topics), stated)


def _inside(folder: Path) -> Path:
    found = [p for p in sorted(folder.iterdir()) if p.is_dir() or p.suffix in (".bag", ".mcap", ".db3")]
    return found[0] if found else folder / "small"


def read(folder: Path) -> Log:
    path = _inside(folder)
    return log_of(path, read_bag(path, "/scan", "/odom"))


def read_result(folder: Path) -> tuple[GivenPath]:
    return (read_path(f"{_inside(folder)}:/odom"),)


def sound(log: Log) -> None:
    assert_sound(log)
    scans = log.recorded.scans
    assert scans is not None
    assert np.isfinite(scans.ranges).all()
    assert (scans.ranges >= 0.0).all()
    assert np.isfinite([scans.scanner.angle_min, scans.scanner.angle_step, scans.scanner.max_range]).all()


BAG_READERS = {
    "ROS 1 bag": Reader(ros1, read, sound, faults_of),
    "ROS 2 bag, SQLite": Reader(sqlite, read, sound, faults_of),
    "ROS 2 bag, MCAP": Reader(mcap, read, sound, faults_of),
    "ROS 2 bag with detections and fixes": Reader(
        lambda: [seeing(), marked(), fixed()], read_full, assert_sound, faults_of
    ),
    "result, a ROS bag": Reader(of_each, read_result, sound_path, faults_of),
}


@cache
def _code(text: str) -> CodeType:
    return compile(text, "<string>", "exec")


def _run(text: str | CodeType, *spaces: Any) -> None:
    exec(_code(text) if isinstance(text, str) else text, *spaces)


def compile_once() -> ExitStack:
    """Meanwhile the library, which compiles the same code for every type whenever a bag is opened, compiles it once."""
    stack = ExitStack()
    for module in (dataclasses, utils):
        stack.enter_context(patch.object(module, "exec", _run, create=True))
    return stack

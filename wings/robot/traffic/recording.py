"""A recording of the line: a folder with `log.toml` and `packets.bin`, intact up to the last record.

`packets.bin` is `MAGIC` and records, little-endian:

    1 byte    kind: S command sent, R bytes received, O device opened, G device gone
    2 bytes   uint16, length of the data
    8 bytes   int64, time since the link began [us], increasing
    data
    4 bytes   CRC-32 of all that

Every record is one system write: a killed process leaves whole records and at most the beginning of one.
"""

from __future__ import annotations

import binascii
import math
import struct
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import tomli_w

from data.columns.header import FORMAT
from data.csv_table import bytes_of
from data.errors import DataError, UsageError
from data.toml_table import load_toml
from wings.robot.walls import FITS, USUAL_FIT

HEADER, PACKETS = "log.toml", "packets.bin"
MAGIC = b"robot 1\n"
SENT, RECEIVED, OPENED, GONE = b"S", b"R", b"O", b"G"
SOURCE = "robot link"
NOISE, LIDAR = ("slip", "sonar_sigma"), "lidar_sigma"
_HEAD = struct.Struct("<cHq")
_CHECK = struct.Struct("<I")


class Record(NamedTuple):
    """An event of the line: kind, time [s, whole us], bytes."""

    kind: bytes
    t: float
    data: bytes = b""


class Recorded(NamedTuple):
    """A recording as read."""

    records: list[Record]  # in the order of their times
    framed: bool  # whether the line carried frames
    cut: int  # bytes of an unfinished record at the end; 0 of a closed log
    noise: tuple[float, ...]  # stated slip [m per sqrt(m)] and sonar sigma [m]; empty if not stated
    source: Mapping[str, object]  # `[source]` of the header
    fit: str  # of walls, see `wings.robot.walls.FITS`
    lidar_sigma: float | None = None  # m, standard deviation of a lidar's range; None: no lidar


class Recording:
    """A recording being written; `with` closes it."""

    def __init__(
        self, folder: Path, *, framed: bool = False, noise: tuple[float, ...] = (), fit: str = USUAL_FIT,
        lidar_sigma: float | None = None,
    ) -> None:  # fmt: skip
        """Create both files; `noise`, `fit`, `lidar_sigma` as of `Recorded`. UsageError if the folder holds a log."""
        if (folder / HEADER).exists() or (folder / PACKETS).exists():
            raise UsageError(f"{folder}: the folder holds a log already; name another folder")
        folder.mkdir(parents=True, exist_ok=True)
        self.folder = folder
        # unbuffered: the system has a record when `append` returns
        self._file = (folder / PACKETS).open("xb", buffering=0)
        self._file.write(MAGIC)
        source = {"kind": SOURCE, "framed": framed, **dict(zip(NOISE, noise, strict=False))}
        source |= {} if fit == USUAL_FIT else {"fit": fit}
        source |= {} if lidar_sigma is None else {LIDAR: lidar_sigma}
        with (folder / HEADER).open("wb") as file:
            tomli_w.dump({"format": FORMAT, "name": folder.absolute().name, "source": source}, file)

    def append(self, record: Record) -> None:
        """Write a record through to the system."""
        head = _HEAD.pack(record.kind, len(record.data), round(record.t * 1e6)) + record.data
        self._file.write(head + _CHECK.pack(binascii.crc32(head)))

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def discard(self) -> None:
        """Remove both files, and the folder if it is empty then."""
        self.close()
        for name in (PACKETS, HEADER):
            (self.folder / name).unlink()
        if not any(self.folder.iterdir()):
            self.folder.rmdir()

    def __enter__(self) -> Recording:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def read_recording(folder: Path) -> Recorded:
    """Read a recording that is finished, truncated, or still being written; DataError if it is damaged."""
    header = folder / HEADER
    contents = load_toml(header, lambda what: DataError.at(header, what), "no such file; a recording needs one")
    source = contents.get("source")
    if not isinstance(source, dict) or source.get("kind") != SOURCE or not isinstance(source.get("framed"), bool):
        raise DataError.at(header, f"not the recording of a link; [source] kind = {SOURCE!r} and framed are needed")
    noise = tuple(source[key] for key in NOISE if key in source)
    if len(noise) == 1 or not all(isinstance(v, float | int) and 0.0 <= v < math.inf for v in noise):
        raise DataError.at(header, f"[source] {' and '.join(NOISE)}: two numbers from 0 up, or neither")
    fit = source.get("fit", USUAL_FIT)
    if fit not in FITS:
        raise DataError.at(header, f"[source] fit {fit!r}: {' or '.join(FITS)} is needed")
    lidar = source.get(LIDAR)
    if lidar is not None and not (isinstance(lidar, float | int) and 0.0 < lidar < math.inf):
        raise DataError.at(header, f"[source] {LIDAR} {lidar!r}: a number above 0 is needed")
    path = folder / PACKETS
    data = bytes_of(path)
    if not data.startswith(MAGIC) and not MAGIC.startswith(data):
        raise DataError.at(path, f"begins with {data[: len(MAGIC)]!r}; {MAGIC!r} is needed")
    records, end = _records(path, data)
    return Recorded(records, source["framed"], len(data) - end, noise, source, fit, lidar)


def _records(path: Path, data: bytes) -> tuple[list[Record], int]:
    """All whole records and the position after the last one."""
    records: list[Record] = []
    at = min(len(MAGIC), len(data))
    while len(data) >= at + _HEAD.size:
        kind, length, microseconds = _HEAD.unpack_from(data, at)
        middle = at + _HEAD.size + length
        end = middle + _CHECK.size
        if end > len(data):
            break
        if _CHECK.unpack_from(data, middle)[0] != binascii.crc32(data[at:middle]):
            if end == len(data):  # after a crash a file may have its length before its contents
                break
            raise DataError.at(path, f"the record at byte {at} is damaged; {len(records)} records before it are intact")
        records.append(Record(kind, microseconds / 1e6, data[at + _HEAD.size : middle]))
        at = end
    return records, at

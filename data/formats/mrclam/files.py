"""The files of a UTIAS MRCLAM dataset, in a folder or in the published zip (never unpacked), as checked tables.

    Barcodes.dat               subject, barcode                          subjects 1-5 are robots
    Landmark_Groundtruth.dat   subject, x [m], y [m], x std, y std
    RobotN_Groundtruth.dat     time [s], x [m], y [m], heading [rad]     may be absent
    RobotN_Odometry.dat        time [s], forward velocity [m/s], angular velocity [rad/s]
    RobotN_Measurement.dat     time [s], barcode (not subject), range [m], bearing [rad]

White-space separated numbers; a line that starts with # is a comment; stamps never decrease, some are equal.
Published by K.Y.K. Leung, Y. Halpern, T.D. Barfoot and H.H.T. Liu, IJRR 30(8), 2011.
"""

from __future__ import annotations

import hashlib
import re
import zipfile
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from itertools import chain
from pathlib import Path, PurePosixPath

import numpy as np

from data.errors import DataError
from data.formats.csv_table import Table, bytes_of, shown
from data.formats.open_log.scans import open_archive
from data.inputs import IntArray, LandmarkMap
from data.se2 import Array

BARCODES, LANDMARKS = "Barcodes.dat", "Landmark_Groundtruth.dat"
ROBOT_FILE = re.compile(r"Robot([1-9][0-9]*)_(Groundtruth|Odometry|Measurement)\.dat")


@dataclass(frozen=True)
class Files:
    """The files of one dataset.

    Attributes:
        name: of the dataset.
        names: of its files.
        read: bytes of one of them.
        path: how errors name one of them.
        zipped: whether they are in a zip.
        sha256: digests by file name, of what was read so far; for a zip its own.
    """

    name: str
    names: frozenset[str]
    read: Callable[[str], bytes]
    path: Callable[[str], str]
    zipped: bool
    sha256: dict[str, str]

    def content(self, name: str) -> bytes:
        """Bytes of a file; DataError naming it if it is not there."""
        if name not in self.names:
            raise DataError.at(self.path(name), "no such file" + self._others(name))
        content = self.read(name)
        if not self.zipped:
            self.sha256[name] = hashlib.sha256(content).hexdigest()
        return content

    def _others(self, name: str) -> str:
        if ROBOT_FILE.fullmatch(name) is None:
            return ""
        there = ", ".join(map(str, self.robots())) or "none"
        return f"; robots with odometry and measurements here: {there}"

    def robots(self) -> list[int]:
        """Robots that have odometry and measurements, ascending."""
        found = (ROBOT_FILE.fullmatch(n) for n in self.names)
        numbers = {int(m[1]) for m in found if m is not None}
        return sorted(n for n in numbers if {robot_file(n, "Odometry"), robot_file(n, "Measurement")} <= self.names)


def robot_file(robot: int, what: str) -> str:
    """Name of a robot's file: `what` is Groundtruth, Odometry or Measurement."""
    return f"Robot{robot}_{what}.dat"


def _belongs(name: str) -> bool:
    return name in (BARCODES, LANDMARKS) or ROBOT_FILE.fullmatch(name) is not None


def _one_home(source: Path, names: list[PurePosixPath]) -> PurePosixPath:
    """The folder that holds the dataset's files: the top, or its one subfolder with such files."""
    homes = sorted({n.parent for n in names if _belongs(n.name) and len(n.parts) <= 2})
    if PurePosixPath(".") in homes:
        return PurePosixPath(".")
    if not homes:
        raise DataError.at(source / BARCODES, "no such file, nor any other MRCLAM file, here or one folder below")
    if len(homes) > 1:
        raise DataError.at(source, f"holds more than one dataset ({', '.join(map(str, homes))}); name one of them")
    return homes[0]


def _open_folder(source: Path) -> Files:
    try:
        names = [PurePosixPath(p.name) for p in source.iterdir() if p.is_file()]
        for below in sorted(p for p in source.iterdir() if p.is_dir()):
            names += [PurePosixPath(below.name, p.name) for p in below.iterdir() if p.is_file()]
    except OSError as error:
        raise DataError.at(source, f"cannot be read: {error.strerror}") from None
    home = _one_home(source, names)
    folder = source / home

    inside = frozenset(n.name for n in names if n.parent == home)
    name = folder.resolve().name
    return Files(name, inside, lambda n: bytes_of(folder / n), lambda n: str(folder / n), False, {})


def _open_zip(source: Path) -> Files:
    try:
        content = source.read_bytes()
        archive = open_archive(source, whole=True)
    except (OSError, zipfile.BadZipFile, NotImplementedError, ValueError) as error:
        raise DataError.at(source, f"not a readable zip file or folder: {error}") from None
    members = {PurePosixPath(n): n for n in archive.namelist() if not n.endswith("/")}
    home = _one_home(source, list(members))

    def read(name: str) -> bytes:
        try:
            return archive.read(members[home / name])
        # the library tells an encrypted member by a RuntimeError, an unknown method by a NotImplementedError
        except (zipfile.BadZipFile, zlib.error, EOFError, OSError, RuntimeError) as error:
            raise DataError.at(source / home / name, f"cannot be read from the zip: {error}") from None

    inside = frozenset(n.name for n in members if n.parent == home)
    title = source.stem if home == PurePosixPath(".") else home.name
    digest = {source.name: hashlib.sha256(content).hexdigest()}
    return Files(title, inside, read, lambda name: str(source / home / name), True, digest)


def open_files(source: Path) -> Files:
    """Files of a dataset: `source` is a folder or a zip that holds them, or whose one subfolder does.

    Raises:
        DataError: neither folder nor zip, no dataset in it, or more than one.
    """
    if not source.exists():
        raise DataError.at(source, "no such folder or zip file")
    return _open_folder(source) if source.is_dir() else _open_zip(source)


ROBOTS = range(1, 6)
"""Subjects that are robots, in every dataset of the collection."""
LONGEST = 1e6
"""s. No recording is longer; a stamp further on is broken, and keyframes up to it would fill the memory."""


def parse(path: str, content: bytes, columns: tuple[str, ...]) -> Table:
    """Rows of numbers, checked: as many as `columns`, finite, and the last one not cut off.

    Raises:
        DataError: with file, line and column.
    """
    lines = content.removeprefix(b"\xef\xbb\xbf").replace(b"\r\n", b"\n").replace(b"\r", b"\n").split(b"\n")
    fields = [line.split() for line in lines]
    data = [i for i, row in enumerate(fields) if row and not row[0].startswith(b"#")]
    if not data:
        raise DataError.at(path, f"no rows; wanted {', '.join(columns)}", line=len(lines))
    rows = [fields[i] for i in data]
    for i, row in zip(data, rows, strict=True):
        if len(row) != len(columns):
            last = " (the file ends here: was it cut off?)" if i == data[-1] and len(row) < len(columns) else ""
            what = f"{len(row)} fields where {len(columns)} are needed ({', '.join(columns)}){last}"
            raise DataError.at(path, what, line=i + 1)
    line = np.array(data, np.int64) + 1
    try:
        if b"_" in b"".join(chain.from_iterable(rows)):  # Python reads 1_0 as ten
            raise ValueError
        values = np.array(list(map(float, chain.from_iterable(rows)))).reshape(-1, len(columns))
    except ValueError:
        raise _not_a_number(path, data, rows, columns) from None
    table = Table(path, dict(zip(columns, values.T, strict=True)), line=line)
    table.require_finite(columns)
    if lines[-1].strip():
        _require_whole_end(table, rows)
    return table


def _not_a_number(path: str, data: list[int], rows: list[list[bytes]], columns: tuple[str, ...]) -> DataError:
    for i, row in zip(data, rows, strict=True):
        for column, field in zip(columns, row, strict=True):
            try:
                float(field)
                fine = b"_" not in field
            except ValueError:
                fine = False
            if not fine:
                return DataError.at(path, f"{shown(field)} is not a number", line=i + 1, column=column)
    raise AssertionError("called for rows that are all numbers")


def _require_whole_end(table: Table, rows: list[list[bytes]]) -> None:
    """Without a line end the last number may be cut: it is if it shows fewer decimals than every other row's."""
    decimals = [len(row[-1].partition(b".")[2]) for row in rows]
    if len(rows) > 1 and decimals[-1] < min(decimals[:-1]):
        last = rows[-1][-1].decode("utf-8", "replace")
        what = f"{last} has fewer decimals than any other row and no line end: the file was cut off"
        raise table.error(len(rows) - 1, list(table.columns)[-1], what)


def _stamped(files: Files, name: str, columns: tuple[str, ...]) -> Table:
    """A file whose first column is a stamp that never decreases."""
    table = parse(files.path(name), files.content(name), ("time", *columns))
    stamp = table.columns["time"]
    backwards = np.diff(stamp, prepend=stamp[0]) < 0.0
    if backwards.any():
        before = float(stamp[int(np.argmax(backwards)) - 1])
        table.require(~backwards, "time", f"{{}} follows {before!r}; stamps must not decrease")
    table.require(
        stamp - stamp[0] <= LONGEST,
        "time",
        f"{{}} is more than {LONGEST:g} s after the first row; stamps are in seconds",
    )
    return table


def read_barcodes(files: Files) -> dict[int, int]:
    """Subject by barcode."""
    table = parse(files.path(BARCODES), files.content(BARCODES), ("subject", "barcode"))
    subject, barcode = (table.integers(name, 0) for name in ("subject", "barcode"))
    _require_distinct(table, "subject", subject)
    _require_distinct(table, "barcode", barcode)
    return dict(zip(barcode.tolist(), subject.tolist(), strict=True))


def read_landmarks(files: Files, replacement: Path | None = None) -> LandmarkMap:
    """Surveyed landmarks by subject, ascending; `replacement` is read instead of the dataset's own file."""
    path = files.path(LANDMARKS) if replacement is None else str(replacement)
    if replacement is None:
        content = files.content(LANDMARKS)
    else:
        content = bytes_of(replacement)
        files.sha256[replacement.name] = hashlib.sha256(content).hexdigest()
    table = parse(path, content, ("subject", "x", "y", "x std-dev", "y std-dev"))
    subject = table.integers("subject", 0)
    table.require(~np.isin(subject, ROBOTS), "subject", "{} is a robot's number (1 to 5), not a landmark's")
    _require_distinct(table, "subject", subject)
    for column in ("x std-dev", "y std-dev"):
        table.require(table.columns[column] >= 0.0, column, "{} is a negative standard deviation")
    order = np.argsort(subject)
    return LandmarkMap(subject[order], table.stack(("x", "y"))[order])


def _require_distinct(table: Table, column: str, values: IntArray) -> None:
    first = np.zeros(len(values), bool)
    first[np.unique(values, return_index=True)[1]] = True
    table.require(first, column, "{} stands in two rows")


def read_truth(files: Files, robot: int) -> Array | None:
    """Stamp and true pose (K, 4) of a robot; None if the dataset has no such file."""
    name = robot_file(robot, "Groundtruth")
    return _stamped(files, name, ("x", "y", "orientation")).all() if name in files.names else None


def read_odometry(files: Files, robot: int) -> Array:
    """Stamp, forward velocity [m/s] and angular velocity [rad/s] (K, 3) of a robot."""
    return _stamped(files, robot_file(robot, "Odometry"), ("forward velocity", "angular velocity")).all()


def read_measurements(files: Files, robot: int) -> Array:
    """Stamp, barcode, range [m] and bearing [rad] (M, 4) of a robot."""
    table = _stamped(files, robot_file(robot, "Measurement"), ("barcode", "range", "bearing"))
    table.integers("barcode", 0)
    table.require(table.columns["range"] >= 0.0, "range", "{} is a negative range")
    return table.all()

"""The files of a UTIAS MRCLAM dataset, in a folder or in the published zip (never unpacked), as checked tables.

    Barcodes.dat               subject, barcode                          subjects 1-5 are robots
    Landmark_Groundtruth.dat   subject, x [m], y [m], x std, y std
    RobotN_Groundtruth.dat     time [s], x [m], y [m], heading [rad]     may be absent
    RobotN_Odometry.dat        time [s], forward velocity [m/s], angular velocity [rad/s]
    RobotN_Measurement.dat     time [s], barcode (not subject), range [m], bearing [rad]

Numbers separated by white space; a line that starts with # is a comment; stamps never decrease, some are equal.
Published by K.Y.K. Leung, Y. Halpern, T.D. Barfoot and H.H.T. Liu, IJRR 30(8), 2011.
"""

from __future__ import annotations

import hashlib
import re
import zipfile
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

import numpy as np

from data.columns.scans import open_archive
from data.csv_table import Table, bytes_of, cut_off, lines_of, number_rows
from data.errors import DataError
from data.inputs import LandmarkMap
from data.se2 import Array

BARCODES, LANDMARKS = "Barcodes.dat", "Landmark_Groundtruth.dat"
ROBOT_FILE = re.compile(r"Robot([1-9][0-9]*)_(Groundtruth|Odometry|Measurement)\.dat")


@dataclass(frozen=True)
class Files:
    """The files of one dataset by name: the bytes of each, and its path in errors.

    `sha256`: digests by file name, of the files read so far; for a zip its own.
    """

    name: str
    names: frozenset[str]
    read: Callable[[str], bytes]
    path: Callable[[str], str]
    zipped: bool
    sha256: dict[str, str]

    def content(self, name: str) -> bytes:
        """Bytes of a file; DataError if it is missing."""
        if name not in self.names:
            there = f"; robots with odometry and measurements here: {', '.join(map(str, self.robots())) or 'none'}"
            raise DataError.at(self.path(name), "no such file" + (there if ROBOT_FILE.fullmatch(name) else ""))
        content = self.read(name)
        if not self.zipped:
            self.sha256[name] = hashlib.sha256(content).hexdigest()
        return content

    def robots(self) -> list[int]:
        """Robots with odometry and measurements, ascending."""
        found = (ROBOT_FILE.fullmatch(n) for n in self.names)
        numbers = {int(m[1]) for m in found if m is not None}
        return sorted(n for n in numbers if {robot_file(n, "Odometry"), robot_file(n, "Measurement")} <= self.names)


def robot_file(robot: int, what: str) -> str:
    """Name of a robot's file: `what` is Groundtruth, Odometry or Measurement."""
    return f"Robot{robot}_{what}.dat"


def _one_home(source: Path, names: list[PurePosixPath]) -> PurePosixPath:
    """The folder of the dataset's files: the top, or its only subfolder with such files."""
    ours = (n for n in names if n.name in (BARCODES, LANDMARKS) or ROBOT_FILE.fullmatch(n.name) is not None)
    homes = sorted({n.parent for n in ours if len(n.parts) <= 2})
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
    return Files(folder.resolve().name, inside, lambda n: bytes_of(folder / n), lambda n: str(folder / n), False, {})


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
        # RuntimeError: an encrypted member; NotImplementedError: an unknown method
        except (zipfile.BadZipFile, zlib.error, EOFError, OSError, RuntimeError) as error:
            raise DataError.at(source / home / name, f"cannot be read from the zip: {error}") from None

    inside = frozenset(n.name for n in members if n.parent == home)
    title = source.stem if home == PurePosixPath(".") else home.name
    digest = {source.name: hashlib.sha256(content).hexdigest()}
    return Files(title, inside, read, lambda name: str(source / home / name), True, digest)


def open_files(source: Path) -> Files:
    """Files of a dataset: `source` is a folder or a zip that holds them, or whose only subfolder does.

    Raises DataError if it is neither, or holds no dataset or several.
    """
    if not source.exists():
        raise DataError.at(source, "no such folder or zip file")
    return _open_folder(source) if source.is_dir() else _open_zip(source)


ROBOTS = range(1, 6)
"""Subjects that are robots, in every dataset of the collection."""
LONGEST = 1e6
"""s, longest recording; keyframes up to a broken stamp would fill the memory."""


def parse(path: str, content: bytes, columns: tuple[str, ...]) -> Table:
    """Rows of finite numbers, checked to be complete; DataError names file, line and column."""
    lines = lines_of(content)
    fields = [line.split() for line in lines]
    data = [i for i, row in enumerate(fields) if row and not row[0].startswith(b"#")]
    if not data:
        raise DataError.at(path, f"no rows; wanted {', '.join(columns)}", line=len(lines))
    rows = [fields[i] for i in data]
    for i, row in zip(data, rows, strict=True):
        if len(row) != len(columns):
            last = cut_off(len(row), len(columns), last=i == data[-1])
            what = f"{len(row)} fields where {len(columns)} are needed ({', '.join(columns)}){last}"
            raise DataError.at(path, what, line=i + 1)
    line = np.array(data, np.int64) + 1
    values = number_rows(path, line.tolist(), rows, columns)
    table = Table(path, dict(zip(columns, values.T, strict=True)), line=line)
    table.require_finite(columns)
    decimals = [len(row[-1].partition(b".")[2]) for row in rows]
    if lines[-1].strip() and len(rows) > 1 and decimals[-1] < min(decimals[:-1]):
        last = rows[-1][-1].decode("utf-8", "replace")
        what = f"{last} has fewer decimals than any other row, and no line end; the file was cut off"
        raise table.error(len(rows) - 1, columns[-1], what)
    return table


def _stamped(files: Files, name: str, columns: tuple[str, ...]) -> Table:
    """A file whose first column is a stamp that never decreases."""
    table = parse(files.path(name), files.content(name), ("time", *columns))
    table.require_ascending("time", strictly=False)
    stamp = table.columns["time"]
    far = f"{{}} is more than {LONGEST:g} s after the first row; stamps are in seconds"
    table.require(stamp - stamp[0] <= LONGEST, "time", far)
    return table


def read_barcodes(files: Files) -> dict[int, int]:
    """Subject by barcode."""
    table = parse(files.path(BARCODES), files.content(BARCODES), ("subject", "barcode"))
    subject, barcode = (table.integers(name, 0) for name in ("subject", "barcode"))
    table.require_distinct("subject", subject, "{} is in two rows")
    table.require_distinct("barcode", barcode, "{} is in two rows")
    return dict(zip(barcode.tolist(), subject.tolist(), strict=True))


def read_landmarks(files: Files, replacement: Path | None = None) -> LandmarkMap:
    """Surveyed landmarks by subject, ascending; `replacement` is read instead of the dataset's file."""
    columns = ("subject", "x", "y", "x std-dev", "y std-dev")
    if replacement is None:
        table = parse(files.path(LANDMARKS), files.content(LANDMARKS), columns)
    else:
        content = bytes_of(replacement)
        files.sha256[replacement.name] = hashlib.sha256(content).hexdigest()
        table = parse(str(replacement), content, columns)
    subject = table.integers("subject", 0)
    table.require(~np.isin(subject, ROBOTS), "subject", "{} is a robot's number (1 to 5), not a landmark's")
    table.require_distinct("subject", subject, "{} is in two rows")
    for column in ("x std-dev", "y std-dev"):
        table.require(table.columns[column] >= 0.0, column, "{} is a negative standard deviation")
    order = np.argsort(subject)
    sigma = table.stack(("x std-dev", "y std-dev"))[order]
    return LandmarkMap(subject[order], table.stack(("x", "y"))[order], sigma=sigma if sigma.any() else None)


def read_truth(files: Files, robot: int) -> Array | None:
    """Stamp and true pose (K, 4) of a robot; None without such a file."""
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

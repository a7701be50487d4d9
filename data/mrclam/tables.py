"""What the files of a UTIAS MRCLAM dataset hold: checked tables of numbers.

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
from itertools import chain
from pathlib import Path

import numpy as np

from data.errors import DataError
from data.inputs import IntArray, LandmarkMap
from data.mrclam.files import BARCODES, LANDMARKS, Files, robot_file
from data.open_log.table import Table
from data.se2 import Array

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
                shown = field.decode("utf-8", "replace")
                shown = repr(shown if len(shown) <= 40 else shown[:37] + "...")
                return DataError.at(path, f"{shown} is not a number", line=i + 1, column=column)
    raise AssertionError("called for rows that are all numbers")


def _require_whole_end(table: Table, rows: list[list[bytes]]) -> None:
    """Without a line end the last number may be cut: it is if it shows fewer decimals than every other row's."""
    decimals = [len(row[-1].partition(b".")[2]) for row in rows]
    if len(rows) > 1 and decimals[-1] < min(decimals[:-1]):
        shown = rows[-1][-1].decode("utf-8", "replace")
        what = f"{shown} has fewer decimals than any other row and no line end: the file was cut off"
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
        try:
            content = replacement.read_bytes()
        except OSError as error:
            raise DataError.at(replacement, f"cannot be read: {error.strerror}") from None
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

"""Laser scans of a table, a row each: ranges in columns that are numbered, angles in others or as stated."""

import re
from types import SimpleNamespace

import numpy as np

from data.csv_table import Table, is_number
from data.errors import DataError, UsageError
from data.formats.bags import GEOMETRY, Collected, LaserScans, scans_of
from data.formats.tables.files import Columns, TextTable
from data.inputs import IntArray
from data.se2 import Array

RANGE = re.compile(r"(?:.*[._])?ranges?[._\[]?\d+\]?")
STATED = ("angle_min", "angle_increment", "range_max")


def read_scans(
    file: TextTable, columns: Columns, scanner: Array | None, span: tuple[float, float]
) -> tuple[LaserScans, Table]:
    """The scans within a span [s], and their stamps as a table. `scanner`: (3,) first angle and step [rad] and reach
    [m], where no columns angle_min, angle_increment and range_max state them.

    Raises DataError for missing columns or an invalid field, UsageError where the angles are unknown.
    """
    at = {name.rpartition(".")[2]: k for k, name in enumerate(file.names)}
    first = columns.find(file, "scans", "range")
    beams = [k for k, name in enumerate(file.names) if RANGE.fullmatch(name)]
    beams = beams if first is None else list(range(first, len(file.names)))
    if not beams:
        what = f"no scans: {file.described()}; columns such as range0, range1 are needed"
        raise DataError.at(file.path, f"{what}, or --columns scans.range=N: all from the N-th on")
    if scanner is None and not {*STATED} <= {*at}:
        what = f"{file.path.name} names no {', '.join(name for name in STATED if name not in at)}"
        raise UsageError(f"--scanner LOW,STEP,MAX, as in -90deg,0.5deg,8m, is needed: {what}")
    whole = np.ones(len(file), bool)
    if columns.find(file, "scans", "t") is None:
        columns.require(file, "scans", ("t",))
    stamp, found = columns.stamps(file, "scans", whole), Collected()
    given = {} if scanner is None else dict(zip(STATED, scanner.tolist(), strict=True))
    for k, (row, line) in enumerate(zip(file.rows, file.line.tolist(), strict=True)):
        wrong = next((j for j in (*beams, *at.values()) if j in beams and not is_number(row[j] or "nan")), None)
        if wrong is not None:
            raise DataError.at(file.path, f"{row[wrong]!r} is not a number", line=line, column=file.names[wrong])
        own = {name: float(row[at[name]]) for name in GEOMETRY if name in at and is_number(row[at[name]])}
        own = {"range_min": 0.0} | own | given
        own.setdefault("angle_max", own["angle_min"] + (len(beams) - 1) * own["angle_increment"])
        clock = SimpleNamespace(sec=0, nanosec=0)
        ranges = [float(row[j] or "nan") for j in beams]
        message = SimpleNamespace(header=SimpleNamespace(stamp=clock, frame_id="laser"), ranges=ranges, **own)
        found.scans.add(message, float(stamp[k]), f"{file.path}:{line}")
    columns.read |= {(file.path, k) for k in (*beams, *(at[n] for n in GEOMETRY if n in at))}
    seen = scans_of(file.path, (), found, "", span)
    rows: IntArray = np.arange(1, len(seen.stamp) + 1)
    return seen, Table(file.path, {"t": seen.stamp}, line=rows)

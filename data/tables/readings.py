"""Readings of a foreign table, in the order of their stamps, and its columns of ids."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from data.errors import DataError
from data.inputs import CLUTTER, UNLABELLED, IntArray
from data.open_log.table import Table
from data.se2 import Array
from data.tables.columns import shared
from data.tables.files import TextTable
from data.tables.motion import Odometry
from data.tables.wanted import Wanted
from data.truth import UNKNOWN_ID


@dataclass(frozen=True, eq=False)
class Sightings:
    """Readings in the order of their stamps: z (M, 2), t (M,) s or frame numbers, whether range and bearing."""

    table: Table
    texts: Mapping[str, list[str]]
    z: Array
    at: Array
    polar: bool
    notes: tuple[str, ...]

    def part(self, rows: IntArray) -> Sightings:
        """Some of them, in this order."""
        table = replace(
            self.table, columns={q: v[rows] for q, v in self.table.columns.items()},
            line=None if self.table.line is None else self.table.line[rows],
        )  # fmt: skip
        texts = {q: [fields[i] for i in rows.tolist()] for q, fields in self.texts.items()}
        return replace(self, table=table, texts=texts, z=self.z[rows], at=self.at[rows])


def sightings(file: TextTable, wanted: Wanted, odometry: Odometry) -> Sightings:
    """The readings of a file: range and bearing, or x and y in the sensor's frame."""
    columns = wanted.columns
    polar = columns.find(file, "observations", "range") is not None
    polar |= columns.find(file, "observations", "bearing") is not None
    if not polar and not columns.has(file, "observations", ("x", "y")):
        raise DataError.at(
            file.path, f"no readings: {file.described()}; needed are range and bearing, or x and y in the body frame; "
            "name them as in --columns range=DIST,bearing=ANGLE",
        )  # fmt: skip
    by_stamp = odometry.stamped and columns.find(file, "observations", "t") is not None
    key = "t" if by_stamp else "frame"
    if not by_stamp and columns.find(file, "observations", "frame") is None:
        columns.require(file, "observations", ("t",) if odometry.stamped else ("frame",))
    values = ("range", "bearing") if polar else ("x", "y")
    table, texts, skipped = columns.table(file, "observations", (*values, key), texts=("true_id", "label"))
    together = "observations" in shared(wanted.files)
    notes = [f"{file.path.name}: {skipped} rows without a reading"] if skipped and not together else []
    z = table.stack(values)
    if polar:
        table.require(z[:, 0] >= 0.0, "range", "{} is a negative range")
    at = table.columns[key]
    if not by_stamp:
        rows = table.integers("frame", 0)
        last = len(odometry.time) - 1
        table.require(rows <= last, "frame", f"{{}} is out of range; the odometry has rows 0 to {last}")
    found = Sightings(table, texts, z, at, polar, tuple(notes))
    back = int((np.diff(at) < 0.0).sum())
    if back:
        found = found.part(np.argsort(at, kind="stable").astype(np.int64))
        found = replace(
            found, notes=(*notes, f"{file.path.name}: {back} readings were stamped before the one above; sorted")
        )
    return found


def whole(table: Table, fields: list[str], name: str) -> IntArray:
    """Ids: whole numbers, blank for not known, -1 for clutter."""
    blank = UNLABELLED if name == "label" else UNKNOWN_ID
    ids = np.full(len(fields), blank, np.int64)
    for i, field in enumerate(fields):
        if field and field.lower() != "nan":
            try:
                value = float(field)
                ids[i] = int(value)
            except (ValueError, OverflowError):
                value = 0.5
            if value != ids[i] or ids[i] < CLUTTER:
                raise table.error(i, name, f"{field!r} is not a whole number from -1 up (-1: clutter; blank: unknown)")
    return ids

"""Observations in tables of another program, of one sensor or several, in the order of their stamps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from data import se2
from data.columns import appearance
from data.columns.appearance import CLASS, DESCRIPTOR, of_observations
from data.csv_table import Table
from data.errors import DataError
from data.formats.tables.files import TextTable, shared
from data.formats.tables.flags import Wanted
from data.formats.tables.motion import Odometry
from data.formats.tables.sensors import LOOKS, TableSensor
from data.inputs import CLUTTER, UNLABELLED, IntArray, Observations
from data.se2 import Array
from data.sensors import Bearing, Range, RangeBearing, RelativePoint, Sensor
from data.truth import UNKNOWN_ID


@dataclass(frozen=True, eq=False)
class FrameObservations:
    """Observations `of` a sensor in the order of their stamps `at` (M,) [s], as the odometry's: z (M, 2), its kind."""

    of: TableSensor
    table: Table
    texts: Mapping[str, list[str]]
    z: Array
    at: Array
    kind: type[Sensor]
    notes: tuple[str, ...]
    one = "observation"

    @property
    def what(self) -> str:
        """What they are, in a message."""
        return self.of.what

    @property
    def stamped(self) -> bool:
        """At their own stamps, not at rows of the odometry."""
        return "t" in self.table

    def part(self, rows: IntArray) -> FrameObservations:
        """Some of them, in this order."""
        texts = {q: [fields[i] for i in rows.tolist()] for q, fields in self.texts.items()}
        return replace(self, table=self.table.part(rows), texts=texts, z=self.z[rows], at=self.at[rows])


IDS = ("true_id", "label")
ALONE: dict[str, type[Sensor]] = {"range": Range, "bearing": Bearing}
"""Sensors of one number by its column."""


def read_observations(file: TextTable, of: TableSensor, wanted: Wanted, odometry: Odometry) -> FrameObservations:
    """The observations of a sensor's file: range and bearing, one of them alone, or x and y in the sensor's frame."""
    columns, alone, role, own = wanted.columns, of.alone, of.role, f"{of.name}." if of.name else ""
    polar = alone is not None or columns.find(file, role, "range") is not None
    if not polar and columns.find(file, role, "bearing") is not None:
        what = f"bearings without a range: {file.described()}; name its column, as in --columns {own}range=DIST"
        raise DataError.at(file.path, f"{what}; if there are only bearings, --observation-sigma has one number")
    if not polar and not columns.has(file, role, ("x", "y")):
        what = f"no observations: {file.described()}; range and bearing, or x and y in the sensor's frame, are needed"
        raise DataError.at(file.path, f"{what}; name them as in --columns {own}range=DIST,{own}bearing=ANGLE")
    by_stamp = odometry.stamped and columns.find(file, role, "t") is not None
    key = "t" if by_stamp else "frame"
    if not by_stamp and columns.find(file, role, "frame") is None:
        columns.require(file, role, ("t",) if odometry.stamped else ("frame",))
    values = (alone,) if alone is not None else ("range", "bearing") if polar else ("x", "y")
    table, texts, skipped = columns.table(file, role, (*values, key), texts=(*IDS, *of.looked))
    table = with_looks(file, table, texts)
    shares = role in shared(wanted.files)
    notes = [f"{file.path.name}: {skipped} rows without an observation"] if skipped and not shares else []
    for quantity, flag in LOOKS.items():
        if quantity not in of.looked and columns.find(file, role, quantity) is not None:
            notes.append(f"{file.path.name}: column {quantity} is not used; --{flag} uses it")
    z = np.zeros((len(table), 2))
    z[:, [1] if alone == "bearing" else list(range(len(values)))] = table.stack(values)
    if polar and alone != "bearing":
        table.require(z[:, 0] >= 0.0, "range", "{} is a negative range")
    at = table.columns[key]
    if not by_stamp:
        rows = table.integers("frame", 0)
        last = len(odometry.time) - 1
        table.require(rows <= last, "frame", f"{{}} is out of range; the odometry has rows 0 to {last}")
        at = odometry.time[rows]
    kind = ALONE[alone] if alone is not None else RangeBearing if polar else RelativePoint
    found = FrameObservations(of, table, texts, z, at, kind, tuple(notes))
    back = int((np.diff(at) < 0.0).sum())
    if back:
        notes.append(f"{file.path.name}: {back} observations were stamped before the one above; sorted")
        found = replace(found.part(np.argsort(at, kind="stable").astype(np.int64)), notes=tuple(notes))
    return found


def with_looks(file: TextTable, table: Table, texts: Mapping[str, Sequence[str]]) -> Table:
    """A table with the descriptors and classes among `texts`, blank where unknown."""
    if DESCRIPTOR in texts:
        values = np.full(len(table), np.nan)
        for i, field in enumerate(texts[DESCRIPTOR]):
            if field and field.lower() != "nan":
                try:
                    values[i] = file.number(field)
                except ValueError:
                    raise table.error(
                        i, DESCRIPTOR, f"{field!r} is not a number; leave it blank where unknown"
                    ) from None
        table = replace(table, columns={**table.columns, DESCRIPTOR: values})
    return replace(table, texts={**table.texts, CLASS: texts[CLASS]}) if CLASS in texts else table


def whole(table: Table, fields: list[str], name: str) -> IntArray:
    """Ids: whole numbers, blank for unknown, -1 for false alarms."""
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


def joined(parts: Sequence[FrameObservations], time: Array) -> tuple[Observations, dict[str, IntArray]]:
    """Observations of all sensors by frame, then sensor, and their ids by column; frames are at `time` (N,)."""
    frame = np.concatenate([np.empty(0, np.int64), *(np.searchsorted(time, p.at) for p in parts)]).astype(np.int64)
    number = np.repeat(np.arange(len(parts)), [len(p.at) for p in parts])
    z = np.concatenate([np.empty((0, 2)), *(p.z for p in parts)])
    R = np.concatenate([np.empty((0, 2, 2)), *(np.tile(np.diag(p.of.sigma**2), (len(p.at), 1, 1)) for p in parts)])
    by = np.lexsort((number, frame))
    ids: dict[str, IntArray] = {}
    for name in IDS:
        if any(name in p.texts for p in parts):
            every = [whole(p.table, p.texts.get(name, [""] * len(p.at)), name) for p in parts]
            ids[name] = np.concatenate(every)[by]
    each = [of_observations(p.table, None, [(p.of.name, p.of.looks)]) for p in parts]
    looks = appearance.every(each, [len(p.at) for p in parts])
    sensor = number[by] if len(parts) > 1 else None
    return Observations(
        frame[by], z[by], R[by], sensor=sensor, appearance=None if looks is None else looks.only(by)
    ), ids


def sensor_of(seen: FrameObservations, notes: list[str]) -> Sensor:
    """The sensor, with the stated or observed field of view."""
    kind, of = seen.kind, seen.of
    polar = kind().polar(seen.z)
    reach, view = of.max_range, of.view
    if reach is None and kind is Bearing:
        reach = np.inf
    elif reach is None:
        # a little more, so that the farthest observation is inside whatever the rounding
        reach = 1.001 * float(polar[:, 0].max()) if len(polar) and polar[:, 0].max() > 0.0 else np.inf
        whose = f" of {of.name}" if of.name else ""
        notes.append(
            f"max_range{whose} is {reach:.4g} m, the farthest observation; --max-range states the sensor's own"
        )
    low, high = view or (-np.pi, np.pi)
    back = se2.inverse(of.pose)
    return kind(reach, low, high, float(back[2]), (float(back[0]), float(back[1])), of.name, of.sees)

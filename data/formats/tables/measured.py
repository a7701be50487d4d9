"""Fixes and closures in tables of another program, in SI units: what they measure is in the fields that are filled."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from data.csv_table import Table
from data.errors import DataError, UsageError
from data.formats.tables.files import TextTable, headings
from data.formats.tables.flags import Wanted
from data.formats.tables.motion import Odometry, pose_columns
from data.inputs import IntArray
from data.pose_measurements import Closures, Fixes, FixKind, FixSource
from data.se2 import Array, BoolArray
from data.terminal import counted

SIGMAS = ("sx", "sy", "stheta")
RELATIVE = ("dx", "dy", "dtheta")
FORBIDDEN = set(',"')
"""Characters that a field of fixes.csv cannot hold."""


@dataclass(frozen=True, eq=False)
class Measured:
    """Fixes or closures in the order of their (later) stamps.

    Attributes:
        what: "fixes" or "closures".
        table: their rows, for messages.
        at: (F,) s, as the odometry's; of closures (F, 2).
        stamped: at their own stamps, not at rows of the odometry.
        z, sigma: (F, 3), NaN where not measured.
        source: (F,) row in `names`.
    """

    what: str
    table: Table
    at: Array
    stamped: bool
    z: Array
    sigma: Array
    source: IntArray
    names: tuple[str, ...]

    @property
    def one(self) -> str:
        """One of them, in a message."""
        return "fix" if self.what == "fixes" else "closure"

    def part(self, rows: IntArray) -> Measured:
        """Some of them, in this order."""
        return replace(
            self, table=self.table.part(rows), at=self.at[rows], z=self.z[rows], sigma=self.sigma[rows],
            source=self.source[rows],
        )  # fmt: skip

    @property
    def covariance(self) -> Array:
        """Of z (F, 3, 3), zero where not measured."""
        variance = np.where(np.isnan(self.z), 0.0, self.sigma**2)
        return np.asarray(variance[:, :, None] * np.eye(3))

    def fixes(self, time: Array, lever: tuple[float, float], rotation: float) -> Fixes:
        """As fixes of a log with frames at `time` (N,)."""
        there = ~np.isnan(self.z)
        kind = np.where(there[:, 2], np.where(there[:, 0], FixKind.POSE, FixKind.HEADING), FixKind.POSITION)
        sources = tuple(FixSource(name, lever, rotation) for name in self.names)
        frame = np.searchsorted(time, self.at).astype(np.int64)
        return Fixes(frame, kind, self.source, np.where(there, self.z, 0.0), self.covariance, sources)

    def closures(self, time: Array) -> Closures:
        """As closures of a log with frames at `time` (N,)."""
        frame = np.searchsorted(time, self.at).astype(np.int64)
        return Closures(frame[:, 0], frame[:, 1], self.z, self.covariance, self.source, self.names)


def read_fixes(file: TextTable, wanted: Wanted, odometry: Odometry, notes: list[str]) -> Measured:
    """The fixes of a file: of each row the position (x, y), the heading, or both."""
    columns, role = wanted.columns, "fixes"
    key = "t" if odometry.stamped and columns.find(file, role, "t") is not None else "frame"
    if key == "frame" and columns.find(file, role, "frame") is None:
        columns.require(file, role, ("t" if odometry.stamped else "frame",))
    pose = pose_columns(file, columns, role)
    position = [q for q in ("x", "y") if columns.find(file, role, q) is not None]
    heading = [q for q in pose[2:] if columns.find(file, role, q) is not None]
    if len(position) == 1 or not (position or heading):
        what = f"no fixes: {file.described()}; x and y, or a heading theta, or both are needed"
        raise DataError.at(file.path, f"{what}; name them as in --columns fixes.x=EAST,fixes.y=NORTH")
    sigmas = [q for q in SIGMAS if columns.find(file, role, q) is not None]
    values = (*position, *heading)
    table, texts, _ = columns.table(
        file, role, (key, *values), optional=sigmas, texts=("source",), may_be_blank=(*values, *sigmas)
    )
    z = np.full((len(table), 3), np.nan)
    z[:, :2] = table.stack(position) if position else np.nan
    if heading:
        z[:, 2] = headings(table.columns)
    half = np.isnan(z[:, 0]) != np.isnan(z[:, 1])
    if half.any():
        row = int(np.argmax(half))
        raise table.error(row, "y" if np.isnan(z[row, 1]) else "x", "blank; both x and y, or neither, are needed")
    at = table.columns["t"] if key == "t" else odometry.time[_rows(table, key, odometry)]
    found = _measured(role, table, texts.get("source"), file.path, at, key == "t", z, wanted.fix_sigma)
    filled = ~np.isnan(z).all(axis=1)
    if not filled.all():
        notes.append(f"{file.path.name}: {counted(int((~filled).sum()), 'row')} without a fix")
    order = np.argsort(at, kind="stable")
    return found.part(order[filled[order]].astype(np.int64))


def read_closures(file: TextTable, wanted: Wanted, odometry: Odometry) -> Measured:
    """The closures of a file, by their later end."""
    columns, role = wanted.columns, "closures"
    stamped = odometry.stamped and columns.find(file, role, "t1") is not None
    ends = ("t1", "t2") if stamped else ("frame1", "frame2")
    if odometry.stamped and not stamped and columns.find(file, role, "frame1") is None:
        columns.require(file, role, ("t1",))
    sigmas = [q for q in SIGMAS if columns.find(file, role, q) is not None]
    table, texts, _ = columns.table(
        file, role, (*ends, *RELATIVE), optional=sigmas, texts=("source",), may_be_blank=sigmas
    )
    at = np.stack([table.columns[e] if stamped else odometry.time[_rows(table, e, odometry)] for e in ends], axis=-1)
    table.require(at[:, 0] != at[:, 1], ends[1], f"{{}} is {ends[0]}, too; two frames are needed")
    z = table.stack(RELATIVE)
    found = _measured(role, table, texts.get("source"), file.path, at, stamped, z, wanted.closure_sigma)
    return found.part(np.argsort(at.max(axis=1), kind="stable").astype(np.int64))


def _rows(table: Table, key: str, odometry: Odometry) -> IntArray:
    """Rows of the odometry."""
    rows, last = table.integers(key, 0), len(odometry.time) - 1
    table.require(rows <= last, key, f"{{}} is out of range; the odometry has rows 0 to {last}")
    return rows


def _measured(
    role: str, table: Table, source: Sequence[str] | None, path: Path, at: Array, stamped: bool, z: Array,
    default: Array | None,
) -> Measured:  # fmt: skip
    """With the sigma of each row, else the stated one, and the sources by name: that of the column, else the file."""
    sigma = np.tile(np.full(3, np.nan) if default is None else default, (len(z), 1))
    for k, name in enumerate(SIGMAS):
        if name in table:
            own = table.columns[name]
            table.require(np.isnan(own) | (own > 0.0), name, "{} is no standard deviation > 0")
            sigma[:, k] = np.where(np.isnan(own), sigma[:, k], own)
    lacking: BoolArray = np.asarray((np.isnan(sigma) & ~np.isnan(z)).any(axis=1))
    if lacking.any():
        flag, what = (
            ("fix", "SX,SY (m), STHETA (rad), or all three") if role == "fixes" else ("closure", "SX,SY,STHETA")
        )
        first = table.error(int(np.argmax(lacking)), None, f"unknown noise of this {flag}")
        raise UsageError(f"{first}; --{flag}-sigma {what}, or columns {', '.join(SIGMAS)} are needed")
    stem = path.stem if path.stem and path.stem.isprintable() and not FORBIDDEN & set(path.stem) else role
    given = [name or stem for name in source] if source is not None else [stem] * len(z)
    names = tuple(dict.fromkeys(given)) or (stem,)
    for row, name in enumerate(given):
        if FORBIDDEN & set(name) or not name.isprintable():
            raise table.error(row, "source", f"{name!r} holds a comma or a quote; a plain name is needed")
    number = {name: k for k, name in enumerate(names)}
    return Measured(role, table, at, stamped, z, sigma, np.array([number[n] for n in given], np.int64), names)

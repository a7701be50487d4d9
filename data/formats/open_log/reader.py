"""Open log folder, formats 1 and 2: reader with strict checks.

    log.toml            see `data.columns.header`
    *.csv               see `data.columns.parts`
    scans.npz           range scans (see `data.columns.scans`)
    relations.csv       row1,row2,x,y,theta[,exact][,stamp1,stamp2][,c_xx,c_xy,c_xt,c_yy,c_yt,c_tt]         optional

observations.csv and [sensor] may be missing where there are scans, fixes or closures. relations.csv: reference
relations for scoring without a true path. x,y,theta: pose of frame row2 in that of frame row1 [m, m, rad], rows from 0;
exact: 1 where both rows are certain, else 0; stamps [s] of the reference.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from data.columns.header import FORMAT, HEADER, LATEST, Header, read_header
from data.columns.named import COVARIANCE, UPPER, require_semidefinite
from data.columns.parts import (
    CLOSURES,
    FIXES,
    FRAMES,
    LANDMARKS,
    OBSERVATIONS,
    ODOMETRY,
    STAMP,
    TRUTH,
    columns_of,
    parts_of,
)
from data.columns.poses import CLOSURE, FIX, POSE, by_name
from data.columns.scans import read_scans
from data.csv_table import bytes_of, is_number, lines_of, read_table
from data.errors import DataError
from data.inputs import Scans
from data.log import Log
from data.motion.motion_prior import note_of
from data.se2 import Array
from data.truth import Relations

ROWS, STAMPS, EXACT = ("row1", "row2"), ("stamp1", "stamp2"), "exact"
SCANS, RELATIONS = "scans.npz", "relations.csv"
FILES = (HEADER, FRAMES, ODOMETRY, OBSERVATIONS, TRUTH, LANDMARKS, SCANS, RELATIONS, FIXES, CLOSURES)


def read_relations(path: Path, frames: int, frame_stamp: Array | None = None) -> Relations:
    """Relations between the frames of a log of so many; `frame_stamp` (N,): its recorded stamps.

    Also as the SLAM benchmark of Kuemmerle et al. (2009) publishes them, without a header: two stamps, then x y z roll
    pitch yaw. Rows are then those of the nearest stamps; of none within `NEAR` the relation is left out.
    """
    if (published := _published(path)) is not None:
        if frame_stamp is None:
            raise DataError.at(path, "relations by stamps; a log whose frames have recorded stamps is needed")
        order = np.argsort(frame_stamp, kind="stable")
        known = frame_stamp[order]
        after = np.clip(np.searchsorted(known, published[:, :2]), 1, max(len(known) - 1, 1))
        place = after - (published[:, :2] - known[after - 1] <= known[after] - published[:, :2])
        off = np.abs(known[place] - published[:, :2]).max(axis=1)
        near = off <= NEAR
        if not near.any():
            spans = [f"{a.min():.15g} to {a.max():.15g} s" for a in (published[:, :2], known)]
            raise DataError.at(path, f"stamps {spans[0]}, of the log {spans[1]}: no relation lies within it")
        rows = order[place[near]].astype(np.int64)
        found, exact = published[near], (off[near] <= SAME).astype(np.int64)
        return Relations(rows[:, 0], rows[:, 1], found[:, [2, 3, 7]], exact, found[:, :2], frame_stamp)
    table = read_table(path, (*ROWS, *POSE), (EXACT, *STAMPS, *COVARIANCE))
    row1, row2 = (table.integers(name, 0) for name in ROWS)
    for name, rows in zip(ROWS, (row1, row2), strict=True):
        table.require(rows < frames, name, f"{{}} is not a row of the log; it has frames 0 to {frames - 1}")
    table.require_finite(POSE)
    exact = stamp = covariance = None
    if EXACT in table:
        values = table.columns[EXACT]
        table.require((values == 0.0) | (values == 1.0), EXACT, "{} is neither 0 nor 1")
        exact = values.astype(np.int64)
    if table.together(STAMPS):
        table.require_finite(STAMPS)
        stamp = table.stack(STAMPS)
    if table.together(COVARIANCE):
        table.require_finite(COVARIANCE)
        covariance = table.symmetric(COVARIANCE)
        require_semidefinite(table, covariance)
    return Relations(row1, row2, table.stack(POSE), exact, stamp, frame_stamp, covariance)


NEAR, SAME = 0.1, 1e-6
"""s, largest distance of a relation's stamps from those of its frames, and of one that is exact."""


def _published(path: Path) -> Array | None:
    """Rows (K, 8) of a file of numbers alone, eight a line; None: it is none."""
    fields = [line.split() for line in lines_of(bytes_of(path, missing="no such file")) if line.strip()]
    if not fields or any(len(f) != 8 or not all(map(is_number, f)) for f in fields):
        return None
    rows = np.array([list(map(float, f)) for f in fields])
    return rows if np.isfinite(rows).all() else None


def relations_to_write(r: Relations) -> dict[str, Sequence[Any]]:
    """Columns by name, as `read_relations` reads them."""
    columns = {"row1": r.row1.tolist(), "row2": r.row2.tolist()} | by_name(POSE, r.relative)
    columns |= {} if r.exact is None else {EXACT: r.exact.tolist()}
    columns |= {} if r.stamp is None else by_name(STAMPS, r.stamp)
    return columns | ({} if r.covariance is None else by_name(COVARIANCE, r.covariance[:, *UPPER]))


def load_folder(path: str | PathLike[str], relations: Path | None = None) -> Log:
    """Read an open log folder; `relations`: a file instead of its relations.csv.

    Observations outside the sensor's stated field of view are kept. The covariance floor is applied here.

    Raises DataError with file, line, column and value.
    """
    folder = Path(path)
    if not os.path.isdir(folder):  # unlike Path.is_dir, also false for a name the system refuses
        raise DataError.at(folder, "not a folder" if os.path.exists(folder) else "no such folder")
    header = read_header(folder / HEADER)
    there = {name for name in FILES if (folder / name).exists()}
    _check(folder, header, there)
    columns = columns_of(header, "t" if ODOMETRY in there else "frame")
    if not there & {FIXES, CLOSURES} and header.scanner is None:
        there.add(OBSERVATIONS)  # it is needed then
    tables = {name: read_table(folder / name, *of) for name, of in columns.items() if name in there}
    parts = parts_of(header, tables)
    scans = _scans(folder, header, there, len(parts.recorded))
    truth, reference = parts.truth, folder / RELATIONS if relations is None else relations
    if relations is not None or RELATIONS in there:
        stamp = tables[FRAMES].columns.get(STAMP) if FRAMES in tables else None
        truth = replace(truth, relations=read_relations(reference, len(parts.recorded), stamp))
    prior = () if header.motion_prior is None else (note_of(header.motion_prior),)
    return Log(
        header.name, replace(parts.recorded, scans=scans), truth, label=parts.label, source=header.source,
        labels_are_sensed=header.labels_are_sensed, notes=(*header.notes, *prior, *parts.notes), origins=header.origins,
    )  # fmt: skip


def _check(folder: Path, header: Header, there: set[str]) -> None:
    """DataError unless the files that are there, and the header, go together."""
    if ODOMETRY in there and FRAMES in there:
        raise DataError.at(folder / ODOMETRY, f"there is {FRAMES} as well; remove one of them")
    if ODOMETRY not in there and FRAMES not in there:
        raise DataError.at(folder / FRAMES, f"no such file; {FRAMES} or {ODOMETRY} is needed")
    if ODOMETRY in there and header.motion_prior is not None:
        raise DataError.at(folder / ODOMETRY, f"{HEADER} states a [motion] prior instead; remove one of them")
    if ODOMETRY in there and header.motion is None:
        raise DataError.at(folder / HEADER, f"no [motion] table; {ODOMETRY} needs one")
    for name, table, sources in ((FIXES, FIX, header.fixes), (CLOSURES, CLOSURE, header.closures)):
        if name in there and header.format == FORMAT:
            what = f"in a folder of format {header.format}; format = {LATEST} in {HEADER} is needed"
            raise DataError.at(folder / name, what)
        if sources and name not in there:
            raise DataError.at(folder / name, f"no such file; [[{table}]] of {HEADER} needs it")
    if not header.sensors and (OBSERVATIONS in there or not there & {FIXES, CLOSURES}):
        needed = f"{OBSERVATIONS} needs one" if OBSERVATIONS in there else f"one, {FIXES} or {CLOSURES} is needed"
        raise DataError.at(folder / HEADER, f"no [sensor] table; {needed}")


def _scans(folder: Path, header: Header, there: set[str], frames: int) -> Scans | None:
    """scans.npz, which needs [scanner] and frames.csv."""
    if header.scanner is None:
        if SCANS in there:
            raise DataError.at(folder / HEADER, f"no [scanner] table; {SCANS} needs one")
        return None
    if ODOMETRY in there:
        raise DataError.at(folder / SCANS, f"scans belong to frames; {FRAMES} is needed instead of {ODOMETRY}")
    return read_scans(folder / SCANS, header.scanner, frames)

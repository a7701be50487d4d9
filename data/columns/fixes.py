"""`fixes.csv` of an open log folder: absolute measurements of the pose, such as GPS, a compass, or motion capture.

    frame,kind[,source][,x][,y][,theta][,c_xx,c_xy,c_xt,c_yy,c_yt,c_tt][,true_inlier]     ascending by frame

With odometry.csv: t [s] instead of frame; the instants of fixes are frames, too. kind: position (x, y), heading (theta)
or pose (x, y, theta), in the world frame [m, rad]; what a row does not measure is blank. Covariance: of the measured
entries; all of them blank: the sigma of the source. source: the name of a [[fix]] in log.toml, blank for the first.
true_inlier: 1, or 0 for an outlier, blank unknown (for scoring alone).

    [[fix]]
    name = "gps"            a source measures p + R(theta) lever and theta + rotation
    lever = [0.3, 0.0]      m, its place in the body frame
    rotation = 0.0          rad, its direction in the body frame
    sigma = [0.5, 0.5]      of x, y [m]; one number: of theta [rad]; three: of x, y, theta
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from data.columns.named import (
    COVARIANCE,
    INLIER,
    SOURCE,
    column,
    inliers,
    names_of,
    require_definite,
    shown_inliers,
    source_rows,
)
from data.csv_table import Table, read_table
from data.errors import unknown
from data.inputs import IntArray
from data.pose_measurements import MEASURED, Fixes, FixKind, FixSource
from data.se2 import Array, BoolArray
from data.toml_table import TomlTable, finite, positive

TABLE, FILE = "fix", "fixes.csv"
KEYS = ("name", "lever", "rotation", "sigma")
KIND = "kind"
KINDS = {kind.name.lower(): kind for kind in FixKind}
POSE = ("x", "y", "theta")
OF_SIGMA = {1: (2,), 2: (0, 1), 3: (0, 1, 2)}
"""Entries of (x, y, theta) that a sigma of so many numbers is of."""
MEASURES: BoolArray = np.array([[entry in MEASURED[kind] for entry in range(3)] for kind in FixKind])
"""Whether a kind (3,) measures x, y, theta (3,)."""
UPPER = np.triu_indices(3)


class Stated(NamedTuple):
    """A [[fix]]: source, and sigma (3,) of x, y, theta, NaN where not stated."""

    source: FixSource
    sigma: Array


def stated(tables: Sequence[TomlTable]) -> tuple[Stated, ...]:
    """The sources that `log.toml` states."""
    return tuple(_source(name, table) for name, table in zip(names_of(tables), tables, strict=True))


def _source(name: str, table: TomlTable) -> Stated:
    lever = (0.0, 0.0)
    if "lever" in table:
        x, y = table.numbers("lever", 2, "two numbers x, y [m] are", finite).tolist()
        lever = (x, y)
    rotation = table.number("rotation", 0.0, "a finite angle (radians)", finite)
    sigma = np.full(3, np.nan)
    if "sigma" in table:
        given = table.numbers("sigma", None, "numbers > 0 (x, y [m], theta [rad]) are", positive)
        if len(given) not in OF_SIGMA:
            raise table.error("sigma", "one number (theta), two (x, y) or three (x, y, theta) are needed")
        sigma[list(OF_SIGMA[len(given)])] = given
    return Stated(FixSource(name, lever, rotation), sigma)


class FixTable(NamedTuple):
    """Fixes without frames: kind, source (F,), z (F, 3), covariance (F, 3, 3), true inliers (F,) or None."""

    table: Table
    kind: IntArray
    source: IntArray
    z: Array
    covariance: Array
    inlier: IntArray | None
    sources: tuple[FixSource, ...]

    def at(self, frame: IntArray) -> Fixes:
        """The fixes of frames (F,), ascending."""
        return Fixes(frame, self.kind, self.source, self.z, self.covariance, self.sources)


def read_fixes(path: Path, sources: Sequence[Stated], key: str) -> FixTable:
    """fixes.csv, checked except for range and order of `key` (frame or t)."""
    numbers = (*POSE, *COVARIANCE, INLIER)
    table = read_table(path, (key, KIND), (SOURCE, *numbers), may_be_blank=(*numbers, SOURCE), words=(KIND, SOURCE))
    return fixes_of(table, sources, key)


def fixes_of(table: Table, sources: Sequence[Stated], key: str) -> FixTable:
    """Fixes of a table with the columns of fixes.csv, checked except for range and order of `key`."""
    table.require_finite((key,))
    table.require_finite([n for n in (*POSE, *COVARIANCE) if n in table], blank=True)
    for row, name in enumerate(table.texts[KIND]):
        if name not in KINDS:
            raise table.error(row, KIND, f"{name!r} is {unknown(name, KINDS)}")
    kind = np.array([KINDS[name] for name in table.texts[KIND]], np.int64)
    stated_by = sources or (Stated(FixSource(TABLE), np.full(3, np.nan)),)
    source = source_rows(table, [s.source.name for s in sources], TABLE)
    values = np.stack([column(table, name) for name in POSE], axis=-1)
    entries = np.stack([column(table, name) for name in COVARIANCE], axis=-1)
    sigma = np.array([s.sigma for s in stated_by])[source]
    measured = MEASURES[kind]
    _require(table, POSE, ~np.isnan(values), measured)
    own: BoolArray = np.asarray(~np.isnan(entries).all(axis=1))
    _require(table, COVARIANCE, ~np.isnan(entries), measured[:, UPPER[0]] & measured[:, UPPER[1]], own)
    lacking = (measured & np.isnan(sigma)).any(axis=1) & ~own
    if lacking.any():
        row = int(np.argmax(lacking))
        what = f"no covariance, and no sigma of it in [[{TABLE}]] {stated_by[source[row]].source.name!r} of log.toml"
        name = POSE[int(np.argmax(measured[row]))]
        raise table.error(row, name, f"{what}; one of them is needed")
    P = np.zeros((len(table), 3, 3))
    P[:, UPPER[0], UPPER[1]] = P[:, UPPER[1], UPPER[0]] = np.where(np.isnan(entries), 0.0, entries)
    diagonal = np.where(measured, np.square(np.where(np.isnan(sigma), 0.0, sigma)), 0.0)
    P[~own] = diagonal[~own, :, None] * np.eye(3)
    for k, of in MEASURED.items():
        rows = np.flatnonzero(kind == k)
        require_definite(table, rows, P[rows][:, of][:, :, of])
    z = np.where(np.isnan(values), 0.0, values)
    return FixTable(table, kind, source, z, P, inliers(table), tuple(s.source for s in stated_by))


def _require(
    table: Table, names: Sequence[str], given: BoolArray, wanted: BoolArray,
    rows: BoolArray | None = None,
) -> None:  # fmt: skip
    """Raise unless exactly the `wanted` (K, n) fields of columns are given; `rows` (K,): only there."""
    wrong = (given != wanted) if rows is None else (given != wanted) & rows[:, None]
    if wrong.any():
        row, k = np.argwhere(wrong)[0].tolist()
        kind = table.texts[KIND][row]
        what = f"blank, but {kind} measures it; a number is needed"
        if given[row, k]:
            what = f"a value, but {kind} does not measure it; leave the field blank"
        raise table.error(row, names[k], what)


def fixes_columns(fixes: Fixes, inlier: IntArray | None, key: str, at: Sequence[Any]) -> dict[str, Sequence[Any]]:
    """Columns by name, as `read_fixes` reads them, with the values (F,) of `key`."""
    measured = MEASURES[fixes.kind]
    columns: dict[str, Sequence[Any]] = {key: at, KIND: [FixKind(k).name.lower() for k in fixes.kind.tolist()]}
    if len(fixes.sources) > 1:
        columns[SOURCE] = [fixes.sources[k].name for k in fixes.source.tolist()]
    for entry, name in enumerate(POSE):
        columns[name] = _or_blank(fixes.z[:, entry], measured[:, entry])
    for i, j, name in zip(*UPPER, COVARIANCE, strict=True):
        columns[name] = _or_blank(fixes.covariance[:, i, j], measured[:, i] & measured[:, j])
    if inlier is not None:
        columns[INLIER] = shown_inliers(inlier)
    return columns


def _or_blank(values: Array, there: BoolArray) -> list[Any]:
    return [v if is_there else "" for v, is_there in zip(values.tolist(), there.tolist(), strict=True)]


def tables_to_write(fixes: Fixes) -> list[dict[str, Any]]:
    """The tables [[fix]]; covariances are in fixes.csv."""
    return [{"name": s.name, "lever": s.lever, "rotation": s.rotation} for s in fixes.sources]

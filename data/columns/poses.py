"""Measured poses of an open log folder, absolute and of frame2 in frame1's (docs/notes/several-sensors.md)."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from data.columns.named import COVARIANCE, UPPER, covariances, names_of, or_blank, require_given, source_rows
from data.csv_table import Table
from data.errors import unknown
from data.inputs import IntArray
from data.pose_measurements import MEASURED, Closures, Fixes, FixKind, FixSource
from data.se2 import Array, BoolArray
from data.toml_table import TomlTable, finite, positive

FIX, CLOSURE = "fix", "closure"
KEYS = {FIX: ("name", "lever", "rotation", "sigma"), CLOSURE: ("name", "sigma")}  # Tables of log.toml, and their keys
SOURCE, INLIER, KIND = "source", "true_inlier", "kind"
POSE, RELATIVE = ("x", "y", "theta"), ("dx", "dy", "dtheta")
ENDS = {"frame": ("frame1", "frame2"), "t": ("t1", "t2")}  # The two ends of closures by the key of observations.csv
KINDS = {kind.name.lower(): kind for kind in FixKind}
OF_SIGMA = {1: (2,), 2: (0, 1), 3: (0, 1, 2)}  # Entries of (x, y, theta) that a sigma of so many numbers is of
MEASURES: BoolArray = np.array([[entry in MEASURED[kind] for entry in range(3)] for kind in FixKind])
"""Whether a kind (3,) measures x, y, theta (3,)."""
UNSTATED = -1  # Of an inlier that is blank


class Stated(NamedTuple):
    """A [[fix]] or [[closure]]: source, of which a closure has the name, and sigma (3,), NaN where not stated."""

    source: FixSource
    sigma: Array


def stated(top: TomlTable, key: str) -> tuple[Stated, ...]:
    """The sources that the tables [[key]] of log.toml state."""
    tables = top.tables_of(key)
    return tuple(_source(name, table, key) for name, table in zip(names_of(tables), tables, strict=True))


def _source(name: str, table: TomlTable, key: str) -> Stated:
    x, y = table.numbers("lever", 2, "two numbers x, y [m] are", finite).tolist() if "lever" in table else (0.0, 0.0)
    rotation = table.number("rotation", 0.0, "a finite angle (radians)", finite)
    sigma = np.full(3, np.nan)
    if "sigma" in table:
        what = "numbers > 0 (x, y [m], theta [rad]) are" if key == FIX else "three numbers > 0 [m, m, rad] are"
        given = table.numbers("sigma", None if key == FIX else 3, what, positive)
        if len(given) not in OF_SIGMA:
            raise table.error("sigma", "one number (theta), two (x, y) or three (x, y, theta) are needed")
        sigma[list(OF_SIGMA[len(given)])] = given
    return Stated(FixSource(name, (x, y), rotation), sigma)


def fixes_of(table: Table, sources: Sequence[Stated], frame: IntArray) -> tuple[Fixes, IntArray | None]:
    """The fixes of frames (F,), ascending, by the rows of fixes.csv, and which are true inliers."""
    table.require_finite([n for n in (*POSE, *COVARIANCE) if n in table], blank=True)
    for row, name in enumerate(table.texts[KIND]):
        if name not in KINDS:
            raise table.error(row, KIND, f"{name!r} is {unknown(name, KINDS)}")
    kind = np.array([KINDS[name] for name in table.texts[KIND]], np.int64)
    z, measured = np.stack([table.get(name) for name in POSE], axis=-1), MEASURES[kind]
    require_given(table, POSE, z, measured, lambda row: table.texts[KIND][row])
    source = source_rows(table, [s.source.name for s in sources], FIX)
    sources = sources or (Stated(FixSource(FIX), np.full(3, np.nan)),)
    P = _covariances(table, measured, source, sources, FIX)
    return Fixes(frame, kind, source, np.nan_to_num(z), P, tuple(s.source for s in sources)), _inliers(table)


def closures_of(
    table: Table, sources: Sequence[Stated], frames: Sequence[IntArray], ends: tuple[str, str]
) -> tuple[Closures, IntArray | None]:
    """The closures between frames (K,) of both ends, by their later one, and which are true inliers."""
    table.require_finite(RELATIVE)
    if table.together(COVARIANCE):
        table.require_finite(COVARIANCE)
    source = source_rows(table, [s.source.name for s in sources], CLOSURE)
    sources = sources or (Stated(FixSource(CLOSURE), np.full(3, np.nan)),)
    P = _covariances(table, np.ones((len(table), 3), bool), source, sources, CLOSURE)
    table.require(frames[0] != frames[1], ends[1], f"{{}} is {ends[0]}, too; two frames are needed")
    by, inlier = np.argsort(np.maximum(*frames), kind="stable"), _inliers(table)
    names = tuple(s.source.name for s in sources)
    closures = Closures(frames[0][by], frames[1][by], table.stack(RELATIVE)[by], P[by], source[by], names)
    return closures, None if inlier is None else inlier[by]


def _covariances(table: Table, measured: BoolArray, source: IntArray, sources: Sequence[Stated], key: str) -> Array:
    """Covariances (K, 3, 3) of the `measured` entries (K, 3): the row's own, else by its source."""
    sigma = np.array([s.sigma for s in sources])[source]
    kind, place = table.texts.get(KIND), [f"[[{key}]] {s.source.name!r}" for s in sources]
    return covariances(
        table, COVARIANCE, measured, sigma, lambda row: CLOSURE if kind is None else kind[row],
        lambda row: place[source[row]],
    )  # fmt: skip


def _inliers(table: Table) -> IntArray | None:
    """Column true_inlier (K,): 1, 0, or `UNSTATED` where blank; None without it."""
    if INLIER not in table:
        return None
    values = table.columns[INLIER]
    table.require(np.isnan(values) | (values == 0.0) | (values == 1.0), INLIER, "{} is neither 0 nor 1 nor blank")
    return np.nan_to_num(values, nan=UNSTATED).astype(np.int64)


# What is read, as columns to write.


def fixes_to_write(fixes: Fixes, inlier: IntArray | None) -> dict[str, Sequence[Any]]:
    """Columns by name, but for that of the frame."""
    measured = MEASURES[fixes.kind]
    columns: dict[str, Sequence[Any]] = {KIND: [FixKind(k).name.lower() for k in fixes.kind.tolist()]}
    if len(fixes.sources) > 1:
        columns[SOURCE] = [fixes.sources[k].name for k in fixes.source.tolist()]
    columns |= dict(zip(POSE, or_blank(fixes.z.T, measured.T), strict=True))
    both = measured[:, UPPER[0]] & measured[:, UPPER[1]]
    columns |= dict(zip(COVARIANCE, or_blank(fixes.covariance[:, *UPPER].T, both.T), strict=True))
    return columns | inliers_to_write(inlier)


def by_name(names: Sequence[str], values: Array) -> dict[str, Sequence[Any]]:
    """Columns of an array (K, n) under n names."""
    return dict(zip(names, values.T.tolist(), strict=True))


def inliers_to_write(inlier: IntArray | None) -> dict[str, Sequence[Any]]:
    """The column, blank where it is not stated."""
    return {} if inlier is None else {INLIER: or_blank(inlier, inlier != UNSTATED)}

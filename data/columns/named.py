"""Named sources in `log.toml`, columns that name them, and covariances of measured poses: what fixes.csv and
closures.csv of an open log folder have in common.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from data.csv_table import Table
from data.errors import unknown
from data.inputs import IntArray
from data.se2 import Array, BoolArray
from data.toml_table import TomlTable

SOURCE, INLIER = "source", "true_inlier"
COVARIANCE = ("c_xx", "c_xy", "c_xt", "c_yy", "c_yt", "c_tt")
UNSTATED = -1
"""Of an inlier that is blank."""
LEAST = 1e-12
"""Least eigenvalue of a correlation matrix."""


def is_name(word: str) -> bool:
    """Whether a field of a CSV can hold a word."""
    return bool(word) and word == word.strip() and word.isprintable() and not set(word) & set(',"')


def names_of(tables: Sequence[TomlTable]) -> list[str]:
    """The name of each table, different from each other."""
    names: list[str] = []
    for table in tables:
        name = table.text("name")
        if not is_name(name):
            raise table.error("name", "a name without commas, quotes and outer spaces is needed")
        if name in names:
            raise table.error("name", "the name of two tables; each needs its own")
        names.append(name)
    return names


def source_rows(table: Table, names: Sequence[str], key: str, column: str = SOURCE) -> IntArray:
    """Row (K,) in `names` of the source of each row, 0 where blank; `key`: of the tables [[key]] that state them."""
    given = table.texts.get(column)
    if given is None:
        return np.zeros(len(table), np.int64)
    row = {"": 0, **{name: k for k, name in enumerate(names)}}
    for k, name in enumerate(given):
        if name not in row:
            known = unknown(name, names) if any(names) else f"stated nowhere; a table [[{key}]] in log.toml is needed"
            raise table.error(k, column, f"{name!r} is {known}")
    return np.array([row[name] for name in given], np.int64)


def inliers(table: Table) -> IntArray | None:
    """Column true_inlier (K,): 1, 0, or `UNSTATED` where blank; None without it."""
    if INLIER not in table:
        return None
    values = table.columns[INLIER]
    blank = np.isnan(values)
    table.require(blank | (values == 0.0) | (values == 1.0), INLIER, "{} is neither 0 nor 1 nor blank")
    return np.where(blank, UNSTATED, np.where(blank, 0.0, values)).astype(np.int64)


def column(table: Table, name: str) -> Array:
    """A column (K,), blank where the table has none."""
    return table.columns[name] if name in table else np.full(len(table), np.nan)


def definite(P: Array) -> BoolArray:
    """Whether covariances (k, d, d) are positive definite (k,), whatever their units."""
    variance = np.diagonal(P, axis1=1, axis2=2)
    fine: BoolArray = np.asarray((variance > 0.0).all(axis=1))
    sigma = np.sqrt(np.where(fine[:, None], variance, 1.0))
    correlation = np.where(fine[:, None, None], P / sigma[:, :, None] / sigma[:, None, :], np.eye(P.shape[-1]))
    return np.asarray(fine & (np.linalg.eigvalsh(correlation)[:, 0] > LEAST))


def require_definite(table: Table, rows: IntArray, P: Array) -> None:
    """Raise at the first row whose covariance (k, d, d) is not positive definite, whatever its units."""
    fine = definite(P)
    if not fine.all():
        k = int(np.argmin(fine))
        low = float(np.linalg.eigvalsh(P[k])[0])
        what = f"the covariance is not positive definite: smallest eigenvalue {low:.6g}"
        raise table.error(int(rows[k]), f"{COVARIANCE[0]} to {COVARIANCE[-1]}", what)


def shown_inliers(inlier: IntArray) -> list[Any]:
    """A column true_inlier."""
    return ["" if i == UNSTATED else i for i in inlier.tolist()]

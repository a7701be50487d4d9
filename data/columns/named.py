"""Names in `log.toml` and the columns that hold them; covariances of poses in columns."""

from __future__ import annotations

import re
from collections.abc import Collection, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from data.csv_table import Table, is_name
from data.errors import unknown
from data.inputs import IntArray
from data.se2 import Array, BoolArray
from data.toml_table import TomlTable

COVARIANCE = ("c_xx", "c_xy", "c_xt", "c_yy", "c_yt", "c_tt")
ENTRIES = f"{COVARIANCE[0]} to {COVARIANCE[-1]}"
UPPER = np.triu_indices(3)
SHOWN = 8
"""Most names of columns in a note."""
LEAST = 1e-12
"""Least eigenvalue of a correlation matrix."""


LENGTH = {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "km": 1e3, "ft": 0.3048, "in": 0.0254}
"""m, of units."""
STAMP = ("t", "time", "times", "timestamp", "timestamps", "stamp")
YAW = ("theta", "yaw", "heading", "psi", "th")
LANDMARK = ("landmark", "lm", "id", "tag", "marker", "beacon", "cone", "barcode", "subject", "feature", "anchor")
MEANT = {
    "true_id": ("gt", "true", "truth"), "label": LANDMARK, "id": LANDMARK, "theta": YAW,
    "class": ("type", "category", "kind", "colour", "color"), "descriptor": ("diameter", "size", "width"),
    "sx": ("sigma", "std", "stddev", "var", "cov", "covariance"), "source": ("sensor", "provider"),
}  # fmt: skip
"""Words in the name of a column that is likely that quantity."""


def unused(names: Sequence[str], quantities: Collection[str]) -> str:
    """Columns that nothing uses, each with the one of the quantities that it likely is."""
    said = []
    for name in names:
        words = set(re.split(r"[^a-z]+", re.sub(r"(?<=[a-z])(?=[A-Z])", "_", name).lower()))
        likely = next((q for q, meant in MEANT.items() if q in quantities and words & set(meant)), "")
        said.append(f"{name} ({likely}={name}?)" if likely else name)
    more = [f"and {len(said) - SHOWN} more"] * (len(said) > SHOWN)
    return f"{'column' if len(said) == 1 else 'columns'} not used: {', '.join([*said[:SHOWN], *more])}"


def or_blank(values: NDArray[Any], there: BoolArray) -> list[Any]:
    """Values (K, ...) to write, empty where there is none."""
    written: list[Any] = np.where(there, values.astype(object), "").tolist()
    return written


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


def source_rows(table: Table, names: Sequence[str], key: str, column: str = "source") -> IntArray:
    """Row (K,) in `names` of the source of each row, 0 where blank; `key`: of the tables [[key]] that state them."""
    given = table.texts.get(column, [""] * len(table))
    row = {"": 0, **{name: k for k, name in enumerate(names)}}
    for k, name in enumerate(given):
        if name not in row:
            known = unknown(name, names) if any(names) else f"stated nowhere; a table [[{key}]] in log.toml is needed"
            raise table.error(k, column, f"{name!r} is {known}")
    return np.array([row[name] for name in given], np.int64)


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
        raise table.error(int(rows[k]), ENTRIES, what)


def require_semidefinite(table: Table, matrices: Array) -> None:
    """Raise unless each covariance (K, 3, 3) is positive semidefinite, to 1e-12 of its trace."""
    eigenvalues = np.linalg.eigvalsh(matrices)
    fine = eigenvalues[:, 0] >= -1e-12 * eigenvalues.sum(axis=1)
    if not fine.all():
        row = int(np.argmin(fine))
        low, trace = eigenvalues[row, 0], eigenvalues[row].sum()
        what = f"the covariance is not positive semidefinite: smallest eigenvalue {low:.6g}, trace {trace:.6g}"
        raise table.error(row, ENTRIES, what)

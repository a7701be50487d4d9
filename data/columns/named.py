"""Names in `log.toml` and the columns that hold them; covariances of poses in columns."""

import re
from collections.abc import Callable, Collection, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from data.csv_table import Table, is_name, symmetric
from data.errors import unknown
from data.inputs import IntArray
from data.se2 import Array, BoolArray
from data.toml_table import TomlTable

COVARIANCE = ("c_xx", "c_xy", "c_xt", "c_yy", "c_yt", "c_tt")
ENTRIES = f"{COVARIANCE[0]} to {COVARIANCE[-1]}"
UPPER = np.triu_indices(3)
SHOWN = 8  # Most names of columns in a note
LEAST = 1e-12  # Least eigenvalue of a correlation matrix


LENGTH = {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "km": 1e3, "ft": 0.3048, "in": 0.0254, "yd": 0.9144}  # m, of units
STAMP = ("t", "time", "times", "timestamp", "timestamps", "stamp", "stamps", "datetime")
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


def is_stamp(name: str) -> bool:
    """Whether a word in the name of a column is one of a stamp."""
    return not {*STAMP}.isdisjoint(re.split(r"[^a-z0-9]+", re.sub(r"(?<=[a-z])(?=[A-Z])", "_", name).lower()))


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


def require_given(
    table: Table, names: Sequence[str], values: Array, wanted: BoolArray, kind: Callable[[int], str],
    rows: BoolArray | None = None,
) -> None:  # fmt: skip
    """Raise unless exactly the `wanted` fields (K, n) are given, in `rows` (K,) only; `kind`: what measures a row."""
    given = ~np.isnan(values)
    wrong = (given != wanted) if rows is None else (given != wanted) & rows[:, None]
    if wrong.any():
        row, k = np.argwhere(wrong)[0].tolist()
        what = f"blank, but {kind(row)} measures it; a number is needed"
        if given[row, k]:
            what = f"a value, but {kind(row)} does not measure it; leave the field blank"
        raise table.error(row, names[k], what)


def covariances(
    table: Table, names: Sequence[str], measured: BoolArray, sigma: Array, kind: Callable[[int], str],
    place: Callable[[int], str],
) -> Array:  # fmt: skip
    """Covariances (K, d, d) of the `measured` entries (K, d), zero elsewhere: a row's own, its upper triangle in the
    columns `names`, else by sigma (K, d), NaN where not stated; `kind`, `place`: words for what measures and states it.
    """
    i, j = np.triu_indices(measured.shape[1])
    entries = np.stack([table.get(name) for name in names], axis=-1)
    own: BoolArray = np.asarray(~np.isnan(entries).all(axis=1))
    require_given(table, names, entries, measured[:, i] & measured[:, j], kind, own)
    sigma = np.where(measured, sigma, 0.0)
    lacking = np.isnan(sigma).any(axis=1) & ~own
    if lacking.any():
        row, what = int(np.argmax(lacking)), "blank" if names[0] in table else "no such column"
        raise table.error(row, names[0], f"{what}, and no sigma in {place(row)} of log.toml; one of them is needed")
    P = symmetric(np.nan_to_num(entries))
    P[~own] = (sigma**2)[~own, :, None] * np.eye(measured.shape[1])
    for of in np.unique(measured[own], axis=0):
        rows, axes = np.flatnonzero(own & (measured == of).all(axis=1)), np.flatnonzero(of)
        part = P[np.ix_(rows, axes, axes)]
        if not (fine := definite(part)).all():
            k = int(np.argmin(fine))
            low = float(np.linalg.eigvalsh(part[k])[0])
            what = f"the covariance is not positive definite: smallest eigenvalue {low:.6g}"
            raise table.error(int(rows[k]), f"{names[0]} to {names[-1]}", what)
    return P


def require_semidefinite(table: Table, matrices: Array) -> None:
    """Raise unless each covariance (K, 3, 3) is positive semidefinite, to 1e-12 of its trace."""
    eigenvalues = np.linalg.eigvalsh(matrices)
    fine = eigenvalues[:, 0] >= -1e-12 * eigenvalues.sum(axis=1)
    if not fine.all():
        row = int(np.argmin(fine))
        low, trace = eigenvalues[row, 0], eigenvalues[row].sum()
        what = f"the covariance is not positive semidefinite: smallest eigenvalue {low:.6g}, trace {trace:.6g}"
        raise table.error(row, ENTRIES, what)

"""Files of arrays as tables: MATLAB's, and numpy's without pickles."""

from itertools import zip_longest
from pathlib import Path
from typing import Any

import numpy as np

from data.columns.scans import BROKEN, array_of, open_archive
from data.errors import DataError
from data.formats.matlab import kind_of, load, variables

SUFFIXES = (".mat", ".npz", ".npy")
PICKLES = (".pkl", ".pickle", ".p")
WIDE = (12, 30)
"""Most rows and fewest columns of a matrix whose rows are the columns of a table: a state at each of many instants."""


def is_arrays(path: Path) -> bool:
    """Whether a file is one of arrays by its name. DataError for a pickle, which can run code."""
    if path.suffix.lower() in PICKLES:
        raise DataError.at(path, "a pickle, which can run code; save its arrays by numpy.savez, or as CSV")
    return path.suffix.lower() in SUFFIXES


def named(path: Path) -> dict[str, Any]:
    """The arrays of a file by name; runs no code of it. DataError for a damaged file."""
    if path.suffix.lower() == ".mat":
        return dict(load(path, variables(path)))
    try:
        if path.suffix.lower() == ".npy":
            return {path.stem: np.load(path, mmap_mode="r", allow_pickle=False)}
        with open_archive(path, whole=True) as archive:
            return {name: array_of(archive, name) for name in (n.removesuffix(".npy") for n in archive.namelist())}
    except OSError as error:
        raise DataError.at(path, f"cannot be read: {error.strerror or error}") from None
    except BROKEN as error:
        raise DataError.at(
            path, f"no plain arrays ({' '.join(str(error).split())[:80]}); numpy.savez writes some"
        ) from None


def columns_of(path: Path) -> tuple[tuple[str, ...], tuple[tuple[str, ...], ...]]:
    """Names and rows: vectors as columns, blank below their ends: NAME, of a matrix NAME_1, NAME_2, ... (of a `WIDE`
    one its rows), of a struct (or struct array) STRUCT.FIELD, or FIELD where it is the only one. DataError for a file
    without numbers.
    """
    found = named(path)
    structs = [name for name, value in found.items() if isinstance(value, dict | list)]
    columns: dict[str, list[str]] = {}
    for name, value in found.items():
        items: dict[str, Any] = {name: value}
        if isinstance(value, dict | list):
            each: list[dict[str, Any]] = [value] if isinstance(value, dict) else value
            above = f"{name}." if len(structs) > 1 else ""
            alike = [key for key in (each[0] if each else ()) if len({np.shape(struct[key]) for struct in each}) == 1]
            items = {f"{above}{key}": np.squeeze([struct[key] for struct in each]) for key in alike}
        for key, numbers in items.items():
            if kind_of(numbers) == "numbers" and numbers.ndim <= 2:
                table = numbers.reshape(-1, 1) if 1 in numbers.shape or numbers.ndim < 2 else numbers
                table = table.T if len(table) <= WIDE[0] and len(table.T) >= WIDE[1] else table
                for k, column in enumerate(table.T.tolist(), start=1):
                    columns[f"{key}_{k}" if len(table.T) > 1 else key] = [repr(float(v)) for v in column]
    rows = tuple(zip_longest(*columns.values(), fillvalue=""))
    if not rows:
        raise DataError.at(path, f"no vector of numbers; it has {', '.join(found) or 'nothing'}")
    return tuple(columns), rows

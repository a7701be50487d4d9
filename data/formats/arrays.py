"""Files of arrays as tables: MATLAB's, Octave's texts, and numpy's without pickles."""

from collections.abc import Collection, Mapping, Sequence
from itertools import zip_longest
from pathlib import Path
from typing import Any

import numpy as np

from data.columns.scans import BROKEN, array_of, open_archive
from data.errors import DataError
from data.formats.matlab import CELLS, is_octave, kind_of, load, octave, variables
from data.formats.messages import file_and_word
from data.se2 import Array

SUFFIXES = (".mat", ".npz", ".npy")
PICKLES = (".pkl", ".pickle", ".p")
WIDE = (12, 30)
"""Most rows and fewest columns of a matrix whose rows are the columns of a table: a state at each of many instants."""


ELEMENT = "element"  # Name of the column of numbers of structs, from 0


def is_arrays(path: Path) -> bool:
    """Whether a file is one of arrays by its name. DataError for a pickle, which can run code."""
    path = file_and_word(path)[0]
    if path.suffix.lower() in PICKLES:
        raise DataError.at(path, "a pickle, which can run code; save its arrays by numpy.savez, or as CSV")
    return path.suffix.lower() in SUFFIXES or is_octave(path)


def named(path: Path) -> dict[str, Any]:
    """The arrays of a file by name; runs no code of it. DataError for a damaged file."""
    if path.suffix.lower() not in (".npz", ".npy"):
        return octave(path) if is_octave(path) else dict(load(path, variables(path)))
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


def columns_of(
    path: Path, stated: Collection[str] = (), odometry: int = 0
) -> tuple[tuple[str, ...], tuple[tuple[str, ...], ...]]:
    """Names and rows: vectors as columns, blank below their ends: NAME, of a matrix NAME_1, NAME_2, ... (of a `WIDE`
    one its rows), of a struct STRUCT.FIELD, or FIELD where it is the only one; of structs and matrices in arrays see
    `_listed`; of FILE:STRUCT those of one struct; of arrays of three dimensions those `stated` (`_solid`), of an
    odometry of so many rows. DataError for a file without numbers.
    """
    path, word = file_and_word(path)
    found = named(path)
    alone = sum(isinstance(value, dict | list) for value in found.values()) == 1
    columns: Columns = {}
    for name, value in found.items():
        columns |= _unrolled("" if alone and isinstance(value, dict | list) else name, value)
    if word and (own := {k.removeprefix(f"{word}."): c for k, c in columns.items() if k.startswith(f"{word}.")}):
        columns = own
    lengths = set(map(len, columns.values()))
    deep = {name: value for name, value in found.items() if np.ndim(value) == 3 and kind_of(value) == "numbers"}
    for name in (n for n in deep if any(column.startswith(f"{n}_") for column in stated)):
        columns |= _solid(path, name, deep[name], odometry, lengths)
    rows = tuple(zip_longest(*columns.values(), fillvalue=""))
    if not rows:
        solid = [f"{n} {np.shape(a)}, as in --columns range={n}_1,bearing={n}_2" for n, a in deep.items()]
        has = ", ".join([*(n for n in found if n not in deep), *solid])
        raise DataError.at(path, f"no vector of numbers; it has {has or 'nothing'}")
    return tuple(columns), rows


Columns = dict[str, list[str]]


def _unrolled(name: str, value: Any) -> Columns:
    """The columns of a value of a file, in words of `columns_of`."""
    if isinstance(value, dict):
        each = [_unrolled(f"{name}.{key}".lstrip("."), item) for key, item in value.items()]
        return {key: column for columns in each for key, column in columns.items()}
    if isinstance(value, list):
        return _listed(name, value)
    if kind_of(value) == CELLS:
        return _listed(name, [{"": item} for item in value.ravel(order="F")])
    if kind_of(value) != "numbers" or value.ndim > 2 or not value.size:
        return {}
    table = value.reshape(-1, 1) if 1 in value.shape or value.ndim < 2 else value
    return _numbered(name, table.T if len(table) <= WIDE[0] and len(table.T) >= WIDE[1] else table)


def _solid(path: Path, name: str, value: Array, odometry: int, lengths: Collection[int]) -> Columns:
    """NAME_1_1, NAME_1_2, ... of an array of three dimensions, and NAME.element, which counts its rows: they are along
    the only dimension as long as the odometry, or `LONG` times as long as the others, or as some other array is.
    """
    longest = np.argmax(value.shape) if max(value.shape) >= LONG * sorted(value.shape)[1] else None
    counts = [(n == odometry, axis == longest, n in lengths) for axis, n in enumerate(value.shape)]
    along = next((axes.index(True) for axes in zip(*counts, strict=True) if axes.count(True) == 1), None)
    if along is None:
        what = "which dimension counts the rows of the odometry? A matrix (rows, all numbers of a row) is needed"
        raise DataError.at(path, f"{name} has shape {value.shape}: {what}")
    rows = np.moveaxis(value, along, 0)
    found = {f"{name}.{ELEMENT}": [str(k) for k in range(len(rows))]}
    for i, j in np.ndindex(rows.shape[1:]):
        found[f"{name}_{i + 1}_{j + 1}"] = [repr(float(v)) for v in rows[:, i, j]]
    return found


LONG = 8  # Times as long as the others is a dimension of rows


def _numbered(name: str, table: Array) -> Columns:
    names = [f"{name}_{k}" for k in range(1, len(table.T) + 1)] if len(table.T) > 1 else [name]
    return {key: [repr(float(v)) for v in column] for key, column in zip(names, table.T.tolist(), strict=True)}


def _listed(name: str, structs: Sequence[Mapping[str, Any]]) -> Columns:
    """A row for each struct, of fields that have as many numbers in all. Below them a row for each column of a matrix,
    or each struct, that a field holds: with its struct's number as NAME.element, and its single numbers, as stamps.
    """
    columns, single, inside = Columns(), list[str](), list[str]()
    for key in structs[0] if structs else ():
        shapes = {np.shape(s[key]) if isinstance(s[key], np.ndarray) else () for s in structs}
        own, plain = f"{name}.{key}".strip("."), all(kind_of(s[key]) == "numbers" for s in structs)
        if plain and len(shapes) == 1 and sum(n > 1 for n in next(iter(shapes))) < 2:
            columns |= _numbered(own, np.stack([s[key].ravel() for s in structs]))
            single += [key] * (own in columns)
        else:
            inside.append(key)
    for key in inside:
        own, rows = f"{name}.{key}".strip("."), len(next(iter(columns.values()), ()))
        for k, struct in enumerate(structs):
            found = _columns_across(own, struct[key], [s[key] for s in structs])
            count = max(map(len, found.values()), default=0)
            found |= {f"{name}.{one}".strip("."): [repr(float(struct[one].item()))] * count for one in single}
            found[f"{name}.{ELEMENT}".strip(".")] = [str(k)] * count
            for column, values in found.items() if count else ():
                columns.setdefault(column, []).extend([*[""] * (rows - len(columns.get(column, ()))), *values])
            rows += count
    return columns


def _columns_across(name: str, value: Any, each: Sequence[Any]) -> Columns:
    """Those of a matrix whose columns, or whose rows if only these differ in number among `each`, are rows."""
    if kind_of(value) != "numbers":
        return _unrolled(name, [value] if isinstance(value, dict) else value)
    shapes = [np.shape(v) for v in each if isinstance(v, np.ndarray) and v.size and v.ndim == 2]
    low, wide = ({shape[axis] for shape in shapes} for axis in (0, 1))
    same = low if len(low) == 1 else wide
    if value.ndim != 2 or not value.size or min(len(low), len(wide)) > 1 or max(same) > WIDE[0]:
        return {}
    return _numbered(name, value.T if len(low) == 1 else value)

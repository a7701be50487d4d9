"""Files of arrays as tables: MATLAB's, Octave's texts, numpy's, JSON, and pickles, of which no code runs."""

import ast
import json
import math
import pickle
import re
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from functools import lru_cache
from itertools import zip_longest
from pathlib import Path
from typing import Any

import numpy as np

from data.columns.named import STAMP
from data.columns.scans import BROKEN, array_of, open_archive
from data.csv_table import is_number
from data.errors import DataError
from data.formats.matlab import CELLS, is_octave, kind_of, load, octave, variables
from data.formats.wrapped import csv_of, file_and_word, package
from data.se2 import Array

PICKLES = (".pkl", ".pickle", ".p")
TEXTS, YAML = (".json", ".jsonl", ".ndjson"), (".yaml", ".yml")
SUFFIXES = (".mat", ".npz", ".npy", ".h5", ".hdf5", *TEXTS, *PICKLES)
MATRICES = ((4, 4), (3, 4))  # Shapes of poses in space
WIDE = (12, 30)  # Most rows and fewest columns of a matrix whose rows are a table's columns: a state at many instants


ELEMENT = "element"  # Name of the column of numbers of structs, from 0


def is_arrays(path: Path) -> bool:
    """Whether a file is one of arrays by its name, and not of `records`."""
    lines, path = records(path)[0], file_and_word(path)[0]
    suffix, there = suffix_of(path), path.is_file() and not lines
    return there and (suffix in SUFFIXES or is_octave(path) or (suffix in YAML and "\n---" not in read_plain(path)))


def suffix_of(path: Path) -> str:
    """The suffix of a file; that of JSON where objects, or lists of lists, are its content, whatever its name."""
    suffix = path.suffix.lower()
    if suffix not in (*SUFFIXES, *YAML):
        with suppress(OSError, ValueError, RecursionError), path.open("rb") as file:
            begin = re.match(rb"\W*{|\s*(\[\s*)+[(\[]", file.read(20))
            if begin and (found := _json(path, path.stat().st_mtime_ns)) and (not begin[1] or np.ndim(found[0][0])):
                return TEXTS[0]
    return suffix


@lru_cache(maxsize=2)
def _json(path: Path, _: int) -> Any:
    text = path.read_text(encoding="utf-8-sig")
    try:
        return json.loads(text)
    except json.JSONDecodeError:
        with suppress(SyntaxError, ValueError, MemoryError, RecursionError):  # the last two of deep nests
            each = [_printed(line) for line in text.splitlines() if line.strip()]
            return each if len(each) > 1 else each[0]
        raise


def _printed(line: str) -> Any:
    """An object of JSON, or a list, tuple or dict as Python prints it."""
    with suppress(json.JSONDecodeError):
        return json.loads(line)
    return ast.literal_eval(re.sub(r"\binf\b", "1e999", re.sub(r"\bnan\b", "None", line.strip())))


def records(path: Path) -> tuple[bytes, str]:
    """Words and numbers of the matrix FILE:NAME, or of the longest array, as CSV, else none; the word of their rows."""
    path, word = file_and_word(path)
    held = path.is_file() and (suffix_of(path) in (".mat", *TEXTS, *PICKLES) or is_octave(path))
    return _records(path, word, path.stat().st_mtime_ns) if held else (b"", word)


@lru_cache(maxsize=4)
def _records(path: Path, word: str, _: int) -> tuple[bytes, str]:
    found = named(path)
    longest = max((math.inf if isinstance(v, dict) else max(np.shape(v), default=0) for v in found.values()), default=0)
    for name, value in found.items():
        of_all = word not in found and max(np.shape(value), default=0) == longest
        if (of_all or word == name) and np.ndim(value) == 2 and kind_of(value) == "text":
            table = value.T if len(value) <= WIDE[0] and len(value.T) >= WIDE[1] else value
            return csv_of(table[0], table[1:]), "" if word == name else word
    return b"", word


def read_plain(path: Path) -> str:
    """A text file, whatever bytes it holds."""
    return path.read_text(encoding="utf-8-sig", errors="replace")


def named(path: Path) -> dict[str, Any]:
    """The arrays of a file by name; runs no code of it. DataError for a damaged file."""
    if suffix_of(path) in (*TEXTS, *YAML, *PICKLES):
        return _plain_file(path)
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


class _Object:
    """An object of a pickle: its attributes alone."""

    def __init__(self, *_: object) -> None: ...


class _Unpickler(pickle.Unpickler):
    """Reads arrays, numbers and containers; any other object becomes a plain one, so no code of a file runs."""

    def find_class(self, module: str, name: str) -> Any:
        """One of `SAFE`, else `_Object`; UnpicklingError for tables of pandas, whose parts are no arrays."""
        module = module.replace("numpy.core", "numpy._core")
        if module.startswith("pandas"):
            raise pickle.UnpicklingError("a table of pandas; save it by to_csv")
        return super().find_class(module, name) if f"{module}.{name}" in SAFE else _Object


SAFE = frozenset({
    "numpy._core.multiarray._reconstruct", "numpy._core.multiarray.scalar", "numpy._core.numeric._frombuffer",
    "numpy.ndarray", "numpy.dtype", "collections.OrderedDict", "collections.defaultdict", "_codecs.encode",
    "copyreg._reconstructor", *(f"builtins.{name}" for name in ("object", "list", "dict", "tuple", "set", "complex")),
})  # fmt: skip


def _plain_file(path: Path) -> dict[str, Any]:
    """What a file of JSON, whole or an object a line, or a pickle holds, by name."""
    try:
        if path.suffix.lower() in YAML:
            found = _plain(package(path, "yaml", "pyyaml").safe_load(read_plain(path)))
        elif path.suffix.lower() in PICKLES:
            with path.open("rb") as file:
                found = _plain(_Unpickler(file, encoding="latin1").load())
        else:
            found = _plain(_json(path, path.stat().st_mtime_ns))
    except OSError as error:
        raise DataError.at(path, f"cannot be read: {error.strerror}") from None
    except (pickle.UnpicklingError, EOFError, ImportError, RecursionError, MemoryError, *BROKEN) as error:
        raise DataError.at(path, f"no plain numbers, lists and arrays: {' '.join(str(error).split())[:100]}") from None
    return found if isinstance(found, dict) else {path.stem: found}


def _plain(value: Any) -> Any:
    """Numbers and equal lists as arrays, lists of objects and unequal lists as lists of dicts, as MATLAB's structs."""
    value = vars(value) if isinstance(value, _Object) else value
    if isinstance(value, dict) and value and all(is_number(str(key)) for key in value):  # by stamp or number
        pairs = [(float(key), _plain(v)) for key, v in value.items()]
        value = [{"key": key, **(v if isinstance(v, dict) else {"value": v})} for key, v in pairs]
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple) or (isinstance(value, np.ndarray) and value.dtype == object and value.ndim):
        each = [_plain(item) for item in value]
        if each and all(isinstance(item, dict) for item in each):
            flat = [_flat(item) for item in each]
            keys = dict.fromkeys(key for item in flat for key in item)
            columns = {key: _alike([item.get(key, np.array(np.nan)) for item in flat]) for key in keys}
            return [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]
        alike = len({np.shape(item) for item in each if not isinstance(item, list | dict)}) == 1
        return np.array(each) if alike and isinstance(each[0], np.ndarray) else [{"": item} for item in each]
    number = isinstance(value, str) and is_number(value)
    return np.asarray(float(value) if number else np.nan if value is None else value)


def _alike(values: list[Any]) -> list[Any]:
    """Values of a field in the shape that most have, where others are as many numbers, or one (as None and False)."""
    shapes = Counter(np.shape(v) for v in values if isinstance(v, np.ndarray))
    usual = shapes.most_common(1)[0][0] if shapes else ()
    usual, count = ((), 1) if math.prod(usual) == 1 else (usual, math.prod(usual))
    if sum(shapes.values()) < len(values) or not all(math.prod(shape) in (1, count) for shape in shapes):
        return values
    return [v.reshape(usual) if v.size == count else np.full(usual, np.nan) for v in values]


def _flat(value: Mapping[str, Any], within: str = "") -> dict[str, Any]:
    """Fields of objects within an object as NAME.FIELD; a pose of 4 x 4 numbers as its rows one after the other."""
    found: dict[str, Any] = {}
    for key, item in value.items():
        if isinstance(item, dict):
            found |= _flat(item, f"{within}{key}.")
        else:
            found[within + key] = item.ravel() if np.shape(item) in MATRICES else item
    return found


def columns_of(
    path: Path, stated: Collection[str] = (), odometry: int = 0
) -> tuple[tuple[str, ...], tuple[tuple[str, ...], ...]]:
    """Names and rows: vectors as columns, blank below their ends: NAME, of a matrix NAME_1, NAME_2, ... (of a `WIDE`
    one its rows), of a struct STRUCT.FIELD, or FIELD of the only one, or of FILE:STRUCT; of structs and matrices in
    arrays see `_listed`, of three dimensions `_solid`, beside an odometry of so many rows. DataError: no numbers.
    """
    path, word = file_and_word(path)
    found = named(path)
    structs = [name for name, value in found.items() if isinstance(value, dict) or
               (isinstance(value, list) and any(key for struct in value for key in struct))]  # fmt: skip
    plain = {name: np.shape(value) for name, value in found.items() if kind_of(value) == "numbers"}
    flat = [(name, shape) for name, shape in plain.items() if len(shape) < 3]
    states = {max(shape) for _, shape in flat if shape and 1 < min(shape) <= WIDE[0] and max(shape) >= WIDE[1]}
    along = states | {max(shape, default=0) for name, shape in flat if name.lower() in STAMP}
    columns: Columns = {}
    for name, value in found.items():
        turned = np.ndim(value) == 2 and len(value.T) in along and len(value) not in along
        value = value.T if turned and len(value) > WIDE[0] else value  # an instant in each column
        upright = np.ndim(value) == 2 and kind_of(value) == "numbers" and len(value) in along  # an instant in each row
        columns |= _numbered(name, value) if upright else _unrolled("" if [name] == structs else name, value)
    if word:
        own = {k.removeprefix(f"{word}."): c for k, c in columns.items() if k.startswith(f"{word}.")}
        if not {*own} & {*STAMP}:  # those beside it, of as many rows
            longest = max(map(len, own.values()), default=0)
            own |= {k: c for k, c in columns.items() if own and k.lower() in STAMP and len(c) == longest}
        matrix = {k: c for k, c in columns.items() if k == word or k.rstrip("0123456789") == f"{word}_"}
        columns = own or matrix or columns
    lengths = set(map(len, columns.values()))
    deep = {name: value for name, value in found.items() if np.ndim(value) == 3 and kind_of(value) == "numbers"}
    for name in (n for n in deep if any(column.startswith(f"{n}_") for column in stated)):
        columns |= _solid(path, name, deep[name], odometry, lengths)
    for name, value in deep.items():
        each = value if value.shape[1:] in MATRICES else np.moveaxis(value, 2, 0)
        R = each[0, :3, :3] if each.shape[1:] in MATRICES else np.zeros((3, 3))
        if np.allclose(R @ R.T, np.eye(3), atol=1e-2):  # poses in space
            columns |= _numbered(name, each[:, :3].reshape(len(each), -1))
    for name, value in deep.items() if not columns else ():
        if value.shape[1] >= WIDE[1] > WIDE[0] >= value.shape[2]:  # beams of scans, as many in each
            columns |= _listed(name, [{"": scan} for scan in value])
    rows = tuple(zip_longest(*columns.values(), fillvalue=""))
    if not rows:
        has = ", ".join([*(n for n in found if n not in deep), *solids(path)])
        raise DataError.at(path, f"no vector of numbers; it has {has or 'nothing'}")
    return tuple(columns), rows


def solids(path: Path) -> list[str]:
    """How the arrays of three dimensions of a file can be named as observations."""
    each = [(n, np.shape(a)) for n, a in named(file_and_word(path)[0]).items() if np.ndim(a) == 3]
    return [f"{n} {shape}, as in --columns range={n}_1,bearing={n}_2" for n, shape in each]


Columns = dict[str, list[str]]


def _unrolled(name: str, value: Any) -> Columns:
    """The columns of a value of a file, in words of `columns_of`."""
    if isinstance(value, dict):
        each = [_unrolled(f"{name}.{key}".lstrip("."), item) for key, item in value.items()]
        return {key: column for columns in each for key, column in columns.items()}
    if isinstance(value, list):
        return _listed(name, value)
    if kind_of(value) == CELLS:
        cells = value.ravel(order="F").tolist()
        while cells and not np.size(cells[-1]):  # of an array that was made too long
            cells.pop()
        return _listed(name, [{"": item} for item in cells])
    if kind_of(value) != "numbers" or value.ndim > 2 or not value.size:
        return {}
    table = value.reshape(-1, 1) if 1 in value.shape or value.ndim < 2 else value
    return _numbered(name, table.T if len(table) <= WIDE[0] and len(table.T) >= WIDE[1] else table)


def _solid(path: Path, name: str, value: Array, odometry: int, lengths: Collection[int]) -> Columns:
    """Columns NAME_1_1, ... and NAME.element of an array of three dimensions, one of which counts the rows."""
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
    """Columns of structs, a row for each; below them a row for each column of a matrix, or struct, in a field."""
    columns, single, inside = Columns(), list[str](), list[str]()
    for key in structs[0] if structs else ():
        shapes = {np.shape(s[key]) if isinstance(s[key], np.ndarray) else () for s in structs}
        own, plain = f"{name}.{key}".strip("."), all(kind_of(s[key]) == "numbers" for s in structs)
        if plain and len(shapes) == 1 and sum(n > 1 for n in next(iter(shapes))) < 2:
            columns |= _numbered(own, np.stack([s[key].ravel() for s in structs]))
            single += [key] * (own in columns)
        else:
            inside.append(key)
    begun = dict[tuple[int, ...], int]()  # of fields with as many rows in each, the first of these
    for key in inside:
        own = f"{name}.{key}".strip(".")
        shapes = {np.shape(v) for s in structs if np.size(v := s[key]) and np.ndim(v) == 2}
        each = [_columns_across(own, struct[key], shapes) for struct in structs]
        counts = tuple(max(map(len, found.values()), default=0) for found in each)
        again, rows = counts in begun, begun.setdefault(counts, len(next(iter(columns.values()), ())))
        for k, (struct, found, count) in enumerate(zip(structs, each, counts, strict=True)):
            if not again:
                found |= {f"{name}.{one}".strip("."): [repr(float(struct[one].item()))] * count for one in single}
                found[f"{name}.{ELEMENT}".strip(".")] = [str(k)] * count
            for column, values in found.items() if count else ():
                columns.setdefault(column, []).extend([*[""] * (rows - len(columns.get(column, ()))), *values])
            rows += count
    return columns


def _columns_across(name: str, value: Any, shapes: Collection[tuple[int, ...]]) -> Columns:
    """Those of a matrix whose columns, or whose rows if only these differ in number among `shapes`, are rows."""
    if kind_of(value) != "numbers":
        return _unrolled(name, [value] if isinstance(value, dict) else value)
    if value.ndim == 1:
        return _numbered(name, value[:, None])
    low, wide = ({shape[axis] for shape in shapes} for axis in (0, 1))
    across = len(low) == 1 and (max(low) <= WIDE[0] or len(wide) > 1)
    if value.ndim != 2 or not value.size or min(len(low), len(wide)) > 1 or max(low if across else wide) > WIDE[0]:
        return {}
    return _numbered(name, value.T if across else value)

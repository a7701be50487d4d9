"""MATLAB files of version 7.3, which are HDF5: a lab's log one frame at a time, and its configuration.

MATLAB's arrays are stored with their dimensions reversed. A struct is a group, with a dataset or group per field; a
struct array is a group whose fields are datasets of references, one per element. Needs h5py (extra `hdf5`).
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from data.errors import DataError
from data.formats.lab.matlab import CELL, CHAR, FUNCTION, KINDS, LIMIT, Struct, Unread, Value

CLASS, EMPTY = "MATLAB_class", "MATLAB_empty"
NUMBERS = frozenset(
    {"double", "single", "logical", *(f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64))}
)
"""MATLAB's classes of numbers."""
BROKEN = (OSError, KeyError, ValueError, RuntimeError, TypeError, AttributeError)
"""Errors of h5py for damaged bytes."""


class Variable73(NamedTuple):
    """A variable: file, name, kind as in `data.formats.lab.matlab.Variable`, fields and number of elements."""

    path: Path
    name: str
    kind: str
    fields: tuple[str, ...]
    elements: int


@contextmanager
def opened(path: Path) -> Iterator[Any]:
    """The file; DataError without h5py and for damaged bytes."""
    try:
        import h5py
    except ImportError:
        right = "pip install 'slamref[hdf5]', or save it with '-v7'"
        raise DataError.at(path, f"MATLAB 7.3 (HDF5) needs the package h5py: {right}") from None
    try:
        with h5py.File(path, "r") as file:
            yield file
    except BROKEN as error:
        raise DataError.at(path, f"damaged: {' '.join(str(error).split())[:200]}") from error


def variables73(path: Path) -> tuple[Variable73, ...]:
    """The variables of a file, their values unread. Raises DataError as `opened`."""
    with opened(path) as file:
        names = [name for name in file if not name.startswith("#")]
        return tuple(_variable(path, name, file[name]) for name in names)


def _variable(path: Path, name: str, item: Any) -> Variable73:
    if not _is_group(item):
        return Variable73(path, name, "numbers" if _class(item) in NUMBERS else _class(item), (), int(item.size))
    fields = tuple(item)
    return Variable73(path, name, "struct", fields, _elements_of(item))


def read73(path: Path, name: str) -> Value:
    """The value of a variable with MATLAB's shape. Raises DataError as `opened`."""
    with opened(path) as file:
        return _value(file, file[name])


class Hdf5Log:
    """A MATLAB struct array log(i), one element in memory at a time."""

    def __init__(self, variable: Variable73) -> None:
        self.path, self.fields, self._variable = variable.path, variable.fields, variable
        if variable.kind != "struct":
            right = "a struct array, one element per frame, is needed"
            raise DataError.at(self.path, f"{variable.name} is of kind {variable.kind}; {right}")

    def __len__(self) -> int:
        return self._variable.elements

    def place(self, frame: int, field: str) -> str:
        """Counting from 1."""
        return f"{self._variable.name}({frame + 1}).{field}"

    def records(self) -> Iterator[dict[str, Value]]:
        """The elements' fields by name."""
        with opened(self.path) as file:
            group = file[self._variable.name]
            for i in range(len(self)):
                yield _element(file, group, i, self.fields)


def _is_group(item: Any) -> bool:
    return not hasattr(item, "dtype")


def _class(item: Any) -> str:
    name = item.attrs.get(CLASS, b"")
    return name.decode("latin-1") if isinstance(name, bytes) else str(name)


def _of_references(item: Any) -> bool:
    return not _is_group(item) and item.dtype.kind == "O" and _class(item) != "cell"


def _elements_of(group: Any) -> int:
    """Number of elements of a struct array; 1 of a struct."""
    sizes = {int(group[name].size) for name in group if _of_references(group[name])}
    if len(sizes) > 1:
        raise ValueError(f"fields of {group.name} have {sorted(sizes)} elements")
    return sizes.pop() if sizes else 1


def _element(file: Any, group: Any, i: int, wanted: Collection[str]) -> dict[str, Value]:
    found = {}
    for name in wanted:
        item = group[name]
        # elements are stored in MATLAB's order, columns first
        found[name] = _value(file, file[item[()].ravel()[i]] if _of_references(item) else item)
    return found


def _value(file: Any, item: Any) -> Value:
    """A whole value; kinds that are not read become `Unread`."""
    if _is_group(item):
        count = _elements_of(item)
        return Struct((1, count), tuple(_element(file, item, i, tuple(item)) for i in range(count)))
    kind = _class(item)
    if item.dtype.kind == "V":
        return Unread("complex numbers")
    if kind not in NUMBERS or item.dtype.kind not in "fiu":
        return Unread(KIND_NAMES.get(kind, kind or "object"))
    if item.attrs.get(EMPTY, 0):
        return np.zeros(tuple(int(n) for n in item[()].ravel()))
    if item.size * item.dtype.itemsize > LIMIT:
        raise ValueError(f"{item.name} has {item.size} numbers, more than 2 GiB")
    return np.asarray(item[()]).T


KIND_NAMES = {"cell": KINDS[CELL], "char": KINDS[CHAR], "function_handle": KINDS[FUNCTION]}
"""What values of other classes are called."""

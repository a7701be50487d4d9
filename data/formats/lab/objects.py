"""Python objects of trusted files, pickles and object arrays: a log in any of its shapes, and a configuration.

A log is a list of dicts or records, one per frame; or one dict of arrays, a row per frame. Either may lie in object
arrays (N, 1) or (1, N), as scipy.io.loadmat returns MATLAB's struct arrays.
"""

from __future__ import annotations

import pickle
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from data.errors import DataError

NEEDS_TRUST = (
    "holds Python objects (a pickle), which can run code when loaded; save plain arrays, "
    "or add --trust-pickle if you trust the file's author"
)
LOG = "log"
BROKEN = (pickle.UnpicklingError, EOFError, ImportError, AttributeError, ValueError, IndexError, TypeError, KeyError)
"""Errors of a pickle that cannot be loaded; OSError aside."""
Record = Mapping[str, Any]
T = TypeVar("T")


def load_objects(path: Path) -> object:
    """What a trusted `.npy` or `.pkl` holds, unwrapped. It may run code. Raises DataError if it cannot be loaded."""
    try:
        if path.suffix.lower() == ".npy":
            return unwrapped(np.load(path, allow_pickle=True))
        with path.open("rb") as file:
            return unwrapped(pickle.load(file))
    except BROKEN as error:
        what = " ".join(str(error).split())[:200]
        raise DataError.at(path, f"the pickle cannot be loaded: {what or type(error).__name__}") from error
    except OSError as error:
        raise DataError.at(path, f"cannot be read: {error.strerror}") from error


def unwrapped(value: object) -> object:
    """The content of an array of one object or record, however deep; a record becomes a dict."""
    while isinstance(value, np.ndarray) and value.size == 1 and (value.dtype.hasobject or value.dtype.names):
        value = value.ravel()[0]
    if isinstance(value, np.void) and value.dtype.names:
        return {name: value[name] for name in value.dtype.names}
    return value


def named_parts(value: object, names: Sequence[str]) -> dict[str, object]:
    """The parts of a dict or record that have these names, unwrapped."""
    return {n: unwrapped(value[n]) for n in names if n in value} if isinstance(value, Mapping) else {}


def log_in(value: object, fields: Sequence[str]) -> object | None:
    """The log in a loaded object: what a dict calls `log`, or the object itself; None where it seems to hold none."""
    if isinstance(value, Mapping):
        return value if set(fields) & set(value) else unwrapped(value[LOG]) if LOG in value else None
    return value if isinstance(value, Sequence | np.ndarray) and not isinstance(value, str | bytes) else None


class ObjectLog:
    """A log of Python objects, all in memory."""

    def __init__(self, path: Path, content: object, fields: Sequence[str]) -> None:
        """`fields`: those of a frame. Raises DataError for another shape."""
        self.path = path
        columns = content if isinstance(content, Mapping) and self._is_columns(content, fields) else None
        self._columns = columns is not None
        self._records = self._items(content) if columns is None else self._rows(columns, fields)
        self.fields = tuple(self._records[0]) if self._records else ()

    @staticmethod
    def _is_columns(content: Mapping[str, Any], fields: Sequence[str]) -> bool:
        """Whether a dict has a row per frame; a recording of one frame has a number for its time."""
        times = content.get(fields[0])
        return times is not None and np.ndim(times) > 0

    def _rows(self, content: Mapping[str, Any], fields: Sequence[str]) -> list[Record]:
        """Frames of a dict of arrays or lists."""
        columns: dict[str, Sequence[Any] | NDArray[Any]] = {}
        for name in (f for f in fields if f in content):
            found = flat_column(content[name])
            if not isinstance(found, Sequence | np.ndarray):
                what = f"{name}: a {type(found).__name__}; an array with a row per frame is needed"
                raise DataError.at(self.path, what)
            columns[name] = found
        times = columns[fields[0]]
        if isinstance(times, np.ndarray) and times.ndim == 2 and len(times) == 1:  # MATLAB's row
            columns[fields[0]] = times.ravel()
        if len({len(column) for column in columns.values()}) > 1:
            counts = ", ".join(f"{name} {len(column)}" for name, column in columns.items())
            raise DataError.at(self.path, f"rows: {counts}; as many rows as frames are needed in each")
        return [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]

    def _items(self, content: object) -> list[Record]:
        """Frames of a list or an array of dicts or records, or a single one."""
        if isinstance(content, np.ndarray):
            content = list(content.ravel())
        elif isinstance(content, Mapping):
            content = [content]
        if not isinstance(content, list | tuple):
            what = f"holds one {type(content).__name__}; a list of dicts, one per frame, or a dict of arrays is needed"
            raise DataError.at(self.path, what)
        items = [unwrapped(item) for item in content]
        for i, item in enumerate(items):
            if not isinstance(item, Mapping):
                what = f"[{i}]: a {type(item).__name__}; a dict of the frame's fields is needed"
                raise DataError.at(self.path, what)
        return [item for item in items if isinstance(item, Mapping)]

    def __len__(self) -> int:
        return len(self._records)

    def place(self, frame: int, field: str) -> str:
        """A frame's field in Python's notation."""
        return f"[{field!r}][{frame}]" if self._columns else f"[{frame}][{field!r}]"

    def records(self) -> Iterator[dict[str, NDArray[Any] | Record]]:
        """The frames' fields by name."""
        for i, item in enumerate(self._records):
            yield {name: plain(self.path, self.place(i, name), value) for name, value in item.items()}


def flat_column(value: T) -> T | NDArray[Any]:
    """A column with a row per frame: object arrays (N, 1) and (1, N) are laid flat."""
    if isinstance(value, np.ndarray) and value.dtype.hasobject and value.ndim == 2 and 1 in value.shape:
        return value.ravel()
    return value


def plain(path: Path, place: str, value: object) -> NDArray[Any] | Record:
    """A field as numbers, or a mapping of such (commands may be one). Raises DataError for other objects."""
    value = unwrapped(value)
    if isinstance(value, Mapping):
        return {name: plain(path, f"{place}[{name!r}]", item) for name, item in value.items()}
    try:
        array = np.asarray(value.tolist() if isinstance(value, np.ndarray) and value.dtype.hasobject else value)
    except ValueError as error:
        raise DataError.at(path, f"{place}: {error}") from error
    if array.dtype.hasobject:
        raise DataError.at(path, f"{place}: Python objects; numbers are needed")
    return array

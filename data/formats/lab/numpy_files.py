"""Logs of the lab's format as `.npy` or `.npz`, read one record at a time.

Plain reads instead of a memory map keep the memory in use small.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from data.errors import DataError
from data.formats.lab.objects import NEEDS_TRUST, flat_column, plain, unwrapped
from data.formats.open_log.scans import BROKEN, open_archive

Record: TypeAlias = "dict[str, NDArray[Any] | Mapping[str, Any]]"
SMALL = 2
"""Most dimensions of arrays that are read whole (timestamps and commands)."""


@dataclass(frozen=True)
class _Layout:
    """The header of an array."""

    dtype: np.dtype[Any]
    shape: tuple[int, ...]
    fortran: bool


class NpyLog:
    """A structured array (N,) with the fields of a frame."""

    def __init__(self, path: Path) -> None:
        self.path = path
        with _reading(path), path.open("rb") as file:
            layout = _layout(file)
            self._offset = file.tell()
            size = path.stat().st_size
        self._layout = layout
        if layout.dtype.names is None or len(layout.shape) != 1:
            what = f"an array of {layout.dtype} and shape {layout.shape}"
            raise DataError.at(path, f"{what}; a structured array (N,) is needed")
        if size < self._offset + math.prod(layout.shape) * layout.dtype.itemsize:
            announced = f"{len(self)} frames of {layout.dtype.itemsize} bytes are announced"
            what = f"{announced} and {size - self._offset} bytes are there"
            raise DataError.at(path, f"damaged: ends early: {what}")
        self.fields = layout.dtype.names

    def __len__(self) -> int:
        return self._layout.shape[0]

    def place(self, frame: int, field: str) -> str:
        """A frame's field in NumPy's notation."""
        return f"[{frame}][{field!r}]"

    def records(self) -> Iterator[Record]:
        """The frames' fields by name."""
        with _reading(self.path), self.path.open("rb") as file:
            file.seek(self._offset)
            for row in _rows(file, self._layout):
                yield {name: row[name] for name in self.fields}


class NpzLog:
    """An archive of an array (N, ...) per field."""

    def __init__(self, path: Path, wanted: tuple[str, ...], *, trust_pickle: bool) -> None:
        self.path = path
        self._layouts: dict[str, _Layout] = {}
        self._whole: dict[str, NDArray[Any]] = {}
        with _reading(path), open_archive(path, whole=False) as archive:
            inside = [n.removesuffix(".npy") for n in archive.namelist() if n.endswith(".npy")]
            self.fields = tuple(name for name in wanted if name in inside)
            for name in self.fields:
                with archive.open(f"{name}.npy") as member:
                    layout = self._layouts[name] = _layout(member)
                if layout.dtype.hasobject and not trust_pickle:
                    raise DataError.at(path, f"{name} {NEEDS_TRUST}")
                if not layout.shape:
                    raise DataError.at(path, f"{name}: a single value; one row per frame is needed")
                if layout.dtype.hasobject or (layout.fortran and len(layout.shape) <= SMALL):
                    with np.load(path, allow_pickle=layout.dtype.hasobject) as arrays:
                        self._whole[name] = flat_column(arrays[name])
                elif layout.fortran and len(layout.shape) > 1:
                    what = "frames are not contiguous in Fortran order; save numpy.ascontiguousarray of it"
                    raise DataError.at(path, f"{name}: {what}")
        lengths = {
            name: len(self._whole[name]) if name in self._whole else layout.shape[0]
            for name, layout in self._layouts.items()
        }
        if len(set(lengths.values())) > 1:
            counts = ", ".join(f"{name} {n}" for name, n in lengths.items())
            raise DataError.at(path, f"rows: {counts}; as many rows as frames are needed in each")
        self._length = next(iter(lengths.values()), 0)

    def __len__(self) -> int:
        return self._length

    def place(self, frame: int, field: str) -> str:
        """A frame's field in NumPy's notation."""
        return f"{field}[{frame}]"

    def records(self) -> Iterator[Record]:
        """The frames' fields by name."""
        with ExitStack() as stack:
            stack.enter_context(_reading(self.path))
            archive = stack.enter_context(open_archive(self.path, whole=False))
            streams: list[Iterator[Any]] = []
            for name in self.fields:
                if name in self._whole:
                    streams.append(iter(self._whole[name]))
                    continue
                member = stack.enter_context(archive.open(f"{name}.npy"))
                streams.append(_rows(member, _layout(member)))
            for i, rows in enumerate(zip(*streams, strict=True)):
                named = zip(self.fields, rows, strict=True)
                yield {name: plain(self.path, self.place(i, name), row) for name, row in named}


def npy_fields(path: Path) -> tuple[str, ...] | None:
    """Field names of a structured array, none of a plain one; None for objects, which may have any. DataError if
    damaged.
    """
    with _reading(path), path.open("rb") as file:
        dtype = _layout(file).dtype
    return None if dtype.hasobject else dtype.names or ()


def npy_value(path: Path) -> object:
    """A structured array of one record as a dict, records inside it too. Raises DataError if damaged."""
    with _reading(path):
        return unwrapped(np.load(path, allow_pickle=False))


def npz_values(path: Path, names: Iterable[str], *, trust_pickle: bool) -> dict[str, object]:
    """Whole arrays of an archive, unwrapped. Raises DataError if damaged, or if they are objects without trust."""
    with _reading(path), open_archive(path, whole=True) as archive:
        for name in names:
            with archive.open(f"{name}.npy") as member:
                if _layout(member).dtype.hasobject and not trust_pickle:
                    raise DataError.at(path, f"{name} {NEEDS_TRUST}")
        with np.load(path, allow_pickle=trust_pickle) as arrays:
            return {name: unwrapped(arrays[name]) for name in names}


def npz_arrays(path: Path) -> tuple[str, ...]:
    """Names of an archive's arrays; DataError if damaged."""
    with _reading(path), open_archive(path, whole=False) as archive:
        return tuple(n.removesuffix(".npy") for n in archive.namelist() if n.endswith(".npy"))


@contextmanager
def _reading(path: Path) -> Iterator[None]:
    """Damaged bytes become a DataError."""
    try:
        yield
    except BROKEN as error:
        raise DataError.at(path, f"damaged: {' '.join(str(error).split())[:200]}") from error
    except OSError as error:
        raise DataError.at(path, f"cannot be read: {error.strerror}") from error


def _layout(stream: IO[bytes]) -> _Layout:
    """The header of an array; leaves the stream at its first value."""
    version = np.lib.format.read_magic(stream)
    if version == (1, 0):
        shape, fortran, dtype = np.lib.format.read_array_header_1_0(stream)
    elif version == (2, 0):
        shape, fortran, dtype = np.lib.format.read_array_header_2_0(stream)
    else:
        raise ValueError(f"an array of format {version[0]}.{version[1]}; 1.0 and 2.0 are read")
    return _Layout(dtype, shape, fortran)


def _rows(stream: IO[bytes], layout: _Layout) -> Iterator[Any]:
    """The rows of an array after its header, one in memory at a time."""
    shape = layout.shape[1:]
    size = math.prod(shape) * layout.dtype.itemsize
    for i in range(layout.shape[0]):
        content = stream.read(size)
        if len(content) < size:
            raise EOFError(f"ends early: {layout.shape[0]} frames are announced and {i} are there")
        yield np.frombuffer(content, layout.dtype).reshape(shape)[()]

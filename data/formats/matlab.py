"""MATLAB files, read whole: versions 4 to 7 by scipy, 7.3 (HDF5) by h5py (extra `hdf5`).

scipy trusts the types and sizes that a file states, and a damaged one can end the process; so they are checked first.
Source: MAT-File Format, Level 5, The MathWorks.
"""

import math
import mmap
import os
import re
import struct
import zlib
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from itertools import zip_longest
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import scipy
from numpy.typing import NDArray

from data.errors import DataError

Value: TypeAlias = "NDArray[Any] | dict[str, Value] | list[dict[str, Value]]"
"""An array in MATLAB's shape; a struct; a struct array, column by column."""
Bytes: TypeAlias = "bytes | mmap.mmap"
BYTE_ORDER, VERSION, HEADER = 126, 124, 128
"""Positions in a file of version 5 to 7: of the byte order and the version, and the end of its header."""
HDF5_SIGNATURE = b"\x89HDF\r\n\x1a\n"
HDF5_AT = (0, 512)  # Positions of the signature in version 7.3: at the start, or after MATLAB's own header
WIDTHS_4 = {0: 8, 1: 4, 2: 4, 3: 2, 4: 2, 5: 1}  # bytes of a number of version 4, by its class
BROKEN = (
    *(ValueError, TypeError, KeyError, IndexError, AttributeError, RuntimeError, OverflowError, OSError),
    *(zlib.error, struct.error),
)  # Errors of the readers for damaged bytes
INT32, UINT32, MATRIX, COMPRESSED = 5, 6, 14, 15
TEXT = frozenset({1, 16})
NUMBERS = frozenset({*range(1, 8), 9, 12, 13, *TEXT, 17, 18})  # Element types of text and numbers
CELL, STRUCT, OBJECT, CHAR, SPARSE, FUNCTION, OPAQUE = 1, 2, 3, 4, 5, 16, 17
NUMERIC = range(6, 16)  # Classes of matrices of numbers
COMPLEX = 0x800
DEEPEST = 32  # Most structs or cell arrays inside each other
BLANK = 1 << 12  # Most elements without content
HEAD = 1 << 16  # Bytes of a compressed variable that hold its name and fields
LIMIT = 2**31 - 1  # Most bytes of a variable in versions 5 to 7


class Variable(NamedTuple):
    """A variable: number of elements, and the fields of a struct."""

    size: int
    fields: tuple[str, ...] = ()


def variables(path: Path) -> dict[str, Variable]:
    """The variables of a file by name, their values unread. DataError as `load`."""
    with _opened(path) as (content, order):
        if order == "4":
            return {name: Variable(math.prod(shape)) for name, shape, _ in scipy.io.whosmat(path)}
        if order == "hdf5":
            with _hdf5(path) as file:
                return {name: _described(item) for name, item in _named(file)}
        return {header.name: Variable(header.size, header.fields) for header, *_ in _matrices(content, order)}


def load(path: Path, names: Collection[str]) -> dict[str, Value]:
    """Those of the named variables that are there, numbers in the type of their class. Raises DataError for a damaged
    file or another kind of file, for 7.3 without h5py, and beyond the memory.
    """
    with _opened(path) as (content, order):
        if order == "hdf5":
            with _hdf5(path) as file:
                sizes: list[int] = []
                file.visititems(lambda _, item: sizes.append(item.nbytes if hasattr(item, "dtype") else 0))
                _must_fit(sum(sizes))
                return {name: _of_hdf5(file, item) for name, item in _named(file) if name in names}
        if order != "4":
            for header, packed, start, end in _matrices(content, order):
                if header.name in names:
                    _must_fit(2 * (end - start))
                    data = _inflated(content[start:end], order) if packed else content
                    if _check(data, *((8, len(data)) if packed else (start, end)), order):
                        raise DataError.at(path, f"{header.name} holds complex numbers; real ones are needed")
        found = scipy.io.loadmat(path, variable_names=list(names), mat_dtype=True)
        return {name: _of_scipy(value) for name, value in found.items() if name in names}


def save(path: Path, values: Mapping[str, object]) -> None:
    """Write a file of version 5: dicts as structs, vectors as rows. The same values give the same bytes."""
    scipy.io.savemat(str(path), dict(values))
    with path.open("r+b") as file:
        file.write(b"MATLAB 5.0 MAT-file".ljust(VERSION - 8))  # scipy states the time


CELLS = "cell array or objects"


def kind_of(value: object) -> str:
    """What a value is, in words."""
    if isinstance(value, Mapping):
        return "a struct"
    if isinstance(value, list):
        return CELLS
    if not isinstance(value, np.ndarray):
        return "a sparse matrix" if scipy.sparse.issparse(value) else f"a {type(value).__name__}"
    kinds = {"O": CELLS, "U": "text", "S": "text", "c": "complex numbers", "V": "records"}
    return kinds.get(value.dtype.kind, "numbers")


@contextmanager
def _opened(path: Path) -> Iterator[tuple[mmap.mmap, str]]:
    """The bytes of a file with their order (`<` or `>`), `4` or `hdf5`; errors of the readers become a DataError."""
    try:
        with path.open("rb") as file:
            order = _order(path, file.read(HDF5_AT[-1] + len(HDF5_SIGNATURE)))
            with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
                if order == "4":
                    _check_version_4(content)
                yield content, order
    except MemoryError as error:
        right = "save its frames as .npy or .npz, which are read one at a time"
        raise DataError.at(path, f"larger than the memory; {right}") from error
    except (FileNotFoundError, PermissionError, IsADirectoryError) as error:
        raise DataError.at(path, f"cannot be read: {error.strerror}") from error
    except (*BROKEN, scipy.io.matlab.MatReadError) as error:
        raise DataError.at(path, f"damaged: {' '.join(str(error).split())[:200]}") from error


def _order(path: Path, head: bytes) -> str:
    order = {b"IM": "<", b"MI": ">"}.get(head[BYTE_ORDER:HEADER])
    version = struct.unpack_from(f"{order}H", head, VERSION)[0] >> 8 if order else 0
    if version == 2 or any(head[at : at + len(HDF5_SIGNATURE)] == HDF5_SIGNATURE for at in HDF5_AT):
        return "hdf5"
    if order and version == 1:
        return order
    if 0 in head[:4] and len(head) >= 20:
        return "4"
    raise DataError.at(path, "not a MATLAB file of version 4 to 7.3")


def _check_version_4(content: mmap.mmap) -> None:
    """Raise ValueError where a name or matrix is longer than the file: scipy's reader takes memory for it first."""
    at, order = 0, "<" if 0 <= struct.unpack_from("<i", content)[0] <= 5000 else ">"
    while at < len(content):
        kind, rows, columns, is_complex, name = struct.unpack_from(f"{order}5i", content, at)
        width = WIDTHS_4.get(kind // 10 % 10)
        if width is None or min(rows, columns, name) < 0:
            raise ValueError("no header of a matrix of version 4")
        at += 20 + name + rows * columns * width * (2 if is_complex else 1)
        if at > len(content):
            raise ValueError("a matrix is longer than the file")


def _must_fit(count: int) -> None:
    """Raise MemoryError for more bytes than the machine has."""
    if hasattr(os, "sysconf") and count > os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"):
        raise MemoryError


class _Header(NamedTuple):
    """A matrix's class, whether it is complex, its number of elements, name and fields."""

    kind: int
    is_complex: bool
    size: int
    name: str
    fields: tuple[str, ...]


def _matrices(content: mmap.mmap, order: str) -> Iterator[tuple[_Header, bool, int, int]]:
    """The variables: header, whether compressed, start and end."""
    names = set()
    for kind, start, end in _elements(content, HEADER, len(content), order):
        if kind not in (MATRIX, COMPRESSED):
            raise ValueError(f"an element of type {kind} is where a variable should be")
        data, at = (content, start) if kind == MATRIX else (_unpacked(content[start : start + HEAD], HEAD), 8)
        header = _header(data, _elements(data, at, len(data) if kind == COMPRESSED else end, order), order)
        if header.name in names:
            raise ValueError(f"two variables {header.name}")
        names.add(header.name)
        yield header, kind == COMPRESSED, start, end


def _unpacked(content: bytes, most: int) -> bytes:
    return zlib.decompressobj().decompress(content, most)


def _inflated(content: bytes, order: str) -> bytes:
    """A compressed variable, which states its size."""
    kind, count = struct.unpack_from(f"{order}II", _unpacked(content, 8))
    _must_fit(2 * count)
    stream = zlib.decompressobj()
    data = stream.decompress(content, count + 9)
    if kind != MATRIX or not stream.eof or len(data) != count + 8:
        raise ValueError(f"ends early: a compressed variable of {count} bytes is cut off or goes on")
    return data


def _elements(data: Bytes, at: int, end: int, order: str) -> Iterator[tuple[int, int, int]]:
    """Type, start and end of the elements between two positions."""
    while at < end:
        if end - at < 8:
            raise ValueError(f"ends early: {end - at} bytes where an element begins")
        kind, count = struct.unpack_from(f"{order}II", data, at)
        start, after = at + 8, at + 8 + count + (0 if kind == COMPRESSED else -count % 8)
        if kind >> 16:
            kind, count, start, after = kind & 0xFFFF, kind >> 16, at + 4, at + 8
        if after > end or start + count > after:
            raise ValueError(f"ends early: {count} bytes are announced and {end - start} are left")
        yield kind, start, start + count
        at = after


def _header(data: Bytes, elements: Iterator[tuple[int, int, int]], order: str) -> _Header:
    """Take the elements of a header."""

    def integers(most: int) -> tuple[int, ...]:
        kind, start, end = next(elements, (0, 0, 0))
        count = (end - start) // 4
        if kind not in (INT32, UINT32) or not 0 < count <= most or (end - start) % 4:
            raise ValueError(f"an element of type {kind} is where integers should be")
        return struct.unpack_from(f"{order}{count}i", data, start)

    def text() -> bytes:
        kind, start, end = next(elements, (0, 0, 0))
        if kind not in TEXT:
            raise ValueError(f"an element of type {kind} is where text should be")
        return bytes(data[start:end])

    flags = integers(2)
    kind = flags[0] & 0xFF
    shape = (1,) if kind == OPAQUE else integers(32)  # objects of MATLAB's newer classes have no dimensions
    if len(flags) != 2 or min(shape) < 0:
        raise ValueError(f"a matrix of size {'x'.join(map(str, shape))}")
    name = text().decode("latin-1")
    for _ in range({OBJECT: 1, OPAQUE: 2}.get(kind, 0)):
        text()  # names of classes
    fields: tuple[str, ...] = ()
    if kind in (STRUCT, OBJECT):
        (width,), names = integers(1), text()
        if width < 1 or len(names) % width:
            raise ValueError("a struct whose field names cannot be told apart")
        fields = tuple(names[i : i + width].split(b"\0")[0].decode("latin-1") for i in range(0, len(names), width))
    return _Header(kind, bool(flags[0] & COMPLEX), math.prod(shape), name, fields)


def _check(data: Bytes, at: int, end: int, order: str, depth: int = 0) -> bool:
    """Whether a matrix holds complex numbers, all the way down; ValueError unless it has the elements it announces."""
    if at == end:  # a field that was never set
        return False
    elements = _elements(data, at, end, order)
    header = _header(data, elements, order)
    inside = list(elements)
    if header.kind in NUMERIC or header.kind in (CHAR, SPARSE):
        needed, kinds = (3 if header.kind == SPARSE else 1) + header.is_complex, NUMBERS
    elif header.kind in (CELL, STRUCT, OBJECT, FUNCTION, OPAQUE):
        needed, kinds = header.size, frozenset({MATRIX})
        if header.kind in (STRUCT, OBJECT):
            needed *= len(header.fields)
    else:
        raise ValueError(f"a matrix of class {header.kind}")
    if depth > DEEPEST or len(inside) != needed or any(kind not in kinds for kind, *_ in inside):
        raise ValueError(f"a matrix of class {header.kind} with {len(inside)} of {needed} elements")
    if header.size > BLANK and (not inside or (header.kind == CHAR and header.size > inside[0][2] - inside[0][1])):
        raise ValueError(f"a matrix of {header.size} elements that are not there")
    is_complex = header.is_complex
    for kind, start, stop in inside:
        if kind == MATRIX:
            is_complex |= _check(data, start, stop, order, depth + 1)
    return is_complex


def _of_scipy(value: Any) -> Any:
    if isinstance(value, np.ndarray) and value.dtype == object:  # a cell array
        cells = [_of_scipy(item) for item in value.ravel(order="F")]
        if cells and all(isinstance(cell, dict) for cell in cells):
            return cells
        held = np.fromiter(cells, object, len(cells))
        return held if min(value.shape) < 2 else _rows(held.reshape(value.shape, order="F"))
    if not isinstance(value, np.ndarray) or not value.dtype.names:
        return value
    found = [{name: _of_scipy(item[name]) for name in value.dtype.names} for item in value.ravel(order="F")]
    return found[0] if len(found) == 1 else found


def _rows(cells: NDArray[Any]) -> NDArray[Any]:
    """A matrix of numbers, of cells with one or none; else of each row's words and numbers; other cells in turn."""
    kinds, most = {kind_of(cell) for cell in cells.flat}, max(map(np.size, cells.flat))
    if kinds == {"numbers"} and most == 1:
        return np.array([[cell.item() if cell.size else np.nan for cell in row] for row in cells])
    if kinds != {"numbers", "text"} or any(min(cell.shape, default=0) > 1 for cell in cells.flat):
        return cells.ravel(order="F")
    rows = [[str(item) for cell in row for item in cell.ravel().tolist() or [""]] for row in cells]
    return np.array([*zip_longest(*rows, fillvalue="")]).T


# Version 7.3 stores arrays with their dimensions reversed. A struct is a group with an item per field; the fields of a
# struct array are datasets of references, one per element.


@contextmanager
def _hdf5(path: Path) -> Iterator[Any]:
    try:
        import h5py
    except ImportError:
        right = "pip install 'slamref[hdf5]', or save it with '-v7'"
        raise DataError.at(path, f"MATLAB 7.3 (HDF5) needs the package h5py: {right}") from None
    with h5py.File(path, "r") as file:
        yield file


def _named(file: Any) -> list[tuple[str, Any]]:
    return [(name, file[name]) for name in file if not name.startswith("#")]


def _class(item: Any) -> str:
    name = item.attrs.get("MATLAB_class", b"")
    return name.decode("latin-1") if isinstance(name, bytes) else str(name)


def _described(item: Any) -> Variable:
    """Raises ValueError where the fields of a struct array differ in length."""
    if hasattr(item, "dtype"):
        return Variable(int(item.size))
    sizes = {int(item[name].size) for name in item if _is_listed(item[name])} or {1}
    if len(sizes) > 1:
        raise ValueError(f"fields of {item.name} have {sorted(sizes)} elements")
    return Variable(sizes.pop(), tuple(item))


def _is_listed(item: Any) -> bool:
    """Whether a field has a reference for each element."""
    return hasattr(item, "dtype") and item.dtype.kind == "O" and _class(item) != "cell"


def _of_hdf5(file: Any, item: Any) -> Any:
    if not hasattr(item, "dtype"):
        size, fields = _described(item)
        # elements are stored in MATLAB's order, columns first
        columns = [
            [_of_hdf5(file, file[reference]) for reference in item[name][()].ravel()] if _is_listed(item[name])
            else [_of_hdf5(file, item[name])] for name in fields
        ]  # fmt: skip
        found = [dict(zip(fields, row, strict=True)) for row in zip(*columns, strict=True)]
        return found[0] if size == 1 and found else found
    kind, content = _class(item), item[()]
    if item.attrs.get("MATLAB_empty", 0):
        return np.zeros(tuple(int(n) for n in content.ravel()))
    if kind == "cell":
        cells = [_of_hdf5(file, file[reference]) for reference in content.ravel()]
        return _of_scipy(np.fromiter(cells, object, len(cells)).reshape(content.shape[::-1], order="F"))
    if kind == "char":
        return np.array(["".join(map(chr, content.T.ravel()))])
    if item.dtype.kind == "V":
        return np.asarray(content["real"] + 1j * content["imag"]).T
    return np.asarray(content).T


def is_octave(path: Path) -> bool:
    """Whether a file has the first line of Octave's text format."""
    if not path.is_file():
        return False
    with path.open("rb") as file:
        return file.read(20).startswith(b"# Created by Octave")


def octave(path: Path) -> dict[str, Value]:
    """The variables of Octave's text format, text of complex or sparse ones. DataError for a damaged file."""
    rows, found = path.read_text(encoding="utf-8", errors="replace").splitlines()[::-1], dict[str, Value]()
    whole, _ = len(rows), rows.pop()
    try:
        while rows:
            found |= [_octave(rows)]
    except BROKEN as error:
        raise DataError.at(path, f"damaged: {' '.join(str(error).split())[:200]}", line=whole - len(rows)) from None
    return found


def _octave(rows: list[str]) -> tuple[str, Any]:
    """Take a variable off lines, the first of which is last: its name and value."""
    said, data, name = dict[str, str](), list[str](), rows.pop().removeprefix("# name: ")
    while rows and not rows[-1].startswith("# name:"):
        key, colon, value = rows.pop().partition(": ")
        said |= {key[2:]: value} if key.startswith("# ") else {}
        data += [key + colon + value] if key.strip() and not key.startswith("# ") else []
    kind, size = said["type"], [int(said[key]) for key in ("rows", "columns") if key in said]
    if kind.endswith("struct"):
        fields = dict(_octave(rows) for _ in range(int(said["length"])))
        each = () if kind == "scalar struct" else zip(*fields.values(), strict=True)
        return name, [dict(zip(fields, row, strict=True)) for row in each] or fields
    if kind == "cell":
        cells = [_octave(rows)[1] for _ in range(math.prod(size))]
        return name, _of_scipy(np.fromiter(cells, object, len(cells)).reshape(size, order="F"))
    if not re.fullmatch(r"((global|bool|float|u?int\d+) )*(bool|scalar|matrix|(double_)?range)", kind):
        return name, np.array(data)
    numbers, n = [float(v) for row in data for v in row.replace("NA", "nan").split()], int(said.get("ndims", 0))
    if kind.endswith("range"):
        return name, np.arange(numbers[0], numbers[1] + 0.5 * numbers[2], numbers[2]).reshape(1, -1)
    shape = [int(v) for v in numbers[:n]] or size or [1, 1]
    return name, np.array(numbers[n:]).reshape(shape, order="F" if n else "C")

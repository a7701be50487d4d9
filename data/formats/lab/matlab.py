"""MATLAB files of versions 5 to 7, read and written incrementally: a struct array comes one element at a time.

A file is a header of 128 bytes and elements, each a tag (type, number of bytes) and its content; a variable is a
matrix element, in version 7 inside a zlib stream of its own. Source: MAT-File Format, Level 5, The MathWorks.
"""

from __future__ import annotations

import math
import os
import struct
import zlib
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import IO, Any, BinaryIO, Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

from data.errors import DataError

HEADER_BYTES, ENDIAN_AT, VERSION_AT = 128, 126, 124
HDF5_SIGNATURE = b"\x89HDF\r\n\x1a\n"
HDF5_AT = (0, 512)
"""Positions of the signature in version 7.3: at the start, or after MATLAB's own header."""


class DamagedError(Exception):
    """Damaged bytes; becomes a DataError where the file is known."""


class Source(Protocol):
    """Bytes in their order; `position` counts those read or skipped."""

    position: int

    def read(self, count: int) -> bytes:
        """The next `count` bytes, all of them."""

    def skip(self, count: int) -> None:
        """Skip `count` bytes."""


class Plain:
    """The bytes of the file itself, from `position` on."""

    def __init__(self, file: BinaryIO, position: int) -> None:
        self._file, self.position = file, position
        self._size = os.fstat(file.fileno()).st_size
        file.seek(position)

    def read(self, count: int) -> bytes:
        """See `Source`."""
        # a damaged count would reserve gigabytes before the end of the file is reached
        if self.position + count > self._size:
            raise DamagedError(f"ends early: {count} bytes are announced and {self._size - self.position} are left")
        self.position += count
        return self._file.read(count)

    def skip(self, count: int) -> None:
        """See `Source`."""
        self.position += count
        self._file.seek(count, os.SEEK_CUR)


class Inflated:
    """The content of a zlib stream of `count` bytes at the file's position, unpacked as it is read."""

    CHUNK = 1 << 16

    def __init__(self, file: BinaryIO, count: int) -> None:
        self._file, self._left, self._pending, self.position = file, count, b"", 0
        self._stream = zlib.decompressobj()

    def _some(self, most: int) -> bytes:
        """Between 1 and `most` bytes, none at the end."""
        while not self._stream.eof:
            if not self._pending:
                self._pending = self._file.read(min(self.CHUNK, self._left))
                self._left -= len(self._pending)
            last = not self._pending
            piece = self._stream.decompress(self._pending, most)
            self._pending = self._stream.unconsumed_tail
            if piece or last:
                return piece
        return b""

    def read(self, count: int) -> bytes:
        """See `Source`."""
        pieces, left = [], count
        while left:
            piece = self._some(left)
            if not piece:
                raise DamagedError(f"ends early: {count} bytes are announced and {count - left} are left")
            pieces.append(piece)
            left -= len(piece)
        self.position += count
        return b"".join(pieces)

    def skip(self, count: int) -> None:
        """See `Source`."""
        while count:
            count -= len(self.read(min(count, self.CHUNK)))

    def close(self) -> None:
        """Read to the checksum at the end."""
        while self._some(self.CHUNK):
            pass
        if not self._stream.eof:
            raise DamagedError("ends early: a compressed variable is cut off")


@contextmanager
def open_mat(path: Path) -> Iterator[tuple[BinaryIO, str]]:
    """The file and its byte order; damaged bytes become a DataError."""
    try:
        with path.open("rb") as file:
            yield file, _byte_order(path, file.read(HDF5_AT[-1] + len(HDF5_SIGNATURE)))
    except (DamagedError, zlib.error) as error:
        raise DataError.at(path, f"damaged: {error}") from error
    except OSError as error:
        raise DataError.at(path, f"cannot be read: {error.strerror}") from error


def is_hdf5(path: Path) -> bool:
    """Whether a file is of version 7.3. Raises DataError if it cannot be read."""
    try:
        with path.open("rb") as file:
            return _has_signature(file.read(HDF5_AT[-1] + len(HDF5_SIGNATURE)))
    except OSError as error:
        raise DataError.at(path, f"cannot be read: {error.strerror}") from error


def _has_signature(head: bytes) -> bool:
    return any(head[at : at + len(HDF5_SIGNATURE)] == HDF5_SIGNATURE for at in HDF5_AT)


def _byte_order(path: Path, head: bytes) -> str:
    hdf5 = _has_signature(head)
    order = {b"IM": "<", b"MI": ">"}.get(head[ENDIAN_AT:HEADER_BYTES])
    version = struct.unpack(f"{order}H", head[VERSION_AT:ENDIAN_AT])[0] if order else 0
    if hdf5 or version >> 8 == 2:
        raise DataError.at(path, f"MATLAB 7.3 (HDF5) is not read; save it with save('{path.name}', ..., '-v7')")
    if order and version >> 8 == 1:
        return order
    if 0 in head[:4] and len(head) >= 20:
        raise DataError.at(path, "MATLAB version 4, which has no structs; save it with -v7")
    raise DataError.at(path, "not a MATLAB file of version 5 to 7")


INT8, INT32, UINT32, MATRIX, COMPRESSED = 1, 5, 6, 14, 15
STORED = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
"""NumPy types of the numeric element types."""
CELL, STRUCT, OBJECT, CHAR, SPARSE, FUNCTION, OPAQUE = 1, 2, 3, 4, 5, 16, 17
KINDS = {CELL: "cell array", OBJECT: "object", CHAR: "text", SPARSE: "sparse matrix", FUNCTION: "function"}
NUMERIC = {6: "f8", 7: "f4", 8: "i1", 9: "u1", 10: "i2", 11: "u2", 12: "i4", 13: "u4", 14: "i8", 15: "u8"}
"""NumPy types of the numeric classes; the values may be stored in a smaller type."""
COMPLEX = 0x08


@dataclass(frozen=True)
class Unread:
    """A value of an unsupported kind (text, cell array, ...)."""

    kind: str


Value: TypeAlias = "NDArray[Any] | Struct | Unread"


@dataclass(frozen=True, eq=False)
class Struct:
    """A struct array: its shape, and its elements column by column, each a dict by field name."""

    shape: tuple[int, ...]
    elements: tuple[dict[str, Value], ...]


@dataclass(frozen=True)
class Variable:
    """A variable of a file: its position, name, kind (`struct`, `numbers`, `text`, ...), shape and fields."""

    path: Path
    start: int
    name: str
    kind: str
    shape: tuple[int, ...]
    fields: tuple[str, ...] = ()

    def __len__(self) -> int:
        return math.prod(self.shape)


@dataclass(frozen=True)
class _Matrix:
    """The header of a matrix element, and the position of its end."""

    kind: int
    flags: int
    shape: tuple[int, ...]
    name: str
    end: int


class _Reader:
    """Elements of a source in a byte order (`<` or `>`)."""

    def __init__(self, source: Source, order: str) -> None:
        self.source, self.order = source, order

    def tag(self) -> tuple[int, int, bytes | None]:
        """Type, number of bytes, and the content if it is inside the tag."""
        first, second = struct.unpack(self.order + "II", raw := self.source.read(8))
        if first >> 16:
            return first & 0xFFFF, first >> 16, raw[4 : 4 + (first >> 16)]
        return first, second, None

    def numbers(self, *, whole: bool = False) -> NDArray[Any]:
        """A numeric element (K,), of integers if `whole`."""
        kind, count, content = self.tag()
        if kind not in STORED:
            raise DamagedError(f"an element of type {kind} is where numbers should be")
        if content is None:
            content = self.source.read(count)
            self.source.skip(-count % 8)
        dtype = np.dtype(self.order + STORED[kind])
        if whole and dtype.kind == "f":
            raise DamagedError("fractions are where whole numbers should be")
        if len(content) != count or count % dtype.itemsize:
            raise DamagedError(f"an element of {count} bytes does not hold numbers of {dtype.itemsize} bytes")
        return np.frombuffer(content, dtype)

    def header(self) -> _Matrix | None:
        """Tag, flags, dimensions and name of a matrix element; None for the empty one of an unset field."""
        kind, count, _ = self.tag()
        if kind != MATRIX:
            raise DamagedError(f"an element of type {kind} is where a matrix should be")
        if not count:
            return None
        end = self.source.position + count
        flags = self.numbers(whole=True)
        if len(flags) != 2:
            raise DamagedError("a matrix without flags")
        kind = int(flags[0]) & 0xFF
        # objects of MATLAB's newer classes have no dimensions
        shape = () if kind == OPAQUE else tuple(int(n) for n in self.numbers(whole=True))
        if any(n < 0 for n in shape):
            raise DamagedError(f"a matrix of size {'x'.join(map(str, shape))}")
        name = self.numbers().tobytes().decode("latin-1")
        return _Matrix(kind, int(flags[0]) >> 8 & 0xFF, shape, name, end)

    def fields(self) -> tuple[str, ...]:
        """Names of a struct's fields."""
        width = self.numbers(whole=True)
        names = self.numbers().tobytes()
        if len(width) != 1 or width[0] < 1 or len(names) % int(width[0]):
            raise DamagedError("a struct whose field names cannot be told apart")
        cut = int(width[0])
        parts = [names[i : i + cut] for i in range(0, len(names), cut)]
        return tuple(part.split(b"\0")[0].decode("latin-1") for part in parts)

    def leave(self, matrix: _Matrix) -> None:
        """Skip to the end of a matrix."""
        if self.source.position > matrix.end:
            raise DamagedError("a matrix is longer than announced")
        self.source.skip(matrix.end - self.source.position)

    def value(self) -> Value:
        """A whole matrix."""
        matrix = self.header()
        if matrix is None:
            return np.empty((0, 0))
        result: Value
        if matrix.kind == STRUCT:
            result = Struct(matrix.shape, tuple(self.elements(matrix, self.fields(), None)))
        elif matrix.kind not in NUMERIC or matrix.flags & COMPLEX:
            result = Unread(_kind(matrix))
        else:
            content = self.numbers()
            if len(content) != math.prod(matrix.shape):
                raise DamagedError(f"{len(content)} numbers for a matrix of size {'x'.join(map(str, matrix.shape))}")
            with np.errstate(invalid="ignore"):  # values that the class cannot hold are undefined
                content = content.astype(NUMERIC[matrix.kind], copy=False)
            result = content.reshape(matrix.shape, order="F")
        self.leave(matrix)
        return result

    def elements(
        self, matrix: _Matrix, fields: tuple[str, ...], wanted: Collection[str] | None
    ) -> Iterator[dict[str, Value]]:
        """Elements of a struct array after its header and field names."""
        for _ in range(math.prod(matrix.shape) if fields else 0):
            element: dict[str, Value] = {}
            for name in fields:
                if self.source.position >= matrix.end:
                    raise DamagedError("a struct array has fewer elements than announced")
                if wanted is None or name in wanted:
                    element[name] = self.value()
                else:
                    self.source.skip(self.tag()[1])
            yield element


def variables(path: str | PathLike[str]) -> tuple[Variable, ...]:
    """The variables of a file, their values unread; DataError for another kind or version of file, or a damaged one."""
    path, found = Path(path), []
    with open_mat(path) as (file, order):
        size, position = os.fstat(file.fileno()).st_size, HEADER_BYTES
        while position < size:
            kind, count, _ = _Reader(Plain(file, position), order).tag()
            if position + 8 + count > size:
                raise DamagedError(f"ends early: {count} bytes are announced and {size - position - 8} are left")
            if kind in (MATRIX, COMPRESSED):
                reader, _ = _at(file, order, position)
                matrix = reader.header()
                if matrix is not None:
                    fields = reader.fields() if matrix.kind == STRUCT else ()
                    found.append(Variable(path, position, matrix.name, _kind(matrix), matrix.shape, fields))
            position += 8 + count
    return tuple(found)


def read(variable: Variable) -> Value:
    """The value of a variable in MATLAB's class and shape; DataError if the file is damaged."""
    with open_mat(variable.path) as (file, order):
        reader, close = _at(file, order, variable.start)
        value = reader.value()
        close()
        return value


def elements(variable: Variable, wanted: Collection[str] | None = None) -> Iterator[dict[str, Value]]:
    """Elements of a struct array in MATLAB's order, one in memory at a time, with the `wanted` fields.

    Raises DataError if the variable is no struct, or the file is damaged.
    """
    with open_mat(variable.path) as (file, order):
        reader, close = _at(file, order, variable.start)
        matrix = reader.header()
        if matrix is None or matrix.kind != STRUCT:
            raise DataError.at(variable.path, f"{variable.name} is of kind {variable.kind}; a struct array is needed")
        yield from reader.elements(matrix, reader.fields(), wanted)
        close()


def _kind(matrix: _Matrix) -> str:
    if matrix.kind == STRUCT:
        return "struct"
    if matrix.kind in NUMERIC:
        return "complex numbers" if matrix.flags & COMPLEX else "numbers"
    return KINDS.get(matrix.kind, "object")


def _at(file: BinaryIO, order: str, start: int) -> tuple[_Reader, Callable[[], None]]:
    """A reader of the top-level matrix at `start`, and a function to call after reading it."""
    plain = Plain(file, start)
    kind, count, _ = _Reader(plain, order).tag()
    if kind != COMPRESSED:
        return _Reader(Plain(file, start), order), lambda: None
    inflated = Inflated(file, count)
    return _Reader(inflated, order), inflated.close


LIMIT = 2**31 - 1
"""Most bytes of a variable in versions 5 to 7."""
NAME_BYTES = 32
"""Bytes of a field name, with its closing zero."""
VERSION = 0x0100


def write_struct_array(
    file: IO[bytes],
    shown: str,
    name: str,
    fields: Sequence[str],
    count: int,
    elements: Iterable[Mapping[str, NDArray[Any]]],
) -> None:
    """Write a file whose one variable `name` is a struct array of 1 x `count` elements with real numeric fields.

    Scalars become 1x1 and vectors rows. DataError, as soon as the size is known, if the variable exceeds 2 GiB.

    Args:
        file: a new seekable file.
        shown: its name in messages.
        name: of the variable.
        fields: names, at most 31 letters.
        count: number of elements.
        elements: exactly that many, each with all fields.
    """
    file.write(b"MATLAB 5.0 MAT-file".ljust(124) + struct.pack("<H2s", VERSION, b"IM"))
    start = file.tell() + 8
    names = b"".join(field.encode("ascii").ljust(NAME_BYTES, b"\0") for field in fields)
    # the number of bytes is filled in at the end
    file.write(struct.pack("<II", MATRIX, 0) + _head(STRUCT, (1, count), name))
    file.write(struct.pack("<HHi", INT32, 4, NAME_BYTES) + _element(INT8, names))
    for i, element in enumerate(elements):
        content = b"".join(_matrix(element[field]) for field in fields)
        bytes_now = file.tell() - start
        if (not i and bytes_now + len(content) * count > LIMIT) or bytes_now + len(content) > LIMIT:
            total = (bytes_now + len(content) * count) / 2**30
            raise DataError(f"{shown}: {total:.1f} GiB for {count} frames; a .mat holds 2 GiB, write npy or npz")
        file.write(content)
    end = file.tell()
    file.seek(start - 4)
    file.write(struct.pack("<I", end - start))
    file.seek(end)


def _element(kind: int, content: bytes) -> bytes:
    return struct.pack("<II", kind, len(content)) + content + bytes(-len(content) % 8)


def _head(kind: int, shape: tuple[int, ...], name: str) -> bytes:
    """Flags, dimensions and name."""
    return (
        _element(UINT32, struct.pack("<II", kind, 0))
        + _element(INT32, struct.pack(f"<{len(shape)}i", *shape))
        + _element(INT8, name.encode("ascii"))
    )


def _matrix(value: NDArray[Any]) -> bytes:
    """A numeric array, columns first."""
    array = np.atleast_2d(value)
    code = array.dtype.str[1:]
    kind = next(k for k, stored in NUMERIC.items() if stored == code)
    stored = next(k for k, name in STORED.items() if name == code)
    little = array.astype(array.dtype.newbyteorder("<"), copy=False)
    return _element(MATRIX, _head(kind, array.shape, "") + _element(stored, little.tobytes("F")))

"""Write a struct array as a MATLAB file of version 5, uncompressed, one element in memory at a time."""

from __future__ import annotations

import struct
from collections.abc import Iterable, Mapping, Sequence
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from data.errors import DataError
from data.visual.lab.mat_stream import INT8, INT32, MATRIX, NUMERIC, STORED, STRUCT, UINT32

LIMIT = 2**31 - 1
"""Bytes of a variable in versions 5 to 7."""
NAME_BYTES = 32
"""For each field name, the closing zero included."""
VERSION = 0x0100


def write_struct_array(
    file: IO[bytes],
    said: str,
    name: str,
    fields: Sequence[str],
    count: int,
    elements: Iterable[Mapping[str, NDArray[Any]]],
) -> None:
    """Write a file whose one variable `name` is a struct array of 1 x `count` elements with real numeric fields.

    Scalars become 1x1 and vectors rows, as MATLAB has no fewer than two dimensions.

    Args:
        file: a new one that can seek, little-endian content goes to its beginning.
        said: the file as messages name it.
        name: of the variable.
        fields: names, at most 31 letters.
        count: number of elements.
        elements: exactly that many, each with all fields; all of the size of the first if the limit is to show early.

    Raises:
        DataError: the variable would exceed the 2 GiB of the format.
    """
    file.write(b"MATLAB 5.0 MAT-file".ljust(124) + struct.pack("<H2s", VERSION, b"IM"))
    start = file.tell() + 8
    names = b"".join(field.encode("ascii").ljust(NAME_BYTES, b"\0") for field in fields)
    # the number of bytes is not known before the end
    file.write(struct.pack("<II", MATRIX, 0) + _head(STRUCT, (1, count), name))
    file.write(struct.pack("<HHi", INT32, 4, NAME_BYTES) + _element(INT8, names))
    for i, element in enumerate(elements):
        content = b"".join(_matrix(element[field]) for field in fields)
        bytes_now = file.tell() - start
        if (not i and bytes_now + len(content) * count > LIMIT) or bytes_now + len(content) > LIMIT:
            total = (bytes_now + len(content) * count) / 2**30
            raise DataError(f"{said}: {total:.1f} GiB for {count} frames; a .mat holds 2 GiB, write npy or npz instead")
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

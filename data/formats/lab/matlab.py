"""The bytes of a MATLAB file of versions 5 to 7: its header, byte order, and sources that give as many as asked for."""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO, Protocol

from data.errors import DataError

HEADER_BYTES, ENDIAN_AT, VERSION_AT = 128, 126, 124
HDF5_SIGNATURE = b"\x89HDF\r\n\x1a\n"
HDF5_AT = (0, 512)
"""Where version 7.3 keeps the signature: after MATLAB's own header, or at the start if another program wrote it."""


class DamagedError(Exception):
    """What is wrong with the bytes; turned into a DataError where the file is known."""


class Source(Protocol):
    """Bytes in their order; `position` counts those given or skipped."""

    position: int

    def read(self, count: int) -> bytes:
        """The next `count` bytes, all of them."""
        ...

    def skip(self, count: int) -> None:
        """Leave `count` bytes out."""
        ...


class Plain:
    """The bytes of the file itself, from `position` on."""

    def __init__(self, file: BinaryIO, position: int) -> None:
        self._file, self.position = file, position
        self._size = os.fstat(file.fileno()).st_size
        file.seek(position)

    def read(self, count: int) -> bytes:
        """The next `count` bytes, all of them."""
        # a damaged count would reserve gigabytes before the end of the file is met
        if self.position + count > self._size:
            raise DamagedError(f"ends early: {count} bytes are announced and {self._size - self.position} are left")
        self.position += count
        return self._file.read(count)

    def skip(self, count: int) -> None:
        """Leave `count` bytes out."""
        self.position += count
        self._file.seek(count, os.SEEK_CUR)


class Inflated:
    """What a zlib stream of `count` bytes at the file's place unpacks to, no more of it in memory than is asked for."""

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
        """The next `count` bytes, all of them."""
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
        """Leave `count` bytes out."""
        while count:
            count -= len(self.read(min(count, self.CHUNK)))

    def close(self) -> None:
        """Read to the end, where the checksum is."""
        while self._some(self.CHUNK):
            pass
        if not self._stream.eof:
            raise DamagedError("ends early: a compressed variable is cut off")


@contextmanager
def open_mat(path: Path) -> Iterator[tuple[BinaryIO, str]]:
    """The file and its byte order; whatever is wrong with its bytes becomes a DataError."""
    try:
        with path.open("rb") as file:
            yield file, _byte_order(path, file.read(HDF5_AT[-1] + len(HDF5_SIGNATURE)))
    except (DamagedError, zlib.error) as error:
        raise DataError.at(path, f"damaged: {error}") from error
    except OSError as error:
        raise DataError.at(path, f"cannot be read: {error.strerror}") from error


def _byte_order(path: Path, head: bytes) -> str:
    hdf5 = any(head[at : at + len(HDF5_SIGNATURE)] == HDF5_SIGNATURE for at in HDF5_AT)
    order = {b"IM": "<", b"MI": ">"}.get(head[ENDIAN_AT:HEADER_BYTES])
    version = struct.unpack(f"{order}H", head[VERSION_AT:ENDIAN_AT])[0] if order else 0
    if hdf5 or version >> 8 == 2:
        raise DataError.at(
            path, f"MATLAB 7.3 (HDF5), which is not read; save it with -v7: save('{path.name}', ..., '-v7')"
        )
    if order and version >> 8 == 1:
        return order
    if 0 in head[:4] and len(head) >= 20:
        raise DataError.at(path, "MATLAB version 4, which has no structs; save it with -v7")
    raise DataError.at(path, "not a MATLAB file of version 5 to 7")

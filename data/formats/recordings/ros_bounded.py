"""rosbags within bounds: no read past the end of a file, no chunk larger than stated.

The library allocates any stated length and unpacks everything; a damaged bag would take gigabytes.
"""

from __future__ import annotations

import bz2
import io
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from importlib import import_module
from importlib.metadata import version
from itertools import accumulate
from pathlib import Path
from threading import RLock
from types import SimpleNamespace
from typing import Any
from unittest.mock import patch

import apsw
from rosbags.highlevel import AnyReader, AnyReaderError
from rosbags.interfaces import Nodetype
from rosbags.rosbag1 import Reader as Reader1
from rosbags.rosbag1 import ReaderError as Reader1Error
from rosbags.rosbag1.reader import Header, RecordType
from rosbags.rosbag2 import ReaderError as Reader2Error
from rosbags.rosbag2 import metadata, storage_mcap
from rosbags.rosbag2 import reader as reader2
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, TypesysError, get_typestore
from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError

from data.columns.scans import DENSEST, LARGE
from data.errors import UsageError

lz4: Any = import_module("lz4.frame")
zstd: Any = import_module("compression.zstd" if sys.version_info >= (3, 14) else "backports.zstd")
"""The library's own module."""
LIBRARY = (
    *(AnyReaderError, Reader1Error, Reader2Error, SerdeError, TypesysError),
    *(YAMLError, apsw.Error, zstd.ZstdError),
)
"""Errors of the library, and of its readers of YAML, SQLite and zstd."""
MADE_FOR = "0.11"
"""Version of rosbags with the replaced names."""
PART = 1 << 18
"""Bytes unpacked at a time."""
ZSTD_WINDOW = 23
"""log2 of the largest window of a zstd frame: 8 MB, as RFC 8878 recommends."""
DEEPEST = 100
"""Deepest nesting of YAML."""


class TooLargeError(ValueError):
    """Content that unpacks to more than stated, or more than any log."""


def most_of(size: int) -> int:
    """Most bytes that so many packed ones may become."""
    return max(LARGE, DENSEST * size)


def unpacking(make: Callable[[], Any], packed: Iterable[bytes], most: int) -> Iterator[bytes]:
    """All packed streams, part by part, by decompressors from `make`.

    Raises TooLargeError for more than `most` bytes, EOFError if they are cut off.
    """
    stream, length = None, 0
    for rest in packed:
        while rest:
            stream = stream or make()
            part = stream.decompress(rest, max_length=PART)
            while part or not (stream.eof or stream.needs_input):
                length += len(part)
                if length > most:
                    raise TooLargeError(f"bytes that unpack to more than {most}")
                if part:
                    yield part
                part = b"" if stream.eof else stream.decompress(b"", max_length=PART)
            rest, stream = (stream.unused_data or b"", None) if stream.eof else (b"", stream)
    if stream is not None:
        raise EOFError("packed bytes are cut off")


def unpacked(make: Callable[[], Any], packed: bytes, stated: int | None = None) -> bytes:
    """The whole content, at most `stated` bytes; TooLargeError if that exceeds what logs pack to."""
    most = most_of(len(packed))
    if stated is not None and stated > most:
        raise TooLargeError(f"{len(packed)} bytes that say they unpack to {stated}")
    return b"".join(unpacking(make, [packed], most if stated is None else stated))


def _zstd() -> Any:
    return zstd.ZstdDecompressor(options={zstd.DecompressionParameter.window_log_max: ZSTD_WINDOW})


MAKE: dict[str, Callable[[], Any]] = {"bz2": bz2.BZ2Decompressor, "lz4": lz4.LZ4FrameDecompressor, "zstd": _zstd}


class _File(io.BufferedReader):
    """Allocates no more than the file holds."""

    def read(self, size: int | None = -1, /) -> bytes:
        if size is not None and size > PART:
            here = self.tell()
            size = min(size, max(self.seek(0, io.SEEK_END) - here, 0))
            self.seek(here)
        return super().read(size)


class _Path(type(Path())):  # type: ignore[misc]
    """A path that opens such files."""

    def open(self, mode: str = "r", *rest: Any, **more: Any) -> Any:
        return _File(io.FileIO(self)) if mode == "rb" else super().open(mode, *rest, **more)


class _Reader1(Reader1):
    """Unpacks chunks to at most the size in their header."""

    def read_chunk(self) -> Any:
        assert self.bio is not None
        at = self.bio.tell()
        header = Header.read(self.bio, RecordType.CHUNK)
        stated, method = header.get_uint32("size"), header.get_string("compression")
        self.bio.seek(at)
        chunk = super().read_chunk()
        if method not in MAKE:
            return chunk
        return chunk._replace(decompressor=partial(unpacked, MAKE[method], stated=stated))


class _Unpacking(io.BytesIO):
    """In place of `zstd.open`: a packed file, part by part."""

    def __init__(self, file: Any, mode: str) -> None:
        super().__init__()
        most = most_of(file.seek(0, io.SEEK_END))
        file.seek(0)
        self.parts = unpacking(_zstd, iter(partial(file.read, PART), b""), most)

    def read(self, size: int | None = -1, /) -> bytes:
        """The next part, of whatever size; b"" at the end."""
        return next(self.parts, b"")


class _Yaml(YAML):
    """Refuses deeply nested text, which takes quadratic time."""

    def load(self, stream: Any) -> Any:
        if isinstance(stream, str):
            inside = accumulate((c in "[{") - (c in "]}") for c in stream)
            if max(inside, default=0) > DEEPEST:
                raise TooLargeError(f"YAML nested deeper than {DEEPEST}")
        return super().load(stream)


METHODS: dict[str, Callable[[bytes, int], bytes]] = {
    "": lambda packed, size: packed,
    "lz4": lambda packed, size: unpacked(MAKE["lz4"], packed, size),
    "zstd": lambda packed, size: unpacked(MAKE["zstd"], packed, size),
}
"""Decompression of MCAP, from bytes and the stated size; the library refuses other methods."""
REPLACED = (
    (storage_mcap, "DECOMPRESSORS", METHODS),
    (reader2, "zstd", SimpleNamespace(decompress=partial(unpacked, _zstd), open=_Unpacking)),
    (reader2, "Path", _Path),  # of the file that a packed one is unpacked into
    (reader2, "YAML", _Yaml),
    (metadata, "YAML", _Yaml),
)
"""Module, name, and replacement in readers of ROS 2 bags."""
ALONE = RLock()
"""Serializes replacement and restoration among threads."""


@contextmanager
def bounded() -> Iterator[None]:
    """Read ROS 2 bags within bounds meanwhile; threads take turns, nesting is allowed.

    Raises UsageError if this version of the library lacks a replaced name.
    """
    with ALONE, ExitStack() as stack:
        for module, name, instead in REPLACED:
            if not hasattr(module, name):
                raise UsageError(
                    f"rosbags {version('rosbags')} cannot be kept within bounds: {module.__name__} has no {name}; "
                    f"version {MADE_FOR} is needed"
                )
            stack.enter_context(patch.object(module, name, instead))
        yield


def _named(description: Any) -> set[str]:
    """Types named in a field's description."""
    kind, inside = description
    if kind == Nodetype.NAME:
        return {inside}
    return _named(inside[0]) if kind in (Nodetype.ARRAY, Nodetype.SEQUENCE) else set()


def _definitions(names: set[str]) -> Any:
    """A store of these types and their parts; one of all types would take seconds and megabytes."""
    every, found = get_typestore(Stores.LATEST).fielddefs, dict[str, Any]()
    while names:
        name = names.pop()
        found[name] = every[name]
        names |= {n for _, field in every[name][1] for n in _named(field)} - found.keys()
    store = get_typestore(Stores.EMPTY)
    store.register(found)
    return store


def any_reader(path: Path, names: set[str]) -> Any:
    """The library's reader of a bag, not yet open; `names`: types to define if the bag does not."""
    reader = AnyReader([_Path(path)], default_typestore=_definitions(names))
    if not reader.is2:
        reader.readers = [_Reader1(_Path(path))]
    return reader

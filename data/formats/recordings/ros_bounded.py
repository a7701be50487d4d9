"""The readers of rosbags, which allocate no more than the file holds: a damaged bag may state any length."""

import io
import sys
from importlib import import_module
from pathlib import Path
from typing import Any

import apsw
from rosbags.highlevel import AnyReader, AnyReaderError
from rosbags.interfaces import Nodetype
from rosbags.rosbag1 import ReaderError as Reader1Error
from rosbags.rosbag2 import ReaderError as Reader2Error
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, TypesysError, get_types_from_msg, get_typestore
from ruamel.yaml.error import YAMLError

zstd: Any = import_module("compression.zstd" if sys.version_info >= (3, 14) else "backports.zstd")
LIBRARY = (AnyReaderError, Reader1Error, Reader2Error, SerdeError, TypesysError, YAMLError, apsw.Error, zstd.ZstdError)
"""Errors of the library, and of its readers of YAML, SQLite and zstd."""
PLENTY = 1 << 18  # Bytes that any machine can allocate


class _File(io.BufferedReader):
    """Allocates no more than the file holds."""

    def read(self, size: int | None = -1, /) -> bytes:
        if size is not None and size > PLENTY:
            here = self.tell()
            size = min(size, max(self.seek(0, io.SEEK_END) - here, 0))
            self.seek(here)
        return super().read(size)


class _Path(type(Path())):  # type: ignore[misc]
    """A path that opens such files."""

    def open(self, mode: str = "r", *rest: Any, **more: Any) -> Any:
        return _File(io.FileIO(self)) if mode == "rb" else super().open(mode, *rest, **more)


def _named(description: Any) -> set[str]:
    """Types named in a field's description."""
    kind, inside = description
    if kind == Nodetype.NAME:
        return {inside}
    return _named(inside[0]) if kind in (Nodetype.ARRAY, Nodetype.SEQUENCE) else set()


def any_reader(files: list[Path], names: set[str]) -> Any:
    """The library's reader of a bag's files, not yet open; `names`: types to define if the bag does not, if known."""
    # A store of these types and their parts; one of all types would take seconds and megabytes.
    turtle = get_types_from_msg("float32 x\nfloat32 y\nfloat32 theta\nfloat32 v\nfloat32 w", "turtlesim/msg/Pose")
    every, found = get_typestore(Stores.LATEST).fielddefs | turtle, dict[str, Any]()
    names &= every.keys()
    while names:
        name = names.pop()
        found[name] = every[name]
        names |= {n for _, field in every[name][1] for n in _named(field)} - found.keys()
    store = get_typestore(Stores.EMPTY)
    store.register(found)
    return AnyReader([_Path(path) for path in files], default_typestore=store)

"""Zip files that can be read in little memory: stored or deflated, as NumPy and every common program write them."""

from __future__ import annotations

import tokenize
import zipfile
import zlib
from pathlib import Path

from data.errors import DataError

METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
"""The others take megabytes for a dictionary whose size the file names."""


LARGE, DENSEST = 1 << 26, 100
"""Bytes, and times its compressed size, that an entry which is read whole may inflate to; logs deflate to a tenth."""


BROKEN = (
    *(ValueError, EOFError, KeyError, NotImplementedError, RuntimeError, zipfile.BadZipFile, zlib.error),
    *(SyntaxError, TypeError, tokenize.TokenError),
)
"""What zipfile and NumPy raise for bytes that are not what they should be; the last three for an array's header."""


def open_archive(path: Path, *, whole: bool) -> zipfile.ZipFile:
    """An archive; `whole`: its entries will be read whole, not in pieces.

    Raises:
        DataError: an entry is compressed in another way, or inflates beyond all measure.
        OSError, ValueError, NotImplementedError, zipfile.BadZipFile: it is none, or damaged.
    """
    archive = zipfile.ZipFile(path)
    for entry in archive.infolist():
        if entry.compress_type not in METHODS:
            archive.close()
            what = f"{entry.filename[:60]!r} is compressed by method {entry.compress_type}"
            raise DataError.at(path, f"{what}; stored (0) or deflated (8) is needed")
        if whole and entry.file_size > max(LARGE, DENSEST * entry.compress_size):
            archive.close()
            what = f"{entry.filename[:60]!r} would inflate from {entry.compress_size} to {entry.file_size} bytes"
            raise DataError.at(path, f"{what}; logs deflate to a tenth or so")
    return archive

"""Bytes of a recorded log, packed by gzip or not."""

from __future__ import annotations

import gzip
import hashlib
import io
import zlib
from pathlib import Path

from data.errors import DataError
from data.open_log.archive import DENSEST, LARGE

PART = 1 << 16
"""Bytes that are unpacked at a time."""


def content_of(path: Path) -> tuple[bytes, str]:
    """Bytes of a file, unpacked if its name ends in .gz, and the SHA-256 of the file as it is.

    Raises:
        DataError: the file cannot be read or unpacked.
    """
    try:
        packed = path.read_bytes()
        content = _unpacked(path, packed) if path.suffix.lower() == ".gz" else packed
        return content, hashlib.sha256(packed).hexdigest()
    except gzip.BadGzipFile:
        raise DataError.at(path, "not a gzip file, though named so; pack it, or name it without .gz") from None
    except (EOFError, zlib.error) as error:
        raise DataError.at(path, f"the gzip file is broken or cut off ({error}); a whole one is needed") from None
    except OSError as error:
        raise DataError.at(path, f"cannot be read: {error.strerror}") from None


def _unpacked(path: Path, packed: bytes) -> bytes:
    """The content of a gzip file, which logs are a fifth or so of; more than any log is not unpacked."""
    most = max(LARGE, DENSEST * len(packed))
    parts, length = [], 0
    with gzip.open(io.BytesIO(packed)) as file:
        while part := file.read(PART):
            parts.append(part)
            length += len(part)
            if length > most:
                what = f"{len(packed)} bytes that unpack to more than {most}"
                raise DataError.at(path, f"{what}; logs pack to a fifth or so")
    return b"".join(parts)

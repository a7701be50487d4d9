"""`scans.npz` of an open log folder (docs/log-folder.md): the range scans of a laser log, read in little memory."""

import io
import math
import tokenize
import zipfile
import zlib
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from data.errors import LARGEST, DataError
from data.inputs import Scanner, Scans
from data.se2 import Array
from data.toml_table import TomlTable, finite, positive

METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)  # Others take megabytes for a dictionary as large as stated
LARGE, DENSEST = 1 << 26, 100  # Bytes, and multiple of its compressed size, that an entry may have; logs have ten
BROKEN = (
    *(ValueError, EOFError, KeyError, NotImplementedError, RuntimeError, zipfile.BadZipFile, zlib.error),
    *(SyntaxError, TypeError, tokenize.TokenError),
)  # Errors of zipfile and NumPy for damaged bytes; the last three for an array's header


def open_archive(path: Path, *, whole: bool) -> zipfile.ZipFile:
    """An archive; `whole`: its entries will be read whole. DataError for its compression or size, else of `BROKEN`."""
    archive = zipfile.ZipFile(path)
    for entry in archive.infolist():
        what, stored = "", max(entry.compress_size, entry.file_size * (entry.compress_type == zipfile.ZIP_STORED))
        if entry.compress_type not in METHODS:
            what = f"is compressed by method {entry.compress_type}; stored (0) or deflated (8) is needed"
        elif stored > path.stat().st_size:
            what = f"states {stored} bytes, more than the file has; was it cut off?"
        elif whole and entry.file_size > max(LARGE, DENSEST * entry.compress_size):
            what = f"would inflate from {entry.compress_size} to {entry.file_size} bytes; logs deflate to about a tenth"
        if what:
            archive.close()
            raise DataError.at(path, f"{entry.filename[:60]!r} {what}")
    return archive


FRAME, RANGES = "frame", "ranges"
KEYS = ("angle_min", "angle_step", "max_range", "sigma", "rotation", "translation")  # The last two are optional


def mounting(table: TomlTable) -> tuple[float, tuple[float, float]]:
    """Rotation [rad] and translation [m] of p_sensor = R p_body + T; zero by default."""
    rotation = table.number("rotation", 0.0, "a finite angle (radians)", finite)
    if "translation" not in table:
        return rotation, (0.0, 0.0)
    tx, ty = table.numbers("translation", 2, "two numbers [m] are", finite)
    return rotation, (float(tx), float(ty))


def read_scanner(table: TomlTable) -> Scanner:
    """[scanner], checked."""
    return Scanner(
        table.number("angle_min", None, "a finite angle (radians)", finite),
        table.number("angle_step", None, "an angle other than 0 (radians)", lambda v: finite(v) and v != 0.0),
        table.number("max_range", None, "a finite range > 0 [m]", positive),
        table.number("sigma", None, "a number > 0 [m]", positive), *mounting(table),
    )  # fmt: skip


def read_scans(path: Path, scanner: Scanner, frames: int) -> Scans:
    """The scans of a log of so many frames, 0: no return. DataError for missing, unknown, invalid or object arrays."""
    frame, ranges = _arrays(path)
    if frame.dtype.kind not in "iu" or frame.ndim != 1:
        raise DataError.at(path, f"{_kind(frame)}; whole numbers (S,) are needed", column=FRAME)
    if ranges.dtype.kind not in "fiu" or ranges.ndim != 2 or ranges.shape[1] == 0 or len(ranges) != len(frame):
        wanted = f"numbers ({len(frame)}, B), a row for each frame, are needed"
        raise DataError.at(path, f"{_kind(ranges)}; {wanted}", column=RANGES)
    number = frame.astype(np.float64)  # exact below 2^53, and monotone above
    out, stay = (number < 0) | (number >= frames), np.diff(number, prepend=-1.0) <= 0
    if out.any() or stay.any():
        row = int(np.argmax(out if out.any() else stay))
        what = f"is out of range; there are frames 0 to {frames - 1}"
        if not out.any():
            what = f"follows {frame[row - 1]}; frames must increase from scan to scan"
        raise DataError.at(path, f"scan {row}: {frame[row]} {what}", column=FRAME)
    metres = ranges.astype(np.float64)
    fine = np.isnan(metres) | ((metres >= 0.0) & (metres <= LARGEST))
    if not fine.all():
        row, beam = np.argwhere(~fine)[0].tolist()
        what = f"scan {row}, beam {beam}: {float(metres[row, beam])!r} is not a range; a number from 0 up is needed"
        raise DataError.at(path, f"{what} (0 or NaN: no return)", column=RANGES)
    return Scans(scanner, frame.astype(np.int64), with_returns(metres, scanner.max_range))


def with_returns(ranges: Array, max_range: float) -> Array:
    """Ranges [m] with 0 for no return: NaN, and what is not below `max_range`."""
    return np.where(ranges < max_range, ranges, 0.0)


def scans_content(scans: Scans) -> bytes:
    """The file's bytes, reproducible."""
    buffer = io.BytesIO()
    np.savez_compressed(buffer, frame=scans.frame, ranges=scans.ranges)
    return buffer.getvalue()


def _arrays(path: Path) -> tuple[NDArray[np.generic], NDArray[np.generic]]:
    """Frame and ranges; runs no code of the file, and allocates no more than it holds."""
    try:
        if path.read_bytes()[:6] == np.lib.format.MAGIC_PREFIX:
            raise DataError.at(path, "one array; an npz file with frame and ranges is needed")
        with open_archive(path, whole=True) as archive:
            names = [n.removesuffix(".npy") for n in archive.namelist()]
            for name in (FRAME, RANGES, *names):
                if name not in names:
                    raise DataError.at(path, f"no such array; found {', '.join(names)[:80] or 'none'}", column=name)
                if name not in (FRAME, RANGES):
                    raise DataError.at(path, f"unknown array; known: {FRAME}, {RANGES}", column=name[:40])
            return array_of(archive, FRAME), array_of(archive, RANGES)
    except OSError as error:
        raise DataError.at(path, f"cannot be read: {error.strerror or error}") from None
    except BROKEN as error:
        what = " ".join(str(error).split())[:80]
        raise DataError.at(path, f"not an npz file of plain arrays ({what}); numpy.savez writes one") from None


def array_of(archive: zipfile.ZipFile, name: str) -> NDArray[np.generic]:
    """A named array of an archive; its size is compared with its header before it is allocated."""
    content = io.BytesIO(archive.read(f"{name}.npy"))
    version = np.lib.format.read_magic(content)
    read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, _, dtype = read(content)
    left = len(content.getbuffer()) - content.tell()
    if not dtype.hasobject and math.prod(shape) * dtype.itemsize != left:
        raise ValueError(f"{name} of shape {shape} is {math.prod(shape) * dtype.itemsize} bytes, and {left} are there")
    content.seek(0)
    return np.asarray(np.lib.format.read_array(content, allow_pickle=False))


def _kind(array: NDArray[np.generic]) -> str:
    return f"{array.dtype} of shape {array.shape}"

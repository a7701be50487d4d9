"""A WebM file out of pictures: OpenCV's VP8, with the same bytes for the same pictures.

Browsers play VP8 without further libraries; they refuse the MPEG-4 that OpenCV puts into MP4 files.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType

import cv2
import numpy as np

from data.errors import SlamrefError

Image = np.ndarray[tuple[int, ...], np.dtype[np.uint8]]

CODEC = "VP80"
EXPECTED = b"'VP80' is not supported with codec id"
"""OpenCV looks the codec up in a list that WebM has none of, says so on the standard error stream, and goes on."""

# EBML elements (RFC 8794, RFC 9559): id, and whether its content is further elements
SEGMENT, TRACKS, TRACK_ENTRY, TRACK_UID = 0x18538067, 0x1654AE6B, 0xAE, 0x73C5
TAGS, TAG, TARGETS, TAG_TRACK_UID = 0x1254C367, 0x7373, 0x63C0, 0x63C5
INSIDE = {SEGMENT, TRACKS, TRACK_ENTRY, TAGS, TAG, TARGETS}
DRAWN = {TRACK_UID, TAG_TRACK_UID}
"""The track's number, which the muxer draws at random and refers to from the tags."""


class Film:
    """A film that is being written; a context manager, as the file is whole only when it was closed."""

    def __init__(self, path: Path, fps: float, width: int, height: int) -> None:
        """Begin a film of so many pictures a second. Raises SlamrefError if the file cannot be written."""
        self._path = path
        path.parent.mkdir(parents=True, exist_ok=True)
        with _without(EXPECTED):
            fourcc = cv2.VideoWriter.fourcc(*CODEC)
            self._writer = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, fourcc, float(fps), (width, height))
        if not self._writer.isOpened():
            raise SlamrefError(f"{path}: cannot be written as a WebM film (VP8, {width} x {height} pixels)")

    def add(self, image: Image) -> None:
        """The next picture (height, width, 3), blue, green, red."""
        self._writer.write(image)

    def __enter__(self) -> Film:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, fault: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._writer.release()
        if kind is None:
            _number_track(self._path)


@contextmanager
def _without(expected: bytes) -> Iterator[None]:
    """Keep one known line of a compiled library off the standard error stream; whatever else it says goes through."""
    real = os.dup(2)
    with tempfile.TemporaryFile() as said:
        os.dup2(said.fileno(), 2)
        try:
            yield
        finally:
            os.dup2(real, 2)
            said.seek(0)
            for line in said.read().splitlines(keepends=True):
                if expected not in line:
                    os.write(real, line)
            os.close(real)


def _number_track(path: Path) -> None:
    """Give the track the number 1 instead of a random one, in place."""
    with path.open("r+b") as file:
        head = file.read(1 << 16)
        for start, length in [*_drawn(head, 0, len(head))]:
            file.seek(start)
            file.write((1).to_bytes(length, "big"))


def _drawn(data: bytes, at: int, end: int) -> Iterator[tuple[int, int]]:
    """Where the random numbers stand: (offset, length) of each, between two offsets of the file's first bytes."""
    while at < end:
        name, at = _number(data, at, keep_marker=True)
        length, at = _number(data, at, keep_marker=False)
        if name in DRAWN:
            yield at, length
        elif name in INSIDE:
            yield from _drawn(data, at, min(at + length, end))
        at += length


def _number(data: bytes, at: int, *, keep_marker: bool) -> tuple[int, int]:
    """A number of variable length, and the offset behind it: one byte more than the first one has leading zeros.

    An element's id keeps the bit that marks the length, its size does not.
    """
    length = 9 - data[at].bit_length()
    value = int.from_bytes(data[at : at + length], "big")
    return (value if keep_marker else value & ~(1 << (7 * length))), at + length

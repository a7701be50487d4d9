"""Arrays packed for the page: quantized differences along time, in the smallest integers that hold them, deflated.

A recording is a list of chunks. A chunk is a header (JSON) and its bytes (raw deflate, in the page as base64):

    {"first": number of its first frame, "frames": number of frames, "arrays": [...], ...added by the scene}

Entries of `arrays` have `name`, `columns`, `rows`, `at` (first byte, after inflating), `size` (bytes of an integer: 1,
2 or 4), `scale`, `log` (values are the exponential of the stored ones), `missing` (ranges of rows [from, to) without a
value) and `steps` (the page leaves the integers as they are). Bytes are stored column after column, of each integer
first all low bytes, then the next ones (similar bytes deflate better). Integers are differences from the row before,
those of the first row from zero. Arrays with the same bytes share them.

A recording can grow while a robot drives: a chunk decodes by itself. The arrays of one name of all chunks, in order,
are that array of the whole recording.
"""

import base64
import json
import zlib
from collections.abc import Mapping
from typing import Any

import numpy as np

from data.inputs import IntArray
from data.se2 import Array

LOG_STEP = 0.001  # of the logarithm: positive quantities are exact to 0.05 %
FURTHEST = 2.0**30 - 1  # largest integer, so that differences have 32 bits
LEVEL = 6  # of compression: 3 % larger than the best, in a ninth of its time
LEAST = 1.0e-12  # least argument of a logarithm
TIME, ANGLE, RHO = 1.0e-4, 1.0e-4, 1.0e-3  # resolution of time [s], angles [rad] and correlations


class Pack:
    """A chunk under construction."""

    def __init__(self, first: int, frames: int) -> None:
        self.first, self.frames = first, frames
        self._entries: list[dict[str, Any]] = []
        self._parts: dict[bytes, int] = {}
        self._length = 0

    def add(self, name: str, values: Array | IntArray, scale: float = 1.0) -> None:
        """Numbers (n,) or (n, c), exact to half a `scale`; rows with NaN or infinity are missing. The scale is coarser
        if some numbers exceed the integers (a diverged path).
        """
        self._put(name, np.asarray(values, float), scale, log=False)

    def add_log(self, name: str, values: Array, step: float = LOG_STEP) -> None:
        """Non-negative numbers (n,) or (n, c), exact to half a `step` of their logarithm."""
        with np.errstate(invalid="ignore"):
            self._put(name, np.log(np.maximum(np.asarray(values, float), LEAST)), step, log=True)

    def add_steps(self, name: str, values: Array | IntArray) -> None:
        """Whole numbers (n,) or (n, c) that are differences already."""
        plain = {"scale": 1.0, "log": False, "steps": True, "missing": []}
        self._store(name, _columns(np.asarray(values, np.int64)), plain)

    @property
    def names(self) -> set[str]:
        """Names of all arrays so far."""
        return {entry["name"] for entry in self._entries}

    def _put(self, name: str, values: Array, scale: float, *, log: bool) -> None:
        columns = _columns(values)
        known = np.isfinite(columns).all(axis=1)
        # unknown rows take the last known one before them, or zero
        last = np.maximum.accumulate(np.where(known, np.arange(len(known)), -1)) if len(known) else np.empty(0, int)
        filled = np.where((last >= 0)[:, None], columns[np.maximum(last, 0)], 0.0)
        scale = max(scale, float(np.abs(filled).max(initial=0.0)) / FURTHEST)
        stored = np.round(filled / scale)
        steps = np.diff(stored, axis=0, prepend=np.zeros((1, stored.shape[1]))).astype(np.int64)
        self._store(name, steps, {"scale": scale, "log": log, "steps": False, "missing": ranges(~known)})

    def _store(self, name: str, steps: IntArray, more: Mapping[str, Any]) -> None:
        most = int(np.abs(steps).max(initial=0))
        if most >= 2**31:
            raise OverflowError(f"{name}: a step of {most}, more than 32 bits hold")
        size = 1 if most < 2**7 else 2 if most < 2**15 else 4
        integers = np.ascontiguousarray(steps.T).astype(f"<i{size}")
        content = integers.view(np.uint8).reshape(-1, size).T.tobytes() if integers.size else b""
        at = self._parts.setdefault(content, self._length)
        self._length += len(content) if at == self._length else 0
        entry = {"name": name, "columns": steps.shape[1], "rows": len(steps), "at": at, "size": size}
        self._entries.append({**entry, **more})

    def done(self, more: Mapping[str, object]) -> dict[str, Any]:
        """The chunk: its header with `more`, and `data` as base64."""
        deflate = zlib.compressobj(LEVEL, zlib.DEFLATED, -15)
        packed = deflate.compress(b"".join(self._parts)) + deflate.flush()
        header = {"first": self.first, "frames": self.frames, "arrays": self._entries}
        return {**header, **more, "data": base64.b64encode(packed).decode()}


def _columns(values: Any) -> Any:
    return values[:, None] if values.ndim == 1 else values


def ranges(which: Any) -> list[list[int]]:
    """Where `which` (n,) holds, as ranges [from, to)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], which, [False]]).astype(np.int8)))
    return list(edges.reshape(-1, 2).tolist())


def text_of(chunk: Mapping[str, Any]) -> str:
    """A chunk as JSON for a page."""
    return json.dumps(chunk, separators=(",", ":"), ensure_ascii=True, allow_nan=False).replace("</", "<\\/")

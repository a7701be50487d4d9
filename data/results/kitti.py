"""KITTI poses: the upper three rows of the 4x4 pose, row by row, 12 numbers a line; stamps in a file of their own."""

from __future__ import annotations

import numpy as np

from data.errors import DataError, UsageError
from data.results.lines import Text, lines_of, numbers, read_text, require_order
from data.results.path import GivenPath, Manner
from data.results.space import UNIT, Spatial, on_plane

ENTRIES = tuple(f"r{i}{j}" if j < 4 else f"t{i}" for i in (1, 2, 3) for j in (1, 2, 3, 4))


def read_kitti(text: Text, manner: Manner) -> GivenPath:
    """The poses at the stamps of `manner.times`, a line each [s]."""
    if manner.times is None:
        raise UsageError(f"{text.path}: KITTI poses have no stamps; --times FILE is needed, a stamp [s] a line")
    rows = numbers(text, ENTRIES).reshape(-1, 3, 4)
    stamps = read_text(manner.times)
    time = numbers(stamps, ("t",))[:, 0]
    if len(time) != len(rows):
        what = f"{len(time)} stamps; {text.path} has {len(rows)} poses, one each is needed"
        raise DataError.at(manner.times, what)
    require_order(stamps, time)
    line, file = lines_of(text), str(text.path)
    R = rows[:, :, :3]
    off = np.abs(R @ R.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2))
    bad = np.flatnonzero((off > UNIT) | (np.linalg.det(R) < 0.0))
    if len(bad):
        raise DataError.at(file, "its first three columns are no rotation", line=int(line[bad[0]]))
    spatial = Spatial(file, "KITTI poses", time, rows[:, :, 3], R, None, "", lambda k: f"line {line[k]}")
    return on_plane(spatial, manner)

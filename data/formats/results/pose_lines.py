"""Trajectories with one pose a line: TUM, SQUARE and KITTI.

TUM: `t x y z qx qy qz qw`; in the wide form followed by the covariance, which may also be in a file of its own. SQUARE
files of `smfeval` are the wide form with a header that states the covariance's frame. The covariance is the lower
triangle, row by row (c11 c21 c22 c31 ... c66), of the 6x6 covariance of the tangent, translation first; without a
header T = T_mean Exp(xi), in the body's axes, as in `smfeval`. KITTI: the upper three rows of the 4x4 pose, row by row,
12 numbers a line; stamps in a file of their own.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from data.errors import DataError, UsageError
from data.formats.csv_table import symmetric
from data.formats.results.path import LOCAL, GivenPath, Manner, Text, numbers, read_text, require_order
from data.formats.results.space import (
    ORDERS,
    POSE,
    UNIT,
    Spatial,
    header_of,
    on_plane,
    read_samples,
    rotations,
    tangent,
)
from data.se2 import Array

TRIANGLE = tuple(f"c{i}{j}" for i in range(1, 7) for j in range(1, i + 1))
SAME_STAMP = 1e-6
"""s, largest difference of a covariance's stamp from its pose's."""
GAUSSIAN, PLAIN, SAMPLES = "gaussian_se3", "deterministic", "ensemble_se3"
UNITS = {"seconds": 1.0, "s": 1.0, "milliseconds": 1e-3, "microseconds": 1e-6, "nanoseconds": 1e-9}


def read_tum(text: Text, manner: Manner) -> GivenPath:
    """A TUM file, with covariances from `manner.cov` if given."""
    rows = numbers(text, POSE)
    if manner.cov is None:
        return _path(text, "TUM", rows, None, LOCAL, manner)
    covariance, frame, declared = _sidecar(manner.cov, rows[:, 0], text)
    return _path(text, f"TUM with covariances of {manner.cov}", rows, covariance, frame, manner, declared=declared)


def read_wide(text: Text, manner: Manner) -> GivenPath:
    """A wide TUM file, with the covariance after the pose."""
    rows = numbers(text, (*POSE, *TRIANGLE))
    return _path(text, "TUM with covariance", rows[:, :8], symmetric(rows[:, 8:], lower=True), LOCAL, manner)


def read_square(text: Text, manner: Manner) -> GivenPath:
    """A SQUARE file."""
    header = header_of(text)
    line, version = header.values["FORMAT"]
    if not version.startswith("SQUARE/"):
        raise DataError.at(text.path, f"FORMAT {version!r}; SQUARE/0.3 is needed", line=line)
    what = header.one_of(text, "REPRESENTATION", (GAUSSIAN, PLAIN, SAMPLES))
    if what is None:
        raise DataError.at(text.path, f"the header lacks REPRESENTATION ({GAUSSIAN}, {PLAIN} or {SAMPLES})", line=line)
    unit = UNITS[header.one_of(text, "TIMESTAMP_UNIT", tuple(UNITS)) or "seconds"]
    if what == SAMPLES:
        return read_samples(text, header, unit, manner)
    if what == PLAIN:
        rows = numbers(text, POSE)
        return _path(text, f"{version}, {what}", _in_seconds(rows, unit), None, "", manner)
    frame, order = tangent(text, header)
    for key, found in (("TANGENT_CONVENTION", frame), ("TANGENT_ORDER", order)):
        if found is None:
            raise DataError.at(text.path, f"the header lacks {key}; {GAUSSIAN} needs it", line=line)
    assert frame is not None  # checked in the loop
    header.one_of(text, "ROTATION_PARAM", ("axis_angle",))
    rows = numbers(text, (*POSE, *TRIANGLE))
    covariance = _ordered(symmetric(rows[:, 8:], lower=True), order)
    return _path(text, f"{version}, {what}", _in_seconds(rows[:, :8], unit), covariance, frame, manner, declared=True)


def _in_seconds(rows: Array, unit: float) -> Array:
    return rows if unit == 1.0 else np.column_stack([rows[:, 0] * unit, rows[:, 1:]])


def _ordered(covariance: Array, order: str | None) -> Array:
    """The covariance with the translation first."""
    if order != ORDERS[1]:
        return covariance
    swap = [3, 4, 5, 0, 1, 2]
    return covariance[:, swap][:, :, swap]


def _sidecar(path: Path, time: Array, poses: Text) -> tuple[Array, str, bool]:
    """Covariances (n, 6, 6) at the stamps (n,), their frame, and whether the file declares it."""
    text = read_text(path)
    header = header_of(text)
    rows = numbers(text, ("t", *TRIANGLE))
    if len(rows) != len(time):
        what = f"{len(rows)} covariances for the {len(time)} poses of {poses.path}"
        raise DataError.at(path, f"{what}; one each is needed")
    off = np.flatnonzero(np.abs(rows[:, 0] - time) > SAME_STAMP)
    if len(off):
        k = int(off[0])
        what = f"stamp {rows[k, 0]!r}; {time[k]!r} is needed, as of the pose at {poses.place(k)}"
        raise DataError.at(path, what, line=text.line[k])
    frame, order = tangent(text, header)
    return _ordered(symmetric(rows[:, 1:], lower=True), order), frame or LOCAL, frame is not None


def _path(
    text: Text, kind: str, rows: Array, covariance: Array | None, frame: str, manner: Manner, *, declared: bool = False
) -> GivenPath:
    """Rows t x y z qx qy qz qw (n, 8) with covariances, in the plane."""
    require_order(text, rows[:, 0])
    file, R = str(text.path), rotations(rows[:, 4:8], text.place)
    return on_plane(Spatial(file, kind, rows[:, 0], rows[:, 1:4], R, covariance, frame, text.place, declared), manner)


ENTRIES = tuple(f"r{i}{j}" if j < 4 else f"t{i}" for i in (1, 2, 3) for j in (1, 2, 3, 4))


def read_kitti(text: Text, manner: Manner) -> GivenPath:
    """Poses at the stamps [s] of `manner.times`, one per line."""
    if manner.times is None:
        raise UsageError(f"{text.path}: KITTI poses have no stamps; --times FILE is needed, a stamp [s] a line")
    rows = numbers(text, ENTRIES).reshape(-1, 3, 4)
    stamps = read_text(manner.times)
    time = numbers(stamps, ("t",))[:, 0]
    if len(time) != len(rows):
        what = f"{len(time)} stamps for the {len(rows)} poses of {text.path}; one each is needed"
        raise DataError.at(manner.times, what)
    require_order(stamps, time)
    file, R = str(text.path), rows[:, :, :3]
    off = np.abs(R @ R.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2))
    bad = np.flatnonzero((off > UNIT) | (np.linalg.det(R) < 0.0))
    if len(bad):
        raise DataError.at(file, "its first three columns are no rotation", line=text.line[bad[0]])
    return on_plane(Spatial(file, "KITTI poses", time, rows[:, :, 3], R, None, "", text.place), manner)

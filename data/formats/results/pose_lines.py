"""Trajectories with one pose a line: TUM, SQUARE, OpenVINS and KITTI.

TUM: `t x y z qx qy qz qw`; in the wide form followed by the covariance, which may also be in a file of its own. SQUARE
files of `smfeval` are the wide form with a header that states the covariance's frame. The covariance is the lower
triangle, row by row (c11 c21 c22 c31 ... c66), of the 6x6 covariance of the tangent, translation first; without a
header T = T_mean Exp(xi), in the body's axes, as in `smfeval`. With 44 columns it is the full matrix. OpenVINS and
MINS (20 columns): upper triangles of the rotation's 3x3 covariance, in the body's axes, and of the position's, in the
world's. KITTI: the upper three rows of the 4x4 pose, row by row, 12 numbers a line; stamps in a file of their own.
"""

from __future__ import annotations

import numpy as np

from data.csv_table import symmetric
from data.errors import DataError, UsageError
from data.formats.results.clock import ROWS, STATED, Clock, clock_of, seconds
from data.formats.results.matrices import full, known_only, translation_first
from data.formats.results.path import LOCAL, MIXED, ROTATION, SILENT, GivenPath, Manner, Spatial, Stated
from data.formats.results.space import UNIT, on_plane, rotations
from data.formats.results.square import POSE, Header, header_of, read_samples, tangent
from data.formats.results.text import Text, numbers, read_text, require_order
from data.se2 import Array

TRIANGLE = tuple(f"c{i}{j}" for i in range(1, 7) for j in range(1, i + 1))
ENTRIES_6 = tuple(f"c{i}{j}" for i in range(1, 7) for j in range(1, 7))
BLOCKS = tuple(f"P{block}{i}{j}" for block in "rt" for i in (1, 2, 3) for j in range(i, 4))
"""Upper triangles of OpenVINS: rotation, then position."""
SAME_STAMP = 1e-6
"""s, largest difference of a covariance's stamp from its pose's."""
GAUSSIAN, PLAIN, SAMPLES = "gaussian_se3", "deterministic", "ensemble_se3"
UNITS = {"seconds": "s", "s": "s", "milliseconds": "ms", "microseconds": "us", "nanoseconds": "ns"}


def read_tum(text: Text, manner: Manner) -> GivenPath:
    """A TUM file, with covariances from `manner.cov` if given."""
    rows = numbers(text, POSE, huge=POSE[:1])
    if manner.cov is None:
        return path_of(text, "TUM", rows, None, manner)
    time, clock = times_of(text, rows[:, 0], manner)
    side = read_text(manner.cov)
    kept = numbers(side, ("t", *TRIANGLE), huge=("t",))
    of_side, _ = times_of(side, kept[:, 0], manner, clock)
    if len(kept) != len(rows):
        what = f"{len(kept)} covariances for the {len(rows)} poses of {text.path}"
        raise DataError.at(manner.cov, f"{what}; one each is needed")
    off = np.flatnonzero(np.abs(of_side - time) > SAME_STAMP)
    if len(off):
        k = int(off[0])
        what = f"stamp {kept[k, 0]!r}; {rows[k, 0]!r} is needed, as of the pose at {text.place(k)}"
        raise DataError.at(manner.cov, what, line=side.line[k])
    kind = f"TUM with covariances of {manner.cov}"
    return path_of(text, kind, rows, symmetric(kept[:, 1:], lower=True), manner, declared=(side, header_of(side)))


def read_wide(text: Text, manner: Manner) -> GivenPath:
    """A wide TUM file, with the covariance after the pose: a triangle, or the full matrix."""
    if len(text.fields[0]) == len(POSE) + len(ENTRIES_6):
        rows = numbers(text, (*POSE, *ENTRIES_6), huge=POSE[:1])
        C, notes = full(rows[:, 8:], text.place)
    else:
        rows = numbers(text, (*POSE, *TRIANGLE), huge=POSE[:1])
        C, notes = symmetric(rows[:, 8:], lower=True), ()
    return path_of(text, "TUM with covariance", rows[:, :8], C, manner, notes=notes)


def read_openvins(text: Text, manner: Manner) -> GivenPath:
    """Poses of OpenVINS or MINS, with covariances of rotation and position."""
    rows = numbers(text, (*POSE, *BLOCKS), huge=POSE[:1])
    C = of_blocks(rows[:, 8:14], rows[:, 14:])
    stated = Stated(convention=True, order=True)
    return path_of(text, "OpenVINS", rows[:, :8], C, manner, frame=MIXED, stated=stated)


def of_blocks(rotation: Array, position: Array) -> Array:
    """Covariances (n, 6, 6), translation first, from upper triangles (n, 6) each, without correlation between them."""
    C = np.zeros((len(rotation), 6, 6))
    C[:, :3, :3], C[:, 3:, 3:] = symmetric(position), symmetric(rotation)
    return C


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
        return read_samples(text, header, {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}[unit], manner)
    stated = Stated(header.text_of("POSE_FRAME"), header.text_of("BODY_FRAME"))
    if what == PLAIN:
        rows = numbers(text, POSE, huge=POSE[:1])
        return path_of(text, f"{version}, {what}", rows, None, manner, stated=stated, unit=unit)
    for key, found in zip(("TANGENT_CONVENTION", "TANGENT_ORDER"), tangent(text, header), strict=True):
        if found is None:
            raise DataError.at(text.path, f"the header lacks {key}; {GAUSSIAN} needs it", line=line)
    header.one_of(text, "ROTATION_PARAM", ("axis_angle",))
    rows = numbers(text, (*POSE, *TRIANGLE), huge=POSE[:1])
    C = symmetric(rows[:, 8:], lower=True)
    return path_of(text, f"{version}, {what}", rows[:, :8], C, manner, stated=stated, unit=unit)


def times_of(
    text: Text,
    stamps: Array,
    manner: Manner,
    clock: Clock | None = None,
    *,
    unit: str | None = None,
    usual: str = "s",
    column: int = 0,
) -> tuple[Array, Clock]:
    """Times (n,) [s] of stamps (n,) in a column of a file, and their clock: given, of a flag, stated, or inferred."""
    require_order(text, stamps)
    if clock is None and manner.stamps is not None:
        clock = Clock(manner.stamps, STATED)
    clock = clock or clock_of(str(text.path), stamps, unit, usual)
    return seconds(stamps, [fields[column] for fields in text.fields], clock.unit), clock


def path_of(
    text: Text,
    kind: str,
    rows: Array,
    C: Array | None,
    manner: Manner,
    *,
    frame: str = LOCAL,
    stated: Stated = SILENT,
    unit: str | None = None,
    usual: str = "s",
    column: int = 0,
    notes: tuple[str, ...] = (),
    declared: tuple[Text, Header] | None = None,
) -> GivenPath:
    """Rows t x y z qx qy qz qw (n, 8) with covariances (n, 6, 6), in the plane.

    Frame and order of the tangent are those of the header of the file, or of the file `declared`, if it has one.
    """
    time, clock = times_of(text, rows[:, 0], manner, unit=unit, usual=usual, column=column)
    if C is not None:
        convention, order = tangent(text, header_of(text))
        if declared is not None:
            own = tangent(*declared)
            convention, order = own[0] or convention, own[1] or order
        frame = convention or frame
        C = translation_first(C) if order == ROTATION else C
        stated = Stated(
            stated.world, stated.body, stated.convention or convention is not None, stated.order or order is not None
        )
        C, more = known_only(C)
        notes += more
        if C is not None and not stated.convention and manner.frame is None:
            notes += (
                f"covariances are read as {frame} ones with the translation first, unless --cov-frame names another",
            )
    file, R = str(text.path), rotations(rows[:, 4:8], text.place)
    kind = f"{kind}, {clock.words}"
    spatial = Spatial(file, kind, time, rows[:, 1:4], R, C, frame, text.place, stated, notes, clock)
    return on_plane(spatial, manner)


ENTRIES = tuple(f"r{i}{j}" if j < 4 else f"t{i}" for i in (1, 2, 3) for j in (1, 2, 3, 4))


def read_kitti(text: Text, manner: Manner) -> GivenPath:
    """Poses in a camera's axes at the stamps of `manner.times`, one per line; without these at the numbers of rows."""
    rows = numbers(text, ENTRIES).reshape(-1, 3, 4)
    if manner.times is None:
        if manner.stamps is not None:
            what = f"{text.path} has no stamps (KITTI poses); --times FILE names them"
            raise UsageError(f"--unit {manner.stamps}: {what}")
        time, clock = np.arange(len(rows), dtype=float), Clock("s", ROWS)
    else:
        stamps = read_text(manner.times)
        raw = numbers(stamps, ("t",), huge=("t",))[:, 0]
        if len(raw) != len(rows):
            what = f"{len(raw)} stamps for the {len(rows)} poses of {text.path}; one each is needed"
            raise DataError.at(manner.times, what)
        time, clock = times_of(stamps, raw, manner)
    file, R = str(text.path), rows[:, :, :3]
    off = np.abs(R @ R.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2))
    bad = np.flatnonzero((off > UNIT) | (np.linalg.det(R) < 0.0))
    if len(bad):
        raise DataError.at(file, "its first three columns are no rotation", line=text.line[bad[0]])
    axes = "a camera's axes" if manner.axes is None else f"a {manner.axes}'s axes"
    kind, stated = f"KITTI poses in {axes}, {clock.words}", Stated(axes=manner.axes is None)
    return on_plane(Spatial(file, kind, time, rows[:, :, 3], R, None, "", text.place, stated, (), clock), manner)

"""CSV results: our own `online.csv` and `final.csv`, `truth.csv` of an open log, and EuRoC's ground truth."""

from __future__ import annotations

import numpy as np

from data.errors import LARGEST, DataError
from data.results.lines import Text, is_number, lines_of, numbers, require_order
from data.results.path import WORLD, GivenPath, Manner, in_order
from data.results.space import Spatial, on_plane, require_covariances, rotations
from data.se2 import Array, wrap_angle

PLANE = ("t", "x", "y", "theta")
COVARIANCE = ("c_xx", "c_xy", "c_xt", "c_yy", "c_yt", "c_tt")
EUROC = ("timestamp [ns]", "p_x", "p_y", "p_z", "q_w", "q_x", "q_y", "q_z")
NANOSECONDS = 1e14
"""Above this a stamp is in ns: a day and more of them, three million years of seconds."""


def is_plane(text: Text) -> bool:
    """Whether the header names our columns."""
    return text.commas and set(PLANE[1:]) <= set(_names(text))


def _names(text: Text) -> list[str]:
    return [f.strip('"') for f in text.fields[0]]


def read_plane(text: Text, manner: Manner) -> GivenPath:
    """Columns t, x, y, theta by name, and the covariance where all six are there; a blank or NaN is unknown."""
    names = _names(text)
    if "t" not in names:
        raise DataError.at(
            text.path,
            "no column t: these are poses of a log's frames; give its folder instead",
            line=text.line[0],
        )
    if manner.frame not in (None, WORLD):
        raise DataError.at(text.path, f"its covariances are {WORLD} by definition; --cov-frame {manner.frame}")
    there = [c for c in COVARIANCE if c in names]
    if there and len(there) < len(COVARIANCE):
        lacking = next(c for c in COVARIANCE if c not in names)
        raise DataError.at(text.path, f"no such column, but {there[0]}; all six or none", line=1, column=lacking)
    columns = [names.index(c) for c in (*PLANE, *there)]
    rows = np.full((len(text.fields) - 1, len(columns)), np.nan)
    for k, (line, fields) in enumerate(zip(text.line[1:], text.fields[1:], strict=True)):
        if len(fields) != len(names):
            raise DataError.at(text.path, f"{len(fields)} fields where the header names {len(names)}", line=line)
        for j, column in enumerate(columns):
            field = fields[column]
            if field and not is_number(field):
                raise DataError.at(text.path, f"{field[:40]!r} is not a number", line=line, column=names[column])
            value = float(field) if field else np.nan
            if np.isinf(value) or abs(value) > LARGEST:
                what = f"{field[:40]}; a number in SI units is needed, or blank where unknown"
                raise DataError.at(text.path, what, line=line, column=names[column])
            rows[k, j] = value
        if not np.isfinite(rows[k, 0]):
            raise DataError.at(text.path, "no stamp; a number is needed", line=line, column="t")
    if not len(rows):
        raise DataError.at(text.path, "a header and no pose; at least one is needed")
    time = rows[:, 0]
    require_order(Text(text.path, text.fields[1:], text.line[1:], (), True), time)
    keep = in_order(time)
    notes = (f"{len(rows) - len(keep)} poses share their stamp with a later one, which counts",)
    pose = np.column_stack([rows[:, 1:3], wrap_angle(rows[:, 3])])
    covariance = _covariance(text, rows[:, 4:]) if there else None
    return GivenPath(
        str(text.path), "CSV of t, x, y, theta" + (" and covariance" if there else ""), time[keep], pose[keep],
        None if covariance is None else covariance[keep], WORLD if there else "", None,
        notes if len(keep) < len(rows) else (),
    )  # fmt: skip


def _covariance(text: Text, entries: Array) -> Array:
    """Matrices (n, 3, 3) of their upper triangles (n, 6)."""
    rows, columns = np.triu_indices(3)
    P = np.empty((len(entries), 3, 3))
    P[:, rows, columns] = P[:, columns, rows] = entries
    require_covariances(P, str(text.path), lambda k: f"line {text.line[k + 1]}")
    return P


def is_euroc(text: Text) -> bool:
    """Whether lines are comma-separated numbers that begin with a stamp in ns, or a comment's header says so."""
    first = text.fields[0]
    if not text.commas or len(first) < len(EUROC) or not all(is_number(f) for f in first[: len(EUROC)]):
        return False
    return abs(float(first[0])) > NANOSECONDS or any("timestamp" in c.lower() for _, c in text.comments)


def read_euroc(text: Text, manner: Manner) -> GivenPath:
    """Stamp [ns], position, quaternion w, x, y, z; velocities and biases behind are left alone."""
    rows = numbers(text, EUROC, more=True)
    # whole nanoseconds have more digits than a float: split before dividing
    time = np.array([_seconds(fields[0]) for fields in text.fields])
    require_order(text, time)
    line, file = lines_of(text), str(text.path)

    def place(k: int) -> str:
        return f"line {line[k]}"

    R = rotations(rows[:, [5, 6, 7, 4]], file, place)
    return on_plane(Spatial(file, "EuRoC CSV", time, rows[:, 1:4], R, None, "", place), manner)


def _seconds(stamp: str) -> float:
    return int(stamp) / 1_000_000_000 if stamp.lstrip("-").isdecimal() else float(stamp) * 1e-9

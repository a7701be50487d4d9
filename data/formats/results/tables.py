"""CSV results: our own `online.csv` and `final.csv`, `truth.csv` of an open log, EuRoC's ground truth.

Beside a result may be `landmarks.csv` and `decisions.csv` with the columns of our result folder. A `landmarks.csv`
without a column `landmark` is the map of an open log and is ignored.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from data.errors import LARGEST, DataError
from data.formats.csv_table import FIRST_ROW, is_number, read_table, symmetric
from data.formats.results.path import WORLD, GivenPath, Manner, Text, in_order, numbers, require_order
from data.formats.results.space import Spatial, on_plane, require_covariances, rotations
from data.inputs import IntArray
from data.result import DISCARD, MapEstimate
from data.se2 import Array, wrap_angle

PLANE = ("t", "x", "y", "theta")
COVARIANCE = ("c_xx", "c_xy", "c_xt", "c_yy", "c_yt", "c_tt")
EUROC = ("timestamp [ns]", "p_x", "p_y", "p_z", "q_w", "q_x", "q_y", "q_z")
NANOSECONDS = 1e14
"""Smallest stamp that is taken for ns: a day of them, or three million years of seconds."""


def is_plane(text: Text) -> bool:
    """Whether the header names our columns."""
    return text.commas and set(PLANE[1:]) <= set(_names(text))


def _names(text: Text) -> list[str]:
    return [f.strip('"') for f in text.fields[0]]


def read_plane(text: Text, manner: Manner) -> GivenPath:
    """Columns t, x, y, theta by name, and the covariance if complete; blank or NaN is unknown."""
    names = _names(text)
    if "t" not in names:
        what = "no column t: these are poses of a log's frames; name its folder instead"
        raise DataError.at(text.path, what, line=text.line[0])
    if manner.frame not in (None, WORLD):
        raise DataError.at(text.path, f"its covariances are {WORLD} ones; remove --cov-frame {manner.frame}")
    there = [c for c in COVARIANCE if c in names]
    if there and len(there) < len(COVARIANCE):
        lacking = next(c for c in COVARIANCE if c not in names)
        what = f"no such column, but {there[0]}; all six or none are needed"
        raise DataError.at(text.path, what, line=1, column=lacking)
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
    shared = len(rows) - len(keep)
    notes = (f"{shared} poses share their stamp with a later one, which is used",) if shared else ()
    pose = np.column_stack([rows[:, 1:3], wrap_angle(rows[:, 3])])[keep]
    path, kind = str(text.path), "CSV of t, x, y, theta"
    if not there:
        return GivenPath(path, kind, time[keep], pose, notes=notes)
    P = symmetric(rows[:, 4:])
    require_covariances(P, lambda k: text.place(k + 1))
    return GivenPath(path, f"{kind} and covariance", time[keep], pose, P[keep], WORLD, notes=notes)


def is_euroc(text: Text) -> bool:
    """Whether lines are comma-separated numbers that begin with a stamp in ns, or a comment's header names it."""
    first = text.fields[0]
    if not text.commas or len(first) < len(EUROC) or not all(is_number(f) for f in first[: len(EUROC)]):
        return False
    return abs(float(first[0])) > NANOSECONDS or any("timestamp" in c.lower() for _, c in text.comments)


def read_euroc(text: Text, manner: Manner) -> GivenPath:
    """Stamp [ns], position, quaternion w, x, y, z; velocities and biases after them are ignored."""
    rows = numbers(text, EUROC, more=True)
    # whole nanoseconds have more digits than a float
    time = np.array([_seconds(fields[0]) for fields in text.fields])
    require_order(text, time)
    R = rotations(rows[:, [5, 6, 7, 4]], text.place)
    return on_plane(Spatial(str(text.path), "EuRoC CSV", time, rows[:, 1:4], R, None, "", text.place), manner)


def _seconds(stamp: str) -> float:
    return int(stamp) / 1_000_000_000 if stamp.lstrip("-").isdecimal() else float(stamp) * 1e-9


MAP_COVARIANCE = ("c_xx", "c_xy", "c_yy")


@dataclass(frozen=True, eq=False)
class Companions:
    """Files beside a result; None: absent.

    Attributes:
        landmarks: the map.
        decisions: (M, 4) frame, observation within its frame, decision, final decision.
        file: of the decisions.
    """

    landmarks: MapEstimate | None = None
    decisions: IntArray | None = None
    file: Path | None = None


def companions(folder: Path) -> Companions:
    """Landmarks and decisions in a folder, if present; DataError for an invalid number."""
    landmarks, decisions = folder / "landmarks.csv", folder / "decisions.csv"
    known = _landmarks(landmarks) if _has(landmarks, "landmark") else None
    if not _has(decisions, "decision"):
        return Companions(known)
    return Companions(known, _decisions(decisions), decisions)


def _has(path: Path, column: str) -> bool:
    """Whether a file exists and has a column of that name."""
    if not path.is_file():
        return False
    with path.open("rb") as file:
        return column in [name.strip() for name in file.readline().decode("utf-8-sig", "replace").split(",")]


def _landmarks(path: Path) -> MapEstimate:
    """Number and position, and covariance, first frame and times seen if present."""
    table = read_table(path, ("landmark", "x", "y"), (*MAP_COVARIANCE, "first_frame", "times_seen"))
    c = table.columns
    n = len(c["landmark"])
    P = np.full((n, 2, 2), np.nan)
    if all(name in c for name in MAP_COVARIANCE):
        P[:, 0, 0], P[:, 1, 1] = c["c_xx"], c["c_yy"]
        P[:, 0, 1] = P[:, 1, 0] = c["c_xy"]
        wide = np.zeros((n, 3, 3))
        wide[:, :2, :2] = P
        require_covariances(wide, lambda k: f"{path}:{k + FIRST_ROW}")
    number = _whole(path, "landmark", c["landmark"], 0)
    again = np.setdiff1d(np.arange(n), np.unique(number, return_index=True)[1])
    if len(again):
        k = int(again[-1])
        raise DataError.at(path, f"{number[k]} is repeated", line=k + FIRST_ROW, column="landmark")
    none = np.full(n, -1.0)
    first, seen = (_whole(path, q, c.get(q, none), -1) for q in ("first_frame", "times_seen"))
    return MapEstimate(number, np.column_stack([c["x"], c["y"]]), P, first, seen)


def _decisions(path: Path) -> IntArray:
    """Frame, observation, decision and final decision (by default the same)."""
    table = read_table(path, ("frame", "observation", "decision"), ("final_decision",))
    c = table.columns
    least = {"frame": 0, "observation": 0, "decision": DISCARD, "final_decision": DISCARD}
    whole = {name: _whole(path, name, values, least[name]) for name, values in c.items()}
    whole.setdefault("final_decision", whole["decision"])
    return np.column_stack([whole[name] for name in least])


def _whole(path: Path, name: str, values: Array, least: int) -> IntArray:
    """Whole numbers from `least` up."""
    bad = np.flatnonzero(~((values == np.round(values)) & (values >= least) & (values <= LARGEST)))
    if len(bad):
        k = int(bad[0])
        what = f"{values[k]:g}; a whole number from {least} up is needed"
        raise DataError.at(path, what, line=k + FIRST_ROW, column=name)
    return values.astype(np.int64)

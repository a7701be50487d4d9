"""CSV results: our own `online.csv` and `final.csv`, `truth.csv` of an open log, EuRoC's ground truth.

Beside a result may be `landmarks.csv` and `decisions.csv` with the columns of our result folder. A `landmarks.csv`
without a column `landmark` is the map of an open log and is ignored.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from data.csv_table import FIRST_ROW, is_number, read_table, symmetric
from data.errors import LARGEST, DataError
from data.formats.results.matrices import known_only
from data.formats.results.path import WORLD, GivenPath, Manner, in_order
from data.formats.results.pose_lines import path_of, times_of
from data.formats.results.space import require_covariances
from data.formats.results.text import Text, numbers
from data.inputs import IntArray
from data.result import DISCARD, MapEstimate
from data.se2 import Array, wrap_angle

PLANE = ("t", "x", "y", "theta")
COVARIANCE = ("c_xx", "c_xy", "c_xt", "c_yy", "c_yt", "c_tt")
EUROC = ("timestamp [ns]", "p_x", "p_y", "p_z", "q_w", "q_x", "q_y", "q_z")
LENGTHS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3}
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
    body = text.without_header()
    for line, fields in zip(body.line, body.fields, strict=True):
        if len(fields) != len(names):
            raise DataError.at(text.path, f"{len(fields)} fields where the header names {len(names)}", line=line)
    if not body.fields:
        raise DataError.at(text.path, "a header and no pose; at least one is needed")
    chosen = replace(body, fields=tuple(tuple(fields[c] for c in columns) for fields in body.fields))
    rows = numbers(chosen, [names[c] for c in columns], blank=True, huge=PLANE[:1])
    bare = np.flatnonzero(~np.isfinite(rows[:, 0]))
    if len(bare):
        raise DataError.at(text.path, "no stamp; a number is needed", line=body.line[bare[0]], column="t")
    time, clock = times_of(chosen, rows[:, 0], manner)
    keep = in_order(time)
    shared = len(rows) - len(keep)
    notes: tuple[str, ...] = ()
    if shared:
        notes = (f"{shared} poses share their stamp with a later one, which is used",)
    turn, scale = (np.pi / 180.0 if manner.angles == "deg" else 1.0), LENGTHS[manner.lengths or "m"]
    pose = np.column_stack([scale * rows[:, 1:3], wrap_angle(turn * rows[:, 3])])[keep]
    unknown = int((~np.isfinite(pose).all(axis=1)).sum())
    if unknown:
        notes += (f"{unknown} of {len(pose)} poses are blank or NaN, and scored as far as they are known",)
    path, kind = str(text.path), "CSV of t, x, y, theta"
    raw = rows[keep, 3] if manner.angles is None else None
    if not there:
        kind = f"{kind}, {clock.words}"
        return GivenPath(path, kind, time[keep], pose, notes=notes, clock=clock, headings=raw)
    exact = ~rows[:, 4:].any(axis=1)  # zeros of our own files: an exact prior
    P = np.zeros((len(rows), 3, 3))
    if not exact.all():
        known, more = known_only(symmetric(rows[~exact, 4:]))
        P[~exact] = np.nan if known is None else known
        notes += more
    P *= np.outer([scale, scale, turn], [scale, scale, turn])
    require_covariances(P, body.place)
    kind = f"{kind} and covariance, {clock.words}"
    return GivenPath(path, kind, time[keep], pose, P[keep], WORLD, notes=notes, clock=clock, headings=raw)


def is_euroc(text: Text) -> bool:
    """Whether lines are comma-separated numbers without a header that begin with a stamp in ns."""
    first = text.fields[0]
    if not text.commas or len(first) < len(EUROC) or not all(is_number(f) for f in first[: len(EUROC)]):
        return False
    return abs(float(first[0])) > NANOSECONDS


def read_euroc(text: Text, manner: Manner) -> GivenPath:
    """Stamp [ns], position, quaternion w, x, y, z; velocities and biases after them are ignored."""
    rows = numbers(text, EUROC, more=True, huge=EUROC[:1])[:, [0, 1, 2, 3, 5, 6, 7, 4]]
    return path_of(text, "EuRoC CSV without header, quaternion w x y z", rows, None, manner, usual="ns")


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

"""The map and the decisions beside a result: `landmarks.csv` and `decisions.csv` with the columns of our result folder.

A `landmarks.csv` without a column `landmark` is the map of an open log and is ignored.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from data.csv_table import FIRST_ROW, read_table
from data.errors import LARGEST, DataError
from data.formats.results.space import require_covariances
from data.inputs import IntArray
from data.result import DISCARD, MapEstimate
from data.se2 import Array

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

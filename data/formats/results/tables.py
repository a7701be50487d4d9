"""The map and the decisions beside a result: `landmarks.csv` and `decisions.csv` with the columns of our result folder.

A `landmarks.csv` without a column `landmark` is the map of an open log and is ignored.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from data.csv_table import FIRST_ROW, read_table
from data.formats.results.space import require_covariances
from data.inputs import IntArray
from data.result import DISCARD, MapEstimate

MAP_COVARIANCE = ("c_xx", "c_xy", "c_yy")


@dataclass(frozen=True, eq=False)
class Companions:
    """Files beside a result; None: absent."""

    landmarks: MapEstimate | None = None  # the map
    # (M, 4) frame, observation within its frame, decision, final decision; (M, 5): and the landmark that it initializes
    # in the end, -1 for none
    decisions: IntArray | None = None
    file: Path | None = None  # of the decisions


def companions(folder: Path) -> Companions:
    """Landmarks and decisions in a folder, if present; DataError for an invalid number."""
    landmarks, decisions = folder / "landmarks.csv", folder / "decisions.csv"
    known = _landmarks(landmarks) if _has(landmarks, "landmark") else None
    if not _has(decisions, "decision"):
        return Companions(known)
    return Companions(known, _decisions(decisions), decisions)


def _has(path: Path, column: str) -> bool:
    if not path.is_file():
        return False
    with path.open("rb") as file:
        return column in [name.strip() for name in file.readline().decode("utf-8-sig", "replace").split(",")]


def _landmarks(path: Path) -> MapEstimate:
    """Number and position, and covariance, first frame and times seen if present."""
    table = read_table(path, ("landmark", "x", "y"), (*MAP_COVARIANCE, "first_frame", "times_seen"))
    n = len(table)
    P = np.full((n, 2, 2), np.nan)
    if all(name in table for name in MAP_COVARIANCE):
        P = table.symmetric(MAP_COVARIANCE)
        wide = np.zeros((n, 3, 3))
        wide[:, :2, :2] = P
        require_covariances(wide, lambda k: f"{path}:{k + FIRST_ROW}")
    number = table.integers("landmark", 0)
    table.require_distinct("landmark", number, "{} is repeated")
    first, seen = (table.integers(q, -1, blank=-1) for q in ("first_frame", "times_seen"))
    return MapEstimate(number, table.stack(("x", "y")), P, first, seen)


def _decisions(path: Path) -> IntArray:
    """Frame, observation, decision and final decision (by default the same), and what it begins, if that is there."""
    table = read_table(path, ("frame", "observation", "decision"), ("final_decision", "begins"))
    final = "final_decision" if "final_decision" in table else "decision"
    least = {"frame": 0, "observation": 0, "decision": DISCARD, final: DISCARD}
    whole = {name: table.integers(name, smallest) for name, smallest in least.items()}
    begins = [table.integers("begins", -1)] if "begins" in table else []
    return np.column_stack([*(whole[name] for name in ("frame", "observation", "decision")), whole[final], *begins])

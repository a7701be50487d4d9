"""`landmarks.csv` of an open log folder: id,x,y[,sx,sy]."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from data.inputs import LandmarkMap
from data.open_log.csv_table import read_table


def read_landmarks(path: Path) -> tuple[LandmarkMap | None, bool]:
    """landmarks.csv, ascending by id, and whether a survey's sigmas were left out; None where there is none."""
    if not path.exists():
        return None, False
    table = read_table(path, ("id", "x", "y"), ("sx", "sy"))
    sigmas = [n for n in ("sx", "sy") if n in table]
    table.require_finite(("x", "y", *sigmas))
    for name in sigmas:
        table.require(table.columns[name] >= 0.0, name, "{} is a negative standard deviation")
    number = table.integers("id", 0)
    order = np.argsort(number, kind="stable")
    repeated = np.zeros(len(number), bool)
    repeated[order[1:]] = number[order[1:]] == number[order[:-1]]
    table.require(~repeated, "id", "{} stands for two landmarks")
    return LandmarkMap(number[order], table.stack(("x", "y"))[order]), any(
        (table.columns[n] > 0.0).any() for n in sigmas
    )

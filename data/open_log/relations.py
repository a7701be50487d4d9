"""`relations.csv`: reference relations between the frames of a log, by which it is scored where no true path is known.

    row1,row2,x,y,theta[,exact][,stamp1,stamp2]     pose of frame row2 in that of frame row1 [m, m, rad], rows from 0;
                                                    exact: 1 where both rows are sure, 0 where not; stamps [s] that the
                                                    reference's author tied the relation to

Columns come in any order; others are left out.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from data.open_log.csv_table import read_table
from data.se2 import Array
from data.truth import Relations

RELATIVE = ("x", "y", "theta")
STAMPS = ("stamp1", "stamp2")
EXACT = "exact"


def read_relations(path: Path, frames: int, frame_stamp: Array | None = None) -> Relations:
    """Relations between the frames of a log of so many; `frame_stamp` (N,) is kept beside them.

    Raises:
        DataError: no such file, a column missing, a value that is not a number, or a row that the log has not.
    """
    table = read_table(path, ("row1", "row2", *RELATIVE), (EXACT, *STAMPS))
    for name in ("row1", "row2"):
        table.integers(name, 0)
        there = table.columns[name] < frames
        table.require(there, name, f"{{}} is not a row of the log; it has frames 0 to {frames - 1}")
    table.require_finite(RELATIVE)
    exact = stamp = None
    if EXACT in table:
        values = table.columns[EXACT]
        table.require((values == 0.0) | (values == 1.0), EXACT, "{} is neither 0 nor 1")
        exact = values.astype(np.int64)
    if any(name in table for name in STAMPS):
        for name in STAMPS:
            if name not in table:
                raise table.error(-1, name, "no such column; stamp1 and stamp2 come together")
        table.require_finite(STAMPS)
        stamp = table.stack(STAMPS)
    row1, row2 = (table.columns[name].astype(np.int64) for name in ("row1", "row2"))
    return Relations(row1, row2, table.stack(RELATIVE), exact, stamp, frame_stamp)


def relations_columns(relations: Relations) -> tuple[list[str], list[list[object]]]:
    """Names of the columns, and the rows: what `read_relations` reads."""
    r = relations
    names = ["row1", "row2", *RELATIVE]
    columns = [r.row1.tolist(), r.row2.tolist(), *r.relative.T.tolist()]
    if r.exact is not None:
        names.append(EXACT)
        columns.append(r.exact.tolist())
    if r.stamp is not None:
        names += STAMPS
        columns += r.stamp.T.tolist()
    return names, [list(row) for row in zip(*columns, strict=True)]

"""`closures.csv` of an open log folder: measured relative poses of two frames, such as loop closures, scan matches,
edges of a pose graph, or a second odometry.

    frame1,frame2,dx,dy,dtheta[,c_xx,c_xy,c_xt,c_yy,c_yt,c_tt][,source][,true_inlier]     in any order

With odometry.csv: t1, t2 [s] instead of frame1, frame2; these instants are frames, too. dx, dy, dtheta: pose of frame2
in the frame of frame1 [m, m, rad], and the covariance of its additive error there; without these columns: the sigma of
the source. source: the name of a [[closure]] in log.toml, blank for the first. true_inlier: 1, or 0 for a false
closure, blank unknown (for scoring alone). relations.csv has the same for scoring; no estimator sees that.

    [[closure]]
    name = "laser"
    sigma = [0.05, 0.05, 0.01]      of dx, dy [m], dtheta [rad]; optional
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from data.columns.named import (
    COVARIANCE,
    INLIER,
    SOURCE,
    inliers,
    names_of,
    require_definite,
    shown_inliers,
    source_rows,
)
from data.csv_table import Table, read_table
from data.inputs import IntArray
from data.pose_measurements import Closures
from data.se2 import Array
from data.toml_table import TomlTable, positive

TABLE, FILE = "closure", "closures.csv"
KEYS = ("name", "sigma")
ENDS = {"frame": ("frame1", "frame2"), "t": ("t1", "t2")}
"""Names of the two ends by the key of observations.csv."""
RELATIVE = ("dx", "dy", "dtheta")
UPPER = np.triu_indices(3)


def stated(tables: Sequence[TomlTable]) -> dict[str, Array | None]:
    """Sigma (3,) of each source, by the name of its [[closure]]; None: not stated."""
    what = "three numbers > 0 [m, m, rad] are"
    sigma = [table.numbers("sigma", 3, what, positive) if "sigma" in table else None for table in tables]
    return dict(zip(names_of(tables), sigma, strict=True))


class ClosureTable(NamedTuple):
    """Closures without frames: relative (K, 3), covariance (K, 3, 3), source (K,), true inliers (K,) or None."""

    table: Table
    ends: tuple[str, str]
    relative: Array
    covariance: Array
    source: IntArray
    inlier: IntArray | None
    sources: tuple[str, ...]

    def between(self, frame1: IntArray, frame2: IntArray) -> tuple[Closures, IntArray | None]:
        """The closures between frames (K,) by their later one, and their true inliers.

        Raises DataError for a closure of a frame with itself.
        """
        self.table.require(frame1 != frame2, self.ends[1], f"{{}} is {self.ends[0]}, too; two frames are needed")
        by = np.argsort(np.maximum(frame1, frame2), kind="stable")
        closures = Closures(
            frame1[by], frame2[by], self.relative[by], self.covariance[by], self.source[by], self.sources
        )
        return closures, None if self.inlier is None else self.inlier[by]


def read_closures(path: Path, sources: Mapping[str, Array | None], key: str) -> ClosureTable:
    """closures.csv, checked except for the range of its ends; `key`: frame or t."""
    optional = (*COVARIANCE, SOURCE, INLIER)
    table = read_table(path, (*ENDS[key], *RELATIVE), optional, may_be_blank=(SOURCE, INLIER), words=(SOURCE,))
    return closures_of(table, sources, key)


def closures_of(table: Table, sources: Mapping[str, Array | None], key: str) -> ClosureTable:
    """Closures of a table with the columns of closures.csv, checked except for the range of its ends."""
    table.require_finite((*ENDS[key], *RELATIVE))
    missing = [name for name in COVARIANCE if name not in table]
    if 0 < len(missing) < len(COVARIANCE):
        raise table.error(-1, missing[0], f"no such column; {','.join(COVARIANCE)} come together")
    source = source_rows(table, list(sources), TABLE)
    stated_by: Mapping[str, Array | None] = sources or {TABLE: None}
    names, sigmas = tuple(stated_by), list(stated_by.values())
    if not missing:
        table.require_finite(COVARIANCE)
        covariance = table.symmetric(COVARIANCE)
        require_definite(table, np.arange(len(table)), covariance)
    else:
        for row, k in enumerate(source.tolist()):
            if sigmas[k] is None:
                what = f"no such column, and no sigma in [[{TABLE}]] {names[k]!r} of log.toml"
                raise table.error(row, COVARIANCE[0], f"{what}; one of them is needed")
        sigma = np.array([s if s is not None else np.zeros(3) for s in sigmas])
        covariance = (sigma**2)[source][:, :, None] * np.eye(3)
    return ClosureTable(table, ENDS[key], table.stack(RELATIVE), covariance, source, inliers(table), names)


def closures_columns(
    closures: Closures, inlier: IntArray | None, key: str, ends: tuple[Sequence[Any], Sequence[Any]]
) -> dict[str, Sequence[Any]]:
    """Columns by name, as `read_closures` reads them, with the values (K,) of both ends."""
    columns: dict[str, Sequence[Any]] = dict(zip(ENDS[key], ends, strict=True))
    columns |= dict(zip(RELATIVE, closures.relative.T.tolist(), strict=True))
    columns |= dict(zip(COVARIANCE, closures.covariance[:, UPPER[0], UPPER[1]].T.tolist(), strict=True))
    if len(closures.sources) > 1:
        columns[SOURCE] = [closures.sources[k] for k in closures.source.tolist()]
    if inlier is not None:
        columns[INLIER] = shown_inliers(inlier)
    return columns


def tables_to_write(closures: Closures) -> list[dict[str, Any]]:
    """The tables [[closure]]; covariances are in closures.csv."""
    return [{"name": name} for name in closures.sources]

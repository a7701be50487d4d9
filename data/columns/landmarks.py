"""landmarks.csv of the open log folder: the map with its standard deviations, and where its landmarks truly are.

    id,x,y[,sx,sy][,true_x,true_y]      in format 2 also kind, descriptor, class

sx, sy: standard deviations [m] of x and y, blank or 0 where exact. true_x, true_y: of a simulated log, blank where
unknown; without these columns the map is the truth.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from data.columns import appearance as looks
from data.columns.header import Header
from data.columns.named import is_name
from data.csv_table import Table, read_table
from data.inputs import LandmarkMap

FILE = "landmarks.csv"
KIND = "kind"
SIGMAS = ("sx", "sy")
TRUE_PLACE = ("true_x", "true_y")


def read_landmarks(path: Path, *, latest: bool = False) -> tuple[LandmarkMap | None, LandmarkMap | None]:
    """landmarks.csv, ascending by id: the map, and the true landmarks, which are the map unless stated (None without
    the file). `latest`: with its columns kind, descriptor and class (format 2).
    """
    if not path.exists():
        return None, None
    more = (KIND, looks.DESCRIPTOR, looks.CLASS) if latest else ()
    blank, words = (*SIGMAS, *TRUE_PLACE, looks.DESCRIPTOR), (KIND, looks.CLASS)
    found = read_table(path, ("id", "x", "y"), (*SIGMAS, *TRUE_PLACE, *more), may_be_blank=blank, words=words)
    return landmarks_of(found)


def landmarks_of(table: Table) -> tuple[LandmarkMap, LandmarkMap]:
    """The map of a table with its columns, and the true landmarks."""
    sigmas = [n for n in SIGMAS if n in table]
    table.require_finite(("x", "y"))
    for pair in (SIGMAS, TRUE_PLACE):
        table.require_finite([n for n in pair if n in table], blank=True)
        missing = [name for name in pair if name not in table]
        if len(missing) == 1:
            raise table.error(-1, missing[0], f"no such column; {' and '.join(pair)} come together")
    for name in sigmas:
        negative = table.columns[name] < 0.0
        table.require(~negative, name, "{} is a negative standard deviation; 0 or blank is an exact landmark")
    number = table.integers("id", 0)
    order = np.argsort(number, kind="stable")
    repeated = np.zeros(len(number), bool)
    repeated[order[1:]] = number[order[1:]] == number[order[:-1]]
    table.require(~repeated, "id", "{} is the id of two landmarks")
    sigma = np.nan_to_num(table.stack(SIGMAS)[order]) if sigmas else np.zeros(0)
    given = table.texts.get(KIND)
    for row, word in enumerate(given or ()):
        if word and not is_name(word):
            raise table.error(row, KIND, f"{word!r} holds a quote; a plain name is needed")
    kind = None if given is None else tuple(given[k] for k in order.tolist())
    seen = looks.of_landmarks(table)
    known = LandmarkMap(
        number[order], table.stack(("x", "y"))[order], kind, None if seen is None else seen.only(order),
        sigma if sigma.any() else None,
    )  # fmt: skip
    if TRUE_PLACE[0] not in table:
        return known, known
    place = table.stack(TRUE_PLACE)[order]
    there = np.flatnonzero(np.isfinite(place).all(axis=1))
    kind = None if kind is None else tuple(kind[k] for k in there.tolist())
    return known, LandmarkMap(known.id[there], place[there], kind)


def usable_sigmas(known: LandmarkMap | None, header: Header) -> tuple[LandmarkMap | None, list[str]]:
    """The map with the sigmas that estimators can use, and a note where these are none of those stated."""
    if known is None or known.sigma is None or all(s.sensor.sees_points for s in header.sensors):
        return known, []
    return known.exact, [f"{FILE}: sigmas of walls are not used; estimators take the map as exact"]

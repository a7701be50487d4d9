"""The rows of the study, in a CSV that an interrupted one goes on with."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import NamedTuple, get_type_hints

BASE = "base"
"""In place of a direction: nothing is changed."""


class Row(NamedTuple):
    """One run.

    log, task: the case; constant, direction: what was changed, to `value`; readings: of the log; rmse_m: of the online
    positions, NaN without truth or end; fp, fn: final decisions, of `readings`; landmarks: in the map in the end;
    same: 1 if every decision, online and final, is that of the baseline; digest: of these; seconds: of the
    processor; status: that of the run, or `slow`; reads: of the baseline, how often it read each constant.
    """

    log: str
    task: str
    constant: str
    direction: str
    value: str
    readings: int
    rmse_m: float
    fp: int
    fn: int
    landmarks: int
    same: int
    digest: str
    seconds: float
    status: str
    reads: str = ""


def read(path: Path) -> list[Row]:
    """The rows of a file; none if it is not there. A last line that was cut off is left out."""
    if not path.exists():
        return []
    types = get_type_hints(Row)
    lines = _whole(path.read_bytes()).decode().splitlines()
    return [Row(**{f: types[f](text) for f, text in row.items()}) for row in csv.DictReader(lines)]


def _whole(content: bytes) -> bytes:
    """A file without a last line that was cut off."""
    return content[: content.rfind(b"\n") + 1]


def append(row: Row, path: Path) -> None:
    """The row at the end of the file, which is begun with the names of the columns; a line cut off there goes."""
    if path.exists() and not (content := path.read_bytes()).endswith(b"\n"):
        path.write_bytes(_whole(content))
    new = not path.exists() or not path.stat().st_size
    with path.open("a", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        if new:
            writer.writerow(Row._fields)
        writer.writerow([f"{v:.8g}" if isinstance(v, float) else v for v in row])


def line_of(row: Row, place: str) -> str:
    """A row as a line of text; `place`: of how many it is."""
    what = BASE if row.direction == BASE else f"{row.constant} {row.direction} ({row.value})"
    return (
        f"{place:>12s} {row.log:18s} {row.task:12s} {what:44s} RMSE {row.rmse_m:8.3f} m, FP {row.fp:5d},"
        f" FN {row.fn:5d}, landmarks {row.landmarks:4d}, {'same' if row.same else 'other'} decisions,"
        f" {row.seconds:6.1f} s, {row.status}"
    )

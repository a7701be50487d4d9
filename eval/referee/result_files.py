"""Files of the result folder as `result_files.toml` lists them, metrics as `metrics.toml` does; rows become tables."""

import math
import re
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Literal

import pandas as pd

from data.inputs import ERRORS
from eval.referee.consistency import CHI2_3_MEDIAN, INSIDE_3SIGMA

Better = Literal["smaller", "larger", "nearer", "neither"]  # The better of two values; `nearer`: to the expected one


@dataclass(frozen=True)
class Metric:
    """A number per run and phase."""

    column: str
    heading: str  # short name, for tables
    unit: str = ""  # of the heading's number; `%`: a share, which tables show in percent
    better: Better = "neither"
    expected: float | None = None  # value of a consistent estimator, if there is one
    form: str = ".4g"  # format of one value; `d`: a whole number, `s`: a text
    spelled: str = ""  # full name, for lines of text; empty: the heading
    about: str = ""  # description in docs/results-folder.md; empty: the full name

    @property
    def percent(self) -> bool:
        """Whether tables show the column in percent."""
        return self.unit == "%"

    @property
    def head(self) -> str:
        """Head of a table's column: heading, expected value, unit."""
        scale = 100.0 if self.percent else 1.0
        expected = "" if self.expected is None else f" (expected {scale * self.expected:.3g})"
        return f"{self.heading}{expected}{self._unit}"

    @property
    def line(self) -> str:
        """Label of a single value in the column's unit: full name, unit, expected value."""
        expected = "" if self.expected is None else f" ({self.expected:.3g} expected)"
        return f"{self.spelled or self.heading}{'' if self.percent else self._unit}{expected}"

    @property
    def _unit(self) -> str:
        return f" [{self.unit}]" if self.unit else ""


RUN = ("log", "task", "estimator", "association", "phase")  # columns that name the run and phase of a row
_EXPECTED = {"chi2_3_median": CHI2_3_MEDIAN, "inside_3sigma": INSIDE_3SIGMA}  # Of consistent estimators


def _metric(expected: str | float | None = None, **row: Any) -> Metric:
    return Metric(expected=_EXPECTED[expected] if isinstance(expected, str) else expected, **row)


_TABLE = tomllib.loads(Path(__file__).with_name("metrics.toml").read_text(encoding="utf-8"))
OF_ESTIMATES = tuple(_metric(**row) for row in _TABLE["estimates"])  # columns of metrics.csv after `status`
OF_DECISIONS = tuple(_metric(**row) for row in _TABLE["decisions"])  # columns of association.csv after those of the run
_BY_COLUMN = {m.column: m for m in (*OF_ESTIMATES, *OF_DECISIONS)}


def metric(column: str) -> Metric:
    """The metric of a column; KeyError if there is none."""
    return _BY_COLUMN[column]


def is_share(column: str) -> bool:
    """Whether tables show the column in percent."""
    return column in _BY_COLUMN and _BY_COLUMN[column].percent


def heads(columns: Sequence[str]) -> dict[str, str]:
    """Head of each column in a table: the metric's, else the column's name."""
    return {c: _BY_COLUMN[c].head if c in _BY_COLUMN else c for c in columns}


Row = dict[str, object]  # a row of a result table by its columns


def is_blank(value: object) -> bool:
    """Whether a cell holds nothing: None, NaN, infinite, or an empty text."""
    return value is None or value is pd.NA or value == "" or (isinstance(value, float) and not math.isfinite(value))


def rows_of(frame: pd.DataFrame) -> list[Row]:
    """The rows of a table; None: a blank cell."""
    return [{str(k): None if is_blank(v) else v for k, v in r.items()} for r in frame.to_dict("records")]


def value_of(row: Row, column: str) -> float:
    """A number of a row, NaN where it is blank."""
    value = row.get(column)
    return math.nan if is_blank(value) else float(value)  # type: ignore[arg-type]


Kind = Literal["text", "count", "number"]
BLANKS = {"text": "str", "count": "Int64", "number": "float64"}
"""Type of a column in a table: unknown is NaN, of a count (an integer column of pandas) `pd.NA`."""


@dataclass(frozen=True)
class Column:
    """A column of a CSV."""

    name: str
    about: str
    unit: str = ""
    kind: Kind = "number"  # a frame and the number of a landmark are counts

    def __post_init__(self) -> None:
        if not self.about.strip():
            raise ValueError(f"column {self.name!r} has no description")


text, count = partial(Column, kind="text"), partial(Column, kind="count")  # columns of words, and of whole numbers


def measured(metric: Metric) -> Column:
    """The column of a metric."""
    expected = "" if metric.expected is None else f" (expected {metric.expected:.3g})"
    kind: Kind = {"d": "count", "s": "text"}.get(metric.form, "number")  # type: ignore[assignment]
    unit = "share" if metric.percent else metric.unit
    return Column(metric.column, f"{metric.about or metric.spelled or metric.heading}{expected}", unit, kind)


@dataclass(frozen=True)
class File:
    """A file of the result folder, or a kind of them."""

    path: str  # below the result folder; `<...>` stands for names
    about: str
    columns: tuple[Column, ...] = ()  # of a CSV, in order
    optional: tuple[str, ...] = ()  # columns of some of these files only
    when: str = ""  # condition under which the file exists; empty: always

    @property
    def name(self) -> str:
        """The last component of the path."""
        return self.path.rpartition("/")[2]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the columns."""
        return tuple(c.name for c in self.columns)

    def table(self, rows: Sequence[Mapping[str, object]]) -> pd.DataFrame:
        """Rows as a table of exactly these columns, each of its type; missing values are unknown."""
        unknown = {k for row in rows for k in row} - set(self.names)
        if unknown:
            raise AssertionError(f"{self.path}: columns {sorted(unknown)} are none of {', '.join(self.names)}")
        return pd.DataFrame({c.name: _typed([row.get(c.name) for row in rows], c.kind) for c in self.columns})

    def write(self, table: pd.DataFrame, place: Path) -> None:
        """Write `place/name`; AssertionError where the columns are not those described here."""
        given = tuple(str(c) for c in table.columns)
        if given != tuple(n for n in self.names if n in given or n not in self.optional):
            raise AssertionError(f"{self.path} has the columns {', '.join(self.names)}, not {', '.join(given)}")
        table.to_csv(place / self.name, index=False, lineterminator="\n")


def _typed(values: Sequence[Any], kind: Kind) -> pd.Series:
    unknown = math.nan if kind == "number" else None
    return pd.Series([unknown if v != "" and is_blank(v) else v for v in values], dtype=BLANKS[kind])


ESTIMATED = tuple(
    Column(f"{prefix}{name}", "systematic error (`--calibrate`) and its standard deviation", unit.strip("1"))
    for name, unit in ERRORS.items() for prefix in ("", "sigma_")
)  # fmt: skip
"""Estimated systematic errors; these columns come last."""
TABLES: dict[str, dict[str, str]] = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))
GROUPS = {
    "estimated": ESTIMATED, "of_estimates": tuple(map(measured, OF_ESTIMATES)),
    "of_decisions": tuple(map(measured, OF_DECISIONS)),
}  # fmt: skip


def _columns(lines: str) -> tuple[Column, ...]:
    """The columns of lines of the table."""
    found: list[Column] = []
    for line in lines.split("\n"):
        if (column := re.fullmatch(r"(?:(count|text) )?(\S+)(?: \[(.+?)\])?: (.+)", line)) is not None:
            kind: Kind = column[1] or "number"  # type: ignore[assignment]
            found.append(Column(column[2], column[4], column[3] or "", kind))
        elif line:
            found += GROUPS[line.removeprefix("@")]
    return tuple(found)


for _name, _lines in TABLES.pop("groups").items():
    GROUPS[_name] = _columns(_lines)


def _files(*keys: str) -> tuple[File, ...]:
    """The files of keys of the table."""
    each, names = [TABLES[key] for key in keys], tuple(c.name for c in ESTIMATED)
    return tuple(
        File(t["path"], t["about"], _columns(t.get("columns", "")),
             names if "@estimated" in t.get("columns", "") else (), t.get("when", "")) for t in each
    )  # fmt: skip


PATH = GROUPS["path"]
ONLINE, FINAL, PATH_TUM, LANDMARKS, DECISIONS, LAB_TEXT = OF_RUNS = _files(
    "online", "final", "path_tum", "landmarks", "decisions", "lab_text"
)
OF_LOGS = _files("truth_tum", "loops", "graph", "map")
OTHERS = _files(
    "report", "details", "players", "tables", "team", "notes", "figures", "write_up", "provenance", "run_log"
)
LOOPS, TEAM = OF_LOGS[1], OTHERS[4]
METRICS, DECISION_COUNTS, CONSISTENCY, TRUST, RELATIONS, SOURCES, SPACE, PUBLISHED, NOTICES, TIMING = TOP = _files(
    "metrics", "association", "consistency", "trust", "relations", "sources", "space", "published", "notices", "timing"
)
(DIFFERENCES,) = _files("differences")

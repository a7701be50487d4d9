"""What a file of the result folder holds: columns with unit and meaning, and how rows become its table and its CSV."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pandas as pd

from eval.referee.metrics import Metric

Kind = Literal["text", "count", "number"]
BLANKS = {"text": "str", "count": "Int64", "number": "float64"}
"""Type of a column in a table: unknown is NaN, of a count (an integer column of pandas) `pd.NA`."""


@dataclass(frozen=True)
class Column:
    """A column of a CSV.

    Attributes:
        name: in the file's first line.
        about: what it holds, in words.
        unit: of its number; empty: it has none.
        kind: `text`, `count` (a whole number, also a frame or the number of a landmark) or `number`.
    """

    name: str
    about: str
    unit: str = ""
    kind: Kind = "number"

    def __post_init__(self) -> None:
        if not self.about.strip():
            raise ValueError(f"column {self.name!r}: what it holds must be said")


def text(name: str, about: str) -> Column:
    """A column of words."""
    return Column(name, about, kind="text")


def count(name: str, about: str) -> Column:
    """A column of whole numbers."""
    return Column(name, about, kind="count")


def measured(metric: Metric) -> Column:
    """The column of a metric."""
    expected = "" if metric.expected is None else f"; {metric.expected:.3g} expected of a consistent estimator"
    kind: Kind = {"d": "count", "s": "text"}.get(metric.form, "number")  # type: ignore[assignment]
    unit = "share, 0 to 1" if metric.percent else metric.unit
    return Column(metric.column, f"{metric.about or metric.spelled or metric.heading}{expected}", unit, kind)


@dataclass(frozen=True)
class File:
    """A file of the result folder, or a kind of them.

    Attributes:
        path: below the result folder; `<...>` stands for names.
        about: what it is, in a sentence or two.
        columns: of a CSV, in order; those `optional` stand in some of these files only.
        when: where it is not always there.
    """

    path: str
    about: str
    columns: tuple[Column, ...] = ()
    optional: tuple[str, ...] = ()
    when: str = ""

    @property
    def name(self) -> str:
        """The last component of the path."""
        return self.path.rpartition("/")[2]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the columns."""
        return tuple(c.name for c in self.columns)

    def table(self, rows: Sequence[Mapping[str, object]]) -> pd.DataFrame:
        """Rows as a table with exactly these columns, each of its type; what a row lacks is unknown."""
        unknown = {k for row in rows for k in row} - set(self.names)
        if unknown:
            raise AssertionError(f"{self.path}: columns {sorted(unknown)} are none of {', '.join(self.names)}")
        return pd.DataFrame({c.name: _typed([row.get(c.name) for row in rows], c.kind) for c in self.columns})

    def write(self, table: pd.DataFrame, place: Path) -> None:
        """Write `place/name`; a column that is not described here cannot be written, nor one be left out."""
        given = tuple(str(c) for c in table.columns)
        if given != tuple(n for n in self.names if n in given or n not in self.optional):
            raise AssertionError(f"{self.path} has the columns {', '.join(self.names)}, not {', '.join(given)}")
        table.to_csv(place / self.name, index=False, lineterminator="\n")


def _typed(values: Sequence[Any], kind: Kind) -> pd.Series:
    blank = [v is None or v is pd.NA or (isinstance(v, float) and not math.isfinite(v)) for v in values]
    if kind == "number":
        numbers = [math.nan if b else float(v) for v, b in zip(values, blank, strict=True)]
        return pd.Series(np.array(numbers, np.float64))
    plain: list[Any] = [None if b else v for v, b in zip(values, blank, strict=True)]
    return pd.Series(plain, dtype=BLANKS[kind])

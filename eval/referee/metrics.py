"""The metrics of the referee, in the order of tables: column, unit, heading, format and preferred values of each."""

import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

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


_TABLE = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))
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

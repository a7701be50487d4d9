"""Rows of metrics.csv and association.csv as the sentences of the report read them."""

from __future__ import annotations

import math

import pandas as pd

from eval.page.tables import is_blank

Row = dict[str, object]


def value_of(row: Row, column: str) -> float:
    """A number of a row, NaN where it is blank."""
    value = row.get(column)
    return math.nan if is_blank(value) else float(value)  # type: ignore[arg-type]


def rows_of(frame: pd.DataFrame) -> list[Row]:
    """The rows of a table."""
    return [{str(k): v for k, v in r.items()} for r in frame.to_dict("records")]

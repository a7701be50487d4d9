"""Rows of metrics.csv and association.csv as the sentences of the report read them."""

from __future__ import annotations

import math
from collections.abc import Sequence

import pandas as pd

from eval.replay.settings import BATCH, ESTIMATORS, FILTERS, INCREMENTAL
from eval.report.page.tables import is_blank

Row = dict[str, object]


def value_of(row: Row, column: str) -> float:
    """A number of a row, NaN where it is blank."""
    value = row.get(column)
    return math.nan if is_blank(value) else float(value)  # type: ignore[arg-type]


def rows_of(frame: pd.DataFrame) -> list[Row]:
    """The rows of a table."""
    return [{str(k): v for k, v in r.items()} for r in frame.to_dict("records")]


def filters_in(rows: Sequence[Row]) -> tuple[str, ...]:
    """The estimators that do not revise their past: ours, and of others those that have no final row."""
    return (*FILTERS, *(name for name in _others(rows) if name not in _finals(rows)))


def smoothers_in(rows: Sequence[Row]) -> tuple[str, ...]:
    """The estimators that do."""
    return (*BATCH, *INCREMENTAL, *(name for name in _others(rows) if name in _finals(rows)))


def _others(rows: Sequence[Row]) -> list[str]:
    return list(dict.fromkeys(str(r["estimator"]) for r in rows if r["estimator"] not in ESTIMATORS))


def _finals(rows: Sequence[Row]) -> set[str]:
    return {str(r["estimator"]) for r in rows if r["phase"] == "final"}

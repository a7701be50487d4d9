"""Numbers and tables as a person reads them: rounded, blank where nothing is known, and in Markdown."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from typing import Any

import pandas as pd

from data.words import number as number
from eval.referee.result_files import is_blank


def interval(lower: float, upper: float) -> str:
    """`lower to upper`, both with as many decimals as the larger one needs for three digits."""
    size = max(abs(lower), abs(upper))
    places = min(max(2 - math.floor(math.log10(size)), 0), 6) if size > 0.0 else 0
    return f"{lower:.{places}f} to {upper:.{places}f}".replace("-", "−")


DIGITS = 3  # significant digits of a column's middle value


def is_numeric(column: Sequence[Any]) -> bool:
    """Whether a column holds numbers only, blanks aside."""
    known = [v for v in column if not is_blank(v)]
    return bool(known) and all(pd.api.types.is_number(v) and not isinstance(v, bool) for v in known)


def _decimals(values: Sequence[float]) -> int:
    sizes = sorted(abs(v) for v in values if v != 0.0)
    if not sizes:
        return 0
    middle = sizes[(len(sizes) - 1) // 2]
    return int(min(max(DIGITS - 1 - math.floor(math.log10(middle)), 0), 6))


def column_text(column: Sequence[Any]) -> list[str]:
    """A column as text: integers whole, others with decimals that suit the middle value (exponents from 1e6)."""
    known = [v for v in column if not is_blank(v)]
    if not is_numeric(column):
        return ["" if is_blank(v) else {True: "yes", False: "no"}[v] if isinstance(v, bool) else str(v) for v in column]
    if all(float(v).is_integer() for v in known):
        return ["" if is_blank(v) else str(int(v)) for v in column]
    places = _decimals([float(v) for v in known])
    return ["" if is_blank(v) else _number(float(v), places) for v in column]


def _number(value: float, places: int) -> str:
    if value == 0.0:
        return "0"
    if abs(value) >= 1e6:
        return f"{value:.2e}"
    text = f"{value:.{places}f}"
    return text.replace("-", "−") if float(text) != 0.0 else text.lstrip("-")


NOTHING = 1e-6  # a number that is closer to zero is a rounding error of arithmetic, and written as 0


def cell_texts(column: Sequence[Any]) -> list[str]:
    """A column as text to read: integers whole, other numbers with three significant digits each."""
    known = [v for v in column if not is_blank(v)]
    if not is_numeric(column) or all(float(v).is_integer() for v in known):
        return column_text(column)
    tiny = [not is_blank(v) and abs(float(v)) < NOTHING for v in column]
    significant = ["" if is_blank(v) else number(float(v), DIGITS).replace("-", "−") for v in column]
    return ["0" if zero else text for zero, text in zip(tiny, significant, strict=True)]


def texts(frame: pd.DataFrame) -> list[list[str]]:
    """The body of a table as text, row by row."""
    columns = [cell_texts(frame[c].tolist()) for c in frame.columns]
    return [list(row) for row in zip(*columns, strict=True)]


def drop_blank_columns(frame: pd.DataFrame) -> pd.DataFrame:
    """The table without the columns that hold nothing."""
    return frame[[c for c in frame.columns if not all(is_blank(v) for v in frame[c].tolist())]]


def markdown_escape(text: str) -> str:
    """Text that Markdown shows as it is, also within a table; underscores inside a word mean nothing and stay."""
    plain = re.sub(r"[\\`*<|&~]|\[(?=[^]]*\]\()", r"\\\g<0>", text.replace("\n", " "))
    return re.sub(r"(?<![^\W_])_|_(?![^\W_])", r"\\_", plain)


def markdown(frame: pd.DataFrame) -> str:
    """The table in Markdown; numbers to the right."""
    rule = ["---:" if is_numeric(frame[c].tolist()) else "---" for c in frame.columns]
    rows = [
        [markdown_escape(str(c)) for c in frame.columns],
        rule,
        *([markdown_escape(t) for t in row] for row in texts(frame)),
    ]
    return "".join(f"| {' | '.join(row)} |\n" for row in rows)

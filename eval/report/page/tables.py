"""Numbers and tables as a person reads them: rounded, blank where nothing is known, and in Markdown."""

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


def is_numeric(column: Sequence[Any]) -> bool:
    """Whether a column holds numbers only, blanks aside."""
    known = [v for v in column if not is_blank(v)]
    return bool(known) and all(pd.api.types.is_number(v) and not isinstance(v, bool) for v in known)


NOTHING = 1e-6  # a number that is closer to zero is a rounding error of arithmetic, and written as 0


def cell_texts(column: Sequence[Any]) -> list[str]:
    """A column as text to read: integers whole, other numbers with three significant digits each."""
    numeric = is_numeric(column)
    whole = numeric and all(float(v).is_integer() for v in column if not is_blank(v))
    return ["" if is_blank(v) else _text(v, numeric, whole) for v in column]


def _text(value: Any, numeric: bool, whole: bool) -> str:
    if not numeric:
        return {True: "yes", False: "no"}[value] if isinstance(value, bool) else str(value)
    if whole:
        return str(int(value))
    return "0" if abs(float(value)) < NOTHING else number(float(value)).replace("-", "−")


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
    body = ([markdown_escape(t) for t in row] for row in texts(frame))
    rows = [[markdown_escape(str(c)) for c in frame.columns], rule, *body]
    return "".join(f"| {' | '.join(row)} |\n" for row in rows)

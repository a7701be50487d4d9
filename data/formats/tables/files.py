"""A CSV file of another program: separator, header and decimal comma are found, its fields are kept as text.

Comma, semicolon, tab or spaces; with a line of names or without; lines that start with `#` or `%` are comments, but the
last one above the first row is the line of names where it has as many fields as the row. Fields may be quoted.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from data.errors import DataError
from data.inputs import IntArray
from data.se2 import Array, BoolArray

SEPARATORS = (";", "\t", ",", " ")
"""In this order, so that a decimal comma is not taken for a separator beside a semicolon or a tab."""
COMMENT = ("#", "%")
NAMES_SHOWN = 200
"""Characters of a line of names that a message shows."""


@dataclass(frozen=True, eq=False)
class TextTable:
    """Rows of text.

    Attributes:
        path: how errors name the file.
        names: of the columns; "1", "2", ... where the file has no line of names.
        rows: fields without quotes and spaces around them, all rows of equal length.
        line: (K,) line of the file each row stands in, from 1.
        named: whether the names stand in the file.
        decimal_comma: numbers are written 1,5.
    """

    path: Path
    names: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    line: IntArray
    named: bool
    decimal_comma: bool = False

    def __len__(self) -> int:
        return len(self.rows)

    def find(self, name: str) -> int | None:
        """Number of the column of that name, or of that number counted from 1; None: there is none."""
        if name in self.names:
            return self.names.index(name)
        if name.isdecimal() and 1 <= int(name) <= len(self.names):
            return int(name) - 1
        return None

    def described(self) -> str:
        """The columns as a message shows them."""
        if not self.named:
            return f"columns 1 to {len(self.names)}, without names"
        text = ", ".join(self.names)
        return "columns " + (text if len(text) <= NAMES_SHOWN else text[:NAMES_SHOWN] + " ...")

    def blank(self, column: int) -> BoolArray:
        """Whether each field of a column (K,) is empty; bool."""
        return np.array([not row[column] for row in self.rows], bool)

    def text(self, column: int, keep: BoolArray) -> list[str]:
        """The fields of a column in the rows to keep (K,), bool."""
        return [row[column] for row, wanted in zip(self.rows, keep.tolist(), strict=True) if wanted]

    def numbers(self, column: int, keep: BoolArray, *, stamps: bool) -> Array:
        """A column as numbers, NaN where blank or nan; `stamps`: dates as in 2024-05-01T12:00:00.5 in s since 1970.

        Raises:
            DataError: a field is none, or infinite.
        """
        parse = _seconds if stamps else _decimal if self.decimal_comma else _number
        fields = self.text(column, keep)
        try:
            return np.array([parse(f) if f else np.nan for f in fields], float)
        except ValueError:
            pass
        k = next(i for i, f in enumerate(fields) if f and not _parses(parse, f))
        what = "a date as in 2024-05-01T12:00:00.5" if stamps else "a number"
        raise DataError.at(
            self.path, f"{fields[k]!r} is not {what}", line=int(self.line[keep][k]), column=self.names[column]
        )


def _number(field: str) -> float:
    if "_" in field:  # Python reads 1_0 as ten
        raise ValueError
    value = float(field)
    if math.isinf(value):
        raise ValueError
    return value


def _decimal(field: str) -> float:
    return _number(field.replace(",", "."))


def _seconds(field: str) -> float:
    """Seconds since 1970 of a date in ISO 8601; without a zone it is UTC."""
    date = datetime.fromisoformat(field)
    return (date if date.tzinfo is not None else date.replace(tzinfo=UTC)).timestamp()


def _parses(parse: Callable[[str], float], field: str) -> bool:
    try:
        parse(field)
    except ValueError:
        return False
    return True


def _is_row(fields: Sequence[str]) -> bool:
    """Whether a line holds values: a number or a date in at least half of its fields that are not blank."""
    filled = [f for f in fields if f]
    values = sum(_parses(_decimal, f) or _parses(_seconds, f) for f in filled)
    return bool(filled) and 2 * values >= len(filled)


def _split(lines: Sequence[str], separator: str) -> list[tuple[str, ...]]:
    """Fields of each line."""
    if separator == " ":
        return [tuple(line.replace('"', " ").split()) for line in lines]
    return [tuple(f.strip() for f in row) for row in csv.reader(lines, delimiter=separator, skipinitialspace=True)]


def _separator(lines: Sequence[str]) -> str:
    """The first that cuts the first lines into the same number of fields, more than one; else a comma (one column)."""
    for separator in SEPARATORS:
        # the line of names may hold any character, so the rows below it decide
        counts = {len(row) for row in _split(lines[1:] or lines, separator)}
        if len(counts) == 1 and counts.pop() > 1:
            return separator
    held = [s for s in SEPARATORS if all(s in line for line in lines)]
    return held[0] if held else ","


def read_text(path: Path) -> TextTable:
    """The file's rows.

    Raises:
        DataError: it cannot be read, is no text, holds no rows, or a row has another number of fields than the first.
    """
    try:
        content = path.read_bytes()
    except OSError as error:
        raise DataError.at(path, f"cannot be read: {error.strerror}") from None
    except ValueError:
        raise DataError.at(path, "no file can be called so") from None
    try:
        text = content.decode("utf-16" if content[:2] in (b"\xff\xfe", b"\xfe\xff") else "utf-8-sig")
    except UnicodeDecodeError:
        text = content.decode("latin-1")
    lines = enumerate(text.splitlines(), 1)
    if long := next((i for i, line in lines if len(line) > csv.field_size_limit()), None):
        raise DataError.at(path, f"more than {csv.field_size_limit()} characters", line=long)
    if "\0" in text:
        raise DataError.at(path, "not a text file; a CSV file is needed")
    numbered = [(i, line.strip("\n\r")) for i, line in enumerate(text.splitlines(), 1) if line.strip(" \r\n;,")]
    plain = [(i, line) for i, line in numbered if not line.lstrip().startswith(COMMENT)]
    if not plain:
        raise DataError.at(path, "no rows")
    separator = _separator([line for _, line in plain[:50]])
    rows = _split([line for _, line in plain], separator)
    number = np.array([i for i, _ in plain], np.int64)
    names: tuple[str, ...] | None = None
    if not _is_row(rows[0]):
        names, rows, number = rows[0], rows[1:], number[1:]
    else:
        above = [line.lstrip().lstrip("#%").strip() for i, line in numbered if i < number[0]]
        candidate = _split(above[-1:], separator)
        if candidate and len(candidate[0]) == len(rows[0]):
            names = candidate[0]
    if not rows:
        raise DataError.at(path, "a line of names and no rows")
    width = len(rows[0]) if names is None else len(names)
    for row, line in zip(rows, number.tolist(), strict=True):
        if len(row) != width:
            last = " (the file ends here: was it cut off?)" if line == number[-1] and len(row) < width else ""
            raise DataError.at(path, f"{len(row)} fields where {width} are needed{last}", line=line)
    if names is not None:
        twice = [n for i, n in enumerate(names) if n and n in names[:i]]
        if twice:
            raise DataError.at(path, f"two columns are named {twice[0]!r}", line=None)
    comma = separator in ";\t " and any("," in f for row in rows for f in row) and not _has_points(rows)
    shown = names if names is not None else tuple(str(k + 1) for k in range(width))
    return TextTable(path, shown, tuple(rows), number, names is not None, comma)


def _has_points(rows: Sequence[Sequence[str]]) -> bool:
    """Whether some number is written with a decimal point."""
    return any("." in f and _parses(_number, f) for row in rows[:1000] for f in row)

"""Text files of trajectories: data lines split into fields, and their numbers."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from data.csv_table import cut_off, is_number
from data.errors import LARGEST, DataError
from data.se2 import Array


@dataclass(frozen=True)
class Text:
    """Data lines of a file, split into fields, with their numbers from 1; and its comments."""

    path: Path
    fields: tuple[tuple[str, ...], ...]
    line: tuple[int, ...]
    comments: tuple[tuple[int, str], ...]
    commas: bool

    def place(self, row: int) -> str:
        """Place of a row, for messages."""
        return f"{self.path}:{self.line[row]}"

    def without_header(self) -> Text:
        """The rows below the first line."""
        return Text(self.path, self.fields[1:], self.line[1:], self.comments, self.commas)


def split(line: str, separator: str | None) -> tuple[str, ...]:
    """Fields of a line; None: at blanks."""
    return tuple(line.split()) if separator is None else tuple(f.strip() for f in line.split(separator))


def read_text(path: Path) -> Text:
    """Split a file at commas or semicolons if its first data line has any, else at blanks; `#`, `%` begin comments."""
    try:
        content = path.read_text(encoding="utf-8-sig")
    except FileNotFoundError:
        raise DataError.at(path, "no such file") from None
    except UnicodeDecodeError:
        raise DataError.at(path, "not a text file; docs/results-files.md lists the formats") from None
    except OSError as fault:
        raise DataError.at(path, f"cannot be read: {fault.strerror}") from None
    lines = [(i, line.strip()) for i, line in enumerate(content.splitlines(), start=1)]
    comments = tuple((i, line) for i, line in lines if line.startswith(("#", "%")))
    data = [(i, line) for i, line in lines if line and not line.startswith(("#", "%"))]
    if not data:
        raise DataError.at(path, "no line of data; at least one is needed")
    separator = next((s for s in (",", ";") if s in data[0][1]), None)
    fields = tuple(split(line, separator) for _, line in data)
    if separator is not None and all(f[-1] == "" for f in fields):  # a comma ends every line
        fields = tuple(f[:-1] for f in fields)
    return Text(path, fields, tuple(i for i, _ in data), comments, separator is not None)


def numbers(
    text: Text, columns: Sequence[str], *, more: bool = False, blank: bool = False, huge: Collection[str] = ()
) -> Array:
    """The fields as numbers (n, columns), NaN where unknown; `more`: further fields of a line are ignored.

    A covariance (see `is_covariance`) may be infinite, which is unknown, too. `blank`:
    fields may be blank. Columns of `huge` may exceed `LARGEST`.
    """
    k = len(columns)
    plain = _plain(text, k, more)
    if plain is not None:
        return plain
    found = np.full((len(text.fields), k), np.nan)
    for row, (line, fields) in enumerate(zip(text.line, text.fields, strict=True)):
        if len(fields) < k or (len(fields) > k and not more):
            last = cut_off(len(fields), k, last=line == text.line[-1])
            raise DataError.at(text.path, f"{len(fields)} fields; {k} are needed{last}", line=line)
        for j, (name, field) in enumerate(zip(columns, fields, strict=False)):
            if blank and not field:
                continue
            if not is_number(field):
                raise DataError.at(text.path, f"{field[:40]!r} is not a number", line=line, column=name)
            value = float(field)
            if math.isinf(value) and not is_covariance(name):
                what = f"{field[:40]}; a finite number in SI units is needed, or nan where unknown"
                raise DataError.at(text.path, what, line=line, column=name)
            if math.isfinite(value) and abs(value) > LARGEST and name not in huge:
                if not is_covariance(name):
                    what = f"{field[:40]}; a finite number in SI units is needed"
                    raise DataError.at(text.path, what, line=line, column=name)
                value = math.nan
            found[row, j] = value
    found[np.isinf(found)] = np.nan
    return found


def _plain(text: Text, k: int, more: bool) -> Array | None:
    """The first k fields of every line as numbers (n, k), at once; None unless all are finite and within bounds."""
    widths = set(map(len, text.fields))
    if min(widths) < k or (max(widths) > k and not more):
        return None
    try:
        found = np.array([list(map(float, fields[:k])) for fields in text.fields])
    except ValueError:
        return None
    underscored = any("_" in field for fields in text.fields for field in fields[:k])  # Python reads 1_0 as ten
    return None if underscored or not (np.abs(found) <= LARGEST).all() else found


def is_covariance(name: str) -> bool:
    """Whether a column holds an entry of a covariance."""
    return name.startswith("c_") or (name[:1] in "cPf" and name[-1:].isdigit())


def require_order(text: Text, time: Array) -> None:
    """DataError where known stamps (n,) decrease."""
    known = np.flatnonzero(np.isfinite(time))
    back = np.flatnonzero(np.diff(time[known]) < 0.0)
    if len(back):
        k, before = int(known[back[0] + 1]), int(known[back[0]])
        late, early = (repr(float(v)) if abs(v) <= LARGEST else f"{v:.0f}" for v in (time[before], time[k]))
        what = f"stamp {early} is before {late} of the line above"
        raise DataError.at(text.path, f"{what}; ascending stamps are needed", line=text.line[k])

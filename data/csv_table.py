"""Strict numeric tables: columns by name as float64 arrays; errors name file, line, column and value.

A CSV file is a header and one row per line, without comments, quoted numbers or blank lines (but at its end). A byte
order mark, CRLF line ends and spaces around fields are accepted. Columns may have any order.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from itertools import chain
from pathlib import Path
from typing import NamedTuple

import numpy as np

from data.errors import LARGEST, DataError
from data.inputs import IntArray
from data.se2 import Array, BoolArray

FIRST_ROW = 2  # Line of the first row below a header


class Columns(NamedTuple):
    """Columns of a file: which it must have, which it may have, those with fields that may be blank, those of words."""

    required: tuple[str, ...]
    optional: tuple[str, ...] = ()
    may_be_blank: tuple[str, ...] = ()
    words: tuple[str, ...] = ()


@dataclass(frozen=True)
class Table:
    """Columns (K,) of a file by name, NaN where blank."""

    path: Path | str  # the file's name in errors
    columns: dict[str, Array]  # by name
    line: IntArray  # (K,) line of each row in the file
    unknown: tuple[str, ...] = ()  # names of columns that were not requested
    texts: Mapping[str, Sequence[str]] = field(default_factory=dict)  # columns of words, each (K,), empty where blank
    named: Mapping[str, str] = field(default_factory=dict)  # columns in errors, where they have other names

    def __contains__(self, name: str) -> bool:
        return name in self.columns

    def __len__(self) -> int:
        return len(self.line)

    def get(self, name: str) -> Array:
        """A column (K,), NaN where the table has none."""
        return self.columns[name] if name in self.columns else np.full(len(self), np.nan)

    def require_names(self, name: str) -> None:
        """Raise at the first word of a column that a field of a CSV cannot hold."""
        for row, word in enumerate(self.texts.get(name, ())):
            if word and not is_name(word):
                what = "a comma or a quote" if "," in word else "a quote"
                raise self.error(row, name, f"{word!r} holds {what}; a plain name is needed")

    def stack(self, names: Sequence[str]) -> Array:
        """Columns side by side, (K, len(names))."""
        return np.stack([self.columns[n] for n in names], axis=-1)

    def all(self) -> Array:
        """All columns side by side, (K, columns), in file order."""
        return self.stack(tuple(self.columns))

    def part(self, rows: IntArray | BoolArray) -> Table:
        """Some of its rows, in this order."""
        columns = {name: values[rows] for name, values in self.columns.items()}
        texts = {name: np.asarray(words, object)[rows].tolist() for name, words in self.texts.items()}
        return replace(self, columns=columns, line=self.line[rows], texts=texts)

    def symmetric(self, names: Sequence[str]) -> Array:
        """Symmetric matrices (K, d, d) from their upper triangles, row by row."""
        return symmetric(self.stack(names))

    def require(self, fine: BoolArray, name: str, what: str) -> None:
        """Raise at the first row where `fine` (K,) is false; `{}` in `what` is the value of column `name`."""
        if not fine.all():
            row = int(np.argmin(fine))
            value = float(self.columns[name][row])
            whole = value.is_integer() and abs(value) <= LARGEST
            raise self.error(row, name, what.format(int(value) if whole else repr(value)))

    def error(self, row: int, name: str | None, what: str) -> DataError:
        """The error of a row."""
        return DataError.at(self.path, what, line=int(self.line[row]), column=self.named.get(name or "", name))

    def together(self, names: Sequence[str]) -> bool:
        """Whether it has these columns; DataError where it has some of them only."""
        missing = [name for name in names if name not in self]
        if missing and len(missing) < len(names):
            what = f"no such column; {(' and ' if len(names) == 2 else ',').join(names)} come together"
            raise DataError.at(self.path, what, line=1, column=missing[0])
        return not missing

    def require_finite(self, names: Collection[str], *, blank: bool = False) -> None:
        """Raise unless every value is finite and at most `LARGEST`, or blank (NaN) where allowed."""
        for name in names:
            values = self.columns[name]
            fine = np.abs(values) <= LARGEST
            if blank:
                fine |= np.isnan(values)
            hint = "; leave the field blank where unknown" * blank
            self.require(fine, name, f"{{}} is not a number between -1e15 and 1e15{hint}")

    def require_ascending(self, name: str, *, strictly: bool, hint: str = "") -> None:
        """Raise, with a hint, at the first row whose value is smaller than (`strictly`: or equal to) the one before."""
        values = self.columns[name]
        fine = np.ones(len(values), bool)
        fine[1:] = values[1:] > values[:-1] if strictly else values[1:] >= values[:-1]
        if not fine.all():
            before = float(values[int(np.argmin(fine)) - 1])
            rule = "must increase" if strictly else "must not decrease"
            self.require(fine, name, f"{{}} follows {before!r}; {name} {rule} from row to row{hint}")

    def require_distinct(self, name: str, values: IntArray, what: str) -> None:
        """Raise at the first row whose value (K,) is that of one above; `{}` in `what` as of `require`."""
        first = np.zeros(len(values), bool)
        first[np.unique(values, return_index=True)[1]] = True
        self.require(first, name, what)

    def integers(self, name: str, smallest: int, *, blank: int | None = None) -> IntArray:
        """A column of whole numbers >= `smallest`; blank fields become `blank`, or an error if that is None."""
        values = self.get(name)
        empty = np.isnan(values) if blank is not None else np.zeros(len(values), bool)
        fine = empty | ((values >= smallest) & (values == np.floor(values)) & (values <= LARGEST))
        self.require(fine, name, f"{{}} is not a whole number from {smallest} up{' (or blank)' * (blank is not None)}")
        return np.where(empty, blank or 0, values).astype(np.int64)


def symmetric(entries: Array, *, lower: bool = False) -> Array:
    """Symmetric matrices (K, d, d) from their upper (or `lower`) triangles, row by row."""
    d = {1: 1, 3: 2, 6: 3, 21: 6}[entries.shape[1]]
    i, j = np.tril_indices(d) if lower else np.triu_indices(d)
    matrices = np.empty((len(entries), d, d))
    matrices[:, i, j] = matrices[:, j, i] = entries
    return matrices


def is_name(word: str) -> bool:
    """Whether a field of a CSV can hold a word."""
    return bool(word) and word == word.strip() and word.isprintable() and not set(word) & set(',"')


def shown(field: bytes) -> str:
    """A field as in a message: one line, at most 40 characters."""
    text = field.decode("utf-8", "replace").strip()
    return repr(text if len(text) <= 40 else text[:37] + "...")


def bytes_of(path: Path, *, missing: str = "") -> bytes:
    """Contents of a file; DataError where it cannot be read, with `missing` as message where there is none."""
    try:
        return path.read_bytes()
    except OSError as error:
        gone = missing if isinstance(error, FileNotFoundError) else ""
        raise DataError.at(path, gone or f"cannot be read: {error.strerror}") from None
    except ValueError:
        raise DataError.at(path, "not a file name") from None


def is_number(field: str | bytes) -> bool:
    """Whether a field is a number, NaN and infinity included; unlike Python, 1_0 is none."""
    try:
        float(field)
    except ValueError:
        return False
    return (b"_" if isinstance(field, bytes) else "_") not in field  # type: ignore[operator]


def number_rows(path: Path | str, lines: Sequence[int], rows: Sequence[Sequence[bytes]], names: Sequence[str]) -> Array:
    """Fields (K, len(names)) as numbers, NaN and infinity included; DataError names the first that is none."""
    fields = [*chain.from_iterable(rows)]
    with suppress(ValueError):
        if b"_" not in b"".join(fields):  # Python reads 1_0 as ten
            return np.array([*map(float, fields)], float).reshape(-1, len(names))
    k = next(k for k, text in enumerate(fields) if not is_number(text))
    what = f"{shown(fields[k])} is not a number" if fields[k].strip() else "blank; a number is needed"
    raise DataError.at(path, what, line=lines[k // len(names)], column=names[k % len(names)])


def lines_of(content: bytes) -> list[bytes]:
    """Lines without line ends and byte order mark."""
    return content.removeprefix(b"\xef\xbb\xbf").replace(b"\r\n", b"\n").replace(b"\r", b"\n").split(b"\n")


def cut_off(fields: int, needed: int, *, last: bool) -> str:
    """Hint of a message about a row with too few fields in the `last` line."""
    return " (the file ends here: was it cut off?)" if last and fields < needed else ""


def ends_early(fields: Iterable[int], needed: int, read: int) -> set[int]:
    """Numbers of fields of rows that end before the header, behind the columns to read, if several rows have each."""
    return {n for n, count in Counter(fields).items() if read <= n < needed and count > 1}


def _header(path: Path, line: bytes, required: Sequence[str]) -> list[str]:
    names = [name.strip().strip('"') for name in line.decode("utf-8", "replace").split(",")]
    for name in required:
        if name not in names:
            found = "the line is blank" if names == [""] else f"found {shown(line)}"
            what = f"no such column; {found}, wanted at least {','.join(required)}"
            raise DataError.at(path, what, line=1, column=name)
    for i, name in enumerate(names):
        if name in names[:i]:
            raise DataError.at(path, "two columns of that name", line=1, column=name)
    return names


def read_table(
    path: Path, required: Sequence[str], optional: Sequence[str] = (), may_be_blank: Collection[str] = (),
    words: Collection[str] = (),
) -> Table:  # fmt: skip
    """Read known columns of a CSV; values are numbers, NaN and infinity included (see `Table.require_finite`).

    `optional` columns are read if present, others are listed in `Table.unknown`; fields of `may_be_blank` may be blank.
    Columns named in `words` are `Table.texts`.
    Raises DataError for a missing file or column, a wrong number of fields, a blank line, or a field that is no number.
    """
    header, *rows = lines_of(bytes_of(path, missing="no such file").rstrip())
    names = _header(path, header, required)
    known = [n for n in names if n in required or n in optional]
    commas = len(names) - 1
    if set(map(bytes.count, rows, [b","] * len(rows))) - {commas} or (commas == 0 and b"" in rows):
        raise _ragged(path, rows, commas)
    fields = b",".join(rows).split(b",") if rows else []
    columns, texts = {}, {}
    for name in known:
        column, blank = fields[names.index(name) :: len(names)], name in may_be_blank
        if name in words:
            texts[name] = [f.decode("utf-8", "replace").strip() for f in column]
            continue
        column = [f if f.strip() else b"nan" for f in column] if blank else column
        columns[name] = number_rows(path, range(FIRST_ROW, len(rows) + FIRST_ROW), [column], [name])[:, 0]
    unknown = tuple(n for n in names if n not in known and n)
    return Table(path, columns, np.arange(len(rows)) + FIRST_ROW, unknown, texts)


def _ragged(path: Path, rows: list[bytes], commas: int) -> DataError:
    """The error at the first row whose number of fields differs from the header's."""
    k = next(i for i, row in enumerate(rows) if not row.strip() or row.count(b",") != commas)
    n = rows[k].count(b",") + 1
    what = f"{n} field{'s' * (n > 1)} where the header names {commas + 1}"
    what += cut_off(n, commas + 1, last=k == len(rows) - 1)
    if not rows[k].strip():
        what = "blank line between rows; a row of unknown values keeps its commas"
    return DataError.at(path, what, line=k + FIRST_ROW)

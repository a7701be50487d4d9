"""Strict numeric CSV: columns by name as float64 arrays; errors name file, line, column and value.

A file is a header and one row per line, without comments, quoted numbers or blank lines (but at its end). A byte
order mark, CRLF line ends and spaces around fields are accepted. Columns come in any order.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from data.errors import LARGEST, DataError
from data.inputs import IntArray
from data.se2 import Array, BoolArray

FIRST_ROW = 2
"""Line of the first row below a line of names."""


@dataclass(frozen=True)
class Table:
    """Columns (K,) of a file by name, NaN where blank.

    Attributes:
        path: how errors name the file.
        columns: by name.
        unknown: names of columns nobody asked for.
        line: (K,) line of the file each row stands in; None: the rows follow one line of names without a gap.
    """

    path: Path | str
    columns: dict[str, Array]
    unknown: tuple[str, ...] = ()
    line: IntArray | None = None

    def __contains__(self, name: str) -> bool:
        return name in self.columns

    def __len__(self) -> int:
        return len(next(iter(self.columns.values())))

    def stack(self, names: Sequence[str]) -> Array:
        """Some columns side by side, (K, len(names))."""
        return np.stack([self.columns[n] for n in names], axis=-1)

    def all(self) -> Array:
        """All columns side by side, (K, columns), in the order of the file."""
        return self.stack(tuple(self.columns))

    def part(self, rows: IntArray | BoolArray) -> Table:
        """Some of its rows, in this order."""
        columns = {name: values[rows] for name, values in self.columns.items()}
        return replace(self, columns=columns, line=None if self.line is None else self.line[rows])

    def symmetric(self, names: Sequence[str]) -> Array:
        """Symmetric matrices (K, d, d) from their upper triangles, row by row."""
        return symmetric(self.stack(names))

    def require(self, fine: BoolArray, name: str, what: str) -> None:
        """Raise at the first row where `fine` (K,) is false; `{}` in `what` stands for the value in column `name`."""
        if not fine.all():
            row = int(np.argmin(fine))
            value = float(self.columns[name][row])
            whole = value.is_integer() and abs(value) <= LARGEST
            raise self.error(row, name, what.format(int(value) if whole else repr(value)))

    def error(self, row: int, name: str | None, what: str) -> DataError:
        """What is wrong at a row."""
        line = row + FIRST_ROW if self.line is None else int(self.line[row])
        return DataError.at(self.path, what, line=line, column=name)

    def require_finite(self, names: Collection[str], *, blank: bool = False) -> None:
        """Raise unless every value is an ordinary number no larger than `LARGEST`, or blank (NaN) where allowed."""
        for name in names:
            values = self.columns[name]
            fine = np.abs(values) <= LARGEST
            if blank:
                fine |= np.isnan(values)
            hint = "; leave the field blank where unknown" if blank else ""
            self.require(fine, name, f"{{}} is not a number between -1e15 and 1e15{hint}")

    def require_ascending(self, name: str, *, strictly: bool) -> None:
        """Raise at the first row whose value is smaller than (or, `strictly`, equal to) the one before."""
        values = self.columns[name]
        fine = np.ones(len(values), bool)
        fine[1:] = values[1:] > values[:-1] if strictly else values[1:] >= values[:-1]
        if not fine.all():
            before = float(values[int(np.argmin(fine)) - 1])
            rule = "must increase from row to row" if strictly else "must not decrease from row to row"
            self.require(fine, name, f"{{}} follows {before!r}; {name} {rule}")

    def integers(self, name: str, smallest: int, *, blank: int | None = None) -> IntArray:
        """A column of whole numbers >= `smallest`; blank fields become `blank`, or an error if that is None."""
        values = self.columns[name]
        empty = np.isnan(values) if blank is not None else np.zeros(len(values), bool)
        fine = empty | ((values >= smallest) & (values == np.floor(values)) & (values <= LARGEST))
        self.require(
            fine, name, f"{{}} is not a whole number from {smallest} up" + (" (or blank)" if blank is not None else "")
        )
        return np.where(empty, 0 if blank is None else blank, np.where(empty, 0.0, values)).astype(np.int64)


def symmetric(entries: Array, *, lower: bool = False) -> Array:
    """Symmetric matrices (K, d, d) from their upper (or `lower`) triangles (K, d (d + 1) / 2), row by row."""
    d = {1: 1, 3: 2, 6: 3, 21: 6}[entries.shape[1]]
    i, j = np.tril_indices(d) if lower else np.triu_indices(d)
    matrices = np.empty((len(entries), d, d))
    matrices[:, i, j] = matrices[:, j, i] = entries
    return matrices


def shown(field: bytes) -> str:
    """A field as an error message shows it: one line, not too long."""
    text = field.decode("utf-8", "replace").strip()
    return repr(text if len(text) <= 40 else text[:37] + "...")


def bytes_of(path: Path, *, missing: str = "") -> bytes:
    """Contents of a file; DataError where it cannot be read, which says `missing` where there is none."""
    try:
        return path.read_bytes()
    except OSError as error:
        gone = missing if isinstance(error, FileNotFoundError) else ""
        raise DataError.at(path, gone or f"cannot be read: {error.strerror}") from None


def _lines(path: Path) -> list[bytes]:
    """Lines of a file without line ends, byte order mark and blank lines at the end."""
    content = bytes_of(path, missing="no such file")
    content = content.removeprefix(b"\xef\xbb\xbf").replace(b"\r\n", b"\n").replace(b"\r", b"\n").rstrip()
    return content.split(b"\n")


def _header(path: Path, line: bytes, required: Sequence[str]) -> list[str]:
    names = [name.strip().strip('"') for name in line.decode("utf-8", "replace").split(",")]
    for name in required:
        if name not in names:
            found = "the line is blank" if names == [""] else f"found {shown(line)}"
            raise DataError.at(
                path, f"no such column; {found}, wanted at least {','.join(required)}", line=1, column=name
            )
    for i, name in enumerate(names):
        if name in names[:i]:
            raise DataError.at(path, "two columns of that name", line=1, column=name)
    return names


def read_table(
    path: Path, required: Sequence[str], optional: Sequence[str] = (), *, may_be_blank: Collection[str] = ()
) -> Table:
    """Read a CSV's known columns; values are numbers, NaN and infinity included (`Table.require_finite` refuses those).

    Args:
        path: the file.
        required: columns that must be there.
        optional: columns read if there. Any other column is left alone and named in `Table.unknown`.
        may_be_blank: columns in which a field may be blank.

    Raises:
        DataError: file or column missing, too few or too many fields, blank line, or a field that is not a number.
    """
    header, *rows = _lines(path)
    names = _header(path, header, required)
    known = [n for n in names if n in required or n in optional]
    commas = len(names) - 1
    if set(map(bytes.count, rows, [b","] * len(rows))) - {commas} or (commas == 0 and b"" in rows):
        raise _ragged(path, rows, commas)
    fields = b",".join(rows).split(b",") if rows else []
    columns = {}
    for name in known:
        column = fields[names.index(name) :: len(names)]
        try:
            if b"_" in b"".join(column):  # Python reads 1_0 as ten
                raise ValueError
            values = (
                [float(f) if f.strip() else np.nan for f in column]
                if name in may_be_blank
                else list(map(float, column))
            )
        except ValueError:
            raise _not_a_number(path, name, column, blank=name in may_be_blank) from None
        columns[name] = np.array(values, float)
    return Table(path, columns, tuple(n for n in names if n not in known and n))


def _ragged(path: Path, rows: list[bytes], commas: int) -> DataError:
    """The error at the first row whose number of fields is not the header's."""
    for i, row in enumerate(rows):
        if not row.strip():
            return DataError.at(
                path, "blank line between rows; a row of unknown values keeps its commas", line=i + FIRST_ROW
            )
        if row.count(b",") != commas:
            n = row.count(b",") + 1
            last = " (the file ends here: was it cut off?)" if i == len(rows) - 1 and n <= commas else ""
            what = f"{n} field{'s' * (n > 1)} where the header names {commas + 1}{last}"
            return DataError.at(path, what, line=i + FIRST_ROW)
    raise AssertionError("called for a table whose rows are all complete")


def _not_a_number(path: Path, name: str, column: list[bytes], *, blank: bool) -> DataError:
    """The error at the first field of a column that is not a number."""
    for i, field in enumerate(column):
        if not field.strip():
            if blank:
                continue
            return DataError.at(path, "blank; a number is needed", line=i + FIRST_ROW, column=name)
        try:
            float(field)
        except ValueError:
            return DataError.at(path, f"{shown(field)} is not a number", line=i + FIRST_ROW, column=name)
        if b"_" in field:
            return DataError.at(path, f"{shown(field)} is not a number", line=i + FIRST_ROW, column=name)
    raise AssertionError("called for a column whose fields are all numbers")

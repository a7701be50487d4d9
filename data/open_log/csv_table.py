"""Strict numeric CSV: columns by name as float64 arrays, and a `DataError` with line and column for whatever is wrong.

A file is a header and one row per line, without comments, quoted numbers or blank lines (but at its end). A byte
order mark, CRLF line ends and spaces around fields are accepted. Columns come in any order.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from pathlib import Path

import numpy as np

from data.errors import DataError
from data.open_log.table import FIRST_ROW, Table


def _shown(field: bytes) -> str:
    """A field as an error message shows it: one line, not too long."""
    text = field.decode("utf-8", "replace").strip()
    return repr(text if len(text) <= 40 else text[:37] + "...")


def _lines(path: Path) -> list[bytes]:
    """Lines of a file without line ends, byte order mark and blank lines at the end."""
    try:
        content = path.read_bytes()
    except FileNotFoundError:
        raise DataError.at(path, "no such file") from None
    except OSError as error:
        raise DataError.at(path, f"cannot be read: {error.strerror}") from None
    content = content.removeprefix(b"\xef\xbb\xbf").replace(b"\r\n", b"\n").replace(b"\r", b"\n").rstrip()
    return content.split(b"\n")


def _header(path: Path, line: bytes, required: Sequence[str]) -> list[str]:
    names = [name.strip().strip('"') for name in line.decode("utf-8", "replace").split(",")]
    for name in required:
        if name not in names:
            found = "the line is blank" if names == [""] else f"found {_shown(line)}"
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
            return DataError.at(path, f"{_shown(field)} is not a number", line=i + FIRST_ROW, column=name)
        if b"_" in field:
            return DataError.at(path, f"{_shown(field)} is not a number", line=i + FIRST_ROW, column=name)
    raise AssertionError("called for a column whose fields are all numbers")

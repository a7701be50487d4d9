"""A table of numbers read from a file, and the checks that name file, line, column and value."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from data.errors import LARGEST, DataError
from data.inputs import IntArray
from data.se2 import Array

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

    def symmetric(self, names: Sequence[str]) -> Array:
        """Symmetric matrices (K, d, d) from their upper triangles, row by row."""
        d = {3: 2, 6: 3}[len(names)]
        matrix = np.empty((len(self), d, d))
        for name, i, j in zip(names, *np.triu_indices(d), strict=True):
            matrix[:, i, j] = matrix[:, j, i] = self.columns[name]
        return matrix

    def require(self, fine: NDArray[np.bool_], name: str, what: str) -> None:
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

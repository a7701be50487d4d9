"""Which column of which file holds what: `--columns t=stamp,v=speed,truth.x=px`, and the values in SI units."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from data.errors import DataError, UsageError
from data.open_log.table import Table
from data.se2 import Array, BoolArray
from data.tables.files import TextTable
from data.tables.units import QUANTITIES, Units

ROLES = ("odometry", "observations", "map", "truth")
QUATERNION = ("qx", "qy", "qz", "qw")


@dataclass(eq=False)
class Columns:
    """What was said, by key `quantity` or `role.quantity`; a quantity without is looked for under its own name.

    `used`: keys that named a column of some file so far.
    """

    said: Mapping[str, str]
    units: Units
    used: set[str] = field(default_factory=set)

    def __post_init__(self) -> None:
        for key, name in self.said.items():
            role, dot, quantity = key.rpartition(".")
            if quantity not in QUANTITIES or (dot and role not in ROLES):
                raise UsageError(
                    f"--columns {key}={name}: unknown quantity {key!r}; known: {', '.join(QUANTITIES)}, each also as "
                    f"in odometry.t (files: {', '.join(ROLES)})"
                )

    def stated(self, role: str, quantities: Collection[str]) -> bool:
        """Whether a column was named for one of these quantities of a file, by role."""
        return any(f"{role}.{q}" in self.said for q in quantities)

    def find(self, file: TextTable, role: str, quantity: str) -> int | None:
        """Number of the column of a file that holds a quantity; None: there is none.

        Raises:
            DataError: the column named for it is not there.
        """
        own = f"{role}.{quantity}"
        if own in self.said:
            column = file.find(self.said[own])
            if column is None:
                raise DataError.at(file.path, f"no column {self.said[own]!r} ({own}); it has {file.described()}")
            self.used.add(own)
            return column
        if quantity in self.said:
            column = file.find(self.said[quantity])
            if column is not None:
                self.used.add(quantity)
                return column
        return file.names.index(quantity) if file.named and quantity in file.names else None

    def require(self, file: TextTable, role: str, quantities: Sequence[str]) -> list[int]:
        """The columns of quantities that a file must have."""
        columns = []
        for q in quantities:
            column = self.find(file, role, q)
            if column is None:
                raise DataError.at(
                    file.path,
                    f"no column {self.said.get(q, q)!r} for {q}; it has {file.described()}; name it as in "
                    f"--columns {role}.{q}=NAME",
                )
            columns.append(column)
        return columns

    def has(self, file: TextTable, role: str, quantities: Sequence[str]) -> bool:
        """Whether a file has a column for each of these quantities."""
        return all(self.find(file, role, q) is not None for q in quantities)

    def check_used(self, files: Sequence[TextTable]) -> None:
        """Raise UsageError for a column that was named and stands in no file."""
        for key, name in self.said.items():
            if key not in self.used:
                has = "; ".join(f"{f.path.name} has {f.described()}" for f in files)
                raise UsageError(f"--columns {key}={name}: not used: {_why(key, name, files)}; {has}")

    def table(
        self,
        file: TextTable,
        role: str,
        quantities: Sequence[str],
        *,
        optional: Sequence[str] = (),
        texts: Sequence[str] = (),
        may_be_blank: Collection[str] = (),
    ) -> tuple[Table, dict[str, list[str]], int]:
        """Quantities of a file in SI units, some optional ones, and `texts` as they stand; how many rows were skipped.

        Rows in which all of the required quantities but t are blank are skipped: a file may hold several things.

        Raises:
            DataError: a column is missing, a field is no number, or blank where that is not allowed.
        """  # fmt: skip
        columns = dict(zip(quantities, self.require(file, role, quantities), strict=True))
        columns |= {q: c for q in optional if (c := self.find(file, role, q)) is not None}
        empty = np.ones(len(file), bool)
        for q in quantities:
            if q != "t":
                empty &= file.blank(columns[q]) | _nan(file, columns[q])
        keep = ~empty if not may_be_blank else np.ones(len(file), bool)
        values: dict[str, Array] = {}
        for q, c in columns.items():
            dates = q == "t" and self.units.is_date(role)
            values[q] = file.numbers(c, keep, stamps=dates) * self.units.factor(role, q)
        table = Table(file.path, values, line=file.line[keep])
        for q, c in columns.items():
            if q not in may_be_blank:
                fine = np.isfinite(values[q])
                if not fine.all():
                    raise table.error(int(np.argmin(fine)), file.names[c], "blank; a number is needed")
        found = {q: file.text(c, keep) for q in texts if (c := self.find(file, role, q)) is not None}
        return table, found, int(empty.sum()) if not may_be_blank else 0


def _nan(file: TextTable, column: int) -> BoolArray:
    return np.array([row[column].lower() == "nan" for row in file.rows], bool)


def _why(key: str, name: str, files: Sequence[TextTable]) -> str:
    """Why a key named nothing."""
    role, _, quantity = key.rpartition(".")
    if any(f.find(name) is not None for f in files):
        return f"nothing here is made of {quantity}" + (f" of the {role}" if role else "")
    return f"no file has a column {name!r}"


def headings(values: Mapping[str, Array]) -> Array:
    """Headings (K,) [rad] of theta, or of a quaternion's rotation about z."""
    if "theta" in values:
        return values["theta"]
    x, y, z, w = (values[q] for q in QUATERNION)
    heading: Array = np.arctan2(2.0 * (w * z + x * y), w * w + x * x - y * y - z * z)
    return heading


def shared(paths: Mapping[str, Path]) -> set[str]:
    """Roles whose file has another role, too."""
    return {r for r, p in paths.items() if list(paths.values()).count(p) > 1}

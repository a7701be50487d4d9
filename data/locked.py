"""Frozen dataclasses of arrays that nobody can change; below all other types, so short."""

from dataclasses import fields, replace
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

IntArray = NDArray[np.int64]
KEPT: dict[str, Any] = {"i": np.int64, "u": np.int64, "b": np.bool_}
"""Type of the locked copy by the kind of an array; float64 for all others."""


def read_only(obj: object) -> None:
    """Lock every array of a frozen dataclass, since the same inputs feed every estimator."""
    for f in fields(obj):  # type: ignore[arg-type]
        value = getattr(obj, f.name)
        if isinstance(value, np.ndarray):
            locked = np.array(value, dtype=KEPT.get(value.dtype.kind, np.float64), order="C")
            locked.setflags(write=False)
            object.__setattr__(obj, f.name, locked)


class Locked:
    """Base of a frozen dataclass that locks its arrays."""

    def __post_init__(self) -> None:
        read_only(self)

    def only(self, rows: slice | NDArray[Any]) -> Self:
        """Some rows, by a slice, indices or a mask, of all its arrays, also of those of its parts."""
        values = {f.name: getattr(self, f.name) for f in fields(self)}  # type: ignore[arg-type]
        part: dict[str, Any] = {n: v[rows] for n, v in values.items() if isinstance(v, np.ndarray)}
        part |= {n: v.only(rows) for n, v in values.items() if isinstance(v, Locked)}
        return replace(self, **part)  # type: ignore[type-var]

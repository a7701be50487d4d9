"""Frozen dataclasses of arrays that nobody can change; below all other types, so short."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

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

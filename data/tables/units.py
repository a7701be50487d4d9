"""Units of a foreign table: what `--unit angle=deg,time=ns,v=km/h` says, as factors to SI."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from data.errors import UsageError

LENGTH = {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "km": 1e3, "ft": 0.3048, "in": 0.0254}
ANGLE = {"rad": 1.0, "mrad": 1e-3, "deg": math.pi / 180.0, "rev": 2.0 * math.pi}
TIME = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0}
DIMENSIONS = {"length": LENGTH, "angle": ANGLE, "time": TIME}
ISO = "iso"
"""Unit of time of a column of dates."""

QUANTITIES = {
    "t": "time",
    **dict.fromkeys(("x", "y", "dx", "dy", "range"), "length"),
    **dict.fromkeys(("theta", "dtheta", "bearing"), "angle"),
    "v": "length/time",
    "omega": "angle/time",
    **dict.fromkeys(("left", "right", "frame", "id", "true_id", "label", "qx", "qy", "qz", "qw"), ""),
}
"""What a column may hold, and its dimension; rates are per second unless a unit says otherwise."""


@dataclass(frozen=True)
class Units:
    """What was said, by key: a dimension, a quantity, or `role.quantity`; the narrower one counts."""

    said: Mapping[str, str]

    def __post_init__(self) -> None:
        for key, unit in self.said.items():
            quantity = key.rpartition(".")[2]
            if key not in DIMENSIONS and not QUANTITIES.get(quantity):
                known = ", ".join([*DIMENSIONS, *(q for q, d in QUANTITIES.items() if d)])
                raise UsageError(f"--unit {key}={unit}: unknown quantity {key!r}; known: {known}")
            factor(key if key in DIMENSIONS else QUANTITIES[quantity], unit, f"--unit {key}={unit}")

    def unit(self, role: str, quantity: str) -> str | None:
        """The unit said for a quantity of its own, `role.quantity` before `quantity`."""
        return self.said.get(f"{role}.{quantity}", self.said.get(quantity))

    def is_date(self, role: str) -> bool:
        """Whether a file's stamps are dates."""
        return (self.unit(role, "t") or self.said.get("time")) == ISO

    def factor(self, role: str, quantity: str) -> float:
        """SI units per unit of a quantity in a file."""
        dimension, unit = QUANTITIES[quantity], self.unit(role, quantity)
        if not dimension or (dimension == "time" and self.is_date(role)):
            return 1.0
        if unit is not None:
            return factor(dimension, unit, f"--unit {quantity}={unit}")
        kind = dimension.partition("/")[0]
        said = self.said.get(kind)
        return 1.0 if said is None else factor(kind, said, f"--unit {kind}={said}")


def factor(dimension: str, text: str, where: str) -> float:
    """SI units per unit `text`, a minus sign in front (clockwise angles) included; UsageError for an unknown one."""
    sign, unit = (-1.0, text[1:]) if text.startswith("-") else (1.0, text)
    over, slash, under = unit.partition("/")
    kind, per, _ = (*dimension.split("/"), "", "")[:3]
    units = DIMENSIONS[kind]
    if kind == "time" and text == ISO:
        return 1.0
    if over not in units or bool(slash) != bool(per) or (per and under not in TIME):
        example = f"{next(iter(units))}/s" if per else ", ".join([*units, ISO] if kind == "time" else units)
        what = f"of {', '.join(units)} per {', '.join(TIME)}, as in {example}," if per else f"one of {example}"
        raise UsageError(f"{where}: unknown unit {text!r}; {what} is needed")
    return sign * units[over] / (TIME[under] if per else 1.0)


def quantity_with_unit(text: str, dimension: str, where: str) -> float:
    """A number with its unit behind, as in 2deg or 5mm; SI where none is said. UsageError for anything else."""
    stripped = text.strip()
    end = len(stripped)
    while end and not (stripped[end - 1].isdigit() or stripped[end - 1] == "."):
        end -= 1
    try:
        value = float(stripped[:end] if end else stripped)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise UsageError(f"{where}: {text!r} is not a number, as in 0.1, 5cm or 2deg")
    unit = stripped[end:].strip()
    return value * (factor(dimension, unit, where) if unit else 1.0)

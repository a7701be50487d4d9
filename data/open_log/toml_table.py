"""Tables of `log.toml`: which keys there are, and readers that give a checked value or raise."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import fields
from pathlib import Path

import numpy as np

from data.errors import LARGEST, DataError
from data.open_log.motion_prior import PRIORS
from data.se2 import Array

KNOWN = {
    "": (
        *("format", "name", "time_is_index", "covariance_floor", "floored", "labels_are_sensed", "notes"),
        *("prior", "sensor", "motion", "source"),
    ),
    "prior": ("mean", "sigma", "covariance"),
    "sensor": (
        *("kind", "sigma", "max_range", "min_angle", "max_angle", "field_of_view"),
        *("rotation", "translation", "extrinsic"),
    ),
    "sensor.extrinsic": ("rotation", "translation"),
    "motion": (
        *("model", "noise", "sigma", "alphas"),
        *("prior", *dict.fromkeys(f.name for kind in PRIORS.values() for f in fields(kind))),
    ),
}


class Reader:
    """One table of the file; every question either gives a checked value or raises."""

    def __init__(self, path: Path, table: Mapping[str, object], where: str = "") -> None:
        """`where` names the table: empty for the top; DataError for a key that does not belong there."""
        self.path, self.table, self.where = path, table, where
        for key in table:
            if key not in KNOWN[where]:
                homes = [
                    f"[{w}]" if w else "the top, before the first [table]" for w, keys in KNOWN.items() if key in keys
                ]
                home = f"; it belongs to {' or '.join(homes)}" if homes else f"; known: {', '.join(KNOWN[where])}"
                raise DataError.at(path, f"unknown key {key!r} {f'in [{where}]' if where else 'at the top'}{home}")

    def __contains__(self, key: str) -> bool:
        return key in self.table

    def error(self, key: str, what: str) -> DataError:
        """What is wrong with a key."""
        place = f"[{self.where}] {key}" if self.where else key
        if key in self.table and not isinstance(self.table[key], dict):
            shown = repr(self.table[key])
            place += f" = {shown if len(shown) <= 60 else shown[:57] + '...'}"
        return DataError.at(self.path, f"{place}: {what}")

    def optional_table(self, key: str) -> Reader | None:
        """The table of that name, if there is one."""
        if key not in self.table:
            return None
        value = self.table[key]
        if not isinstance(value, dict):
            raise self.error(key, "this must be a table")
        return Reader(self.path, value, f"{self.where}.{key}" if self.where else key)

    def table_of(self, key: str) -> Reader:
        """The table of that name."""
        found = self.optional_table(key)
        if found is None:
            raise DataError.at(self.path, f"no [{key}] table")
        return found

    def one_of(self, key: str, known: Mapping[str, object] | tuple[str, ...], default: str | None = None) -> str:
        """One of some names."""
        value = self.table.get(key, default)
        if isinstance(value, str) and value in known:
            return value
        raise self.error(key, f"{'missing' if value is None else 'unknown'}; known: {', '.join(known)}")

    def flag(self, key: str) -> bool:
        """True or false; false if left out."""
        value = self.table.get(key, False)
        if isinstance(value, bool):
            return value
        raise self.error(key, "true or false is needed")

    def number(self, key: str, default: float, what: str, fine: Callable[[float], bool] = lambda _: True) -> float:
        """A number that is `fine`; `what` says in the message which one would be."""
        if key not in self.table:
            return default
        value = _number(self.table[key])
        if value is None or not fine(value):
            raise self.error(key, f"{what} is needed")
        return value

    def numbers(self, key: str, length: int, what: str, fine: Callable[[float], bool] = lambda _: True) -> Array:
        """A list (length,) of numbers that are `fine`."""
        value = self.table.get(key)
        if isinstance(value, list) and len(value) == length:
            found = [_number(v) for v in value]
            if all(v is not None and fine(v) for v in found):
                return np.array(found, float)
        raise self.error(key, f"{'missing; ' if value is None else ''}{what} needed")


def _number(value: object) -> float | None:
    """A TOML number as a float, infinity included; None for anything else."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    if abs(value) <= LARGEST or value in (math.inf, -math.inf):
        return float(value)
    return None


def finite(value: float) -> bool:
    """An ordinary number."""
    return math.isfinite(value)


def not_negative(value: float) -> bool:
    """From 0 up."""
    return 0.0 <= value < math.inf


def positive(value: float) -> bool:
    """Above 0, and its square, too."""
    return 0.0 < value < math.inf and value * value > 0.0

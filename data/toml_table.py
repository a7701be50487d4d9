"""TOML files written by people: tables with known keys, and checked values. `fault` makes the error of a message."""

from __future__ import annotations

import math
import re
import tomllib
from collections.abc import Callable, Collection, Mapping
from pathlib import Path

import numpy as np

from data.errors import LARGEST, SlamrefError, did_you_mean, unknown
from data.se2 import Array

Fault = Callable[[str], SlamrefError]
Known = Mapping[str, Collection[str]]
SHOWN = 60  # Most characters of a value in a message
DEEPEST = 100  # Most parts of a dotted key; tomllib's memory grows with the square of their number
_DEEP = re.compile(rb"(?:\.[\w\"'\t -]{1,64}){%d}" % DEEPEST)


def load_toml(path: Path, fault: Fault, missing: str = "no such file") -> dict[str, object]:
    """Contents of a file; `missing` is the message where there is none."""
    try:
        content = path.read_bytes()
        if _DEEP.search(content):
            raise fault(f"not valid TOML here: a key of more than {DEEPEST} parts")
        return tomllib.loads(content.decode())
    except FileNotFoundError:
        raise fault(missing) from None
    except OSError as error:
        raise fault(f"cannot be read: {error.strerror}") from None
    except (ValueError, RecursionError) as error:  # bad UTF-8 and absurd numbers are ValueErrors too
        raise fault(f"not valid TOML: {' '.join(str(error).split())}") from None


class TomlTable:
    """One table of a file; its methods return a checked value or raise."""

    def __init__(self, fault: Fault, table: Mapping[str, object], known: Known, where: str = "") -> None:
        """`known`: keys by dotted table, else any; `where` names this table. Raises for an unknown key."""
        self.fault, self.table, self.known, self.where = fault, table, known, where
        keys = known.get(where, table)
        for key in table:
            if key not in keys:
                homes = [f"[{w}]" if w else "the top, before the first [table]" for w, ks in known.items() if key in ks]
                known_there = f"{did_you_mean(key, keys)}; known: {', '.join(keys)}"
                home = f"; it belongs to {' or '.join(homes)}" if homes else known_there
                raise fault(f"unknown key {key!r} {f'in [{where}]' if where else 'at the top'}{home}")

    def __contains__(self, key: str) -> bool:
        return key in self.table

    def error(self, key: str, what: str) -> SlamrefError:
        """The error of a key."""
        place = f"[{self.where}] {key}" if self.where else key
        if key in self.table and not isinstance(self.table[key], dict):
            shown = repr(self.table[key])
            place += f" = {shown if len(shown) <= SHOWN else shown[: SHOWN - 3] + '...'}"
        return self.fault(f"{place}: {what}")

    def _below(self, key: str) -> str:
        return f"{self.where}.{key}" if self.where else key

    def _open(self, key: str, value: object, keys: Collection[str] | None) -> TomlTable:
        if not isinstance(value, dict):
            raise self.error(key, "this must be a table")
        known = self.known if keys is None else {**self.known, self._below(key): keys}
        return TomlTable(self.fault, value, known, self._below(key))

    def optional_table(self, key: str, keys: Collection[str] | None = None) -> TomlTable | None:
        """The table of that name, if there is one; `keys`: its keys, where `known` does not list them."""
        return self._open(key, self.table[key], keys) if key in self.table else None

    def table_of(self, key: str, keys: Collection[str] | None = None) -> TomlTable:
        """The table of that name."""
        found = self.optional_table(key, keys)
        if found is None:
            raise self.fault(f"no [{self._below(key)}] table; one is needed")
        return found

    def tables_of(self, key: str) -> list[TomlTable]:
        """The tables [[key]], none if left out."""
        value = self.table.get(key, [])
        if not isinstance(value, list):
            raise self.error(key, f"tables [[{self._below(key)}]] are needed")
        return [self._open(key, table, None) for table in value]

    def one_of(self, key: str, known: Collection[str], default: str | None = None) -> str:
        """One of some names."""
        value = self.table.get(key, default)
        if isinstance(value, str) and value in known:
            return value
        raise self.error(key, f"missing; known: {', '.join(known)}" if value is None else unknown(str(value), known))

    def names(self, key: str, known: Collection[str], default: tuple[str, ...]) -> tuple[str, ...]:
        """A list of distinct known names, at least one."""
        if key not in self.table:
            return default
        value = self.table[key]
        if not isinstance(value, list):
            raise self.error(key, "a list is needed")
        for name in value:
            if not isinstance(name, str) or name not in known:
                raise self.error(key, f"{name!r} is {unknown(str(name), known)}")
        if not value or len(set(value)) != len(value):
            raise self.error(key, "at least one name, none of them twice, is needed")
        return tuple(value)

    def text(self, key: str, default: str | None = None) -> str:
        """A text; required without a default."""
        value = self.table.get(key, default)
        if isinstance(value, str):
            return value
        raise self.error(key, f"{'missing; ' if value is None else ''}text is needed")

    def flag(self, key: str, *, default: bool = False) -> bool:
        """True or false."""
        value = self.table.get(key, default)
        if isinstance(value, bool):
            return value
        raise self.error(key, "true or false is needed")

    def whole(self, key: str, default: int, least: int | None = None) -> int:
        """A whole number, from `least` up."""
        value = self.table.get(key, default)
        if isinstance(value, bool) or not isinstance(value, int):
            raise self.error(key, "a whole number is needed")
        if least is not None and value < least:
            raise self.error(key, f"at least {least} is needed" if least else "must not be negative")
        return value

    def number(
        self, key: str, default: float | None, what: str, fine: Callable[[float], bool] = lambda _: True
    ) -> float:
        """A number that is `fine`; `what` names such a number in the message. Required without a default."""
        if key not in self.table:
            if default is None:
                raise self.error(key, "missing; a number is needed")
            return default
        value = _number(self.table[key])
        if value is None or not fine(value):
            raise self.error(key, f"{what} is needed")
        return value

    def numbers(self, key: str, length: int | None, what: str, fine: Callable[[float], bool] = lambda _: True) -> Array:
        """A list (length,) of numbers that are `fine`; any length if None."""
        value = self.table.get(key)
        if isinstance(value, list) and length in (None, len(value)):
            found = [_number(v) for v in value]
            if all(v is not None and fine(v) for v in found):
                return np.array(found, float)
        raise self.error(key, f"{'missing; ' if value is None else ''}{what} needed")


def _number(value: object) -> float | None:
    """A TOML number as a float, infinity included; else None."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    if abs(value) <= LARGEST or value in (math.inf, -math.inf):
        return float(value)
    return None


finite = math.isfinite


def not_negative(value: float) -> bool:
    """Finite and >= 0."""
    return 0.0 <= value < math.inf


def positive(value: float) -> bool:
    """Finite and > 0, its square included."""
    return 0.0 < value < math.inf and value * value > 0.0

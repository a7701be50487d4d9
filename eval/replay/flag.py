"""Tables of flags and kinds of values, for command line, config files and scenario files."""

import argparse
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, is_dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Literal

from data.command import stretch
from data.errors import UsageError, unknown

Read = Callable[[str, object], Any]
"""A kind of value: (label, text of the command line or value of a TOML file) to a checked value, or UsageError."""


@dataclass(frozen=True)
class Flag:
    """One field of a table."""

    read: Read  # the kind of its values
    metavar: str  # of the value; empty for a switch
    help: str = ""  # one line for `--help`; empty: that of `flags.toml` by its name
    numbers: bool = True  # whether estimators' numbers depend on it: it belongs to the command that reproduces them
    repeatable: bool = False  # given once for each value
    short: str = ""  # one letter
    bare: str = ""  # the value of a flag without one; empty: a value is needed
    name: str = ""  # name, default: of the field; part: of the field that holds its table, empty in the table itself
    default: Any = None
    part: str = ""

    @property
    def option(self) -> str:
        """The flag on the command line; a switch that is on by default is turned off."""
        name = self.name.replace("_", "-")
        return f"--no-{name}" if self.default is True else f"--{name}"

    def of(self, options: Any) -> Any:
        """Its value in a table."""
        return getattr(getattr(options, self.part) if self.part else options, self.name)

    def words(self, value: Any) -> list[str]:
        """The words of a command line for this value."""
        if isinstance(value, bool):
            return [] if value is self.default else [self.option]
        if self.repeatable:
            texts = list(value)
        else:
            texts = [",".join(value) if isinstance(value, tuple) else "none" if value is None else str(value)]
        # a value that begins with a dash would be taken for a flag
        return [word for t in texts for word in ([f"{self.option}={t}"] if t.startswith("-") else [self.option, t])]


def row(default: Any, read: Read, metavar: str = "", help: str = "", **more: Any) -> Any:
    """A field of a table with its default; see `Flag`."""
    return field(default=default, metadata={"flag": Flag(read, metavar, help, **more)})


free_row = partial(row, numbers=False)  # a field on which no number depends


def rows(table: type[Any]) -> dict[str, Flag]:
    """The rows of a table by name, in its order, including those of nested tables."""
    found: dict[str, Flag] = {}
    for f in fields(table):
        if "flag" in f.metadata:
            found[f.name] = replace(f.metadata["flag"], name=f.name, default=f.default)
        elif is_dataclass(f.default):
            found |= {name: replace(r, part=f.name) for name, r in rows(type(f.default)).items()}
    return found


def filled(table: type[Any], values: Mapping[str, Any]) -> Any:
    """A table with these values by name, in nested tables too; defaults for all others."""
    known = rows(table)
    made: dict[str, Any] = {}
    for f in fields(table):
        own = {name: value for name, value in values.items() if name in known and known[name].part == f.name}
        if f.name in values:
            made[f.name] = values[f.name]
        elif own:
            part: type[Any] = type(f.default)
            made[f.name] = part(**own)
    return table(**made)


def read_values(table: type[Any], given: Mapping[str, object], label: Callable[[Flag], str]) -> dict[str, Any]:
    """Checked values for a table; `label` names a row in messages, as in `--gate` or `gate =`."""
    known = rows(table)
    return {name: known[name].read(label(known[name]), value) for name, value in given.items()}


def number(label: str, value: object) -> float:
    """Any number."""
    try:
        if isinstance(value, bool):
            raise ValueError
        return float(str(value))
    except ValueError:
        raise UsageError(f"{label} {value}: a number is needed, as in {label} 0.5") from None


def probability(label: str, value: object) -> float | None:
    """A probability between 0 and 1, or `none`."""
    if value == "none":
        return None
    p = number(label, value)
    if not 0.0 < p < 1.0:
        instead = f"or none{_as_probability(label, p)}"
        raise UsageError(f"{label} {p:g}: a probability between 0 and 1 (both excluded), {instead}")
    return p


PERCENT = 50.0  # from here on a number is a probability in percent; below, and above 1, a chi-square value


def _as_probability(label: str, value: float) -> str:
    """What a number above 1 stands for as a probability."""
    if not 1.0 < value < 100.0:
        return ""
    if value >= PERCENT:
        return f"; {value:g} % is {label} {value / 100.0:.12g}"
    return f"; {value:g} as a chi-square value of 2 degrees of freedom is {label} {-math.expm1(-0.5 * value):.4g}"


def probability_or_auto(label: str, value: object) -> float | Literal["auto"] | None:
    """A probability, `none`, or `auto`."""
    return "auto" if value == "auto" else probability(label, value)


def positive(label: str, value: object) -> float:
    """A positive number."""
    span = number(label, value)
    if not 0.0 < span < math.inf:
        raise UsageError(f"{label} {span:g}: a positive number is needed")
    return span


def positive_or_none(label: str, value: object) -> float | None:
    """A positive number, or `none`."""
    return None if value == "none" else positive(label, value)


def whole(least: int, otherwise: str) -> Read:
    """A whole number from `least` up."""

    def read(label: str, value: object) -> int:
        try:
            if isinstance(value, (bool, float)):
                raise ValueError
            n = int(str(value))
        except ValueError:
            raise UsageError(f"{label} {value}: a whole number is needed, as in {label} {max(least, 1)}") from None
        if n < least:
            raise UsageError(f"{label} {n}: {otherwise}")
        return n

    return read


def switch(label: str, value: object) -> bool:
    """True or false."""
    if not isinstance(value, bool):
        raise UsageError(f"{label} {value!r}: true or false is needed")
    return value


def text(needed: str) -> Read:
    """A text that is not empty."""

    def read(label: str, value: object) -> str:
        if not isinstance(value, str) or not value:
            raise UsageError(f"{label} {value!r}: {needed} is needed")
        return value

    return read


def texts(label: str, value: object) -> tuple[str, ...]:
    """A list of texts."""
    given = [value] if isinstance(value, str) else value
    if not isinstance(given, (list, tuple)) or not all(isinstance(v, str) for v in given):
        raise UsageError(f"{label} {value!r}: a list of names is needed")
    return tuple(v.strip() for v in given if v.strip())


def stretches(label: str, value: object) -> tuple[str, ...]:
    """Texts FROM:TO in seconds."""
    given = texts(label, value)
    for each in given:
        try:
            stretch(each)
        except argparse.ArgumentTypeError as fault:
            raise UsageError(f"{label} {fault}") from None
    return given


def one_of(known: Sequence[str]) -> Read:
    """One of the known names."""

    def read(label: str, value: object) -> str:
        if value not in known:
            raise UsageError(f"{label} {value!r}: {unknown(str(value), known)}")
        return str(value)

    return read


def names(known: Sequence[str] | None = None) -> Read:
    """Different names (of `known`, if given), separated by commas or as a list."""

    def read(label: str, value: object) -> tuple[str, ...]:
        given = tuple(name.strip() for part in texts(label, value) for name in part.split(",") if name.strip())
        for name in given:
            if known is not None and name not in known:
                raise UsageError(f"{label} {name}: {unknown(name, known)}")
        if len(set(given)) != len(given):
            raise UsageError(f"{label} {','.join(given)}: named twice")
        return given

    return read


def folder(label: str, value: object) -> Path:
    """A folder, which may not exist yet."""
    path = Path(str(value))
    if path.exists() and not path.is_dir():
        raise UsageError(f"{label} {path}: exists and is not a folder")
    return path

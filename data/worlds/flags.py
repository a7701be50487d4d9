"""Command-line flags of the simulated worlds, one for every field of their parameters."""

from __future__ import annotations

import argparse
import math
import re
from collections.abc import Callable, Sequence
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

from data.worlds.registry import parameters_of


def number(text: str) -> float:
    """A flag's number; nan is none."""
    value = float(text)
    if math.isnan(value):
        raise ValueError
    return value


def degrees(text: str) -> float:
    """A flag's angle in degrees, in radians."""
    return math.radians(number(text))


number.__name__ = degrees.__name__ = "number"  # argparse names the type in its message


def seed(text: str) -> int:
    """A flag's seed."""
    if not text.isdecimal():
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number from 0 up")
    return int(text)


def add_flags(sub: argparse.ArgumentParser, simulator: str) -> None:
    """OUT, `--seed`, and a flag for every parameter, with what its docstring says; angles kept in degrees stay so."""
    sub.add_argument("out", metavar="OUT", type=Path, help="log folder to write")
    sub.add_argument("--seed", type=seed, default=0, metavar="N", help="seed of every random number (default: 0)")
    parameters = parameters_of(simulator)
    names = [f.name for f in fields(parameters)]
    described: dict[str, str] = {}
    for kind in reversed([k for k in parameters.__mro__ if is_dataclass(k)]):  # worlds that err share what they err by
        described |= _attributes(kind.__doc__ or "", names)
    for f in fields(parameters):
        flag, text = f"--{f.name.replace('_', '-')}", described.get(f.name, "")
        if isinstance(f.default, bool):
            text = f"{text} (default: {'on' if f.default else 'off'})".replace("%", "%%")
            sub.add_argument(flag, action=argparse.BooleanOptionalAction, default=f.default, help=text)
            continue
        # a parameter that may be left out is a number, and says what it is then
        number_of: type[Any] = float if f.default is None else type(f.default)
        default: Any = f.metadata.get("default", f.default)
        unit = number_of.__name__.upper()
        convert: Callable[[str], object] = number if number_of is float else number_of
        if f.metadata.get("unit") == "deg":
            default, unit, convert = f"{math.degrees(default):.12g}", "DEG", degrees
        text = f"{text} (default: {default})".strip().replace("%", "%%")
        sub.add_argument(flag, type=convert, default=f.default, metavar=unit, help=text)
        if "alias" in f.metadata:  # understood, not advertised
            alias = f"--{f.metadata['alias']}"
            sub.add_argument(alias, type=convert, default=argparse.SUPPRESS, dest=f.name, help=argparse.SUPPRESS)


def _attributes(docstring: str, names: Sequence[str]) -> dict[str, str]:
    """What a docstring says about each name: the text from `name:` (or `name, other:`) to the next one."""
    docstring = docstring.partition("Raises:")[0]
    name = f"(?:{'|'.join(names)})"
    found = list(re.finditer(rf"\b({name}(?:, {name})*): ", docstring))
    ends = [m.start() for m in found[1:]] + [len(docstring)]
    texts = {m[1]: " ".join(docstring[m.end() : end].split()) for m, end in zip(found, ends, strict=True)}
    return {n: text.replace("`", "").rstrip(" .,;") for group, text in texts.items() for n in group.split(", ")}

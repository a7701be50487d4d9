"""The simulated worlds, each listed once: module, parameters, flags, help, and logs by name.

A world is imported when it is needed, so `--help` does not wait for it.

Names of simulated logs: `world:SEED[:KEY=VALUE+KEY+no-KEY+...]`; keys and flags are the fields of the world's
parameters. A switch is its name, or `no-` and its name; `-` and `_` are equivalent. A field in radians with metadata
`unit: deg` is written in degrees.
"""

from __future__ import annotations

import argparse
import importlib
import math
import re
import tomllib
from collections.abc import Callable, Mapping
from dataclasses import Field, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from data.command import count, number
from data.errors import UsageError, did_you_mean
from data.wing import World, wings

if TYPE_CHECKING:
    from data.log import Log


SWITCH = {"on": True, "true": True, "1": True, "off": False, "false": False, "0": False}


def _halves(name: str, part: str, known: Mapping[str, Field[Any]], counts: tuple[str, ...]) -> tuple[str, str]:
    """Key and text from `key=text`, or of a switch from `key` or `no-key`."""
    key, equals, text = part.partition("=")
    key = key.strip().replace("-", "_")
    if not equals:
        key, text = (key[3:], "off") if key.startswith("no_") else (key, "on")
    there = key in known or key in counts
    if not there or (not equals and not _is_switch(known.get(key))):
        switches = [_switch(f, on=not f.default) for f in known.values() if _is_switch(f)]
        others = [*counts, *(k for k, f in known.items() if not _is_switch(f))]
        what = f"{key} needs a value, as in {key}=1" if there else f"{part!r} is not known"
        if not there and "," in part:
            what += f" (keys are joined with +, as in {name.replace(',', '+')})"
        elif not there:
            what += did_you_mean(part.partition("=")[0], [*switches, *others])
        raise UsageError(f"{name}: {what}; known: {', '.join([*switches, *(f'{k}=' for k in others)])}")
    return key, text.strip()


def _value(place: str, f: Field[Any], text: str) -> object:
    """The text in the field's type; `place` begins an error message."""
    if _is_switch(f):
        if text not in SWITCH:
            hint = f.metadata.get("hint")
            raise UsageError(f"{place}: on or off is needed{f'; {hint}' if hint else ''}")
        return SWITCH[text]
    if isinstance(f.default, int):
        return _whole(place, text)
    if isinstance(f.default, str):
        return text
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise UsageError(f"{place}: a number is needed{_joined_by_commas(place, text)}")
    return math.radians(number) if f.metadata.get("unit") == "deg" else number


def _whole(place: str, text: str) -> int:
    if not re.fullmatch(r"[0-9]{1,9}", text):
        raise UsageError(f"{place}: a whole number is needed{_joined_by_commas(place, text)}")
    return int(text)


def _joined_by_commas(place: str, text: str) -> str:
    """A hint where a value is followed by another key."""
    return f"; keys are joined with +, as in {place.partition(': ')[0].replace(',', '+')}" if "," in text else ""


def _is_switch(f: Field[Any] | None) -> bool:
    return f is not None and isinstance(f.default, bool)


def _switch(f: Field[Any], *, on: bool) -> str:
    return ("" if on else "no-") + f.name.replace("_", "-")


def name_of(world: str, parameters: Any, seed: int) -> str:
    """The name that `parse` inverts: world, seed, and parameters that differ from their defaults."""
    changed = [(f, value) for f in fields(parameters) if (value := getattr(parameters, f.name)) != f.default]
    parts = [_switch(f, on=v) if _is_switch(f) else f"{f.name}={written(f, v)}" for f, v in changed]
    return f"{world}:{seed}" + (":" + "+".join(parts) if parts else "")


def written(f: Field[Any], value: Any) -> str:
    """A parameter as in a log's name."""
    if isinstance(value, float) and f.metadata.get("unit") == "deg":
        short = f"{math.degrees(value):.12g}"
        return short if math.radians(float(short)) == value else repr(math.degrees(value))
    return f"{value:.12g}" if isinstance(value, float) and float(f"{value:.12g}") == value else str(value)


_OWN = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))
SIMULATORS: Mapping[str, World] = {name: World(**texts) for name, texts in _OWN.items()} | {
    name: world for wing in wings() for name, world in wing.worlds.items()
}


class Named(NamedTuple):
    """The parts of a log's name: world, parameters, seed, and given `counts`."""

    world: str
    parameters: Any
    seed: int
    counts: Mapping[str, int]


def parameters_of(world: str) -> type[Any]:
    """The dataclass of a world's parameters."""
    w = SIMULATORS[world]
    found: type[Any] = getattr(importlib.import_module(w.module), w.parameters)
    return found


def simulate(world: str, parameters: Any, seed: int, name: str | None = None) -> Log:
    """One log of a world, reproducible to the byte."""
    log: Log = importlib.import_module(SIMULATORS[world].module).simulate(parameters, seed, name)
    return log


def is_simulated(name: str) -> bool:
    """Whether a log's name is of a simulated world, well-formed or not."""
    world, colon, _ = name.partition(":")
    return bool(colon) and world in SIMULATORS


def parse(name: str) -> Named:
    """The parts of a simulated log's name: counts are keys that are no parameters, whole numbers from 1 up. A field
    whose default is None takes a number. UsageError names known keys.
    """
    world, *rest = name.split(":", 2)
    w, parameters = SIMULATORS[world], parameters_of(world)
    if not rest or not re.fullmatch(r"[0-9]{1,18}", rest[0]):
        raise UsageError(f"{name}: the seed is a whole number, as in {w.example}")
    known = {f.name: f for f in fields(parameters)}
    values: dict[str, Any] = {}
    counted: dict[str, int] = {}
    for part in rest[1].split("+") if len(rest) == 2 else ():
        key, text = _halves(name, part, known, w.counts)
        if key in values or key in counted:
            raise UsageError(f"{name}: {key} is given twice")
        if key in known:
            values[key] = _value(f"{name}: {part}", known[key], text)
        else:
            counted[key] = _whole(f"{name}: {part}", text)
            if counted[key] < 1:
                raise UsageError(f"{name}: {part}: at least 1 is needed")
    return Named(world, parameters(**values), int(rest[0]), counted)


def named_log(name: str) -> Log:
    """The log of a name, without images. UsageError for an unknown name, or counts, which need images."""
    world, parameters, seed, counts = parse(name)
    for key in counts:
        raise UsageError(f"{name}: {key} is for a recording with images")
    return simulate(world, parameters, seed, name)


def degrees(text: str) -> float:
    """A flag's angle in degrees, in radians."""
    return math.radians(number(text))


def add_flags(sub: argparse.ArgumentParser, simulator: str) -> None:
    """OUT, `--seed`, and a flag for every parameter with its text; fields in degrees stay in degrees."""
    sub.add_argument("out", metavar="OUT", type=Path, help="log folder to write")
    sub.add_argument("--seed", type=count, default=0, metavar="N", help="seed of every random number (default: 0)")
    for f in fields(parameters_of(simulator)):
        flag, text = f"--{f.name.replace('_', '-')}", f.metadata.get("help", "")
        if isinstance(f.default, bool):
            text = f"{text} (default: {'on' if f.default else 'off'})".replace("%", "%%")
            sub.add_argument(flag, action=argparse.BooleanOptionalAction, default=f.default, help=text)
            continue
        # an optional parameter is a number, with its default in words
        number_of: type[Any] = float if f.default is None else type(f.default)
        default: Any = f.metadata.get("default", f.default)
        unit = number_of.__name__.upper()
        convert: Callable[[str], object] = number if number_of is float else number_of
        if f.metadata.get("unit") == "deg":
            default, unit, convert = f"{math.degrees(default):.12g}", "DEG", degrees
        text = f"{text} (default: {default})".strip().replace("%", "%%")
        sub.add_argument(flag, type=convert, default=f.default, metavar=unit, help=text)

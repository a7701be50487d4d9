"""Names of simulated logs: `world:SEED[:KEY=VALUE+KEY+no-KEY+...]`; keys are the fields of the world's parameters.

A switch is said by its name alone or with `no-` before it, `-` and `_` are the same, a field kept in radians whose
metadata say `unit: deg` is written in degrees, and one whose metadata have an `alias` is understood by that, too.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import Field, fields
from typing import Any, TypeVar

from data.errors import UsageError

P = TypeVar("P")
SWITCH = {"on": True, "true": True, "1": True, "off": False, "false": False, "0": False}


def parse(name: str, parameters: type[P], example: str, *, counts: Iterable[str] = ()) -> tuple[P, int, dict[str, int]]:
    """Parameters, seed, and what was given of `counts`: keys that are no parameters, whole numbers from 1 up.

    `example` stands in the message about a seed that is none. A field whose default is None takes a number.

    Raises:
        UsageError: anything not understood, with what would be; or what `parameters` itself refuses.
    """
    rest = name.split(":", 2)[1:]
    if not rest or not re.fullmatch(r"[0-9]{1,18}", rest[0]):
        raise UsageError(f"{name}: the seed is a whole number, as in {example}")
    known = {f.name: f for f in fields(parameters)}  # type: ignore[arg-type]
    values: dict[str, Any] = {}
    counted: dict[str, int] = {}
    for part in rest[1].split("+") if len(rest) == 2 else ():
        key, text = _halves(name, part, known, tuple(counts))
        if key in values or key in counted:
            raise UsageError(f"{name}: {key} is given twice")
        if key in known:
            values[key] = _value(f"{name}: {part}", known[key], text)
        else:
            counted[key] = _whole(f"{name}: {part}", text)
            if counted[key] < 1:
                raise UsageError(f"{name}: {part}: at least 1 is needed")
    return parameters(**values), int(rest[0]), counted


def _halves(name: str, part: str, known: Mapping[str, Field[Any]], counts: tuple[str, ...]) -> tuple[str, str]:
    """Key and text from `key=text`, `key` or `no-key`; the latter two are for switches."""
    key, equals, text = part.partition("=")
    key = key.strip().replace("-", "_")
    if not equals:
        key, text = (key[3:], "off") if key.startswith("no_") else (key, "on")
    key = next((name for name, f in known.items() if f.metadata.get("alias") == key), key)
    there = key in known or key in counts
    if not there or (not equals and not _is_switch(known.get(key))):
        switches = [_switch(f, on=not f.default) for f in known.values() if _is_switch(f)]
        others = [*counts, *(k for k, f in known.items() if not _is_switch(f))]
        what = f"{key} needs a value, as in {key}=1" if there else f"{part!r} is not known"
        raise UsageError(f"{name}: {what}; known: {', '.join([*switches, *(f'{k}=' for k in others)])}")
    return key, text.strip()


def _value(place: str, f: Field[Any], text: str) -> object:
    """The text in the field's type; `place` begins the message about one that does not fit."""
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
        raise UsageError(f"{place}: a number is needed")
    return math.radians(number) if f.metadata.get("unit") == "deg" else number


def _whole(place: str, text: str) -> int:
    if not re.fullmatch(r"[0-9]{1,9}", text):
        raise UsageError(f"{place}: a whole number is needed")
    return int(text)


def _is_switch(f: Field[Any] | None) -> bool:
    return f is not None and isinstance(f.default, bool)


def _switch(f: Field[Any], *, on: bool) -> str:
    return ("" if on else "no-") + f.name.replace("_", "-")


def name_of(world: str, parameters: Any, seed: int) -> str:
    """The name that `parse` reads as the same: world, seed, and what differs from the defaults, in their order."""
    changed = [(f, value) for f in fields(parameters) if (value := getattr(parameters, f.name)) != f.default]
    parts = [_switch(f, on=v) if _is_switch(f) else f"{f.name}={written(f, v)}" for f, v in changed]
    return f"{world}:{seed}" + (":" + "+".join(parts) if parts else "")


def written(f: Field[Any], value: Any) -> str:
    """A parameter as it stands in a log's name."""
    if isinstance(value, float) and f.metadata.get("unit") == "deg":
        short = f"{math.degrees(value):.12g}"
        return short if math.radians(float(short)) == value else repr(math.degrees(value))
    return f"{value:.12g}" if isinstance(value, float) and float(f"{value:.12g}") == value else str(value)

"""Recordings and simulations as open logs."""

from __future__ import annotations

import tomllib
from argparse import ArgumentParser, ArgumentTypeError
from pathlib import Path
from typing import TYPE_CHECKING, Any

from data.command import declare

if TYPE_CHECKING:
    from data.command import Add

TEXTS: dict[str, Any] = tomllib.loads(Path(__file__).with_name("texts.toml").read_text(encoding="utf-8"))
"""Of a kind: `help`, `about`, `examples`, and `arguments` by name with what `add_argument` takes."""


def units(text: str) -> dict[str, str]:
    """Units of a laser log, as in angle=deg,time=ms."""
    from data.formats.recordings.mending import RADIANS, SECONDS

    known = {"angle": RADIANS, "time": SECONDS}
    found = dict(pair.strip().partition("=")[::2] for pair in text.split(","))
    for key, unit in found.items():
        if unit not in known.get(key, {}):
            right = f"{', '.join(known[key])}" if key in known else f"of {', '.join(known)}"
            raise ArgumentTypeError(f"{key}={unit} is unknown; {right} is needed, as in angle=deg,time=ms")
    return found


def parser_of(add: Add, kind: str) -> ArgumentParser:
    """The parser of a kind, with its texts and arguments."""
    of = TEXTS[kind]
    sub = add(kind, help=of["help"], description=of["about"], epilog=of["examples"])
    declare(sub, of["arguments"], units=units)
    return sub

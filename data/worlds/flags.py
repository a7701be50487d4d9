"""Command-line flags of the simulators, one for every field of their parameters, and the logs they make.

The simulators are imported when asked for, so that `--help` and a mistyped flag do not wait for them.
"""

from __future__ import annotations

import argparse
import importlib
import math
import re
from collections.abc import Callable, Sequence
from dataclasses import asdict, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from data.log import Log

SIMULATORS = {
    "arena": ("data.worlds.arena", "Arena"),
    "corridor": ("data.worlds.corridor", "Corridor"),
    "circle": ("data.worlds.circle", "Circle"),
    "linear": ("data.worlds.linear", "LinearWorld"),
    "visual": ("data.worlds.gallery", "Gallery"),
}
"""Module of each simulator and, in it, the dataclass of its parameters; beside that stands `simulate`."""
SIMULATED = {
    "arena": (
        "a simulated world whose noise is known",
        "A simulated robot among point landmarks, every noise known; the same seed gives the same log.",
        "example:\n  python -m data.convert arena logs/arena-0 --seed 0 --frames 500 --sensor relative_point",
    ),
    "corridor": (
        "the corridor lab on data association, simulated",
        "A simulated robot once round a square of corridors, with people or without; the same seed gives the same log.",
        """\
examples:
  python -m data.convert corridor logs/corridor-0 --seed 0 --people
  python -m data.convert corridor logs/blind --seed 3 --no-odometry
  python -m data.convert corridor logs/narrow --people --crowd 20 --range 8 --min-angle -60 --max-angle 60 --srho .02
""",
    ),
    "circle": (
        "the circle world of the literature on consistent SLAM, simulated",
        "A simulated robot round and round among landmarks; the defaults are a published benchmark, the same seed gives"
        " the same log.",
        """\
examples:
  python -m data.convert circle logs/circle-0 --seed 0
  python -m data.convert circle logs/short --frames 400 --turn-rate .075 --landmarks 15 --ring 1 --min-range .5
  python -m data.convert circle logs/scattered --layout scatter --map-seed 1 --substeps 3
""",
    ),
    "linear": (
        "a simulated world in which every right estimator is consistent",
        "A simulated robot among a grid of landmarks, its heading all but known; the same seed gives the same log.",
        "example:\n  python -m data.convert linear logs/linear-0 --seed 0 --frames 200",
    ),
}
"""Help, description and examples of each simulator."""


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


def _parameters(kind: str) -> type[Any]:
    """The dataclass of a simulator's parameters."""
    module, parameters = SIMULATORS[kind]
    found: type[Any] = getattr(importlib.import_module(module), parameters)
    return found


def add_flags(sub: argparse.ArgumentParser, simulator: str) -> None:
    """OUT, `--seed`, and a flag for every parameter, with what its docstring says; angles kept in degrees stay so."""
    sub.add_argument("out", metavar="OUT", type=Path, help="log folder to write")
    sub.add_argument("--seed", type=seed, default=0, metavar="N", help="seed of every random number (default: 0)")
    parameters = _parameters(simulator)
    described = _attributes(parameters.__doc__ or "", [f.name for f in fields(parameters)])
    for f in fields(parameters):
        flag, text = f"--{f.name.replace('_', '-')}", described.get(f.name, "")
        if isinstance(f.default, bool):
            text = f"{text} (default: {'on' if f.default else 'off'})".replace("%", "%%")
            sub.add_argument(flag, action=argparse.BooleanOptionalAction, default=f.default, help=text)
            continue
        # a parameter that may be left out is a number, and says what it is then
        kind: type[Any] = float if f.default is None else type(f.default)
        default: Any = f.metadata.get("default", f.default)
        unit = kind.__name__.upper()
        convert: Callable[[str], object] = number if kind is float else kind
        if f.metadata.get("unit") == "deg":
            default, unit, convert = f"{math.degrees(default):.12g}", "DEG", degrees
        text = f"{text} (default: {default})".strip().replace("%", "%%")
        sub.add_argument(flag, type=convert, default=f.default, metavar=unit, help=text)


def _attributes(docstring: str, names: Sequence[str]) -> dict[str, str]:
    """What a docstring says about each name: the text from `name:` (or `name, other:`) to the next one."""
    docstring = docstring.partition("Raises:")[0]
    name = f"(?:{'|'.join(names)})"
    found = list(re.finditer(rf"\b({name}(?:, {name})*): ", docstring))
    ends = [m.start() for m in found[1:]] + [len(docstring)]
    texts = {m[1]: " ".join(docstring[m.end() : end].split()) for m, end in zip(found, ends, strict=True)}
    return {n: text.replace("`", "").rstrip(" .,;") for group, text in texts.items() for n in group.split(", ")}


def simulated(args: argparse.Namespace) -> Log:
    """The log that the flags describe; its source holds every parameter."""
    parameters = _parameters(args.kind)
    values = parameters(**{f.name: getattr(args, f.name) for f in fields(parameters)})
    log: Log = importlib.import_module(SIMULATORS[args.kind][0]).simulate(values, args.seed)
    return replace(log, source={**log.source, args.kind: asdict(values)})

"""Simulated worlds as open logs, with a flag for every parameter."""

from __future__ import annotations

import argparse
from dataclasses import fields, replace
from typing import TYPE_CHECKING

from data.worlds.registry import SIMULATORS, add_flags, parameters_of, simulate

if TYPE_CHECKING:
    from data.command import Add
    from data.log import Log

KINDS = tuple(world for world, w in SIMULATORS.items() if w.help)
"""Worlds with logs; of others a recording is written."""


def add_parsers(add: Add, *, parameters: bool) -> None:
    """A parser for each world; `parameters`: with its flags, which take the world to be loaded."""
    for world in KINDS:
        w = SIMULATORS[world]
        sub = add(world, help=w.help, description=w.description, epilog=w.examples)
        if parameters:
            add_flags(sub, world)


def convert(args: argparse.Namespace) -> Log:
    """The log of the flags; its source has every parameter."""
    from data.worlds.erring import described

    kind = parameters_of(args.kind)
    values = kind(**{f.name: getattr(args, f.name) for f in fields(kind)})
    log = simulate(args.kind, values, args.seed)
    return replace(log, source={**log.source, args.kind: described(values)})

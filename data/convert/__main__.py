"""Command line: convert a recording or a simulation to an open log folder."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from data.command import COMPLETION, Parser, complete
from data.convert import kinds as own
from data.terminal import ending
from data.wing import wings
from data.worlds.registry import SIMULATORS

if TYPE_CHECKING:
    from data.formats.open_log import Recording
    from data.log import Log

PROG = "python -m data.convert"
SOURCES: tuple[Any, ...] = (own, *(import_module(module) for wing in wings() for module in wing.conversions))
"""Modules with their KINDS, `add_parsers`, and `convert`: a log, or a sentence on a file written in another format."""


def parser(*, simulators: bool = True, prog: str = PROG) -> argparse.ArgumentParser:
    """The command line; `simulators`: with their flags, which take these to be loaded."""
    about = "Write a recording or a simulation as an open log folder; OUT's last component becomes its name."
    top = Parser(prog=prog, description=about)
    examples = ["examples:"]
    kinds = top.add_subparsers(dest="kind", metavar="KIND", required=True)

    def add(name: str, *, help: str, description: str, epilog: str) -> argparse.ArgumentParser:
        epilog = epilog.replace(PROG, prog)
        own = [line for line in epilog.splitlines() if f" {name} " in line and not line.endswith("\\")]
        examples.extend(own[:1])
        return kinds.add_parser(name, help=help, description=description, epilog=epilog)

    for source in SOURCES:
        source.add_parsers(add, parameters=simulators)
    top.epilog = "\n".join(examples)
    return top


@ending("interrupted; nothing was written")
def main(argv: Sequence[str] | None = None, prog: str = PROG) -> None:
    """Convert and report; 0, or 2 with one line on stderr."""
    given = list(sys.argv[1:] if argv is None else argv)
    reader = parser(simulators=any(kind in given for kind in SIMULATORS) or COMPLETION in os.environ, prog=prog)
    complete(reader)
    args = reader.parse_args(given)
    made: Log | Recording | str = next(s for s in SOURCES if args.kind in s.KINDS).convert(args)
    if isinstance(made, str):
        print(made)
        return
    from data.formats.open_log import Recording, write_folder
    from data.origin import Origin, listed
    from data.questions.asked import ask
    from data.words import sentence, title

    made, samples = made if isinstance(made, Recording) else Recording(made)
    written = write_folder(made, args.out, samples)
    print(made)
    unsaid = (f"{origin}: {what}" for origin, what in listed(written.origins) if origin is not Origin.GIVEN)
    for note in (*written.notes, *unsaid):
        print(f"- {note}")
    for question in ask(made):
        print(f"warning: {sentence(question)} ({title(question)})")
    print(f"written: {Path(args.out).absolute()}")


if __name__ == "__main__":
    sys.exit(main())

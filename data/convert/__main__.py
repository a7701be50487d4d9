"""Command line: convert a recording or a simulation to an open log folder."""

from __future__ import annotations

import argparse
import os
import re
import shlex
import sys
from collections.abc import Collection, Sequence
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from data.command import COMPLETION, Parser, complete
from data.convert import bag, g2o, mrclam, named, table
from data.terminal import counted, ended
from data.wing import wings
from data.worlds.registry import SIMULATORS

if TYPE_CHECKING:
    from data.formats.open_log.writer import Recording
    from data.log import Log
    from data.notice import Notice

PROG = "python -m data.convert"
OF_WINGS = (import_module(module) for wing in wings() for module in wing.conversions)
SOURCES: tuple[Any, ...] = (mrclam, bag, table, g2o, named, *OF_WINGS)
"""Modules with the names of their KINDS, `add_parsers`, and `convert`: the log to write, or a sentence about a file
written in another format.
"""


def parser(*, simulators: bool = True, prog: str = PROG) -> argparse.ArgumentParser:
    """The command line; `simulators`: with their flags, which take these to be loaded."""
    top = Parser(
        prog=prog,
        description="Write a recording or a simulation as an open log folder; OUT's last component becomes its name.",
    )
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


def mending(given: Sequence[str], questions: Sequence[Notice]) -> str:
    """The command that converts a recording with all flags of questions about it; empty if that mends none of them.

    `given`: words of `slamref convert` without these flags.
    """
    words = again(given, questions, parser(simulators=False))
    return shlex.join(["slamref", "convert", *words]) if words else ""


def summary(log: Log) -> list[str]:
    """The contents of a log, in sentences."""
    inputs, truth = log.recorded, log.truth
    span = "no stamps" if inputs.time_is_index else f"{inputs.time[-1] - inputs.time[0]:.1f} s"
    label = log.granted
    ids = [] if label is None else label[label >= 0].tolist()
    lines = [
        f"{counted(len(inputs), 'frame')} ({span}), {counted(len(inputs.observations.z), 'observation')}"
        + (f" of {counted(len(set(ids)), 'landmark')}" if label is not None else ""),
        "no known map" if inputs.map is None else f"a map of {counted(len(inputs.map.id), 'landmark')}",
        "no ground truth" if truth.pose is None else f"ground truth in {counted(truth.known_poses, 'frame')}",
    ]
    if inputs.fixes is not None:
        lines.append(counted(len(inputs.fixes), "fix", "fixes"))
    if inputs.closures is not None:
        lines.append(counted(len(inputs.closures), "closure"))
    if inputs.scans is not None:
        lines.append(f"{counted(len(inputs.scans.frame), 'scan')} of {counted(inputs.scans.ranges.shape[1], 'beam')}")
    if truth.relations is not None:
        lines.append(counted(len(truth.relations), "reference relation"))
    if inputs.floored:
        floored = counted(inputs.floored, "singular increment")
        lines.append(f"{floored} got the covariance floor {inputs.covariance_floor:g}")
    return lines


def main(argv: Sequence[str] | None = None, prog: str = PROG) -> int:
    """Convert and report; 0, or 2 with one line on stderr."""
    return ended(lambda: _convert(argv, prog), "interrupted; nothing was written")


def _convert(argv: Sequence[str] | None, prog: str) -> None:
    given = list(sys.argv[1:] if argv is None else argv)
    simulators = any(kind in given for kind in SIMULATORS) or COMPLETION in os.environ
    reader = parser(simulators=simulators, prog=prog)
    complete(reader)
    args = reader.parse_args(given)
    made: Log | Recording | str = next(s for s in SOURCES if args.kind in s.KINDS).convert(args)
    if isinstance(made, str):
        print(made)
        return
    from data.formats.open_log.writer import Recording, write_folder
    from data.origin import Origin, listed
    from data.questions.asked import ask
    from data.words import sentence, title

    made, samples = made if isinstance(made, Recording) else Recording(made)
    written = write_folder(made, args.out, samples)
    print(f"{made.name}: {', '.join(summary(made))}.")
    unsaid = (f"{origin}: {what}" for origin, what in listed(written.origins) if origin is not Origin.GIVEN)
    for note in (*written.notes, *unsaid):
        print(f"- {note}")
    found = ask(made)
    for question in found:
        print(f"warning: {sentence(question)} ({title(question)})")
    if words := again(given, found, reader):
        print(f"if so: {shlex.join([*prog.split(), *words])}")
    print(f"written: {Path(args.out).absolute()}")


# --- the command that converted a recording, with flags that mend what is wrong in its log ---

PAIRS, REPEATED = ("--unit", "--columns", "--time-offset"), ("--exclude-truth",)
"""Flags of pairs KEY=VALUE, joined by commas; and flags that may be repeated. Of others the value is replaced."""


def flags_of(reader: argparse.ArgumentParser, kind: str) -> set[str]:
    """Flags of a kind."""
    choices = next(a.choices for a in reader._actions if isinstance(a, argparse._SubParsersAction))
    return {flag for action in choices[kind]._actions for flag in action.option_strings}


def mended(given: Sequence[str], flags: Sequence[str], known: Collection[str]) -> list[str]:
    """The words of a command with flags `--name`, `--name value` or `--name=value`; empty where none is `known`."""
    words, changed = list(given), False
    for flag in dict.fromkeys(flags):
        name, *value = re.split("[ =]", flag, maxsplit=1)
        if name not in known or flag in words:
            continue
        changed = True
        at = next((i for i, w in enumerate(words) if w == name or w.startswith(f"{name}=")), None)
        if not value:
            words += [name]
        elif at is not None and name not in REPEATED:
            there = at if "=" in words[at] else at + 1
            head = f"{name}=" if there == at else ""
            words[there] = f"{head}{_joined(words[there].removeprefix(head), value[0]) if name in PAIRS else value[0]}"
        else:
            words += [flag] if flag.startswith(f"{name}=") else [name, *value]
    return words if changed else []


def _joined(given: str, more: str) -> str:
    """Pairs KEY=VALUE, of which the latter replace those with the same key."""
    new = {pair.partition("=")[0] for pair in more.split(",")}
    kept = [pair for pair in given.split(",") if pair.partition("=")[0].strip() not in new]
    return ",".join([*kept, more])


def again(given: Sequence[str], questions: Sequence[Notice], reader: argparse.ArgumentParser) -> list[str]:
    """The words `given` with all flags of the questions that `reader` knows; none where there are no such."""
    flags = [str(flag) for question in questions for flag in cast("tuple[str, ...]", question.named.get("flags", ()))]
    return mended(given, flags, flags_of(reader, given[0])) if given and flags else []


if __name__ == "__main__":
    sys.exit(main())

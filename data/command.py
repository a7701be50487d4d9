"""How a command reads its words: completion in the shell, one line for a wrong word, examples under its own name."""

import argparse
import contextlib
import math
import os
import re
import sysconfig
import textwrap
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NoReturn

from data.digest import ROOT
from data.errors import UsageError, did_you_mean, unknown

Add = Callable[..., argparse.ArgumentParser]
"""Adds the parser of a kind of `slamref convert`, by name, help, description and epilog."""
COMPLETION = "_ARGCOMPLETE"  # Environment variable by which the shell asks for completions (argcomplete)


def count(text: str) -> int:
    """A flag's whole number from 0 up."""
    if not text.isdecimal():
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number from 0 up")
    return int(text)


def stretch(text: str) -> tuple[float, float]:
    """FROM:TO in seconds, FROM before TO."""
    begin, colon, end = text.partition(":")
    with contextlib.suppress(ValueError):
        if colon and float(begin) < float(end):
            return float(begin), float(end)
    raise argparse.ArgumentTypeError(f"{text!r} is not FROM:TO in seconds, FROM before TO")


def number(text: str) -> float:
    """A flag's number, not NaN."""
    value = float(text)
    if math.isnan(value):
        raise ValueError
    return value


TYPES: dict[str, Any] = {"path": Path, "int": int, "float": float, "number": number, "count": count, "stretch": stretch}
TYPES |= {"either": argparse.BooleanOptionalAction}


def within(flag: str, least: float, most: float = math.inf, *, whole: bool = False) -> Callable[[str], float]:
    """A flag's number between limits; UsageError for another one."""

    def convert(text: str) -> float:
        with contextlib.suppress(ValueError):
            value = float(text)
            if least <= value <= most and (value.is_integer() or not whole):
                return value
        limits = f"from {least:g}" + (" up" if math.isinf(most) else f" to {most:g}")
        raise UsageError(f"{flag} {text}: a {'whole ' * whole}number {limits} is needed")

    return convert


def declare(
    parser: argparse._ActionsContainer, arguments: Mapping[str, Mapping[str, Any]], **types: Callable[[str], Any]
) -> None:
    """Add the arguments of a table, by name with what `add_argument` takes: types and actions by their names here, or
    as `within` the limits of a number.
    """
    known = TYPES | types
    for name, given in arguments.items():
        how: dict[str, Any] = {k: known.get(v, v) if k in ("type", "action") else v for k, v in given.items()}
        if isinstance(how.get("metavar"), list):
            how["metavar"] = tuple(how["metavar"])
        if limits := how.pop("within", None):
            how["type"] = within(name, **limits)
        parser.add_argument(name, **how)


PLACE = re.compile(r"(^|[=,:])(/(?!/)(?:[^/=,:]*/)*)")
"""Folder of an absolute path in a word of a command, as in `--out=/a/b` or `mine=/a/b.py:Mine`."""


def portable(word: str) -> str:
    """A word of a command with its paths relative to the working directory; of others the file's name alone. A result
    folder that is handed on does not tell where somebody's files lie, and is the same wherever they lie.
    """
    here = Path.cwd().as_posix().rstrip("/")
    return "." if here and word == here else PLACE.sub(r"\1", word.replace(f"{here}/", "") if here else word)


def without_places(text: str, words: Iterable[str]) -> str:
    """A text without the folders that `words` of a command name, the working directory, and those of programs."""
    found = {place[2] for word in words for place in PLACE.finditer(word)}
    found |= {f"{place}/" for place in (Path.cwd().as_posix(), ROOT, *map(sysconfig.get_path, ("purelib", "stdlib")))}
    for place in sorted(found, key=len, reverse=True):
        if place.strip("/"):
            text = text.replace(place, "")
    return text


class Parser(argparse.ArgumentParser):
    """Errors are one line, flags are written out, examples keep their layout; a minus and a digit begin a value."""

    def __init__(self, **options: Any) -> None:
        super().__init__(allow_abbrev=False, formatter_class=argparse.RawDescriptionHelpFormatter, **options)
        said = re.sub(r"(?m)^(\S.*)\n(?=\S)", r"\1 ", self.description or "")  # a paragraph is filled as a whole
        lines = ((line, len(re.sub(r"^( +\S+ {2,}| *).*", r"\1", line))) for line in said.splitlines())
        self.description = "\n".join(textwrap.fill(line, 80, subsequent_indent=" " * n) for line, n in lines)
        if self.add_help:  # of a command with one page of help
            self.add_argument("--help-all", action="help", help=argparse.SUPPRESS)
        self._negative_number_matcher = re.compile(r"-\.?\d")

    def error(self, message: str) -> NoReturn:
        """One line, status 2."""
        self.exit(2, f"{self.prog}: {message}; {self.prog} --help shows the flags\n")

    def parse_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Values by name; a word too many ends the process with the flag that it probably means."""
        found, left = self.parse_known_args(args, namespace)
        self.refuse(left)
        return found

    def refuse(self, left: Sequence[str]) -> None:
        """End the process if words are left over."""
        if left:
            below = [a.choices for a in self._actions if isinstance(a, argparse._SubParsersAction)]
            parsers = {self.prog: self} | {f"{self.prog} {name}": p for names in below for name, p in names.items()}
            flags = [flag for p in parsers.values() for flag in p._option_string_actions if flag.startswith("--")]
            word = next((w for w in left if w.startswith("-")), left[0])
            flag = f"--{word.partition('=')[0].lstrip('-')}"
            hint = did_you_mean(flag, flags) if word.startswith("-") else ""
            others = [*OF_OTHERS.get(flag, ()), *(n for n, p in parsers.items() if flag in p._option_string_actions)]
            if others and word.startswith("--") and self.prog not in others:
                self.error(f"{word}: a flag of {', '.join(others)}, not of this command")
            what = "unknown flag" if word.startswith("-") else "a word too many"
            self.error(f"{word}: {what}{hint}")

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        if action.choices is not None and value not in action.choices:
            raise argparse.ArgumentError(action, f"{value}: {unknown(str(value), map(str, action.choices))}")


OF_OTHERS = dict.fromkeys(("--exclude-truth", "--keep-truth"), ("slamref run", "slamref score"))
"""Flags that questions about a log name, and that belong to another command than the one that converts it."""


class Command(Parser):
    """The parser of `prog`, named so in `examples` instead of `module`; `description` begins `--help`, they end it."""

    def __init__(self, prog: str, module: str, description: str, examples: str = "", **options: Any) -> None:
        super().__init__(prog=prog, description=description, epilog=examples.replace(module, prog), **options)

    def read(self, argv: Sequence[str] | None = None) -> argparse.Namespace:
        """Values by name. Positional words and flags may be mixed; ends the process as argparse does."""
        complete(self)
        found, left = self.parse_known_intermixed_args(argv)
        self.refuse(left)
        return found


def complete(parser: argparse.ArgumentParser) -> None:
    """Answer the shell and end the process, if it asks for completions."""
    if COMPLETION in os.environ:
        import argcomplete

        argcomplete.autocomplete(parser)


def completed(words: list[str], commands: Iterable[str]) -> list[str]:
    """The words of `slamref`; completes names of commands for the shell and ends, a subcommand answers for its own."""
    if COMPLETION not in os.environ:
        return words
    before = os.environ["COMP_LINE"][: int(os.environ["COMP_POINT"])].split(" ")
    if len([w for w in before if w]) > 1 + (before[-1] != ""):
        os.environ[COMPLETION] = "2"  # the shell's first two words are the command
        return before[1:2]
    parser = argparse.ArgumentParser(prog="slamref")
    parser.add_argument("command", choices=list(commands))
    complete(parser)
    return words

"""What may be asked: the table of flags, read from a command line and config files into checked options."""

import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

from data.command import Command, declare

TEXTS = Path(__file__).parent / "texts"


def texts_of(command: str) -> tuple[str, str]:
    """What the help of a command says before its flags, and its examples behind them: `texts/<command>.txt`."""
    about, _, examples = (TEXTS / f"{command}.txt").read_text(encoding="utf-8").partition("\n\nexamples:")
    return about, f"examples:{examples.rstrip()}"


def command_of(prog: str, module: str, name: str, **types: Callable[[str], Any]) -> Command:
    """A command with its texts and those of its arguments that it shares with no other: `texts/arguments.toml`."""
    command = Command(prog, module, *texts_of(name))
    declare(command, tomllib.loads((TEXTS / "arguments.toml").read_text(encoding="utf-8"))[name], **types)
    return command

"""Parsers of the kinds of `python -m data.convert`."""

from __future__ import annotations

import argparse
from typing import Any, NoReturn, Protocol


class Add(Protocol):
    """Adds a kind's parser: `add_parser` of argparse's subparsers."""

    def __call__(self, name: str, *, help: str, description: str, epilog: str) -> argparse.ArgumentParser:
        """The parser, to which flags are added."""


class Parser(argparse.ArgumentParser):
    """Reports errors in one line; flags must be written out, and texts keep their layout."""

    def __init__(self, **options: Any) -> None:
        super().__init__(allow_abbrev=False, formatter_class=argparse.RawDescriptionHelpFormatter, **options)

    def error(self, message: str) -> NoReturn:
        """One line, status 2."""
        self.exit(2, f"{self.prog}: {message} (see --help)\n")

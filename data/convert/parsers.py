"""How the kinds of `python -m data.convert` get their parsers."""

from __future__ import annotations

import argparse
from typing import Any, NoReturn, Protocol


class Add(Protocol):
    """Adds the parser of a kind: `add_parser` of argparse's subparsers."""

    def __call__(self, name: str, *, help: str, description: str, epilog: str) -> argparse.ArgumentParser:
        """The parser, to which flags are added."""


class Parser(argparse.ArgumentParser):
    """Says what is wrong in one line; flags are written out."""

    def __init__(self, **options: Any) -> None:
        """Text is shown as it was written."""
        super().__init__(allow_abbrev=False, formatter_class=argparse.RawDescriptionHelpFormatter, **options)

    def error(self, message: str) -> NoReturn:
        """One line, status 2."""
        self.exit(2, f"{self.prog}: {message} (see --help)\n")

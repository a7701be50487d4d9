"""Parsers of the kinds of `python -m data.convert`."""

from __future__ import annotations

import argparse
from typing import Protocol


class Add(Protocol):
    """Adds a kind's parser: `add_parser` of argparse's subparsers."""

    def __call__(self, name: str, *, help: str, description: str, epilog: str) -> argparse.ArgumentParser:
        """The parser, to which flags are added."""

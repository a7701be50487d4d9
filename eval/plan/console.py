"""Messages of `slamref run` to the user, kept for run.log."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable

from data.terminal import unread
from eval.plan.flags.table import Options


class Console:
    """Messages to the user, kept for run.log."""

    def __init__(self, options: Options) -> None:
        """Follow -q and -v; run.log gets everything."""
        self.quiet, self.verbose = options.execution.quiet, options.execution.verbose
        self.lines: list[str] = []
        self.coloured = sys.stdout.isatty() and "NO_COLOR" not in os.environ
        self.kept: Callable[[], str] = lambda: "nothing was changed"

    def say(self, text: str, colour: str = "") -> None:
        """Print a message, unless quiet; on a terminal in an ANSI colour."""
        self.lines.append(text)
        if not self.quiet:
            _print(f"\033[{colour}m{text}\033[0m" if colour and self.coloured else text)

    def complain(self, text: str) -> None:
        """Print an error that does not end the command, even if quiet."""
        self.lines.append(f"slamref: {text}")
        print(f"slamref: {text}", file=sys.stderr, flush=True)

    def detail(self, text: str) -> None:
        """Print a message for -v."""
        self.lines.append(text)
        if self.verbose:
            _print(text)


def _print(text: str) -> None:
    """Print a line; a closed pipe (`... | head -1`) does not end the run."""
    try:
        print(text, flush=True)
    except BrokenPipeError:
        if not unread():
            raise

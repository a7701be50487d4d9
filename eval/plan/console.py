"""Messages of `slamref run` to the user, kept for run.log."""

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from data.terminal import counted, unread
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
            say(f"\033[{colour}m{text}\033[0m" if colour and self.coloured else text)

    def complain(self, text: str) -> None:
        """Print an error that does not end the command, even if quiet."""
        self.lines.append(f"slamref: {text}")
        print(f"slamref: {text}", file=sys.stderr, flush=True)

    def detail(self, text: str) -> None:
        """Print a message for -v."""
        self.lines.append(text)
        if self.verbose:
            say(text)


def say(text: str) -> None:
    """Print a line; a closed pipe (`... | head -1`) or terminal does not end the run."""
    try:
        print(text, flush=True)
    except BrokenPipeError:
        if not unread():
            raise


EVERY = 60.0  # [s] between the lines of a log file
LINE = "{desc}: {n_fmt} of {total_fmt} {unit}s after {elapsed}, about {remaining} left\n"


def say_kept(kept: int, total: int, quiet: bool) -> None:
    """Say that runs of an earlier, perhaps interrupted command are used again."""
    if kept and not quiet:
        from tqdm import tqdm

        tqdm.write(f"{kept} of {counted(total, 'run')} are kept from before and are not repeated", file=sys.stderr)


@contextmanager
def progress(
    what: str, quiet: bool, check: Callable[[], None], thing: str = "run"
) -> Iterator[Callable[[int, int], None]]:
    """Yields its update (done, total); `check` is called at each. A bar on a terminal, else a line each minute."""
    from tqdm import tqdm

    lines: dict[str, Any] = {"mininterval": EVERY, "delay": EVERY, "bar_format": LINE}
    look = {} if sys.stderr.isatty() else lines
    with tqdm(desc=what, disable=quiet, leave=False, unit=thing, miniters=1, **look) as bar:

        def update(done: int, total: int) -> None:
            check()
            bar.total = total
            bar.update(done - bar.n)

        yield update

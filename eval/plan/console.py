"""Messages of `slamref run` to the user, kept for run.log."""

from __future__ import annotations

import os
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

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


FIRST = 5.0  # [s] over which the rate is measured; what is done by then needs no line
EVERY = 60.0  # [s] between the lines that follow
MINUTE, HOUR = 60.0, 3600.0


def duration(seconds: float) -> str:
    """A span of time as a person says it."""
    if seconds < MINUTE:
        return f"{max(seconds, 1.0):.0f} s"
    return f"{seconds / MINUTE:.0f} min" if seconds < 2.0 * HOUR else f"{seconds / HOUR:.1f} h"


def first_line(what: str, done: int, total: int, seconds: float, thing: str = "run") -> str:
    """How many runs there are, at what rate, and how long they will take."""
    rate = done / seconds
    each = f"{rate:.2g} a second" if rate >= 1.0 else f"{rate * MINUTE:.2g} a minute"
    so_far = f"{done} done in {duration(seconds)} ({each})"
    return f"{what}: {counted(total, thing)}, {so_far}: about {_left(done, total, seconds)} left"


def next_line(what: str, done: int, total: int, seconds: float, thing: str = "run") -> str:
    """How far it has come, and how long the rest will take."""
    text = f"{what}: {done} of {counted(total, thing)} after {duration(seconds)}"
    return f"{text}, about {_left(done, total, seconds)} left" if done else text


def _left(done: int, total: int, seconds: float) -> str:
    return duration((total - done) * seconds / done)


def say_kept(kept: int, total: int, quiet: bool) -> None:
    """Say that runs of an earlier, perhaps interrupted command are used again."""
    if kept and not quiet:
        from tqdm import tqdm

        tqdm.write(f"{kept} of {counted(total, 'run')} are kept from before and are not repeated", file=sys.stderr)


class _Lines:
    """Lines for a log file, by a thread that looks at the clock."""

    def __init__(self, what: str, thing: str) -> None:
        self.what, self.thing, self.begin = what, thing, time.monotonic()
        self.done = self.total = 0
        self._over, self._told = threading.Event(), False
        self._thread = threading.Thread(target=self._watch, daemon=True)
        self._thread.start()

    def _watch(self) -> None:
        wait = FIRST
        while not self._over.wait(wait):
            seconds = time.monotonic() - self.begin
            if self._told or seconds >= EVERY:
                self._write(next_line(self.what, self.done, self.total, seconds, self.thing))
            elif 0 < self.done < self.total:
                self._write(first_line(self.what, self.done, self.total, seconds, self.thing))
            wait = EVERY if self._told else FIRST

    def _write(self, line: str) -> None:
        self._told = True
        sys.stderr.write(line + "\n")
        sys.stderr.flush()

    def end(self) -> None:
        self._over.set()
        self._thread.join()


@contextmanager
def progress(
    what: str, quiet: bool, check: Callable[[], None], thing: str = "run"
) -> Iterator[Callable[[int, int], None]]:
    """Yields its update (done, total); `check` is called at each."""
    from tqdm import tqdm

    terminal = sys.stderr.isatty()
    lines = _Lines(what, thing) if not (quiet or terminal) else None
    try:
        with tqdm(desc=what, disable=quiet or not terminal, leave=False, unit=thing) as bar:

            def update(done: int, total: int) -> None:
                check()
                if lines is not None:
                    lines.done, lines.total = done, total
                bar.total = total
                bar.update(done - bar.n)

            yield update
    finally:
        if lines is not None:
            lines.end()

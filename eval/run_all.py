"""`slamref run`: run filters and smoothers on identical inputs, score them, write the report."""

import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from types import FrameType
from typing import NoReturn

from data.errors import UsageError
from data.terminal import INTERRUPTED, ended, message_of
from data.whole import whole_folder
from eval.open_report import show
from eval.plan import first_use
from eval.plan.console import Console
from eval.plan.flags.options import read_options
from eval.plan.flags.table import PROG

MARK = "provenance.json"


def lab(argv: Sequence[str] | None = None, prog: str = PROG) -> int:
    """`slamref lab`: positional words are values of `--lab`."""
    return main(argv, prog, "lab")


def main(argv: Sequence[str] | None = None, prog: str = PROG, positional: str = "log") -> int:
    """The command `prog`, whose positional words are values of flag `positional`; returns its exit status."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    consoles: list[Console] = []

    def body() -> int:
        with heeding_interruption() as check, first_use.stopping():
            options = read_options(arguments, prog, positional)
            consoles.append(Console(options))
            if line := first_use.start(options):
                consoles[0].say(line)
            check()
            with staged(options.output.out) as folder:
                from eval.report import steps  # everything: a wrong flag is answered without it

                status = steps.run(options, consoles[0], folder, [*prog.split(), *arguments], check)
                check()
        if options.output.open:
            show(options.output.out)
        return status

    return ended(body, lambda: f"interrupted; {consoles[0].kept() if consoles else 'nothing was changed'}")


@contextmanager
def heeding_interruption() -> Iterator[Callable[[], None]]:
    """A function that raises KeyboardInterrupt after Ctrl-C, even if a library lost the exception. Exceptions in
    callbacks from compiled code vanish, or become others; after Ctrl-C these count as interruptions, too.
    """
    pressed: list[int] = []

    def handle(number: int, frame: FrameType | None) -> None:
        pressed.append(number)
        raise KeyboardInterrupt

    def check() -> None:
        if pressed:
            raise KeyboardInterrupt

    if threading.current_thread() is not threading.main_thread():  # only that one may set handlers
        yield check
        return
    before = signal.signal(signal.SIGINT, handle)
    try:
        yield check
    except Exception:
        check()
        raise
    finally:
        signal.signal(signal.SIGINT, before)


def leave(status: int) -> NoReturn:
    """End the process with a status; after an interruption at once, since Python would report a signal instead."""
    if status == INTERRUPTED:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(status)
    sys.exit(status)


@contextmanager
def staged(out: Path) -> Iterator[Path]:
    """A folder beside `out` that replaces it if the block succeeds, and is deleted otherwise."""
    out = out.absolute()
    if out.exists() and any(out.iterdir()) and not (out / MARK).exists():
        raise UsageError(f"--out {out.name}: the folder contains other files than a report; name another one")
    with ExitStack() as stack:
        try:
            partial = stack.enter_context(whole_folder(out))
        except OSError as fault:
            raise UsageError(f"--out {out}: {message_of(fault)}") from fault
        yield partial


if __name__ == "__main__":
    leave(main())

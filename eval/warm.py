"""`python -m eval.warm`: compile every kernel once, into the cache, so that no first run has to wait for it."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Sequence

from data.command import Command
from data.terminal import ended

PROG = "python -m eval.warm"


def main(argv: Sequence[str] | None = None, prog: str = PROG) -> int:
    """Compile everything; returns the exit status."""
    return ended(
        lambda: _warm(argv, prog), "interrupted; what was compiled is kept, and the next time goes on from there"
    )


def _warm(argv: Sequence[str] | None, prog: str) -> None:
    p = Command(prog, PROG, "Compile every kernel once, into the cache.")
    p.add_argument("--background", action="store_true", help="at low priority, and not beside another one; no output")
    background = p.read(argv).background
    if background:
        os.nice(19)
    from eval.plan.warming import compile_all, mark

    begin = time.monotonic()
    compile_all(quiet=background, background=background)
    place = mark()
    where = "" if place is None else f"; kept in {place.parent} and its neighbours"
    sys.stdout.write(f"every kernel is compiled ({time.monotonic() - begin:.0f} s){where}\n")


if __name__ == "__main__":
    sys.exit(main())

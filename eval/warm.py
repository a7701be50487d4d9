"""`slamref warm`: compile all kernels into the cache, so that no run waits for them."""

import os
import sys
import time
from collections.abc import Sequence

from data.terminal import ending
from eval.plan.flags import command_of

PROG = "python -m eval.warm"


@ending("interrupted; compiled kernels are kept")
def main(argv: Sequence[str] | None = None, prog: str = PROG) -> None:
    """The command `prog`; returns its exit status."""
    background: bool = command_of(prog, PROG, "warm").read(argv).background
    if background:
        os.nice(19)
    from data.compiled import base
    from eval.plan.warming import compile_all

    begin = time.monotonic()
    compile_all(quiet=background, background=background)
    sys.stdout.write(f"all kernels are compiled ({time.monotonic() - begin:.0f} s), in {base()}\n")


if __name__ == "__main__":
    sys.exit(main())

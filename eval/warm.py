"""`slamref warm`: compile all kernels into the cache, so that no run waits for them."""

import os
import sys
import time
from collections.abc import Sequence

from data.command import Command
from data.terminal import ending

PROG = "python -m eval.warm"


@ending("interrupted; compiled kernels are kept")
def main(argv: Sequence[str] | None = None, prog: str = PROG) -> None:
    """The command `prog`; returns its exit status."""
    p = Command(prog, PROG, "Compile all kernels into the cache.")
    p.add_argument("--background", action="store_true", help="at low priority, unless another process compiles; silent")
    background: bool = p.read(argv).background
    if background:
        os.nice(19)
    from data.compiled import base
    from eval.plan.warming import compile_all

    begin = time.monotonic()
    compile_all(quiet=background, background=background)
    sys.stdout.write(f"all kernels are compiled ({time.monotonic() - begin:.0f} s), in {base()}\n")


if __name__ == "__main__":
    sys.exit(main())

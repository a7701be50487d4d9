"""`slamref benchmark`: speed of estimators and peers in one process, each the median of repetitions after a warm-up."""

import argparse
import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING

from data.errors import unknown
from data.terminal import ending
from eval.plan.flags import command_of

if TYPE_CHECKING:
    from eval.benchmarks.speed import Timed

PROG = "python -m eval.benchmark"
TABLES = ("localization", "victoria-park", "association", "hindsight", "study")


def _tables(text: str) -> list[str]:
    for name in (names := text.split(",")):
        if name not in TABLES:
            raise argparse.ArgumentTypeError(f"{name}: {unknown(name, TABLES)}")
    return names


@ending("interrupted; tables and files written so far are complete")
def main(argv: Sequence[str] | None = None, prog: str = PROG) -> None:
    """The command `prog`; returns its exit status."""
    args = command_of(prog, PROG, "benchmark", tables=_tables).read(argv)
    from eval.benchmarks import speed  # which is slow to import, after --help

    done: dict[str, list[Timed]] = {}
    for name in args.only or TABLES:  # print each when it is done, and write all so far
        done[name] = getattr(speed, f"{name.replace('-', '_')}_lines")(args.quick)
        print(speed.table(done[name]), flush=True)
        if args.out is not None:
            speed.write(done, args.out)


if __name__ == "__main__":
    sys.exit(main())

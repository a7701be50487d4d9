"""`slamref benchmark`: speed of estimators and peers in one process, each the median of repetitions after a warm-up."""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from data.command import Command
from data.errors import unknown
from data.terminal import ending

if TYPE_CHECKING:
    from eval.benchmarks.speed import Timed

PROG = "python -m eval.benchmark"
TABLES = ("localization", "victoria-park", "association", "hindsight", "study")
EXAMPLES = "examples:\n  python -m eval.benchmark --only localization,association --out speed.csv"


@ending("interrupted; tables and files written so far are complete")
def main(argv: Sequence[str] | None = None, prog: str = PROG) -> None:
    """The command `prog`; returns its exit status."""
    p = Command(prog, PROG, "Time the estimators and their peers in the same run.", EXAMPLES)

    def asked(text: str) -> list[str]:
        names = text.split(",")
        for name in names:
            if name not in TABLES:
                raise argparse.ArgumentTypeError(f"{name}: {unknown(name, TABLES)}")
        return names

    p.add_argument("--quick", action="store_true", help="a tenth of the work, as a trial")
    which = f"these tables, with commas or repeated: {', '.join(TABLES)}"
    p.add_argument("--only", metavar="NAME", type=asked, action="extend", help=which)
    p.add_argument("--out", metavar="FILE", type=Path, help="all lines as CSV, with machine and versions")
    args = p.read(argv)
    from eval.benchmarks import speed  # which is slow to import, after --help

    done: dict[str, list[Timed]] = {}
    for name in args.only or TABLES:  # print each when it is done, and write all so far
        done[name] = getattr(speed, f"{name.replace('-', '_')}_lines")(args.quick)
        print(speed.table(done[name]), flush=True)
        if args.out is not None:
            speed.write(done, args.out)


if __name__ == "__main__":
    sys.exit(main())

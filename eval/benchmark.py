"""`slamref benchmark`: speed of the estimators and of their peers in the same process.

Each number is the median of several repetitions after a warm-up. Ratios hold on other machines, seconds do not.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from data.command import Command
from data.errors import unknown
from data.terminal import ended
from data.wing import used, wings

if TYPE_CHECKING:
    from eval.benchmarks.speed import Timed

PROG = "python -m eval.benchmark"
TABLES = ("localization", "victoria-park", "association", "hindsight", "study")
GROWTH = ("frames", "landmarks", "closures", "twins", "processes")
EXAMPLES = """\
examples:
  python -m eval.benchmark --only localization,association
  python -m eval.benchmark --only frames,landmarks,closures,twins,processes --out growth.csv"""


def main(argv: Sequence[str] | None = None, prog: str = PROG) -> int:
    """The command `prog`; returns its exit status."""
    return ended(lambda: _benchmark(argv, prog), "interrupted; tables and files written so far are complete")


def _benchmark(argv: Sequence[str] | None, prog: str) -> None:
    p = Command(prog, PROG, "Time the estimators and their peers in the same run.", EXAMPLES)
    tables: dict[str, tuple[str, ...]] = {
        name: (f"eval.benchmarks.speed:{name.replace('-', '_')}_lines",) for name in TABLES
    }
    tables |= {wing.name: wing.benchmarks for wing in wings() if wing.benchmarks}
    known = (*tables, *GROWTH)

    def asked(text: str) -> list[str]:
        names = text.split(",")
        for name in names:
            if name not in known:
                raise argparse.ArgumentTypeError(f"{name}: {unknown(name, known)}")
        return names

    p.add_argument("--quick", action="store_true", help="a tenth of the work, as a trial")
    p.add_argument(
        "--only",
        metavar="NAME",
        type=asked,
        action="extend",
        help=f"these tables, with commas or repeated: {', '.join(tables)}; and growth with {', '.join(GROWTH)}",
    )
    p.add_argument(
        "--out", metavar="FILE", type=Path, help="all lines as CSV, with machine and versions; growth also as FILE.png"
    )
    args = p.read(argv)
    _tables({name: tables.get(name, ()) for name in args.only or known}, args.quick, args.out)


def _tables(asked: Mapping[str, Sequence[str]], quick: bool, out: Path | None) -> None:
    """Print each table when it is done, and write all so far."""
    from eval.benchmarks import growth, speed
    from eval.figures.style import save

    done: dict[str, list[Timed]] = {}
    for name, functions in asked.items():
        made = [used(f) for f in functions] or [partial(growth.lines, name)]
        done[name] = [line for lines in made for line in lines(quick)]
        print((speed.table if functions else growth.text)(done[name]), flush=True)
        if out is not None:
            speed.write(done, out)
            if grown := [line for name in done if name in GROWTH for line in done[name]]:
                save(growth.growth_figure(grown), out.parent, out.stem, ("png",))


if __name__ == "__main__":
    sys.exit(main())

"""`python -m eval.benchmark`: how fast the estimators are, beside their peers timed in the same run.

Every figure is the median of several repetitions after a warm-up; ratios compare neighbours in the same process, so
they travel between machines, absolute seconds do not. Only the parser is imported at once.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from eval.benchmarks.timed import Timed

PROG = "python -m eval.benchmark"


def main(argv: Sequence[str] | None = None, prog: str = PROG) -> int:
    """Time everything and print the tables as they come."""
    p = argparse.ArgumentParser(
        prog=prog, description="How fast the estimators are, beside their peers timed in the same run."
    )
    p.add_argument("--quick", action="store_true", help="a tenth of the work, to see that it runs")
    quick = p.parse_args(argv).quick
    from eval.benchmarks.timed import table

    for lines in _measured(quick):
        print(table(lines), flush=True)
    return 0


def _measured(quick: bool) -> Iterator[list[Timed]]:
    """The tables, each when it is done."""
    from eval.benchmarks.association import association_lines, hindsight_lines
    from eval.benchmarks.localization import localization_lines
    from eval.benchmarks.studies import study_lines
    from eval.benchmarks.victoria_park import victoria_park_lines
    from eval.benchmarks.visual import visual_lines

    frames = 700 if quick else 10**9
    yield localization_lines(2_000 if quick else 20_000)
    yield victoria_park_lines(frames)
    yield association_lines(quick)
    yield hindsight_lines(frames)
    yield study_lines(quick)
    yield visual_lines(quick)


if __name__ == "__main__":
    sys.exit(main())

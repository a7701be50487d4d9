"""`slamref benchmark`: speed of the estimators and of their peers in the same process.

Each number is the median of several repetitions after a warm-up. Ratios hold on other machines, seconds do not.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from data.command import Command
from data.terminal import ended
from data.wing import of_all, used, wings

if TYPE_CHECKING:
    from eval.benchmarks.speed import Timed

PROG = "python -m eval.benchmark"


def main(argv: Sequence[str] | None = None, prog: str = PROG) -> int:
    """The command `prog`; returns its exit status."""
    return ended(lambda: _benchmark(argv, prog), "interrupted; tables and files written so far are complete")


def _benchmark(argv: Sequence[str] | None, prog: str) -> None:
    p = Command(prog, PROG, "Time the estimators and their peers in the same run.")
    p.add_argument("--quick", action="store_true", help="a tenth of the work, as a trial")
    p.add_argument(
        "--large",
        metavar="OUT",
        type=Path,
        help="time and memory for logs of 1000 to 100 000 frames, in OUT/large.csv and OUT/large.png; takes hours",
    )
    measurements = {flag: found for wing in wings() for flag, found in wing.measurements.items()}
    for flag, (_, text) in measurements.items():
        p.add_argument(f"--{flag}", action="store_true", help=text)
    args = p.read(argv)
    quick = args.quick
    for flag, (lines_of, _) in measurements.items():
        if getattr(args, flag):
            print("\n".join(used(lines_of)(quick)), flush=True)
            return
    if args.large is not None:
        _large(args.large, quick)
        return
    from eval.benchmarks.speed import table

    for lines in _measured(quick):
        print(table(lines), flush=True)


def _large(out: Path, quick: bool) -> None:
    """Measure logs of all sizes; the line and the files of each are written when it is done."""
    from eval.benchmarks.large import SIZES, line_of, measure_all, scaling_figure, write
    from eval.figures.style import save

    out.mkdir(parents=True, exist_ok=True)
    found = []
    for m in measure_all(SIZES[:3] if quick else SIZES):
        print(line_of(m), flush=True)
        found.append(m)
        write(found, out / "large.csv")
    save(scaling_figure(found), out, "large")


def _measured(quick: bool) -> Iterator[list[Timed]]:
    """The lines of each table, when it is done."""
    from eval.benchmarks.speed import (
        association_lines,
        hindsight_lines,
        localization_lines,
        study_lines,
        victoria_park_lines,
    )

    frames = 700 if quick else 10**9
    yield localization_lines(2_000 if quick else 20_000)
    yield victoria_park_lines(frames)
    yield association_lines(quick)
    yield hindsight_lines(frames)
    yield study_lines(quick)
    yield from (lines(quick) for lines in of_all("benchmarks"))


if __name__ == "__main__":
    sys.exit(main())

"""`python -m eval.benchmark`: how fast the estimators are, beside their peers timed in the same run.

Every figure is the median of several repetitions after a warm-up; ratios compare neighbours in the same process, so
they travel between machines, absolute seconds do not. Only the parser is imported at once.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from data.errors import UsageError
from data.terminal import ended

if TYPE_CHECKING:
    from eval.benchmarks.timed import Timed

PROG = "python -m eval.benchmark"


def main(argv: Sequence[str] | None = None, prog: str = PROG) -> int:
    """Time everything and print the tables as they come; returns the exit status."""
    return ended(lambda: _benchmark(argv, prog), "interrupted; what was printed or written so far is whole")


def _benchmark(argv: Sequence[str] | None, prog: str) -> None:
    p = argparse.ArgumentParser(
        prog=prog, description="How fast the estimators are, beside their peers timed in the same run."
    )
    p.add_argument("--quick", action="store_true", help="a tenth of the work, to see that it runs")
    p.add_argument(
        "--large",
        metavar="OUT",
        type=Path,
        help="instead: time and memory of logs of 1000 to 100 000 frames, to OUT/large.csv and OUT/large.png (hours)",
    )
    p.add_argument(
        "--laser",
        action="store_true",
        help="instead: errors, consistency and loop closures of 50 simulated floor plans",
    )
    p.add_argument(
        "--variety",
        metavar="OUT",
        type=Path,
        help="instead: jcbb and jcbb-hindsight on 200 simulated worlds, to OUT/variety.csv (an interrupted one goes on)"
        " and OUT/variety.png",
    )
    p.add_argument(
        "--sensitivity",
        metavar="OUT",
        type=Path,
        help="instead: jcbb-hindsight with each of its constants halved and doubled, on worlds of the variety and named"
        " logs (corridor with people, Victoria Park, UTIAS), to OUT/sensitivity.csv (an interrupted one goes on) and"
        " OUT/sensitivity.md (hours)",
    )
    p.add_argument(
        "--half",
        choices=("judge", "choose", "later"),
        help="with --variety: those to judge on, those to choose on, or 200 more that settings were neither chosen nor"
        " judged on; with --sensitivity (default there: judge)",
    )
    p.add_argument(
        "--worlds",
        type=int,
        metavar="N",
        help="with --variety: the first N of them (default: all); with --sensitivity: the N with the fewest readings,"
        " of the three kinds in turn; 0: named logs only",
    )
    p.add_argument(
        "--exact",
        action="store_true",
        help="with --variety: the same worlds where noise and view are as they are stated, and odometry does not err in"
        " system, to OUT/variety-exact.csv and .png",
    )
    only = p.add_argument_group("with --sensitivity")
    only.add_argument("--data", metavar="DIR", type=Path, help="folder with MRCLAM_Dataset1.zip, 6 and 9 (UTIAS)")
    only.add_argument(
        "--log",
        metavar="NAME",
        action="append",
        help="one more simulated log, such as corridor:0:no-odometry+forward; may be repeated",
    )
    only.add_argument("--robots", choices=("one", "all"), help="of each UTIAS dataset robot 3 (default), or all")
    only.add_argument("--constant", metavar="NAME", action="append", help="only this one; may be repeated")
    only.add_argument("--processes", type=int, metavar="N", help="runs at a time (default: 1)")
    only.add_argument(
        "--baseline",
        action="store_const",
        const=True,
        help="only the logs with nothing changed: which constants they read, and what the study would cost",
    )
    args = p.parse_args(argv)
    quick = args.quick
    for flag in ("data", "log", "robots", "constant", "processes", "baseline"):
        if args.sensitivity is None and getattr(args, flag) is not None:
            raise UsageError(f"--{flag} is for --sensitivity")
    if args.sensitivity is not None:
        _sensitivity(args, quick)
        return
    if args.variety is not None:
        worlds = args.worlds if args.worlds is not None else 10 if quick else 200
        _variety(args.variety, args.half, worlds, exact=args.exact)
        return
    if args.exact:
        raise UsageError("--exact is for --variety")
    for flag in ("half", "worlds"):
        if getattr(args, flag) is not None:
            raise UsageError(f"--{flag} is for --variety or --sensitivity")
    if args.laser:
        from eval.benchmarks.laser import SEEDS, measure_plans, plan_lines

        print("\n".join(plan_lines(measure_plans(range(SEEDS // 10 if quick else SEEDS)))), flush=True)
        return
    if args.large is not None:
        _large(args.large, quick)
        return
    from eval.benchmarks.timed import table

    for lines in _measured(quick):
        print(table(lines), flush=True)


def _large(out: Path, quick: bool) -> None:
    """Measure logs of all sizes, a line each as they come; with the files of what is done so far."""
    from eval.benchmarks.large import SIZES, line_of, measure_all, scaling_figure, write
    from eval.figures.style import save

    out.mkdir(parents=True, exist_ok=True)
    found = []
    for m in measure_all(SIZES[:3] if quick else SIZES):
        print(line_of(m), flush=True)
        found.append(m)
        write(found, out / "large.csv")
    save(scaling_figure(found), out, "large")


def _variety(out: Path, half: str | None, worlds: int, *, exact: bool) -> None:
    """Run what is not in the file yet, a line each as they come; then the goals, and the figure."""
    from eval.figures.style import save
    from tests.research.variety.figure import variety_figure
    from tests.research.variety.goals import table, worlds_of
    from tests.research.variety.measure import append, line_of, measure_all, read
    from tests.research.variety.worlds import indices

    chosen, name = indices(half, worlds), "variety-exact" if exact else "variety"
    out.mkdir(parents=True, exist_ok=True)
    file = out / f"{name}.csv"
    for row in measure_all(chosen, read(file), exact=exact):
        append(row, file)
        print(line_of(row), flush=True)
    rows = [r for r in read(file) if r.number in set(chosen)]
    print("\n".join(table(rows)), flush=True)
    save(variety_figure(worlds_of(rows)), out, name)


def _sensitivity(args: argparse.Namespace, quick: bool) -> None:
    """Run what is not in the file yet, a line each as they come; then what the constants do, or the study costs."""
    from tests.research.sensitivity.cases import chosen, named, simulated, worlds
    from tests.research.sensitivity.measure import BASE, append, cost_lines, line_of, measure_all, read, read_lines
    from tests.research.sensitivity.table import summaries, table

    constants = chosen(args.constant)
    cases, missing = named(args.data, args.robots == "all")
    cases = worlds(args.half or "judge", 3 if quick and args.worlds is None else args.worlds) + cases
    cases += simulated(args.log or [])
    for line in missing:
        print(line, flush=True)
    out: Path = args.sensitivity
    out.mkdir(parents=True, exist_ok=True)
    file = out / "sensitivity.csv"
    processes = args.processes or 1
    for place, row in measure_all(
        cases, constants, read(file), args.data, processes, only_base=args.baseline is not None
    ):
        append(row, file)
        print(line_of(row, place), flush=True)
    rows = [r for r in read(file) if (r.log, r.task) in set(cases)]
    base = [r for r in rows if r.direction == BASE]
    if args.baseline:
        print("\n".join([*read_lines(base, constants), "", *cost_lines(base, constants)]), flush=True)
        return
    lines = table(summaries(rows, constants))
    (out / "sensitivity.md").write_text("\n".join(lines) + "\n", encoding="utf-8")
    print("\n".join(lines), flush=True)


def _measured(quick: bool) -> Iterator[list[Timed]]:
    """The tables, each when it is done."""
    from eval.benchmarks.association import association_lines, hindsight_lines
    from eval.benchmarks.speed import localization_lines, study_lines, victoria_park_lines, visual_lines

    frames = 700 if quick else 10**9
    yield localization_lines(2_000 if quick else 20_000)
    yield victoria_park_lines(frames)
    yield association_lines(quick)
    yield hindsight_lines(frames)
    yield study_lines(quick)
    yield visual_lines(quick)


if __name__ == "__main__":
    sys.exit(main())

"""`python -m tests.research STUDY OUT`: studies too long for the suite (`--help` names them).

`variety` and `hiding` are those that `jcbb-hindsight` was made with. All write a row a run to a CSV file in OUT; an
interrupted study goes on with it.
"""

import argparse
import sys
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from data.command import Parser
from data.terminal import ended
from tests.research.rows import append, read

GROWTH = ("frames", "landmarks", "closures", "twins", "processes")


def main(argv: Sequence[str] | None = None) -> int:
    """Run one study and print its rows as they come; returns the exit status."""
    return ended(lambda: _study(argv), "interrupted; what was printed or written so far is whole")


def parser() -> argparse.ArgumentParser:
    p = Parser(prog="python -m tests.research", description="Studies too long for the suite.")
    studies = p.add_subparsers(dest="study", required=True)
    variety = studies.add_parser("variety", help="jcbb and jcbb-hindsight on 200 simulated worlds, to OUT/variety.csv")
    variety.add_argument("out", metavar="OUT", type=Path)
    variety.add_argument(
        "--half",
        choices=("judge", "choose", "later"),
        help="those to judge on, those to choose on, or 200 more that settings were neither chosen nor judged on",
    )
    variety.add_argument("--worlds", type=int, metavar="N", default=200, help="the first N of them (default: all)")
    variety.add_argument(
        "--exact",
        action="store_true",
        help="the same worlds where noise and view are as they are stated, and odometry does not err in system, to"
        " OUT/variety-exact.csv",
    )
    hiding = studies.add_parser("hiding", help="the same where landmarks hide: occlusion, sides, removal, people")
    hiding.add_argument("out", metavar="OUT", type=Path)
    hiding.add_argument("--half", choices=("judge", "choose", "later", "grove"), default="choose")
    hiding.add_argument("--worlds", type=int, metavar="N", default=80, help="the first N of them (default: all)")
    audit = studies.add_parser("audit", help="what the audit names in spoilt graphs, to OUT/audit-table.csv")
    audit.add_argument("out", metavar="OUT", type=Path)
    audit.add_argument("--graphs", type=int, metavar="N", default=6, help="of each structure and error (6)")
    audit.add_argument("--sound", type=int, metavar="N", default=40, help="of each structure (40)")
    audit.add_argument("--poses", type=int, metavar="N", default=150, help="poses of a structure (150)")
    foreign = studies.add_parser("foreign", help="causes on worlds of another kind than our own, to OUT/causes*.csv")
    foreign.add_argument("out", metavar="OUT", type=Path)
    foreign.add_argument("--sound", type=int, metavar="N", default=300, help="sound logs (default: 300)")
    foreign.add_argument("--each", type=int, metavar="N", default=10, help="logs of each fault (default: 10)")
    foreign.add_argument("--first", type=int, metavar="N", default=0, help="the first of the logs (default: 0)")
    foreign.add_argument("--fault", metavar="NAME", action="append", help="only this fault; may be repeated")
    foreign.add_argument("--strength", metavar="X", type=float, action="append", help="of a fault (default: 1)")
    foreign.add_argument("--shape", metavar="NAME", action="append", help="only this shape; may be repeated")
    foreign.add_argument("--association", metavar="NAME", default="known", help="known (default), jcbb, …")
    foreign.add_argument("--twins", type=int, metavar="N", default=19, help="replicates of each log (default: 19)")
    foreign.add_argument("--jobs", type=int, metavar="N", default=1, help="runs at a time (default: 1)")
    growth = studies.add_parser("growth", help="how costs grow with one quantity, to OUT/growth.csv and OUT/growth.png")
    growth.add_argument("out", metavar="OUT", type=Path)
    growth.add_argument("--of", metavar="NAME", action="append", choices=GROWTH, help=f"of {', '.join(GROWTH)}")
    growth.add_argument("--quick", action="store_true", help="the first three sizes")
    sound = studies.add_parser("sound", help="how often the cross-examination accuses sound logs of many formats")
    sound.add_argument("--logs", type=int, metavar="N", default=600, help="sound logs (default: 600)")
    sound.add_argument("--first", type=int, metavar="N", default=0, help="the first of them (default: 0)")
    mistakes = studies.add_parser("mistakes", help="from which stated noise on mistakes in a log become silent")
    mistakes.add_argument("worlds", metavar="WORLD", nargs="*", default=["robot", "example", "visual:0"])
    return p


def _study(argv: Sequence[str] | None) -> None:
    args = parser().parse_args(argv)
    if args.study == "sound":
        from tests.research import sound

        sound.study(args.logs, args.first)
        return
    if args.study == "mistakes":
        from tests.research import mistakes

        mistakes.study(args.worlds)
        return
    args.out.mkdir(parents=True, exist_ok=True)
    if args.study == "variety":
        _variety(args.out, args.half, args.worlds, exact=args.exact)
    elif args.study == "hiding":
        _hiding(args.out, args.half, args.worlds)
    elif args.study == "foreign":
        from tests.research.foreign import causes
        from tests.research.foreign.faults import FAULTS
        from tests.research.foreign.shapes import SHAPES

        faults, shapes = args.fault or list(FAULTS), args.shape or list(SHAPES)
        wanted = causes.cases(
            faults, shapes, args.each, args.sound, args.association, args.first, args.strength or [1.0]
        )
        causes.study(args.out, wanted, args.twins, args.jobs)
    elif args.study == "growth":
        from tests.research import growth

        growth.study(args.out, args.of or GROWTH, quick=args.quick)
    else:
        from tests.research import audit

        audit.table(args.out, args.graphs, args.poses, args.sound)


def _variety(out: Path, half: str | None, count: int, *, exact: bool) -> None:
    """Run what is not in the file yet, a line each as they come; then the goals."""
    from tests.research.variety.goals import table
    from tests.research.variety.measure import Row, line_of, measure_all, world_of
    from tests.research.variety.worlds import indices

    chosen, name = indices(half, count), "variety-exact" if exact else "variety"
    file = out / f"{name}.csv"
    for row in measure_all(chosen, read(Row, file), world=partial(world_of, exact=exact)):
        append(row, file)
        print(line_of(row), flush=True)
    print("\n".join(table([r for r in read(Row, file) if r.number in set(chosen)])), flush=True)


def _hiding(out: Path, half: str, count: int) -> None:
    """Run what is not in the file yet, a line each as they come; then the table."""
    from tests.research.variety.goals import hiding_table
    from tests.research.variety.hiding import GROVE, indices, world_of
    from tests.research.variety.measure import Row, line_of, measure_all

    chosen = [GROVE] if half == "grove" else indices(half, count)
    file, limit = out / "hiding.csv", 1200.0 if half == "grove" else 60.0
    for row in measure_all(chosen, read(Row, file), limit, world=world_of, smoothing=half != "grove"):
        append(row, file)
        print(line_of(row), flush=True)
    print("\n".join(hiding_table([r for r in read(Row, file) if r.number in set(chosen)])), flush=True)


if __name__ == "__main__":
    sys.exit(main())

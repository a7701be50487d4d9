"""The net of numbers: `python -m tests.net` runs the cases and says which column of which run has moved."""

import argparse
import os
import sys
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

# Before numpy is imported, here and in the processes: threads of BLAS would change the order of sums.
os.environ["OPENBLAS_NUM_THREADS"] = "1"
os.environ.setdefault("MPLBACKEND", "Agg")

from data.command import Parser
from tests.net.cases import CASES
from tests.net.digest import appeared, columns_of, compare, left_out, watched
from tests.net.record import RECORDED, Done, Record, done
from tests.net.values import differences

PROCESSES = 2


def told(name: str, case: Done | str, args: argparse.Namespace) -> Iterator[tuple[bool, str]]:
    """Whether something has moved, and the line that says it."""
    if isinstance(case, str):
        yield True, _line(name, "", "", f"failed: {case}")
        return
    if args.against is not None:
        before = columns_of(args.against / name, CASES[name].runs)
        yield from ((True, _line(name, *move)) for move in differences(case.columns, before, args.tolerance))
        return
    kept, now = Record.read(name), case.record
    if kept is None:
        yield True, _line(name, "", "", "not recorded yet")
        return
    if now.status != kept.status:
        yield True, _line(name, "", "", f"exit status {now.status} was {kept.status}")
    for move in compare(now.files, kept.files, exact=args.exact, close=CASES[name].close):
        yield True, _line(name, *move)
    for file, column in appeared(now.files, kept.files):
        yield False, _line(name, file, column, "new, not compared")
    for file in case.files:
        if not watched(file) and not left_out(file):
            yield False, _line(name, file, "", "new, not compared")


def _line(case: str, file: str, column: str, what: str) -> str:
    return "  ".join(word for word in (case, file, column, what) if word)


def main(argv: list[str] | None = None) -> int:
    args = _parser().parse_args(argv)
    names = [n for n in CASES if (not args.only or n in args.only) and (CASES[n].short or not args.short)]
    if args.list:
        for n in names:
            _say(f"{n:22} {'short' if CASES[n].short else '     '}  {CASES[n].covers}\n{'':29} {CASES[n].words}")
        return 0
    moved, seconds = 0, 0.0
    with ProcessPoolExecutor(PROCESSES, mp_context=get_context("spawn")) as pool:
        for name, case in zip(names, pool.map(done, names, [args.save] * len(names)), strict=True):
            if args.record and not isinstance(case, str):
                case.record.write(name)
            else:
                for failed, line in told(name, case, args):
                    moved += failed
                    _say(line)
            if not isinstance(case, str):
                seconds += case.seconds
                if args.verbose:
                    _say(f"{name}: {case.seconds:.1f} s, {len(case.record.files)} files")
    if args.record:
        if not args.only and not args.short:
            for stale in sorted(RECORDED.glob("*.json")):
                if stale.stem not in CASES:
                    stale.unlink()
        _say(f"{len(names)} cases recorded, {seconds:.0f} s CPU")
    else:
        _say(f"{len(names)} cases, {moved} columns moved, {seconds:.0f} s CPU")
    return 1 if moved else 0


def _say(line: str) -> None:
    sys.stdout.write(line + "\n")
    sys.stdout.flush()


def _parser() -> argparse.ArgumentParser:
    parser = Parser(prog="python -m tests.net", description=__doc__)
    parser.add_argument("--record", action="store_true", help="what comes out now is what is kept from now on")
    parser.add_argument(
        "--exact", action="store_true", help="compare every byte of the columns, on the machine of the record"
    )
    parser.add_argument("--only", nargs="+", metavar="NAME", choices=list(CASES), help="these cases only")
    parser.add_argument("--short", action="store_true", help="the short half only")
    parser.add_argument("--save", type=Path, metavar="DIR", help="keep the result folders there")
    parser.add_argument(
        "--against", type=Path, metavar="DIR", help="compare every value with result folders saved before"
    )
    parser.add_argument(
        "--tolerance", type=float, default=1e-9, help="of --against, relative to a column's largest value"
    )
    parser.add_argument("--list", action="store_true", help="the cases, and what each covers")
    parser.add_argument("-v", "--verbose", action="store_true", help="seconds and files of each case, too")
    return parser


if __name__ == "__main__":
    sys.exit(main())

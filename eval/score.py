"""`python -m eval.score ESTIMATE TRUTH`: somebody's trajectory against a truth, a name and a value a line.

Only the parser is imported at once, so that `--help` does not wait for the numerical libraries.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import Any

from data.command import Command
from data.errors import UsageError
from data.terminal import ended
from eval.plan.flags.table import Reading, add_flags
from eval.replay.flag import read_values, rows

PROG = "python -m eval.score"
HELP = """\
Score a trajectory against a truth: errors, relative errors, and with a covariance NEES. Both may be CSV with the
columns t,x,y,theta, TUM (also with covariance), SQUARE, EuRoC, KITTI poses or a topic of a ROS bag; the truth also a
log. A name and a value a line, SI units (deg where the name says so), names as in metrics.csv; nothing is aligned
unless asked. With several estimates, each of a run of its own: their mean NEES, with a verdict and its power."""
EXAMPLES = """\
examples:
  python -m eval.score estimate.tum truth.tum
  python -m eval.score estimate.tum truth.tum --align se2
  python -m eval.score estimate.tum truth.tum --cov estimate.cov      covariances in a file of their own
  python -m eval.score wide.tum truth.csv --cov-frame world           29 columns; errors added in the world's axes
  python -m eval.score poses.txt gt.txt --times times.txt --axes camera     KITTI
  python -m eval.score bag:/odom truth.csv --truth-gap 0.2
  python -m eval.score results/report/runs/arena_0/slam-ekf-known/online.csv arena:0
  python -m eval.score runs/*/est.csv --truth runs/*/truth.csv        Monte Carlo: one run each, a verdict on all

exit status: 0 fine, 2 wrong usage or bad data"""


def main(argv: Sequence[str] | None = None, prog: str = PROG) -> int:
    """The whole command, called `prog`; returns the exit status."""
    parser = Command(prog, PROG, HELP, EXAMPLES)
    parser.add_argument("files", metavar="FILE", nargs="+", help="ESTIMATE TRUTH, or estimates alone with --truth")
    parser.add_argument(
        "--truth", metavar="FILE", nargs="+", default=[], help="one truth for all estimates, or one for each, in order"
    )
    table = rows(Reading)
    add_flags(parser, table.values())
    given = vars(parser.read(argv))
    return ended(lambda: _score(given))


def _score(given: dict[str, Any]) -> None:
    from eval.report.results import printed

    files, truths = _files(given.pop("files"), given.pop("truth"))
    reading = Reading(**read_values(Reading, given, lambda row: row.option))
    scores, notes = printed(files, truths, reading)
    sys.stdout.write(f"{scores}\n")
    sys.stderr.write("".join(f"note: {note}\n" for note in notes.splitlines()))


def _files(files: list[str], truths: list[str]) -> tuple[list[str], list[str]]:
    """Estimates, and a truth for each."""
    if not truths:
        if len(files) != 2:
            what = "ESTIMATE TRUTH are needed" if len(files) < 2 else "which are truths? --truth FILE ... is needed"
            raise UsageError(f"{len(files)} file{'s' * (len(files) > 1)}; {what}")
        return files[:1], files[1:]
    if len(truths) == 1:
        return files, truths * len(files)
    if len(truths) != len(files):
        raise UsageError(f"{len(files)} estimates and {len(truths)} truths; one for all is needed, or one for each")
    return files, truths


if __name__ == "__main__":
    sys.exit(main())

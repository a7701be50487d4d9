"""A CARMEN log of a laser robot as an open log, optionally with raw odometry recovered from a corrected one."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from data.convert.parsers import Add
    from data.log import Log

KINDS = ("carmen",)
EXAMPLES = """\
examples:
  python -m data.convert carmen intel.log.gz logs/intel                       relations: intel.relations.csv beside it
  python -m data.convert carmen intel.log.gz logs/intel --relations my_relations.csv
  python -m data.convert carmen intel.gfs.log logs/intel-raw --undo-correction
"""


def add_parsers(add: Add, *, parameters: bool) -> None:
    """The parser of `carmen`; `parameters` is unused."""
    sub = add(
        "carmen",
        help="a CARMEN log with laser scans (.log, .clf, also .gz)",
        description="Odometry and laser scans of a CARMEN log, with reference relations where there are some.",
        epilog=EXAMPLES,
    )
    sub.add_argument("source", metavar="SOURCE", type=Path, help="log file: ODOM, FLASER or ROBOTLASER1 lines")
    sub.add_argument("out", metavar="OUT", type=Path, help="log folder to write")
    text = "poses are a particle filter's: recover the raw odometry"
    sub.add_argument("--undo-correction", action="store_true", help=text)
    text = "reference relations by frame (default: NAME.relations.csv beside the log)"
    sub.add_argument("--relations", metavar="FILE", type=Path, help=text)


def convert(args: argparse.Namespace) -> Log:
    """The log of the file."""
    from data.formats.recordings.carmen import load_carmen

    return load_carmen(args.source, args.relations, undo_correction=args.undo_correction)

"""`slamref convert`: the converters of `data.convert`, and `laser`, which takes scan matching."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from data.convert.__main__ import main as convert_main

if TYPE_CHECKING:
    from data.command import Add
    from data.log import Log

PROG = "python -m eval.convert"
KINDS = ("laser",)
MOTIONS = ("scan-match", "odometry")
PARTS = ("loops", "corners")
TEXT = """\
Key poses of a laser log as frames of a log without scans, which every estimator replays:
  motion        scan-match (default): scan matching from key pose to key pose, with the wheels as its prior
                odometry: the wheels; each scan matched to those of key poses before is a closure, source scan-match
  closures.csv  loops that the front end believes, source loop
  observations  corners of walls in the scans of key poses, labelled by the front end's final path
  relations.csv reference relations of the laser log, whose frames are frames, too, with --motion odometry; else
                each end is carried to its key pose by the front end's own match
A pair of scans is never motion and closure at once, and wheels count once. Scans of neighbouring matches overlap, and
corners come from scans that are matched as well: their errors are taken as independent.
"""
EXAMPLES = """\
examples:
  python -m data.convert laser intel.log.gz logs/intel-keys
  python -m data.convert laser floorplan:0 logs/plan --motion odometry --leave-out corners
"""


def main(argv: Sequence[str] | None = None, prog: str = PROG) -> int:
    """Convert and report; 0, or 2 with one line on stderr."""
    return convert_main(argv, prog, (sys.modules[__name__],))


def add_parsers(add: Add, *, parameters: bool) -> None:
    """The parser of `laser`; `parameters` is unused."""
    sub = add("laser", help="key poses, loops and corners of a laser log", description=TEXT, epilog=EXAMPLES)
    sub.add_argument("source", metavar="LOG", help="a laser log by path or name (CARMEN, open log folder, floorplan:0)")
    sub.add_argument("out", metavar="OUT", type=Path, help="log folder to write")
    sub.add_argument("--motion", choices=MOTIONS, default=MOTIONS[0], help=f"of key poses (default: {MOTIONS[0]})")
    text = "a part that the log has not; repeatable"
    sub.add_argument("--leave-out", metavar="PART", choices=PARTS, action="append", default=[], help=text)
    text = "a key pose every M metres (default: 0.4)"
    sub.add_argument("--keyframe-distance", metavar="M", type=float, default=0.4, help=text)
    text = "reference relations by frame (default: NAME.relations.csv beside the log)"
    sub.add_argument("--relations", metavar="FILE", type=Path, help=text)
    sub.add_argument("--no-odometry", action="store_true", help="odometry is unknown: scans alone tell the motion")


def convert(args: argparse.Namespace) -> Log:
    """The log of key poses. UsageError for a log without scans, or where nothing would be left."""
    from data.errors import UsageError
    from data.logs import Reading, open_log
    from eval.convert.key_poses import frames_of_relations, log_of_keys
    from eval.plan.warming import compile_if_needed
    from eval.replay.laser.front_end import is_unknown
    from eval.replay.laser.key_log import key_log
    from eval.replay.settings import Setup

    if not 0.0 < args.keyframe_distance < 1e3:
        raise UsageError(f"--keyframe-distance {args.keyframe_distance:g}: a number above 0 is needed")
    if args.motion == MOTIONS[0] and set(args.leave_out) == set(PARTS):
        raise UsageError(f"--leave-out {' --leave-out '.join(PARTS)}: nothing beside the motion is left")
    log = open_log(args.source, Reading(relations=args.relations, no_odometry=args.no_odometry))
    if log.recorded.scans is None:
        raise UsageError(f"{args.source}: no laser scans; a log with scans is needed")
    if args.motion == "odometry" and is_unknown(log.recorded.increments):
        raise UsageError(f"--motion odometry: {log.name} has none; --motion scan-match is needed")
    compile_if_needed()
    made = key_log(
        log.recorded, Setup(keyframe_distance=args.keyframe_distance), motion=args.motion,
        also=frames_of_relations(log) if args.motion == "odometry" else None,
        loops="loops" not in args.leave_out, corners="corners" not in args.leave_out,
    )  # fmt: skip
    return log_of_keys(args.out.absolute().name, log, made, args.motion)


if __name__ == "__main__":
    sys.exit(main())

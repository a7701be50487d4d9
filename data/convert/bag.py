"""ROS bags with detections, fixes, truth or scans as open logs (with `rosbags`)."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from data.convert import TEXTS, said_of

if TYPE_CHECKING:
    from data.command import Add
    from data.log import Log

KINDS = ("bag",)


def add_parsers(add: Add, *, parameters: bool) -> None:
    """The parser of `bag`; `parameters` is unused."""
    sub = add("bag", **said_of("bag"))
    sub.add_argument("source", metavar="BAG", type=Path, help="a .bag file, a folder of ROS 2, or its .mcap or .db3")
    sub.add_argument("out", metavar="OUT", type=Path, nargs="?", help="log folder to write (not with --list)")
    sub.add_argument("--list", action="store_true", help="print what each topic becomes, and write nothing")
    for flag, (metavar, text) in TEXTS["bag"]["flags"].items():
        sub.add_argument(f"--{flag}", metavar=metavar, help=text)
    sub.add_argument("--skip", metavar="TOPIC", action="append", default=[], help="a topic to leave out; repeatable")


def convert(args: argparse.Namespace) -> Log | str:
    """The log of the bag; with --list a table of its topics."""
    from data.columns.named import LENGTH
    from data.errors import UsageError, unknown
    from data.formats.bags import Wanted, chosen, collect, listed, log_of_bag, topics_of
    from data.formats.recordings.laser import TravelNoise
    from data.formats.tables.files import POSE, TRAVEL, numbers

    topics = chosen(
        args.source, topics_of(args.source), odometry=args.odom, scans=args.scan, truth=args.truth,
        second=args.second_odom, skip=args.skip, listing=args.list,
    )  # fmt: skip
    if args.list:
        return listed(topics)
    if args.out is None:
        raise UsageError("OUT, a log folder to write, is needed (or --list)")

    if args.second_odom_sigma is not None and args.second_odom is None:
        text = f"--second-odom-sigma {args.second_odom_sigma}"
        raise UsageError(f"{text}: there is none; --second-odom TOPIC names it")
    travel = "of travel [m] per sqrt(m) and sqrt(rad), of the heading [rad] per sqrt(m) and sqrt(rad)"
    one, found = "a standard deviation", {}
    for flag, dimensions, what, zero in (
        ("prior", POSE, "x, y [m], heading [rad]", None), ("prior-sigma", POSE, "of x, y [m], heading", True),
        ("point-sigma", ("length",), one, False), ("bearing-sigma", ("angle",), one, False),
        ("position-sigma", ("length",), one, False), ("heading-sigma", ("angle",), one, False),
        ("range-sigma", ("length",), one, False),
        ("second-odom-sigma", TRAVEL, travel, True),
    ):  # fmt: skip
        text = getattr(args, flag.replace("-", "_"))
        found[flag] = None if text is None else numbers(text, dimensions, flag, what, zero=zero)
    prior, prior_sigma, *sigmas, second = found.values()
    alone = [None if sigma is None else float(sigma[0]) for sigma in sigmas]
    noise = None if second is None else TravelNoise(*second.tolist())
    if (unit := args.range_unit or "") not in ("", *LENGTH):
        raise UsageError(f"--range-unit {unit}: {unknown(unit, LENGTH)}")
    wanted = Wanted(prior, prior_sigma, alone[0], alone[1], alone[2], alone[3], noise, alone[4], unit)
    return log_of_bag(args.source, args.out.absolute().name, topics, collect(args.source, topics), wanted)

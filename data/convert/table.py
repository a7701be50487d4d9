"""CSV files of another program as an open log: `--columns t=stamp,v=speed --unit angle=deg,time=ns`."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from data.convert import TEXTS, said_of

if TYPE_CHECKING:
    from data.command import Add
    from data.formats.open_log import Recording

KINDS = ("table",)
SENSED = "labels-sensed"
TABLES = ("columns", "unit", "time-offset")
REPEATED = (
    "sensor", "observation-sigma", "sensor-pose", "max-range", "view", "sees", "descriptor-sigma", "class-error",
)  # fmt: skip
KEYS_ALONE = ("odometry", SENSED)  # Keys of a mapping file besides the flags below
FLAGS: dict[str, tuple[str, str]] = TEXTS["table"]["flags"]


def add_parsers(add: Add, *, parameters: bool) -> None:
    """The parser of `table`; `parameters` is unused."""
    sub = add("table", **said_of("table"))
    sub.argument_default = argparse.SUPPRESS
    says = TEXTS["table"]["says"]
    sub.add_argument("source", metavar="SOURCE", type=Path, help=says["source"])
    sub.add_argument("out", metavar="OUT", type=Path, help="log folder to write")
    for name, (metavar, text) in FLAGS.items():
        action = "append" if name in (*TABLES, *REPEATED) else "store"
        sub.add_argument(f"--{name}", dest=name, metavar=metavar, help=text, action=action)
    sub.add_argument(f"--{SENSED}", dest=SENSED, action="store_true", help=says[SENSED])


def convert(args: argparse.Namespace) -> Recording:
    """The log of the files, with velocities as recorded."""
    from data.formats.tables.log import read_log
    from data.formats.tables.request import settle, with_mapping

    given: dict[str, object] = {key: value for key, value in vars(args).items() if key in (*FLAGS, SENSED)}
    if args.source.suffix == ".toml":
        given = with_mapping(args.source, given, (*FLAGS, *KEYS_ALONE))
    else:
        given["odometry"] = str(args.source)
    # a log of odometry with fixes, closures or a second odometry needs no observations
    if not {"fixes", "closures", "sensor", "scans", "second-odometry"} & set(given):
        given.setdefault("observations", given.get("odometry"))
    return read_log(args.out.absolute().name, settle(given))

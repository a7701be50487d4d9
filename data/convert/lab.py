"""A folder in the visual lab's format as an open log: detected pictures, their corners as observations."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from data.convert.parsers import Add
    from data.log import Log

KINDS = ("lab",)
EXAMPLES = """\
examples:
  python -m data.convert lab my_lab logs/lab                      pictures found, their corners as observations
  python -m data.convert lab my_lab logs/lab --camera-translation m --corner-noise depth
"""


def add_parsers(add: Add, *, parameters: bool) -> None:
    """The parser of `lab`; `parameters` is unused."""
    sub = add(
        "lab",
        help="a folder in the visual lab's format, as an open log",
        description="Find the pictures in every image of a recording, and write their corners as an open log folder.",
        epilog=EXAMPLES,
    )
    sub.add_argument("source", metavar="FOLDER", type=Path, help="with configuration, log file and folder landmark/")
    sub.add_argument("out", metavar="OUT", type=Path, help="log folder to write")
    sub.add_argument("--camera-translation", choices=("cm", "mm", "m"), default="cm", help="unit of T (default: cm)")
    text = "what R and T do (default: p_c = R p_b + T)"
    sub.add_argument("--camera-reading", choices=("to-camera", "to-body"), default="to-camera", help=text)
    sub.add_argument("--corner-noise", choices=("lab", "depth"), default="lab", help="of the corners (default: lab)")
    sub.add_argument("--trust-pickle", action="store_true", help="read object arrays: they can run code")


def convert(args: argparse.Namespace) -> Log:
    """The log of a folder in the lab's format."""
    from data.visual.opening import Camera, open_lab_log

    camera = Camera(args.camera_translation, args.camera_reading, args.corner_noise, args.trust_pickle)
    return open_lab_log(args.source, camera, lambda text: print(text, file=sys.stderr))  # noqa: T201

"""A recording of pictures on walls: rendered in the visual lab's format, and a folder in it as an open log."""

from __future__ import annotations

import argparse
import sys
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING

from data.terminal import counted
from data.worlds.registry import add_flags

if TYPE_CHECKING:
    from data.command import Add
    from data.log import Log

KINDS = ("visual", "lab")
VISUAL = """\
examples:
  python -m data.convert visual my_lab --seed 0                   configuration, images and stereo points, rendered
  python -m data.convert visual my_lab --seed 3 --form npz --frames 40
  slamref run my_lab
"""
LAB = """\
examples:
  python -m data.convert lab my_lab logs/lab                      pictures found, their corners as observations
  python -m data.convert lab my_lab logs/lab --camera-translation m --corner-noise depth
"""


def add_parsers(add: Add, *, parameters: bool) -> None:
    """The parsers of both; `parameters`: with the renderer's flags, which take it to be loaded."""
    sub = add(
        "visual",
        help="a rendered recording of pictures on walls, in the visual lab's format",
        description="Render what a robot with a stereo camera records, and write it in the visual lab's format.",
        epilog=VISUAL,
    )
    if parameters:
        add_flags(sub, "visual")
        sub.add_argument("--form", choices=("mat", "npy", "npz"), default="mat", help="of the log file (default: mat)")
        sub.add_argument("--frames", type=int, metavar="N", help="the first N frames only")
    lab = add(
        "lab",
        help="a folder in the visual lab's format, as an open log",
        description="Find the pictures in every image of a recording, and write their corners as an open log folder.",
        epilog=LAB,
    )
    lab.add_argument("source", metavar="FOLDER", type=Path, help="with configuration, log file and folder landmark/")
    lab.add_argument("out", metavar="OUT", type=Path, help="log folder to write")
    lab.add_argument("--camera-translation", choices=("cm", "mm", "m"), default="cm", help="unit of T (default: cm)")
    text = "what R and T do (default: p_c = R p_b + T)"
    lab.add_argument("--camera-reading", choices=("to-camera", "to-body"), default="to-camera", help=text)
    lab.add_argument("--corner-noise", choices=("lab", "depth"), default="lab", help="of the corners (default: lab)")
    lab.add_argument("--trust-pickle", action="store_true", help="read object arrays: they can run code")


def convert(args: argparse.Namespace) -> Log | str:
    """The log of a folder; of `visual`, which is rendered and written, a sentence about the result."""
    if args.kind == "lab":
        from data.logs import Reading
        from wings.camera.opening import open_lab_log

        reading = Reading(args.camera_translation, args.camera_reading, args.corner_noise, args.trust_pickle)
        return open_lab_log(args.source, reading, lambda text: print(text, file=sys.stderr))
    from wings.camera.gallery import Gallery
    from wings.camera.lab.folder import write_lab
    from wings.camera.rendering.render import Rendered

    gallery = Gallery(**{f.name: getattr(args, f.name) for f in fields(Gallery)})
    recording = Rendered(gallery, args.seed, frames=args.frames)
    write_lab(args.out, recording, form=args.form)
    held = f"{counted(len(recording), 'frame')}, {counted(len(recording.references), 'picture')}"
    return f"{held}; written: {args.out.absolute()}"

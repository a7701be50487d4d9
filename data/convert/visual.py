"""The visual kinds of `python -m data.convert`: render a lab folder, or make an open log of one."""

from __future__ import annotations

import argparse
import sys
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING

from data.worlds.flags import add_flags

if TYPE_CHECKING:
    from collections.abc import Callable

    from data.log import Log

VISUAL = "visual"
LAB = "lab"
VISUAL_EXAMPLES = """\
examples:
  python -m data.convert visual my_lab --seed 0                   configuration, images and stereo points, rendered
  python -m data.convert visual my_lab --seed 3 --form npz --frames 40
  python -m eval.run_all --log my_lab
"""
LAB_EXAMPLES = """\
examples:
  python -m data.convert lab my_lab logs/lab                      pictures found, their corners as observations
  python -m data.convert lab my_lab logs/lab --camera-translation m --corner-noise depth
"""


def add_kinds(add: Callable[..., argparse.ArgumentParser], *, parameters: bool) -> None:
    """Parsers of both kinds; `parameters`: with the renderer's flags, which take it to be loaded."""
    sub = add(
        VISUAL,
        help="a rendered recording of pictures on walls, in the visual lab's format",
        description="Render what a robot with a stereo camera records, and write it in the visual lab's format.",
        epilog=VISUAL_EXAMPLES,
    )
    if parameters:
        add_flags(sub, VISUAL)
        sub.add_argument("--form", choices=("mat", "npy", "npz"), default="mat", help="of the log file (default: mat)")
        sub.add_argument("--frames", type=int, metavar="N", help="the first N frames only")
    sub = add(
        LAB,
        help="a folder in the visual lab's format, as an open log",
        description="Find the pictures in every image of a recording, and write their corners as an open log folder.",
        epilog=LAB_EXAMPLES,
    )
    sub.add_argument("source", metavar="FOLDER", type=Path, help="with configuration, log file and folder landmark/")
    sub.add_argument("out", metavar="OUT", type=Path, help="log folder to write")
    sub.add_argument("--camera-translation", choices=("cm", "mm", "m"), default="cm", help="unit of T (default: cm)")
    sub.add_argument(
        "--camera-reading", choices=("to-camera", "to-body"), default="to-camera",
        help="what R and T do (default: p_c = R p_b + T)",
    )  # fmt: skip
    sub.add_argument("--corner-noise", choices=("lab", "depth"), default="lab", help="of the corners (default: lab)")
    sub.add_argument("--trust-pickle", action="store_true", help="read object arrays: they can run code")


def write_visual(args: argparse.Namespace) -> str:
    """Render and write; returns what was written, in a sentence."""
    from data.visual.lab.folder import write_lab
    from data.visual.rendering.render import Rendered
    from data.worlds.gallery import Gallery

    gallery = Gallery(**{f.name: getattr(args, f.name) for f in fields(Gallery)})
    recording = Rendered(gallery, args.seed, frames=args.frames)
    write_lab(args.out, recording, form=args.form)
    return f"{len(recording)} frames, {len(recording.references)} pictures"


def read_lab(args: argparse.Namespace) -> Log:
    """The log of a folder in the lab's format."""
    from data.visual.opening import Camera, open_lab_log

    camera = Camera(args.camera_translation, args.camera_reading, args.corner_noise, args.trust_pickle)
    return open_lab_log(args.source, camera, lambda text: print(text, file=sys.stderr))  # noqa: T201

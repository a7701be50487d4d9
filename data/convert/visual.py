"""A rendered recording of pictures on walls, written in the visual lab's format."""

from __future__ import annotations

import argparse
from dataclasses import fields
from typing import TYPE_CHECKING

from data.terminal import counted
from data.worlds.registry import add_flags

if TYPE_CHECKING:
    from data.convert.parsers import Add

KINDS = ("visual",)
EXAMPLES = """\
examples:
  python -m data.convert visual my_lab --seed 0                   configuration, images and stereo points, rendered
  python -m data.convert visual my_lab --seed 3 --form npz --frames 40
  slamref run my_lab
"""


def add_parsers(add: Add, *, parameters: bool) -> None:
    """The parser of `visual`; `parameters`: with the renderer's flags, which take it to be loaded."""
    sub = add(
        "visual",
        help="a rendered recording of pictures on walls, in the visual lab's format",
        description="Render what a robot with a stereo camera records, and write it in the visual lab's format.",
        epilog=EXAMPLES,
    )
    if parameters:
        add_flags(sub, "visual")
        sub.add_argument("--form", choices=("mat", "npy", "npz"), default="mat", help="of the log file (default: mat)")
        sub.add_argument("--frames", type=int, metavar="N", help="the first N frames only")


def convert(args: argparse.Namespace) -> str:
    """Render and write; returns a sentence about the result."""
    from data.formats.lab.folder import write_lab
    from data.visual.rendering.render import Rendered
    from data.worlds.gallery import Gallery

    gallery = Gallery(**{f.name: getattr(args, f.name) for f in fields(Gallery)})
    recording = Rendered(gallery, args.seed, frames=args.frames)
    write_lab(args.out, recording, form=args.form)
    held = f"{counted(len(recording), 'frame')}, {counted(len(recording.references), 'picture')}"
    return f"{held}; written: {args.out.absolute()}"

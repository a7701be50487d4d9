"""A recording of pictures on walls: rendered in the visual lab's format, and a folder in it as an open log."""

from __future__ import annotations

import argparse
import sys
from dataclasses import fields
from typing import TYPE_CHECKING

from data.command import declare
from data.convert import TEXTS, parser_of
from data.terminal import counted
from data.worlds.registry import add_flags

if TYPE_CHECKING:
    from data.command import Add
    from data.log import Log

KINDS = ("visual", "lab", "closures")


def add_parsers(add: Add, *, parameters: bool) -> None:
    """The parsers of all; `parameters`: with the renderer's flags, which take it to be loaded."""
    for kind in KINDS:
        sub = parser_of(add, kind)
        if kind != "visual":
            declare(sub, TEXTS["pictures"]["arguments"])
        elif parameters:
            add_flags(sub, kind)


def convert(args: argparse.Namespace) -> Log | str:
    """The log of a folder; of `visual`, which is rendered and written, a sentence about the result."""
    if args.kind == "lab":
        from data.logs import Reading
        from wings.camera.opening import open_lab_log

        reading = Reading(args.camera_translation, args.camera_reading, args.corner_noise, args.trust_pickle)
        return open_lab_log(args.source, reading, lambda text: print(text, file=sys.stderr))
    if args.kind == "closures":
        return _closures(args)
    from wings.camera.gallery import Gallery
    from wings.camera.lab.folder import write_lab
    from wings.camera.rendering.render import Rendered

    gallery = Gallery(**{f.name: getattr(args, f.name) for f in fields(Gallery)})
    recording = Rendered(gallery, args.seed, frames=args.frames)
    write_lab(args.out, recording, form=args.form)
    held = f"{counted(len(recording), 'frame')}, {counted(len(recording.references), 'picture')}"
    return f"{held}; written: {args.out.absolute()}"


def _closures(args: argparse.Namespace) -> Log:
    from data.logs import Reading
    from data.whole import whole_file
    from wings.camera.opening import open_places

    reading = Reading(args.camera_translation, args.camera_reading, trust_pickle=args.trust_pickle)
    log, found = open_places(args.source, args.apart, reading)
    rows = [(c.frame1, c.frame2, f"{c.similarity:.4f}", c.inliers, f"{c.likelihood:.6f}") for c in found]
    table = [("frame1", "frame2", "similarity", "inliers", "likelihood"), *rows]
    args.out.absolute().parent.mkdir(parents=True, exist_ok=True)
    with whole_file(args.out.absolute().with_name(f"{args.out.name}.candidates.csv")) as partial:
        partial.write_text("".join(f"{','.join(map(str, row))}\n" for row in table), encoding="utf-8", newline="")
    return log

"""The page itself: one file with style, scripts and data inside, which opens from a disk and asks for nothing."""

from __future__ import annotations

import html
import re
from collections.abc import Mapping, Sequence
from importlib.resources import files
from string import Template
from typing import Any

from eval.player.pack import text_of

SCRIPTS = (
    "decode", "history", "view", "marks", "state", "map", "controls", "inspect", "matching", "camera", "plots", "main",
)  # fmt: skip
"""In the order of loading."""
NOTES = (
    "Candidates, gates and what other methods say are recorded while a run is made: of filters always, of smoothers"
    " where they decide for themselves. Kept are candidates inside 99.999 %, the nearest one and the chosen one; each"
    " method is asked in every frame, but not in logs of more than 2000 frames where labels decide.",
    "A landmark's mean and ellipse change only when they moved by more than half of what is stated above the paths.",
)


def document(name: str, chunks: Sequence[Mapping[str, Any]]) -> str:
    """The page of a log, with its recording in one or more chunks."""
    here = files("eval.player")
    page, vendor = here / "page", here / "vendor"

    def read(folder: Any, file: str) -> str:
        text: str = (folder / file).read_text(encoding="utf-8")
        return text

    # the first line of the library names its address, which a page that loads nothing need not have
    plotting = re.sub(r"^/\*!.*?\*/\s*", "", read(vendor, "uPlot.iife.min.js"))
    return Template(read(page, "player.html")).substitute(
        title=html.escape(f"{name}: player"),
        name=html.escape(name),
        style=read(vendor, "uPlot.min.css") + read(page, "player.css"),
        notes="\n".join(f"<li>{html.escape(note)}</li>" for note in NOTES),
        chunks="\n".join(f'<script type="application/json" class="chunk">{text_of(c)}</script>' for c in chunks),
        uplot=read(vendor, "VERSION").split()[1].rstrip(","),
        licence=read(vendor, "LICENSE").strip(),
        plotting=plotting,
        scripts="\n".join(read(page, f"{script}.js") for script in SCRIPTS),
    )

"""From the flags to how figures look, with what this machine has: its fonts, and LaTeX if there is one."""

from __future__ import annotations

import shutil

from data.errors import UsageError
from eval.figures.figure_style import FigureStyle
from eval.plan.flags.table import Drawing, Output, inches

TIMES = ("times", "times new roman", "times roman")
LIKE_TIMES = ("Times New Roman", "Times", "Nimbus Roman", "TeX Gyre Termes", "Liberation Serif", "STIXGeneral")
"""The last one comes with matplotlib."""
USUAL = "DejaVu Sans"
NEEDED = ("latex", "dvipng")
SYSTEMS = ("pdflatex", "xelatex", "lualatex")


def require_latex(drawing: Drawing) -> None:
    """Raise UsageError, before any work, where LaTeX is asked for and is not here."""
    if drawing.usetex:
        for program in NEEDED:
            if shutil.which(program) is None:
                raise UsageError(f"--usetex needs LaTeX, and there is no program {program!r} on this machine")
    if drawing.pgf and _system() is None:
        raise UsageError(f"--pgf needs LaTeX, and there is none of {', '.join(SYSTEMS)} on this machine")


def figure_style_of(drawing: Drawing, output: Output) -> tuple[FigureStyle, str]:
    """How figures look, and a sentence about a font that is not here (empty: all is as asked).

    PDF files are written for a paper: where one of its flags, a write-up or `--formats` asks for them.
    """
    fonts, mathematics, said = _fonts(drawing.font)
    width = None if drawing.figure_width is None else inches(drawing.figure_width)
    pgf = _system() if drawing.pgf else None
    pdf = output.write_up or "pdf" in output.formats or drawing != Drawing()
    return FigureStyle(width, fonts, mathematics, drawing.font_size, drawing.usetex, pgf, pdf), said


def _system() -> str | None:
    return next((s for s in SYSTEMS if shutil.which(s) is not None), None)


def _fonts(name: str | None) -> tuple[tuple[str, ...], str | None, str]:
    if name is None:
        return (), None, ""
    from matplotlib import font_manager  # slow to load, and needed for a font alone

    known = {f.name.lower(): f.name for f in font_manager.fontManager.ttflist}
    times = name.lower() in TIMES
    wanted = known.get(name.lower())
    if wanted is not None:
        return (wanted, USUAL), "stix" if times else None, ""
    like = next((f for f in LIKE_TIMES if f.lower() in known), USUAL) if times else USUAL
    said = f"--font {name}: not on this machine; figures have {like} instead"
    return tuple(dict.fromkeys((like, USUAL))), "stix" if times else None, said

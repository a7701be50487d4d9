"""The figure style for given flags, with the fonts and LaTeX of this machine."""

from __future__ import annotations

import shutil

from data.errors import UsageError
from eval.figures.figure_style import FigureStyle
from eval.plan.flags.table import Drawing, Output, inches

TIMES = ("times", "times new roman", "times roman")
LIKE_TIMES = ("Times New Roman", "Times", "Nimbus Roman", "TeX Gyre Termes", "Liberation Serif", "STIXGeneral")
"""Substitutes in order of preference; matplotlib contains the last one."""
USUAL = "DejaVu Sans"
NEEDED = ("latex", "dvipng")
SYSTEMS = ("pdflatex", "xelatex", "lualatex")


def require_latex(drawing: Drawing) -> None:
    """Raise UsageError if LaTeX is needed and missing."""
    if drawing.usetex:
        for program in NEEDED:
            if shutil.which(program) is None:
                raise UsageError(f"--usetex: needs LaTeX; program {program!r} is not on this machine")
    if drawing.pgf and _system() is None:
        raise UsageError(f"--pgf: needs LaTeX; none of {', '.join(SYSTEMS)} is on this machine")


def figure_style_of(drawing: Drawing, output: Output) -> tuple[FigureStyle, str]:
    """The figure style, and a message about a missing font (empty: none is missing).

    A flag of `Drawing`, `--figures` or `--show` adds PDF files and each figure's data; `--write-up` and `--formats pdf`
    add PDF files only.
    """
    fonts, mathematics, message = _fonts(drawing.font)
    width = None if drawing.figure_width is None else inches(drawing.figure_width)
    pgf = _system() if drawing.pgf else None
    paper = drawing != Drawing() or bool(output.figures or output.show)
    pdf = output.write_up or "pdf" in output.formats or paper
    titles = not drawing.no_titles
    style = FigureStyle(width, fonts, mathematics, drawing.font_size, drawing.usetex, pgf, pdf, titles, paper)
    return style, message


def _system() -> str | None:
    return next((s for s in SYSTEMS if shutil.which(s) is not None), None)


def _fonts(name: str | None) -> tuple[tuple[str, ...], str | None, str]:
    if name is None:
        return (), None, ""
    from matplotlib import font_manager  # slow to load

    known = {f.name.lower(): f.name for f in font_manager.fontManager.ttflist}
    times = name.lower() in TIMES
    wanted = known.get(name.lower())
    if wanted is not None:
        return (wanted, USUAL), "stix" if times else None, ""
    like = next((f for f in LIKE_TIMES if f.lower() in known), USUAL) if times else USUAL
    message = f"--font {name}: not on this machine; figures use {like} instead"
    return tuple(dict.fromkeys((like, USUAL))), "stix" if times else None, message

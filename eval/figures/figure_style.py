"""The style that figures for a paper are asked to have: width, fonts, size, LaTeX. Loads nothing of matplotlib."""

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from typing import Any

USUAL_TYPE = 8.0  # pt, of titles and labels


@dataclass(frozen=True)
class FigureStyle:
    """What is wished for: width [in] (None: as usual), fonts by preference, type size [pt], LaTeX, pgf, PDF files.
    titles: whether a figure has a title inside, beside those of its panels. data: write its data, too.
    """

    width: float | None = None
    fonts: tuple[str, ...] = ()
    mathematics: str | None = None
    size: float = USUAL_TYPE
    usetex: bool = False
    pgf: str | None = None
    pdf: bool = False
    titles: bool = True
    data: bool = False

    @property
    def formats(self) -> tuple[str, ...]:
        """Of the files; PNG comes first."""
        return ("png", "pdf") if self.pdf else ("png",)

    def settings(self) -> dict[Any, Any]:
        """What differs from the usual settings of matplotlib."""
        made: dict[Any, Any] = {}
        if self.fonts:
            made["font.family"] = list(self.fonts)
        if self.mathematics is not None:
            made["mathtext.fontset"] = self.mathematics
        if self.size != USUAL_TYPE:
            made |= dict.fromkeys(("font.size", "axes.titlesize", "axes.labelsize"), self.size)
            made |= dict.fromkeys(("legend.fontsize", "xtick.labelsize", "ytick.labelsize"), self.size - 1.0)
            made["figure.titlesize"] = self.size + 0.5
        if self.usetex:
            made["text.usetex"] = True
            made["axes.unicode_minus"] = False
        if self.pgf is not None:
            made["pgf.texsystem"] = self.pgf
            made["pgf.rcfonts"] = False
        return made


USUAL = FigureStyle()
PHONE = 3.5  # in: letters of 6 pt are 9 pixels high on a page of 380
FOR_PHONE = "-narrow"  # ends the name of a figure's file that was drawn for a phone
_FIGURE_STYLE: ContextVar[FigureStyle] = ContextVar("look", default=USUAL)


def current() -> FigureStyle:
    """What is wished for now."""
    return _FIGURE_STYLE.get()


@contextmanager
def figure_style(look: FigureStyle) -> Iterator[None]:
    """Figures made within have this look."""
    token = _FIGURE_STYLE.set(look)
    try:
        yield
    finally:
        _FIGURE_STYLE.reset(token)


TEX = {
    "\\": r"\textbackslash{}", "&": r"\&", "%": r"\%", "$": r"\$", "#": r"\#", "_": r"\_", "{": r"\{", "}": r"\}",
    "~": r"\textasciitilde{}", "^": r"\textasciicircum{}", "<": r"$<$", ">": r"$>$", "|": r"$|$",
    "σ": r"$\sigma$", "χ": r"$\chi$", "±": r"$\pm$", "×": r"$\times$", "²": r"$^2$", "°": r"$^\circ$", "≤": r"$\le$",
    "≥": r"$\ge$", "−": r"$-$", "–": "--", "—": "---", "\u00a0": "~", "…": r"\dots{}", "µ": r"$\mu$", "ν": r"$\nu$",
    "θ": r"$\theta$", "α": r"$\alpha$", "ᵀ": r"$^T$", "⁻": r"$^-$", "¹": r"$^1$",
}  # fmt: skip


def tex_escape(text: str) -> str:
    """Text as LaTeX prints it: special characters escaped, Greek and signs in math mode."""
    return "".join(TEX.get(c, c) for c in text)

"""Text as LaTeX sets it, in tables and in figures."""

from __future__ import annotations

from matplotlib.figure import Figure
from matplotlib.text import Text

_TEX = {
    "\\": r"\textbackslash{}", "&": r"\&", "%": r"\%", "$": r"\$", "#": r"\#", "_": r"\_", "{": r"\{", "}": r"\}",
    "~": r"\textasciitilde{}", "^": r"\textasciicircum{}", "<": r"$<$", ">": r"$>$", "|": r"$|$",
    "σ": r"$\sigma$", "χ": r"$\chi$", "±": r"$\pm$", "×": r"$\times$", "²": r"$^2$", "°": r"$^\circ$", "≤": r"$\le$",
    "≥": r"$\ge$", "−": r"$-$", "–": "--", "—": "---", "\u00a0": "~", "…": r"\dots{}", "µ": r"$\mu$", "ν": r"$\nu$",
    "θ": r"$\theta$", "α": r"$\alpha$", "ᵀ": r"$^T$", "⁻": r"$^-$", "¹": r"$^1$",
}  # fmt: skip


def tex_escape(text: str) -> str:
    """Text as LaTeX prints it: special characters escaped, Greek and signs in math mode."""
    return "".join(_TEX.get(c, c) for c in text)


def translate(fig: Figure, *, escape: bool) -> None:
    """Signs in every text of a figure as commands of LaTeX; `escape`: what is special to LaTeX, too.

    The pgf backend of matplotlib escapes the latter itself.
    """
    signs = {c: command for c, command in _TEX.items() if not c.isascii() or escape}
    for text in fig.findobj(Text):
        assert isinstance(text, Text)
        given = text.get_text()
        if "$" not in given:  # else somebody wrote mathematics
            text.set_text("".join(signs.get(c, c) for c in given))

"""Figures of a given width and type, for a paper; and text as LaTeX sets it, in tables and in figures."""

from __future__ import annotations

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.legend import Legend
from matplotlib.text import Text

from eval.figures.figure_style import USUAL_TYPE, current

DOUBLE = 7.0  # in. Width of both columns
NARROW = 5.0  # in. Below, panels side by side are two at most
MARGIN = 0.06  # in, left free at the right edge


def page_width() -> float:
    """In. Width of a figure."""
    return current().width or DOUBLE


def across(most: int) -> int:
    """How many panels stand side by side."""
    return most if page_width() >= NARROW else min(most, 2)


def points(usual: float) -> float:
    """Size [pt] of a text that is smaller or larger than the rest."""
    return usual * current().size / USUAL_TYPE


def untitle(fig: Figure) -> None:
    """Remove the title of a figure; those that tell its panels apart stay."""
    fig.suptitle("")
    if len(fig.axes) == 1:
        for place in ("left", "center", "right"):
            fig.axes[0].set_title("", loc=place)


def refit(fig: Figure) -> None:
    """Make room in a narrow figure, unless `settle` did: titles wrapped, legends in fewer columns, a longer page."""
    if current().width is None or not isinstance(fig.get_layout_engine(), ConstrainedLayoutEngine):
        return
    fig.draw_without_rendering()
    line = current().size * 1.25 / 72.0
    added = 0.0
    suptitle = fig._suptitle  # type: ignore[attr-defined]
    if suptitle is not None and suptitle.get_text():
        added += line * _wrap(suptitle, fig.bbox.width - suptitle.get_window_extent().x0 - MARGIN * fig.dpi)
    rows: dict[float, float] = {}
    for ax in fig.axes:
        wrapped = line * _wrap_titles(ax, fig)
        top = round(ax.get_position().y1, 3)
        rows[top] = max(rows.get(top, 0.0), wrapped)
    added += sum(rows.values())
    for legend in list(fig.legends):
        added += _relegend(fig, legend)
    width, height = fig.get_size_inches()
    fig.set_size_inches(width, height + added)


def _wrap_titles(ax: Axes, fig: Figure) -> int:
    """Lines more in the titles of a panel."""
    box = ax.get_window_extent()
    more = 0
    for where, room in (("left", fig.bbox.width - box.x0 - MARGIN * fig.dpi), ("center", box.width)):
        title: Text = {"left": ax._left_title, "center": ax.title}[where]  # type: ignore[attr-defined]
        side = len({round(a.get_window_extent().x0) for a in fig.axes}) > 1
        more = max(more, _wrap(title, box.width if side else room))
    return more


def _wrap(text: Text, room: float) -> int:
    """Break a text between words so that no line is wider than `room` [pixels]; how many lines that is more."""
    before = text.get_text()
    if not before or text.get_window_extent().width <= room:
        return 0
    made: list[str] = []
    for paragraph in before.split("\n"):
        line = ""
        for word in paragraph.split(" "):
            longer = f"{line} {word}".strip()
            text.set_text(longer)
            if line and text.get_window_extent().width > room:
                made.append(line)
                line = word
            else:
                line = longer
        made.append(line)
    text.set_text("\n".join(made))
    return len(made) - before.count("\n") - 1


def _relegend(fig: Figure, legend: Legend) -> float:
    """A legend below everything, in as many columns as there is room for; how much longer [in] the page has to be."""
    handles = [h for h in legend.legend_handles if h is not None]
    labels = [t.get_text() for t in legend.get_texts()]
    before, title = legend.get_window_extent().height, legend.get_title().get_text() or None
    length = legend.handlelength
    legend.remove()
    for columns in (3, 2, 1):
        made = fig.legend(handles, labels, loc="outside lower center", ncols=columns, handlelength=length, title=title)
        fig.draw_without_rendering()
        if columns == 1 or made.get_window_extent().width <= fig.bbox.width - MARGIN * fig.dpi:
            break
        made.remove()
    return max(float(made.get_window_extent().height - before) / fig.dpi, 0.0)


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
    """Signs in every text as commands of LaTeX; `escape`: also what is special to LaTeX (pgf does so itself)."""
    signs = {c: command for c, command in _TEX.items() if not c.isascii() or escape}
    for text in fig.findobj(Text):
        assert isinstance(text, Text)
        given = text.get_text()
        if "$" not in given:  # else somebody wrote mathematics
            text.set_text("".join(signs.get(c, c) for c in given))

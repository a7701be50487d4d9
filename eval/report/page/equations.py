"""Equations with matrices and fractions: as LaTeX, and as a picture for where no LaTeX is.

Matplotlib's mathtext sets everything but matrices; these are laid out here, entry by entry.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties
from matplotlib.lines import Line2D
from matplotlib.mathtext import MathTextParser

from eval.figures.style import drawing

FONT = "cm"
"""Computer Modern, which comes with matplotlib."""
SIZE = 11.5
"""pt, of the letters; in the report about that of the text around."""
AXIS = 0.25 * SIZE
"""pt above the baseline: where fractions and matrices have their middle."""
BETWEEN_LINES, BETWEEN_ROWS, BETWEEN_COLUMNS, BRACKET, MARGIN = 11.0, 5.0, 15.0, 3.5, 3.0
"""pt."""
STRUT = (0.7 * SIZE, 0.22 * SIZE)
"""pt, least height and depth of a row, so that rows of a matrix keep their distance."""


@dataclass(frozen=True)
class Matrix:
    """A matrix of LaTeX entries, times a scalar."""

    rows: tuple[tuple[str, ...], ...]
    factor: str = ""


@dataclass(frozen=True)
class Equation:
    """left = right; what stands to the right is written side by side. Without left: the line before continued."""

    left: str
    right: tuple[str | Matrix, ...]


@dataclass(frozen=True)
class Where:
    """Abbreviations, each by those before it: (symbol, meaning), after an introducing word."""

    terms: tuple[tuple[str, str], ...]
    word: str = "where"


def _where(line: Where) -> str:
    return rf"\mathrm{{{line.word}}}\quad " + r",\quad ".join(f"{symbol} = {meaning}" for symbol, meaning in line.terms)


def _matrix_latex(matrix: Matrix) -> str:
    rows = r" \\ ".join(" & ".join(row) for row in matrix.rows)
    return f"{matrix.factor} \\begin{{bmatrix}} {rows} \\end{{bmatrix}}".lstrip()


def latex(lines: Sequence[Equation | Where]) -> str:
    """The equations, aligned, as what stands in math mode (needs amsmath)."""
    written = []
    for line in lines:
        if isinstance(line, Where):
            written.append("& " + _where(line))
        else:
            written.append(
                f"{line.left} &= ".lstrip() + "".join(i if isinstance(i, str) else _matrix_latex(i) for i in line.right)
            )
    return "\\begin{aligned}\n" + " \\\\[1ex]\n".join(written) + "\n\\end{aligned}"


@dataclass(frozen=True)
class _Box:
    """Something laid out: width, height above and depth below the baseline [pt], texts and strokes in it."""

    width: float
    height: float
    depth: float
    texts: tuple[tuple[float, float, str], ...] = ()
    strokes: tuple[tuple[tuple[float, float], ...], ...] = ()

    def moved(self, dx: float, dy: float) -> _Box:
        """The same, shifted by (dx, dy) pt."""
        texts = tuple((x + dx, y + dy, s) for x, y, s in self.texts)
        strokes = tuple(tuple((x + dx, y + dy) for x, y in stroke) for stroke in self.strokes)
        return _Box(self.width, self.height, self.depth, texts, strokes)


@lru_cache(maxsize=256)
def _text_box(text: str) -> _Box:
    """A formula without matrices; ValueError if mathtext does not know a command in it."""
    # LaTeX sets sin and cos apart from what they are multiplied with, mathtext does not
    text = re.sub(r"(?<=[\w)'}]) *(?=\\(?:sin|cos)\b)", r"\\,", text)
    finer = 20.0  # mathtext rounds up to whole points
    prop = FontProperties(size=SIZE, math_fontfamily=FONT)
    width, total, depth, _, _ = MathTextParser("path").parse(f"${text}$", dpi=72.0 * finer, prop=prop)
    return _Box(width / finer, (total - depth) / finer, depth / finer, ((0.0, 0.0, text),))


def _side_by_side(boxes: list[_Box]) -> _Box:
    placed, x = [], 0.0
    for box in boxes:
        placed.append(box.moved(x, 0.0))
        x += box.width
    height, depth = max(b.height for b in boxes), max(b.depth for b in boxes)
    return _Box(x, height, depth, sum((b.texts for b in placed), ()), sum((b.strokes for b in placed), ()))


def _matrix_box(matrix: Matrix) -> _Box:
    cells = [[_text_box(entry) for entry in row] for row in matrix.rows]
    widths = [max(row[j].width for row in cells) for j in range(len(cells[0]))]
    heights = [max([STRUT[0], *(c.height for c in row)]) for row in cells]
    depths = [max([STRUT[1], *(c.depth for c in row)]) for row in cells]
    half = 0.5 * (sum(heights) + sum(depths) + BETWEEN_ROWS * (len(cells) - 1)) + 1.0
    inner = sum(widths) + BETWEEN_COLUMNS * (len(widths) - 1)
    placed, top = [], AXIS + half - 1.0
    for row, height, depth in zip(cells, heights, depths, strict=True):
        x = 2.6 * BRACKET
        for cell, width in zip(row, widths, strict=True):
            placed.append(cell.moved(x + 0.5 * (width - cell.width), top - height))
            x += width + BETWEEN_COLUMNS
        top -= height + depth + BETWEEN_ROWS
    high, low, right = AXIS + half, AXIS - half, inner + 5.2 * BRACKET
    foot = 0.9 * BRACKET
    brackets = tuple(
        ((x + way * BRACKET, high), (x, high), (x, low), (x + way * BRACKET, low))
        for x, way in ((foot, 1.0), (right - foot, -1.0))
    )
    box = _Box(right, high, -low, sum((c.texts for c in placed), ()), brackets)
    return _side_by_side([_text_box(matrix.factor + r"\,"), box]) if matrix.factor else box


def formula_figure(lines: Sequence[Equation | Where]) -> Figure:
    """The equations as a picture just large enough, aligned at their first equals sign as in LaTeX."""
    with drawing():
        lefts = [_text_box(e.left) if isinstance(e, Equation) and e.left else None for e in lines]
        rights = [
            _text_box(_where(line))
            if isinstance(line, Where)
            else _side_by_side(
                [_text_box("="), *(_matrix_box(i) if isinstance(i, Matrix) else _text_box(i) for i in line.right)]
            )
            for line in lines
        ]
        tab = MARGIN + max(left.width for left in lefts if left is not None)
        placed, y = [], -MARGIN
        for left, right in zip(lefts, rights, strict=True):
            y -= right.height
            placed.append(right.moved(tab, y))
            if left is not None:
                placed.append(left.moved(tab - left.width, y))
            y -= right.depth + BETWEEN_LINES
        width, height = tab + max(r.width for r in rights) + MARGIN, -(y + BETWEEN_LINES) + MARGIN
        fig = Figure(figsize=(width / 72.0, height / 72.0))
        fig.set_layout_engine("none")
        for box in placed:
            for x, at, text in box.texts:
                fig.text(x / width, 1.0 + at / height, f"${text}$", fontsize=SIZE, va="baseline", math_fontfamily=FONT)
            for stroke in box.strokes:
                xs, ys = zip(*stroke, strict=True)
                line = Line2D([x / width for x in xs], [1.0 + at / height for at in ys], color="black", linewidth=0.8)
                fig.add_artist(line)
        return fig

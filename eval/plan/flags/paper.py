"""Flags of tables and figures for a paper: which columns, how wide, in which type. No number depends on them."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field

from data.errors import UsageError
from eval.replay.flag import flag, one_of, positive, switch, text, texts

INCH = {"in": 1.0, "cm": 1.0 / 2.54, "mm": 1.0 / 25.4, "pt": 1.0 / 72.27}
"""in. A unit of length; pt as TeX has it, 72.27 to the inch."""
SMALLEST, LARGEST = 1.5, 20.0
"""in. Widths of a figure between which axes, ticks and their labels have room."""
TYPE = (4.0, 24.0)
"""pt."""


def inches(length: str) -> float:
    """A length as `3.4in`, `8.6cm`, `86mm` or `252pt`."""
    found = re.fullmatch(r"\s*([0-9.]+)\s*(in|cm|mm|pt)\s*", length)
    try:
        return float(found[1]) * INCH[found[2]] if found else math.nan
    except ValueError:
        return math.nan


def width(label: str, value: object) -> str:
    """A length that a figure can be wide."""
    wide = inches(str(value))
    if not math.isfinite(wide):
        raise UsageError(f"{label} {value}: a length with its unit is needed, as in 3.4in, 8.6cm, 86mm or 252pt")
    if not SMALLEST <= wide <= LARGEST:
        raise UsageError(f"{label} {value}: between {SMALLEST:g}in and {LARGEST:g}in is needed")
    return str(value).replace(" ", "")


def points(label: str, value: object) -> float:
    """A size of type."""
    size = positive(label, value)
    if not TYPE[0] <= size <= TYPE[1]:
        raise UsageError(f"{label} {size:g}: between {TYPE[0]:g} and {TYPE[1]:g} points is needed")
    return size


def columns(label: str, value: object) -> tuple[str, ...]:
    """Names separated by commas or as a list, each once; whether there are such columns is asked later."""
    given = tuple(name.strip() for part in texts(label, value) for name in part.split(",") if name.strip())
    if len(set(given)) != len(given):
        raise UsageError(f"{label} {','.join(given)}: named twice")
    return given


@dataclass(frozen=True)
class Paper:
    """How tables and figures are made for a paper."""

    columns: tuple[str, ...] = field(
        default=(),
        metadata=flag(
            columns, "LIST", "columns of the LaTeX tables, in this order, by their names in metrics.csv, "
            "association.csv and consistency.csv (default: as many as there is room for)", numbers=False,
        ),
    )  # fmt: skip
    table_width: str = field(
        default="page",
        metadata=flag(
            one_of(("column", "page")), "WIDTH", "of the LaTeX tables: column (252 pt) or page (516 pt, default) of an "
            "IEEE paper", numbers=False,
        ),
    )  # fmt: skip
    figure_width: str | None = field(
        default=None,
        metadata=flag(width, "LENGTH", "of all figures, as in 3.4in, 8.6cm, 252pt (default: 7in)", numbers=False),
    )
    font: str | None = field(
        default=None, metadata=flag(text("a font's name"), "NAME", "of all figures, as in Times", numbers=False)
    )
    font_size: float = field(
        default=8.0, metadata=flag(points, "PT", "of titles and labels in figures; ticks have 1 pt less (default: 8)",
                                   numbers=False)
    )  # fmt: skip
    usetex: bool = field(
        default=False, metadata=flag(switch, "", "LaTeX sets the text in figures (latex, dvipng)", numbers=False)
    )
    pgf: bool = field(
        default=False,
        metadata=flag(
            switch, "", "figures as .pgf, too: the document's own fonts (pdflatex or xelatex)", numbers=False
        ),
    )

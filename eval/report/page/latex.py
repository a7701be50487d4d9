"""A table in LaTeX that fits its column or page without scaling: the columns that matter most, names to read."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import pandas as pd

from eval.figures.paper.tex import tex_escape
from eval.page.paper import names
from eval.page.paper.columns import known
from eval.page.paper.widths import GAP, WIDTHS, text_width
from eval.page.tables import column_text, is_blank, is_numeric

NAMES = ("log", "task", "scenario", "estimator", "association", "phase")
"""Columns that say what a row is about; they are never left out, only said once where they are all the same."""
READ: dict[str, Callable[[str], str]] = {
    "log": names.log,
    "task": lambda t: names.TASKS.get(t, t),
    "association": names.association,
}
ESTIMATORS = ("filter", "smoother", "deciding for")
"""Heads of other columns that name estimators."""
NARROWEST, NARROWEST_NAMES = 60.0, 100.0
"""pt. A column of text, or of names, is not broken into narrower lines."""
FIGURES = re.compile(r"[−-]?[\d.]+(?:e[+-]?\d+)?(?: ± [\d.]+|–[\d.]+)?")
"""Numbers, with a standard error or as an interval, that were made text."""
SLACK = 1.0
"""pt. The widths were within 0.5 pt of those that pdflatex found for 26 tables."""
SIZES = ("footnotesize", "scriptsize")


@dataclass(frozen=True)
class Cells:
    """One column: its key, rank (None: never left out), lines of its head, cells, and whether they are numbers.

    `width`: of a column of text that is broken into lines [pt]; None: it is as wide as it has to be. `full`: the head
    as the report has it.
    """

    key: str
    rank: float | None
    head: str
    body: tuple[str, ...]
    numeric: bool
    width: float | None = None
    full: str = ""

    @property
    def narrowest(self) -> float:
        """Pt."""
        return NARROWEST_NAMES if self.rank is None else NARROWEST

    def natural(self, size: str) -> float:
        """Width [pt] without breaking cells; the head is broken between any two words."""
        if self.width is not None:
            return self.width
        words = (text_width(w, size) for w in _words(self.head))
        return max(*words, *(text_width(t, size) for t in self.body), 0.0)

    def lines(self, size: str) -> list[str]:
        """The head broken into lines that make the column no wider."""
        room, made = self.natural(size), list[str]()
        for word in _words(self.head):
            if made and text_width(f"{made[-1]} {word}", size) <= room:
                made[-1] += f" {word}"
            else:
                made.append(word)
        return made


@dataclass(frozen=True)
class Sheet:
    """A table for a paper: its LaTeX, its width [pt], what was left out for want of room, what is in every row, and
    what shortened heads are in full.
    """

    tex: str
    width: float
    left_out: tuple[str, ...]
    common: tuple[str, ...]
    heads: tuple[tuple[str, str], ...]


def sheet(frame: pd.DataFrame, stem: str, caption: str, width: str = "page", columns: Sequence[str] = ()) -> Sheet:
    """The table as a float with a short caption and label `tab:<stem>`; `width`: `column` or `page`.

    `columns`: keys of those wanted, in this order, as far as the table has them; without any, as many as there is room
    for, the most wanted first.
    """
    cells, common = _named(frame)
    chosen = [c for key in columns for c in cells if c.key == key]
    if chosen:
        cells = [c for c in cells if c.rank is None] + chosen
    room, left_out, size = WIDTHS[width], list[str](), SIZES[0]
    while total(cells, size) > room - SLACK:
        narrowed = _narrowed(cells, size, room)
        spare = [c for c in cells if c.rank is not None]
        if narrowed is not None:
            cells = narrowed
        elif chosen and size != SIZES[-1]:
            size = SIZES[-1]
        elif chosen or len(spare) < 2:
            break
        else:
            last = max(spare, key=lambda c: c.rank or 0.0)
            cells = [c for c in cells if c is not last]
            left_out.append(last.head)
    said = caption + (f" ({', '.join(common)})" if common else "")
    tex = _render(cells, stem, said, size, wide=width == "page", total=total(cells, size), room=room)
    heads = tuple((c.head, c.full) for c in cells if c.full and c.full != c.head)
    return Sheet(tex, total(cells, size), tuple(reversed(left_out)), tuple(common), heads)


def total(cells: Sequence[Cells], size: str) -> float:
    """Width of the table [pt]."""
    return sum(c.natural(size) for c in cells) + GAP * (len(cells) - 1)


def _narrowed(cells: Sequence[Cells], size: str, room: float) -> list[Cells] | None:
    """The widest column of text broken into lines, as narrow as it must be; None where that does not help."""
    texts = [c for c in cells if not c.numeric and c.width is None and c.natural(size) > c.narrowest]
    if not texts:
        return None
    widest = max(texts, key=lambda c: c.natural(size))
    word = max(text_width(w, size) for t in (widest.head, *widest.body) for w in t.split() or [""])
    width = max(widest.natural(size) - (total(cells, size) - room + SLACK), widest.narrowest, word)
    if width >= widest.natural(size):
        return None
    return [replace(c, width=width) if c is widest else c for c in cells]


def _named(frame: pd.DataFrame) -> tuple[list[Cells], list[str]]:
    """The columns with names to read, those of a run as one; and what is the same in every row."""
    common: list[str] = []
    cells: list[Cells] = []
    for head in [h for h in NAMES if h in frame.columns and h not in ("estimator", "phase")]:
        values = ["" if is_blank(v) else str(v) for v in frame[head].tolist()]
        read: list[str] = [READ[head](v) if head in READ else v for v in values]
        if len(set(read)) == 1 and read[0] and len(frame) > 1:
            common.append(f"association {read[0]}" if head == "association" else read[0])
        elif head != "association" or "estimator" not in frame.columns:
            cells.append(Cells(head, None, head, tuple(read), numeric=False))
    if "estimator" in frame.columns:
        cells.append(Cells("estimator", None, "estimator", tuple(_rows(frame)), numeric=False))
    elif "phase" in frame.columns:
        cells.append(Cells("phase", None, "phase", tuple(map(str, frame["phase"].tolist())), numeric=False))
    for place, head in enumerate(str(c) for c in frame.columns):
        if head not in NAMES:
            values, what = frame.iloc[:, place].tolist(), known(head, place)
            body = column_text(values)
            if head in ESTIMATORS:
                body = [names.estimators(t) for t in body]
            numeric = is_numeric(values) or all(FIGURES.fullmatch(t) for t in body if t)
            cells.append(Cells(what.key, what.rank, what.short, tuple(body), numeric, full=head))
    return cells, common


def _rows(frame: pd.DataFrame) -> list[str]:
    """Estimator, with association and phase where rows differ in them."""
    who = [names.estimators(str(v)) for v in frame["estimator"].tolist()]
    how = (
        [names.association(str(v)) for v in frame["association"].tolist()]
        if "association" in frame
        else [""] * len(who)
    )
    when = [str(v) for v in frame["phase"].tolist()] if "phase" in frame else [""] * len(who)
    several = len({h for h in how if h}) > 1
    phases: dict[tuple[str, str], set[str]] = {}
    for w, h, p in zip(who, how, when, strict=True):
        phases.setdefault((w, h), set()).add(p)
    made = []
    for w, h, p in zip(who, how, when, strict=True):
        text = f"{w}, {h}" if several and h else w
        made.append(f"{text} ({p})" if len(phases[w, h]) > 1 and p else text)
    return made


def _words(head: str) -> list[str]:
    return re.findall(r"\[[^]]*\]|\d+ %|\S+", head) or [""]


def _head(c: Cells, size: str) -> str:
    # {} keeps LaTeX from taking a unit in brackets for the optional argument of a line break
    lines = r"\\{}".join(tex_escape(line) for line in c.lines(size))
    return rf"\shortstack[{'r' if c.numeric else 'l'}]{{{lines}}}"


def _render(
    cells: Sequence[Cells], stem: str, caption: str, size: str, *, wide: bool, total: float, room: float
) -> str:
    spec = "".join("r" if c.numeric else "l" if c.width is None else rf"p{{{c.width:.1f}pt}}" for c in cells)
    ragged = [r"\raggedright\arraybackslash " if c.width is not None else "" for c in cells]
    rows = [
        [f"{r}{tex_escape(t)}" for t, r in zip(row, ragged, strict=True)]
        for row in zip(*(c.body for c in cells), strict=True)
    ]
    # {} again: a row that begins with a bracket would be an option of the line break before it
    body = ["{}" * row[0].startswith("[") + " & ".join(row) for row in rows]
    environment = "table*" if wide else "table"
    packages = "booktabs,array" if any(ragged) else "booktabs"
    fits = "fits" if total <= room else "IS WIDER THAN"
    lines = [
        rf"% \usepackage{{{packages}}}",
        f"% about {total:.0f} pt wide, {fits} {room:.0f} pt, an IEEE {'page' if wide else 'column'}, with 10 pt type;"
        " see notes.tex",
        rf"\begin{{{environment}}}",
        r"  \centering",
        rf"  \caption{{{tex_escape(caption)}}}",
        rf"  \label{{tab:{stem}}}",
        rf"  \{size}",
        rf"  \setlength{{\tabcolsep}}{{{GAP / 2:g}pt}}",
        rf"  \begin{{tabular}}{{@{{}}{spec}@{{}}}}",
        r"    \toprule",
        rf"    {' & '.join(_head(c, size) for c in cells)} \\",
        r"    \midrule",
        *(rf"    {row} \\" for row in body),
        r"    \bottomrule",
        r"  \end{tabular}",
        rf"\end{{{environment}}}",
    ]
    return "\n".join(lines) + "\n"

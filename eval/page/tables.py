"""Tables a person reads: human column heads with units, rounding, and the same rows as CSV, Markdown and LaTeX.

CSV keeps every digit; Markdown and LaTeX round each column as a whole. Unknown is blank everywhere.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pandas as pd

FORMATS = ("csv", "md", "tex")
DIGITS = 3
"""Significant digits of a column's middle value."""
HEAD_WIDTH = 12
"""Characters of a LaTeX column head before it is broken into a second line."""

_TEX = {
    "\\": r"\textbackslash{}", "&": r"\&", "%": r"\%", "$": r"\$", "#": r"\#", "_": r"\_", "{": r"\{", "}": r"\}",
    "~": r"\textasciitilde{}", "^": r"\textasciicircum{}", "<": r"$<$", ">": r"$>$", "|": r"$|$",
    "σ": r"$\sigma$", "χ": r"$\chi$", "±": r"$\pm$", "×": r"$\times$", "²": r"$^2$", "°": r"$^\circ$", "≤": r"$\le$",
    "≥": r"$\ge$", "−": r"$-$", "–": "--", "—": "---", "\u00a0": "~", "…": r"\dots{}", "µ": r"$\mu$", "ν": r"$\nu$",
    "θ": r"$\theta$", "α": r"$\alpha$", "ᵀ": r"$^T$", "⁻": r"$^-$", "¹": r"$^1$",
}  # fmt: skip


def is_blank(value: object) -> bool:
    """Whether a cell holds nothing: None, NaN, infinite, or an empty text."""
    if value is None or value is pd.NA or value == "":
        return True
    return isinstance(value, float) and not math.isfinite(value)


def _is_number(value: object) -> bool:
    return pd.api.types.is_number(value) and not isinstance(value, bool)


def is_numeric(column: Sequence[Any]) -> bool:
    """Whether a column holds numbers only, blanks aside."""
    known = [v for v in column if not is_blank(v)]
    return bool(known) and all(_is_number(v) for v in known)


def _decimals(values: Sequence[float]) -> int:
    sizes = sorted(abs(v) for v in values if v != 0.0)
    if not sizes:
        return 0
    middle = sizes[(len(sizes) - 1) // 2]
    return int(min(max(DIGITS - 1 - math.floor(math.log10(middle)), 0), 6))


def column_text(column: Sequence[Any]) -> list[str]:
    """A column as text: integers whole, other numbers with one number of decimals that suits the middle value.

    A number far beyond its column (a million and more) is written with an exponent instead of many digits.
    """
    known = [v for v in column if not is_blank(v)]
    if not is_numeric(column):
        return ["" if is_blank(v) else _word(v) for v in column]
    if all(float(v).is_integer() for v in known):
        return ["" if is_blank(v) else str(int(v)) for v in column]
    places = _decimals([float(v) for v in known])
    return ["" if is_blank(v) else _number(float(v), places) for v in column]


def _word(value: object) -> str:
    return ("yes" if value else "no") if isinstance(value, bool) else str(value)


def _number(value: float, places: int) -> str:
    if value == 0.0:
        return "0"
    if abs(value) >= 1e6:
        return f"{value:.2e}"
    text = f"{value:.{places}f}"
    return text.replace("-", "−") if float(text) != 0.0 else text.lstrip("-")


def texts(frame: pd.DataFrame) -> list[list[str]]:
    """The body of a table as text, row by row."""
    columns = [column_text(frame[c].tolist()) for c in frame.columns]
    return [list(row) for row in zip(*columns, strict=True)]


def drop_blank_columns(frame: pd.DataFrame) -> pd.DataFrame:
    """The table without the columns that hold nothing."""
    return frame[[c for c in frame.columns if not all(is_blank(v) for v in frame[c].tolist())]]


def markdown_escape(text: str) -> str:
    """Text that Markdown shows as it is, also within a table; underscores inside a word mean nothing and stay."""
    plain = re.sub(r"[\\`*<|&~]|\[(?=[^]]*\]\()", r"\\\g<0>", text.replace("\n", " "))
    return re.sub(r"(?<![^\W_])_|_(?![^\W_])", r"\\_", plain)


def markdown(frame: pd.DataFrame) -> str:
    """The table in Markdown; numbers to the right."""
    rule = ["---:" if is_numeric(frame[c].tolist()) else "---" for c in frame.columns]
    rows = [
        [markdown_escape(str(c)) for c in frame.columns],
        rule,
        *([markdown_escape(t) for t in row] for row in texts(frame)),
    ]
    return "".join(f"| {' | '.join(row)} |\n" for row in rows)


def tex_escape(text: str) -> str:
    """Text as LaTeX prints it: special characters escaped, Greek and signs in math mode."""
    return "".join(_TEX.get(c, c) for c in text)


def _tex_head(name: str, align: str) -> str:
    lines: list[str] = []
    for word in re.findall(r"\[[^]]*\]|\S+", name):
        if lines and len(lines[-1]) + 1 + len(word) <= HEAD_WIDTH:
            lines[-1] += f" {word}"
        else:
            lines.append(word)
    # {} keeps LaTeX from taking a unit in brackets for the optional argument of a line break
    stacked = r"\\{}".join(tex_escape(line) for line in lines)
    return rf"\shortstack[{align}]{{{stacked}}}"


def latex(frame: pd.DataFrame, stem: str, caption: str) -> str:
    """The table in LaTeX with booktabs, as a float with caption and label `tab:<stem>`, never wider than the text."""
    align = ["r" if is_numeric(frame[c].tolist()) else "l" for c in frame.columns]
    head = " & ".join(_tex_head(str(c), a) for c, a in zip(frame.columns, align, strict=True))
    # {} again: a row that begins with a bracket would be an option of the line break before it
    body = ["{}" * row[0].startswith("[") + " & ".join(tex_escape(t) for t in row) for row in texts(frame)]
    lines = [
        r"% \usepackage{booktabs,graphicx}",
        r"\begin{table}",
        r"  \centering",
        rf"  \caption{{{tex_escape(caption)}}}",
        rf"  \label{{tab:{stem}}}",
        r"  \footnotesize",
        r"  \resizebox{\ifdim\width>\linewidth\linewidth\else\width\fi}{!}{%",
        rf"  \begin{{tabular}}{{@{{}}{''.join(align)}@{{}}}}",
        r"    \toprule",
        rf"    {head} \\",
        r"    \midrule",
        *(rf"    {row} \\" for row in body),
        r"    \bottomrule",
        r"  \end{tabular}}",
        r"\end{table}",
    ]
    return "\n".join(lines) + "\n"


def write_table(
    frame: pd.DataFrame, folder: Path, stem: str, caption: str, formats: Sequence[str] = FORMATS
) -> list[Path]:
    """Write `folder/stem.csv|.md|.tex`. The caption heads the Markdown and LaTeX tables.

    Raises ValueError for an unknown format.
    """
    unknown = sorted(set(formats) - set(FORMATS))
    if unknown:
        raise ValueError(f"table format {unknown[0]!r}; known: {', '.join(FORMATS)}")
    folder.mkdir(parents=True, exist_ok=True)
    plain = frame.astype(object).map(lambda v: "" if is_blank(v) else v)
    text = {
        "csv": lambda: plain.to_csv(index=False, lineterminator="\n"),
        "md": lambda: f"{caption}\n\n{markdown(frame)}",
        "tex": lambda: latex(frame, stem, caption),
    }
    written = []
    for suffix in formats:
        path = folder / f"{stem}.{suffix}"
        path.write_text(text[suffix](), encoding="utf-8", newline="\n")
        written.append(path)
    return written

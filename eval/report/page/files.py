"""Tables written as files: CSV with every digit, Markdown rounded, LaTeX for a paper."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import pandas as pd

from eval.plan.flags.table import Output
from eval.referee.result_files import is_blank
from eval.report.page import latex
from eval.report.page.blocks import FinePrint, Table
from eval.report.page.latex import add_note, sheet
from eval.report.page.tables import markdown

FORMATS = ("csv", "md", "tex")
TITLES = {
    "comparison": "Errors and consistency", "association": "Association outcomes",
    "differences": "Filters against smoothers", "consistency": "Consistency over simulated runs",
    "coverage": "Coverage of the last positions [%]", "relations": "Errors against reference relations",
    "graph-sizes": "Sizes of the pose graph", "revisions": "Revised decisions",
    "kinds": "Noise by kind of factor", "worst": "Worst factors",
    "published": "Ours beside published numbers", "trust": "Consistency without ground truth",
}  # fmt: skip
"""Of a LaTeX table, by a part of its name."""
LONGEST = 80  # characters of the first sentence of a caption that stands in a paper


class Paper(NamedTuple):
    """How LaTeX tables are made: `width` is `column` or `page`; `columns` are keys of those wanted, none: by room."""

    width: str = "page"
    columns: tuple[str, ...] = ()


def short_caption(stem: str, caption: str) -> str:
    """A caption of a few words: what kind of table, on which log and task (the first sentence, if it is short)."""
    title = next((t for part, t in TITLES.items() if part in stem.split("-") or stem.endswith(part)), "")
    if "-trust-" in stem:
        title = TITLES["trust"]
    first = caption.partition(". ")[0].partition(": ")[0].rstrip(".").replace("`", "")
    parts = [latex.place(p) for p in first.split(", ")]
    where = ", ".join(parts) if len(first) <= LONGEST else ""
    return ": ".join(t for t in (title, where) if t) or stem


def _without_place(caption: str) -> str:
    """A caption without the log and task it begins with, so that tables of several logs share a note."""
    first, _, rest = caption.partition(". ")
    return rest if rest and len(first) <= LONGEST and ": " not in first else caption


def write_table(
    frame: pd.DataFrame,
    folder: Path,
    stem: str,
    caption: str,
    formats: Sequence[str] = FORMATS,
    paper: Paper = Paper(),  # noqa: B008
    for_paper: pd.DataFrame | None = None,
    fine_print: str = "",
) -> list[Path]:
    """Write `folder/stem.csv|.md|.tex`; the caption of LaTeX stands in `notes.tex`. ValueError: an unknown format.

    `for_paper`: the same rows with more columns to choose from; `fine_print`: what else the note says.
    """
    unknown = sorted(set(formats) - set(FORMATS))
    if unknown:
        raise ValueError(f"table format {unknown[0]!r}; known: {', '.join(FORMATS)}")
    folder.mkdir(parents=True, exist_ok=True)
    plain = frame.astype(object).map(lambda v: "" if is_blank(v) else v)

    def tex() -> str:
        made = sheet(
            frame if for_paper is None else for_paper, stem, short_caption(stem, caption), paper.width, paper.columns
        )
        add_note(folder, stem, f"{_without_place(caption)} {fine_print}".strip(), made.left_out, made.heads)
        return made.tex

    text = {
        "csv": lambda: plain.to_csv(index=False, lineterminator="\n"),
        "md": lambda: f"{caption}\n\n{markdown(frame)}",
        "tex": tex,
    }
    written = []
    for suffix in formats:
        path = folder / f"{stem}.{suffix}"
        path.write_text(text[suffix](), encoding="utf-8", newline="\n")
        written.append(path)
    return written


def written_table(
    frame: pd.DataFrame,
    folder: Path,
    stem: str,
    caption: str,
    wanted: Output,
    *,
    for_paper: pd.DataFrame | None = None,
    fine: FinePrint | None = None,
    apart: tuple[int, ...] = (),
) -> Table:
    """Write a table as `folder/tables/stem.<format>`; the report links to its CSV if there is one.

    `for_paper`: the same rows with more columns to choose from; `fine`, `apart`: as of a `Table`.
    """
    paper = Paper(wanted.table_width, wanted.columns)
    text = "" if fine is None else fine.text
    write_table(
        frame, folder / "tables", stem, caption, [f for f in wanted.formats if f in FORMATS], paper, for_paper, text
    )
    return Table(frame, caption, stem if "csv" in wanted.formats else None, fine, apart)

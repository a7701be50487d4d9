"""A report as Markdown and as one HTML file that needs nothing else; the parts it is made of, and tables as files."""

from __future__ import annotations

from pathlib import Path
from typing import Protocol

import pandas as pd

from eval.report.page.blocks import (
    READING,
    Block,
    Film,
    FinePrint,
    Folded,
    Formula,
    Mark,
    Overview,
    OverviewRow,
    Picture,
    Report,
    Section,
    Sketch,
    Table,
    anchor,
    folded,
)
from eval.report.page.files import Paper, write_table
from eval.report.page.html import report_html
from eval.report.page.markdown import report_markdown

__all__ = [
    "READING", "Block", "Film", "FinePrint", "Folded", "Formula", "Mark", "Overview", "OverviewRow", "Picture",
    "Report", "Section", "Sketch", "Table", "Wanted", "anchor", "folded", "report_html", "report_markdown",
    "write_report", "written_table",
]  # fmt: skip


class Wanted(Protocol):
    """What is asked of tables: their formats, and what those for a paper are like (see `files.Paper`)."""

    @property
    def formats(self) -> tuple[str, ...]:
        """Of csv, md and tex."""

    @property
    def table_width(self) -> str:
        """Of LaTeX tables: `column` or `page`."""

    @property
    def columns(self) -> tuple[str, ...]:
        """Keys of the columns of LaTeX tables; none: as many as there is room for."""


def written_table(
    frame: pd.DataFrame,
    folder: Path,
    stem: str,
    caption: str,
    wanted: Wanted,
    *,
    for_paper: pd.DataFrame | None = None,
    fine: FinePrint | None = None,
    apart: tuple[int, ...] = (),
) -> Table:
    """Write a table as `folder/tables/stem.<format>`; the report links to its CSV if there is one.

    `for_paper`: the same rows with more columns to choose from; `fine`: what the caption leaves to the section on
    reading (and to the notes of the LaTeX tables); `apart`: places of the rows that the report shows beneath.
    """
    paper = Paper(wanted.table_width, wanted.columns)
    text = "" if fine is None else fine.text
    write_table(frame, folder / "tables", stem, caption, wanted.formats, paper, for_paper, text)
    return Table(frame, caption, stem if "csv" in wanted.formats else None, fine, apart)


def write_report(folder: Path, report: Report) -> None:
    """Write `report.md` and `report.html` into the result folder; its figures must be there already, as PNG."""
    (folder / "report.md").write_text(report_markdown(report), encoding="utf-8", newline="\n")
    (folder / "report.html").write_text(report_html(folder, report), encoding="utf-8", newline="\n")

"""All that a section writer needs of the page: blocks, tables as files, and the pages themselves."""

from __future__ import annotations

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
from eval.report.page.files import Drawn, Wanted, written_table
from eval.report.page.render import report_html, report_markdown, write_report

__all__ = [
    "READING", "Block", "Drawn", "Film", "FinePrint", "Folded", "Formula", "Mark", "Overview", "OverviewRow", "Picture",
    "Report", "Section", "Sketch", "Table", "Wanted", "anchor", "folded", "report_html", "report_markdown",
    "write_report", "written_table",
]  # fmt: skip

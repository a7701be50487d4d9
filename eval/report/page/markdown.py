"""The report as Markdown, figures by their place in `figures/`."""

from __future__ import annotations

import re
from collections.abc import Sequence

import pandas as pd

from eval.report.page.blocks import (
    READING,
    Block,
    Cell,
    Film,
    Folded,
    Formula,
    Mark,
    Numbers,
    Overview,
    Picture,
    Report,
    Section,
    Sketch,
    Table,
    film_markdown,
    with_fine_print,
)
from eval.report.page.tables import markdown, markdown_escape


def report_markdown(report: Report) -> str:
    """The whole report."""
    numbers = Numbers()
    parts = [f"# {report.title}", *_blocks(report.introduction, numbers)]
    for section in report.first:
        parts += _section(section, numbers)
    parts.append(f"Made by\n\n```sh\n{report.command}\n```")
    for section in with_fine_print(report):
        parts += _section(section, numbers)
    return "\n\n".join(parts) + "\n"


def slug(heading: str) -> str:
    """Address of a heading as the usual viewers of Markdown make it: punctuation left out, spaces as hyphens."""
    return re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-")


def _section(section: Section, numbers: Numbers) -> list[str]:
    return [f"{'#' * section.level} {section.heading}", *_blocks(section.blocks, numbers)]


def _blocks(blocks: Sequence[Block], numbers: Numbers) -> list[str]:
    return [part for block in blocks for part in _block(block, numbers)]


def _block(block: Block, numbers: Numbers) -> list[str]:
    if isinstance(block, Table):
        where = f" ([CSV](tables/{block.stem}.csv))" if block.stem else ""
        head = f"**Table {numbers.of(block)}.** {block.caption}{_link(block)}{where}"
        return [head, markdown(beneath(block)[0]).rstrip("\n")]
    if isinstance(block, Picture):
        alt = re.sub(r"[\[\]\\]", "", block.alt)
        below = f"**Figure {numbers.of(block)}.** {block.caption}{_link(block)}"
        return [f"![{alt}](figures/{block.stem}.png)", below]
    if isinstance(block, Formula):
        return [f"```math\n{block.latex}\n```"]
    if isinstance(block, Film):
        return [film_markdown(block)]
    if isinstance(block, Folded):
        inside = _blocks(block.blocks, numbers)
        return [f"<details><summary>{markdown_escape(block.summary)}</summary>", *inside, "</details>"]
    if isinstance(block, Overview):
        return [_overview(block), block.caption]
    return [block]


def beneath(table: Table) -> tuple[pd.DataFrame, int]:
    """The table's rows with those that stand apart last, and how many stand before them."""
    apart = [i for i in table.apart if i < len(table.frame)]
    order = [i for i in range(len(table.frame)) if i not in apart]
    return table.frame.iloc[[*order, *apart]], len(order)


def _link(block: Table | Picture) -> str:
    return "" if block.fine is None else f" [{READING}](#{slug(READING)})."


def _overview(overview: Overview) -> str:
    heads = [markdown_escape(h) for h in overview.heads]
    lines = [f"| {' | '.join(heads)} |", f"| {' | '.join('---' for _ in heads)} |"]
    for row in overview.rows:
        links = "".join(f" [{markdown_escape(text)}]({place})" for text, place in row.links)
        name = f"[{markdown_escape(row.name)}](#{slug(row.section)}){links}"
        lines.append(f"| {' | '.join([name, *(_cell(c) for c in row.cells)])} |")
    return "\n".join(lines)


def _cell(cell: Cell) -> str:
    if cell is None:
        return ""
    if isinstance(cell, Mark):
        note = f" ({markdown_escape(cell.note)})" if cell.note else ""
        return f"{cell.symbol} **{markdown_escape(cell.word)}**{note}"
    if isinstance(cell, Sketch):
        alt = re.sub(r"[\[\]\\|]", "", cell.alt)
        return f"![{alt}](figures/{cell.stem}.svg)" if cell.stem else ""
    return markdown_escape(cell)

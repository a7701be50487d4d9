"""The report as one HTML page that needs nothing else: images inside, no script, no network."""

from __future__ import annotations

import html
import re
from collections.abc import Sequence
from pathlib import Path

from markdown_it import MarkdownIt

from eval.page.blocks import (
    READING,
    Block,
    Cell,
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
    anchor,
    cut,
    every_block,
    with_fine_print,
)
from eval.page.film import POLICY as OF_FILMS
from eval.page.film import Film, film_html
from eval.page.plain import beneath
from eval.page.tables import markdown
from eval.page.web.images import images, with_alt
from eval.page.web.style import STYLE

POLICY = "default-src 'none'; img-src data:; style-src 'unsafe-inline'"
OVERVIEW, CONTENTS = "overview", "contents"
"""Addresses of the first table and of the list of sections."""


class Page:
    """Turns blocks into HTML, counting tables, figures and headings on the way."""

    def __init__(self, pictures: dict[str, str]) -> None:
        self.md = MarkdownIt("commonmark", {"html": False}).enable("table")
        self.pictures = pictures
        self.numbers = Numbers()
        self.used: dict[str, int] = {}
        self.links: list[str] = []

    def sections(self, sections: Sequence[Section]) -> str:
        """Sections of level 2 with all below them, each an element of its own."""
        parts: list[str] = []
        for section in sections:
            if section.level == 2:
                parts += ["</section>"] if parts else []
                parts.append("<section>")
            name, heading = self._address(section.heading), self.md.renderInline(section.heading)
            parts.append(f'<h{section.level} id="{name}">{heading}</h{section.level}>')
            if section.level == 2:
                self.links.append(f'<li><a href="#{name}">{heading}</a></li>')
            parts.append(self.blocks(section.blocks))
        opened, closed = parts.count("<section>"), parts.count("</section>")
        return "\n".join([*parts, *["</section>"] * (opened - closed)])

    def _address(self, heading: str) -> str:
        name = anchor(heading)
        self.used[name] = self.used.get(name, 0) + 1
        return name if self.used[name] == 1 else f"{name}-{self.used[name]}"

    def blocks(self, blocks: Sequence[Block]) -> str:
        """Blocks in order."""
        return "\n".join(self._block(block) for block in blocks)

    def _block(self, block: Block) -> str:
        if isinstance(block, Table):
            return self._table(block)
        if isinstance(block, Picture):
            image = with_alt(self.pictures[block.stem], block.alt)
            return f"<figure>{image}\n{self._caption('Figure', block)}</figure>"
        if isinstance(block, Formula):
            return f'<div class="formula">{with_alt(self.pictures[block.stem], block.latex)}</div>'
        if isinstance(block, Film):
            return film_html(block, self.md)
        if isinstance(block, Folded):
            inside = self.blocks(block.blocks)
            return f"<details><summary>{self.md.renderInline(block.summary)}</summary>\n{inside}\n</details>"
        if isinstance(block, Overview):
            return self._overview(block)
        return str(self.md.render(block)).rstrip("\n")

    def _caption(self, kind: str, block: Table | Picture) -> str:
        """The caption: what is longer than two lines is folded; the fine print is linked."""
        front, rest = cut(block.caption)
        text = f"<b>{kind} {self.numbers.of(block)}.</b> {self.md.renderInline(front)}"
        if block.fine is not None:
            text += f' <a href="#{anchor(READING)}">{READING}</a>.'
        if rest:
            text += f"<details><summary>More</summary>{self.md.renderInline(rest)}</details>"
        return f"<figcaption>{text}</figcaption>"

    def _table(self, table: Table) -> str:
        caption = self._caption("Table", table)
        frame, before = beneath(table)
        body = str(self.md.render(markdown(frame)))
        if before < len(table.frame):
            rows = body.split("<tr>\n")  # text before the head, head, rows
            rows[before + 2] = f'{_apart(len(table.frame.columns))}<tr class="apart">\n{rows[before + 2]}'
            body = "<tr>\n".join(rows).replace('<tr>\n<tr class="between">', '<tr class="between">')
        name = html.escape(cut(table.caption, 60)[0][:80])
        return f'<figure class="table">{caption}\n{_scrolled(body, name)}</figure>'

    def _overview(self, overview: Overview) -> str:
        heads = "".join(f'<th scope="col">{html.escape(h)}</th>' for h in overview.heads)
        rows = []
        for row in overview.rows:
            links = "".join(f' <a class="more" href="{html.escape(to)}">{html.escape(t)}</a>' for t, to in row.links)
            name = f'<a href="#{anchor(row.section)}">{_breakable(row.name)}</a>{links}'
            cells = "".join(f"<td>{_cell(c)}</td>" for c in row.cells)
            rows.append(f'<tr><th scope="row">{name}</th>{cells}</tr>')
        table = f"<table>\n<thead><tr>{heads}</tr></thead>\n<tbody>\n" + "\n".join(rows) + "\n</tbody>\n</table>"
        caption = f"<figcaption>{self.md.renderInline(overview.caption)}</figcaption>"
        return f'<figure class="overview" id="{OVERVIEW}">{_scrolled(table, "Overview")}\n{caption}</figure>'


def _breakable(name: str) -> str:
    """A name that may be broken where its parts meet, and nowhere else."""
    return re.sub(r"([:+/_])(?=\w)", r"\1<wbr>", html.escape(name))


def _scrolled(table: str, name: str) -> str:
    """A table in a box of its own that scrolls, also by keyboard."""
    return f'<div class="scroll" role="region" aria-label="{name}" tabindex="0">{table}</div>'


def _apart(columns: int) -> str:
    words = "Diverged, incomplete or implausible: in no average and no comparison"
    return f'<tr class="between"><td colspan="{columns}">{words}</td></tr>\n'


def _cell(cell: Cell) -> str:
    if cell is None:
        return ""
    if isinstance(cell, Mark):
        note = f"<small>{html.escape(cell.note)}</small>" if cell.note else ""
        word = f'<span class="mark {cell.tone}"><span aria-hidden="true">{cell.symbol}</span> {html.escape(cell.word)}'
        return f"{word}</span>{note}"
    if isinstance(cell, Sketch):
        return f'<span class="sketch" role="img" aria-label="{html.escape(cell.alt)}">{cell.svg}</span>'
    first, _, note = cell.partition("\n")
    return html.escape(first) + (f"<small>{html.escape(note)}</small>" if note else "")


def report_html(folder: Path, report: Report) -> str:
    """The report as one HTML page; figures are read from `folder/figures` (FileNotFoundError names a missing one)."""
    sections = with_fine_print(report)
    blocks = [*report.introduction, *(b for s in (*report.first, *sections) for b in s.blocks)]
    page = Page(images(folder, [b.stem for b in every_block(blocks) if isinstance(b, Picture | Formula)]))
    overview = any(isinstance(b, Overview) for b in report.introduction)
    title = html.escape(report.title)
    place = next((i for i, b in enumerate(report.introduction) if isinstance(b, Overview)), len(report.introduction))
    before, after = page.blocks(report.introduction[:place]), page.blocks(report.introduction[place:])
    first, rest = page.sections(report.first), page.sections(sections)
    listed = len(page.links) > 2
    top = [f'<a href="#{CONTENTS}">Contents</a>'] if listed else []
    top += [f'<a href="#{anchor(READING)}">{READING}</a>'] if anchor(READING) in page.used else []
    films = OF_FILMS if any(isinstance(b, Film) for b in every_block(blocks)) else ""
    parts = [
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">',
        '<meta name="viewport" content="width=device-width, initial-scale=1">',
        f'<meta http-equiv="Content-Security-Policy" content="{POLICY}{films}">',
        f"<title>{title}</title>\n<style>{STYLE}</style>\n</head>\n<body>",
        f'<a class="skip" href="#{OVERVIEW}">Skip to the overview</a>' if overview else "",
        f"<h1>{title}</h1>",
        before,
        f'<p class="top">{" · ".join(top)}</p>' if top else "",
        after,
        f'<div class="first">{first}</div>' if first else "",
        "\n".join([f'<nav id="{CONTENTS}" aria-label="Contents"><ul>', *page.links, "</ul></nav>"]) if listed else "",
        f'<p class="made">Made by</p>\n<pre tabindex="0"><code>{html.escape(report.command)}</code></pre>',
        rest,
        "</body>\n</html>",
    ]
    return "\n".join(part for part in parts if part) + "\n"

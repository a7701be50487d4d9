"""The report as one HTML page that needs nothing else: images inside, no script, no network.

Figures inside the page: as WebP where that is smaller than the PNG file, with the size they are shown at.

How the page looks: light and dark, wide, narrow and printed; nothing from elsewhere.
"""

from __future__ import annotations

import base64
import html
import re
import struct
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import cv2
import numpy as np
from cv2.typing import MatLike
from markdown_it import MarkdownIt

from eval.report.page.blocks import POLICY as OF_FILMS
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
    anchor,
    cut,
    every_block,
    film_html,
    with_fine_print,
)
from eval.report.page.markdown import beneath
from eval.report.page.tables import markdown

QUALITY, LOSSLESS = 60, 101
"""Of WebP. At 60, lines drawn at two pixels for a page pixel look the same (compared) at half the lossless size."""
FLAT = 2.0
"""A figure whose PNG is less than so many times as large has few colours, and lossless may be smaller still: bars."""
THREADS = 2


def images(folder: Path, stems: Sequence[str]) -> dict[str, str]:
    """`<img` with size and source (no alternative text, not closed) for each of `folder/figures/<stem>.png`.

    Raises FileNotFoundError, which names a missing one.
    """
    wanted = list(dict.fromkeys(stems))
    with ThreadPoolExecutor(THREADS) as threads:
        made = threads.map(_image, [folder / "figures" / f"{stem}.png" for stem in wanted])
        return dict(zip(wanted, made, strict=True))


def _image(path: Path) -> str:
    data = path.read_bytes()
    width, height = _png_size(data)
    kind, shown = "png", data
    pixels = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    if pixels is not None:
        found = [_webp(pixels, QUALITY)]
        if len(data) < FLAT * len(found[0]):
            found.append(_webp(pixels, LOSSLESS))
        smallest = min(found, key=len)
        if len(smallest) < len(data):
            kind, shown = "webp", smallest
    # two image pixels for a page pixel: sharp on fine screens
    size = f'width="{width // 2}" height="{height // 2}"'
    return f'<img {size} src="data:image/{kind};base64,{base64.b64encode(shown).decode()}"'


def _webp(pixels: MatLike, quality: int) -> bytes:
    return cv2.imencode(".webp", pixels, [cv2.IMWRITE_WEBP_QUALITY, quality])[1].tobytes()


def with_alt(image: str, alt: str) -> str:
    """The whole element."""
    return f'{image} alt="{html.escape(alt)}">'


def _png_size(data: bytes) -> tuple[int, int]:
    """Width and height in pixels, from the header (PNG specification, section 11.2.1)."""
    width, height = struct.unpack(">II", data[16:24])
    return int(width), int(height)


STYLE = """
:root { color-scheme: light dark; --ink: #1b1b1b; --paper: #ffffff; --faint: #5c5c5c; --rule: #d0d0d0;
  --shade: #f4f4f4; --link: #0b57a0; --good: #0a6640; --fair: #8a5300; --bad: #b3261e; }
@media (prefers-color-scheme: dark) {
  :root { --ink: #e4e4e4; --paper: #16181b; --faint: #a8a8a8; --rule: #3c4046; --shade: #20242a; --link: #8ab8f0;
    --good: #6fd3a2; --fair: #f0b45c; --bad: #ff9b93; }
}
* { box-sizing: border-box; }
html { scroll-padding-top: 1rem; }
body { margin: 0 auto; padding: 1.25rem 1.25rem 4rem; max-width: 72rem; color: var(--ink); background: var(--paper);
  font: 1rem/1.55 system-ui, "Segoe UI", Roboto, "Helvetica Neue", Arial, sans-serif; }
h1 { font-size: 1.7rem; line-height: 1.2; margin: 0.25rem 0 0.75rem; }
h2 { font-size: 1.35rem; margin: 2.5rem 0 0.75rem; padding-top: 0.75rem; border-top: 1px solid var(--rule); }
h3 { font-size: 1.1rem; margin: 1.75rem 0 0.5rem; }
h4 { font-size: 1rem; margin: 1.25rem 0 0.5rem; }
p, ul, ol { max-width: 60rem; }
a { color: var(--link); }
a:focus-visible, summary:focus-visible, .scroll:focus-visible, pre:focus-visible, video:focus-visible {
  outline: 3px solid var(--link); outline-offset: 2px; }
.skip { position: absolute; left: -99rem; }
.skip:focus { left: 1rem; top: 0.5rem; padding: 0.4rem 0.8rem; background: var(--paper); z-index: 9; }
.top, .made { margin: 0.5rem 0; font-size: 0.9rem; }
nav { margin: 1.25rem 0; padding: 0.6rem 1rem; background: var(--shade); border-radius: 4px; font-size: 0.92rem; }
nav ul { margin: 0; padding: 0; list-style: none; columns: 3 16rem; max-width: none; }
code, pre { font-family: ui-monospace, "DejaVu Sans Mono", Consolas, monospace; font-size: 0.88em; }
code { background: var(--shade); padding: 0.1em 0.3em; border-radius: 3px; overflow-wrap: anywhere; }
pre { background: var(--shade); padding: 0.7rem 0.9rem; border-radius: 4px; overflow-x: auto; }
pre code { background: none; padding: 0; }
details { margin: 0.5rem 0; }
summary { cursor: pointer; color: var(--link); width: fit-content; }
details[open] > summary { margin-bottom: 0.4rem; }
figure { margin: 1.25rem 0; }
figcaption { color: var(--faint); font-size: 0.88rem; line-height: 1.45; margin: 0.4rem 0; }
figcaption b { color: var(--ink); }
figcaption details { margin: 0; }
img, video { max-width: 100%; height: auto; background: #ffffff; border-radius: 4px; }
.formula { margin: 1.25rem 0; }
.scroll { overflow-x: auto; max-width: 100%; width: fit-content; }
table { border-collapse: separate; border-spacing: 0; font-size: 0.86rem; line-height: 1.3;
  font-variant-numeric: tabular-nums; border-top: 2px solid var(--ink); border-bottom: 2px solid var(--ink); }
th, td { padding: 0.3rem 0.6rem; text-align: left; vertical-align: bottom; background: var(--paper); }
td { white-space: nowrap; }
thead th { font-weight: 600; border-bottom: 1px solid var(--ink); min-width: 4.2rem; }
tbody tr:nth-child(even) > * { background: var(--shade); }
tr > :first-child { position: sticky; left: 0; z-index: 1; white-space: normal; min-width: min(8.5rem, 27vw);
  max-width: 38vw; }
.between td { color: var(--bad); white-space: normal; border-top: 1px solid var(--ink); position: static; }
.apart td, .apart ~ tr td { color: var(--faint); }
.overview table { font-size: 0.92rem; }
.overview td, .overview tbody th { vertical-align: middle; border-top: 1px solid var(--rule);
  padding: 0.35rem 0.55rem; }
.overview thead th { vertical-align: bottom; min-width: 0; padding: 0.3rem 0.55rem; }
.overview tbody th { font-weight: 600; max-width: 12rem; overflow-wrap: break-word; }
.overview .more { display: block; font-weight: 400; font-size: 0.85rem; }
.overview small { display: block; color: var(--faint); font-size: 0.8rem; white-space: normal; max-width: 11rem;
  line-height: 1.25; }
.mark { font-weight: 700; white-space: nowrap; }
.good { color: var(--good); } .fair { color: var(--fair); } .bad { color: var(--bad); } .none { color: var(--faint); }
.overview td:last-child { min-width: 6.5rem; }
.sketch svg { display: block; background: #ffffff; border-radius: 3px; }
@media (max-width: 75rem) {
  table { font-size: 0.78rem; }
  th, td { padding: 0.3rem 0.4rem; }
  thead th { min-width: 3.4rem; }
  .overview table { font-size: 0.85rem; }
  .overview td, .overview tbody th, .overview thead th { padding: 0.35rem 0.35rem; }
  .overview small { max-width: 9.6rem; }
}
@media (max-width: 40rem) {
  body { padding: 0.75rem 0.75rem 3rem; }
  h1 { font-size: 1.35rem; }
  .overview tbody th, .overview thead th:first-child { max-width: 7rem; min-width: 6.5rem; font-size: 0.85rem;
    padding: 0.35rem; }
  .overview small { max-width: 9rem; }
}
@page { size: A4; margin: 14mm 12mm; }
@media print {
  :root { color-scheme: light; --ink: #000; --paper: #fff; --faint: #333; --rule: #bbb; --shade: #f4f4f4;
    --link: #000; --good: #0a6640; --fair: #8a5300; --bad: #b3261e; }
  body { max-width: none; padding: 0; font-size: 10pt; }
  nav, .skip, .top { display: none; }
  section { break-before: page; }
  .first > section:only-child { break-before: auto; }
  h2 { margin-top: 0; border: 0; padding: 0; }
  h2, h3, h4, figcaption { break-after: avoid; }
  figure:not(.table), tr, .formula { break-inside: avoid; }
  img { max-height: 21cm; object-fit: contain; }
  details::details-content { content-visibility: visible; display: block; height: auto; }
  summary, video { display: none; }
  .scroll { overflow: visible; width: auto; }
  tr > :first-child { position: static; min-width: 0; }
  table { font-size: 6.5pt; }
  .overview table { font-size: 8pt; }
  .overview small, .overview .more { font-size: 6.5pt; }
  th, td, .overview td, .overview tbody th { padding: 0.12rem 0.22rem; min-width: 0; }
  thead th { min-width: 0; }
  td { white-space: normal; overflow-wrap: break-word; }
}
"""


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

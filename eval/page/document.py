"""A report as Markdown and as one HTML file that needs nothing else: images inside, no script, no network."""

from __future__ import annotations

import base64
import html
import re
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import pandas as pd
from markdown_it import MarkdownIt

from eval.page.film import POLICY, Film, film_html, film_markdown
from eval.page.tables import markdown
from eval.page.written import Paper, write_table

STYLE = """
:root { color-scheme: light dark; --ink: #1b1b1b; --paper: #ffffff; --faint: #5c5c5c; --rule: #d0d0d0;
  --shade: #f4f4f4; --link: #0b57a0; }
@media (prefers-color-scheme: dark) {
  :root { --ink: #e4e4e4; --paper: #16181b; --faint: #a8a8a8; --rule: #3c4046; --shade: #20242a; --link: #8ab8f0; }
}
* { box-sizing: border-box; }
body { margin: 0 auto; padding: 1.5rem 1.25rem 4rem; max-width: 58rem; color: var(--ink); background: var(--paper);
  font: 1rem/1.55 system-ui, "Segoe UI", Roboto, "Helvetica Neue", Arial, sans-serif; }
h1 { font-size: 1.8rem; line-height: 1.2; margin: 0.5rem 0 1rem; }
h2 { font-size: 1.35rem; margin: 2.5rem 0 0.75rem; padding-top: 0.75rem; border-top: 1px solid var(--rule); }
h3 { font-size: 1.1rem; margin: 1.75rem 0 0.5rem; }
h4 { font-size: 1rem; margin: 1.25rem 0 0.5rem; }
p, ul, ol { max-width: 44rem; }
a { color: var(--link); }
nav { margin: 1.25rem 0; padding: 0.6rem 1rem; background: var(--shade); border-radius: 4px; font-size: 0.92rem; }
nav ul { margin: 0; padding: 0; list-style: none; columns: 2 16rem; }
code, pre { font-family: ui-monospace, "DejaVu Sans Mono", Consolas, monospace; font-size: 0.88em; }
code { background: var(--shade); padding: 0.1em 0.3em; border-radius: 3px; overflow-wrap: anywhere; }
pre { background: var(--shade); padding: 0.7rem 0.9rem; border-radius: 4px; overflow-x: auto; }
pre code { background: none; padding: 0; }
figure { margin: 1.5rem 0; }
figcaption { color: var(--faint); font-size: 0.88rem; line-height: 1.45; max-width: 50rem; margin: 0.4rem 0; }
figcaption b { color: var(--ink); }
img { max-width: 100%; height: auto; background: #ffffff; border-radius: 4px; }
video { max-width: 100%; height: auto; background: #ffffff; border-radius: 4px; }
.formula { margin: 1.25rem 0; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; font-size: 0.86rem; line-height: 1.3; font-variant-numeric: tabular-nums;
  border-top: 2px solid var(--ink); border-bottom: 2px solid var(--ink); }
th, td { padding: 0.3rem 0.6rem; text-align: left; vertical-align: bottom; }
td { white-space: nowrap; }
th { font-weight: 600; border-bottom: 1px solid var(--ink); min-width: 4.2rem; }
tbody tr:nth-child(even) { background: var(--shade); }
@media print {
  :root { color-scheme: light; --ink: #000; --paper: #fff; --faint: #333; --rule: #bbb; --shade: #f4f4f4;
    --link: #000; }
  body { max-width: none; padding: 0; font-size: 10pt; }
  nav { display: none; }
  h2, h3, h4 { break-after: avoid; }
  figure, tr { break-inside: avoid; }
  video { display: none; }
  .scroll { overflow: visible; }
  table { font-size: 7pt; }
  th, td { padding: 0.15rem 0.3rem; }
  td { white-space: normal; }
}
"""


@dataclass(frozen=True)
class Table:
    """A table with its caption (Markdown); `stem` names it in `tables/` if it was written there."""

    frame: pd.DataFrame
    caption: str
    stem: str | None = None


@dataclass(frozen=True)
class Picture:
    """A figure saved as `figures/<stem>.png`, its caption (Markdown), and what it shows for those who cannot see it."""

    stem: str
    caption: str
    alt: str


@dataclass(frozen=True)
class Formula:
    """Equations: LaTeX as in math mode, and `figures/<stem>.png` that shows the same where no LaTeX is."""

    stem: str
    latex: str


class Wanted(Protocol):
    """What is asked of tables: their formats, and what those for a paper are like (see `eval.page.written.Paper`)."""

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
    fine_print: str = "",
) -> Table:
    """Write a table as `folder/tables/stem.<format>`; the report links to its CSV if there is one.

    `for_paper`: the same rows with more columns to choose from; `fine_print`: what the caption leaves to the text.
    """
    paper = Paper(wanted.table_width, wanted.columns)
    write_table(frame, folder / "tables", stem, caption, wanted.formats, paper, for_paper, fine_print)
    return Table(frame, caption, stem if "csv" in wanted.formats else None)


Block = str | Table | Picture | Formula | Film
"""A paragraph or list in Markdown, a table, a figure, equations, or a film."""


@dataclass(frozen=True)
class Section:
    """A heading of level 2 to 4 and what stands below it, in order."""

    heading: str
    blocks: tuple[Block, ...]
    level: int = 2


@dataclass(frozen=True)
class Report:
    """A whole report: title, the command that makes it again, first page, sections."""

    title: str
    command: str
    introduction: tuple[Block, ...]
    sections: tuple[Section, ...]


@dataclass(frozen=True)
class _Numbered:
    """A block with its number among the tables or figures (0 for text)."""

    block: Block
    number: int


def _numbered(report: Report) -> Iterator[Section | _Numbered]:
    """Headings and blocks in reading order, tables and figures counted from 1."""
    tables = figures = 0

    def count(block: Block) -> _Numbered:
        nonlocal tables, figures
        if isinstance(block, Table):
            tables += 1
            return _Numbered(block, tables)
        if isinstance(block, Picture):
            figures += 1
            return _Numbered(block, figures)
        return _Numbered(block, 0)

    yield from map(count, report.introduction)
    for section in report.sections:
        yield section
        yield from map(count, section.blocks)


def report_markdown(report: Report) -> str:
    """The report as Markdown, figures by their place in `figures/`."""
    made_by = f"Made by\n\n```sh\n{report.command}\n```"
    parts, first = [f"# {report.title}"], len(report.introduction)
    for i, item in enumerate(_numbered(report)):
        if i == first:
            parts.append(made_by)
        if isinstance(item, Section):
            parts.append(f"{'#' * item.level} {item.heading}")
        elif isinstance(item.block, Table):
            where = f" ([CSV](tables/{item.block.stem}.csv))" if item.block.stem else ""
            parts.append(f"**Table {item.number}.** {item.block.caption}{where}")
            parts.append(markdown(item.block.frame).rstrip("\n"))
        elif isinstance(item.block, Picture):
            alt = re.sub(r"[\[\]\\]", "", item.block.alt)
            parts.append(f"![{alt}](figures/{item.block.stem}.png)")
            parts.append(f"**Figure {item.number}.** {item.block.caption}")
        elif isinstance(item.block, Film):
            parts.append(film_markdown(item.block))
        elif isinstance(item.block, Formula):
            parts.append(f"```math\n{item.block.latex}\n```")
        else:
            parts.append(item.block)
    if not report.sections:
        parts.append(made_by)
    return "\n\n".join(parts) + "\n"


def _renderer() -> MarkdownIt:
    return MarkdownIt("commonmark", {"html": False}).enable("table")


def anchor(heading: str) -> str:
    """Address of a heading within the page."""
    return re.sub(r"[^a-z0-9]+", "-", heading.lower()).strip("-") or "section"


def _png_size(data: bytes) -> tuple[int, int]:
    """Width and height in pixels, from the header (PNG specification, section 11.2.1)."""
    width, height = struct.unpack(">II", data[16:24])
    return int(width), int(height)


def _image_html(folder: Path, stem: str, alt: str) -> str:
    data = (folder / "figures" / f"{stem}.png").read_bytes()
    width, height = _png_size(data)
    # two image pixels for a page pixel: sharp on fine screens
    size = f'width="{width // 2}" height="{height // 2}"'
    source = f"data:image/png;base64,{base64.b64encode(data).decode()}"
    return f'<img {size} alt="{html.escape(alt)}" src="{source}">'


def _picture_html(picture: Picture, number: int, folder: Path, md: MarkdownIt) -> str:
    caption = f"<figcaption><b>Figure {number}.</b> {md.renderInline(picture.caption)}</figcaption>"
    return f"<figure>{_image_html(folder, picture.stem, picture.alt)}\n{caption}</figure>"


def _table_html(table: Table, number: int, md: MarkdownIt) -> str:
    caption = f"<figcaption><b>Table {number}.</b> {md.renderInline(table.caption)}</figcaption>"
    return f'<figure>{caption}\n<div class="scroll">{md.render(markdown(table.frame))}</div></figure>'


def report_html(folder: Path, report: Report) -> str:
    """The report as one HTML page; figures are read from `folder/figures` (FileNotFoundError names a missing one)."""
    md = _renderer()
    title = html.escape(report.title)
    used: dict[str, int] = {}
    body, links = [], []
    for item in _numbered(report):
        if isinstance(item, Section):
            name = anchor(item.heading)
            used[name] = used.get(name, 0) + 1
            if used[name] > 1:
                name += f"-{used[name]}"
            heading = md.renderInline(item.heading)
            body.append(f'<h{item.level} id="{name}">{heading}</h{item.level}>')
            if item.level == 2:
                links.append(f'<li><a href="#{name}">{heading}</a></li>')
        elif isinstance(item.block, Table):
            body.append(_table_html(item.block, item.number, md))
        elif isinstance(item.block, Picture):
            body.append(_picture_html(item.block, item.number, folder, md))
        elif isinstance(item.block, Film):
            body.append(film_html(item.block, md))
        elif isinstance(item.block, Formula):
            body.append(f'<div class="formula">{_image_html(folder, item.block.stem, item.block.latex)}</div>')
        else:
            body.append(md.render(item.block).rstrip("\n"))
    first = next((i for i, part in enumerate(body) if part.startswith("<h2")), len(body))
    navigation = "\n".join(["<nav><ul>", *links, "</ul></nav>"]) if len(links) > 2 else ""
    policy = "default-src 'none'; img-src data:; style-src 'unsafe-inline'"
    policy += POLICY if any('class="film"' in part for part in body) else ""
    page = [
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">',
        '<meta name="viewport" content="width=device-width, initial-scale=1">',
        f'<meta http-equiv="Content-Security-Policy" content="{policy}">',
        f"<title>{title}</title>\n<style>{STYLE}</style>\n</head>\n<body>\n<h1>{title}</h1>",
        *body[:first],
        navigation,
        f"<p>Made by</p>\n<pre><code>{html.escape(report.command)}</code></pre>",
        *body[first:],
        "</body>\n</html>",
    ]
    return "\n".join(part for part in page if part) + "\n"


def write_report(folder: Path, report: Report) -> None:
    """Write `report.md` and `report.html` into the result folder; its figures must be there already, as PNG."""
    (folder / "report.md").write_text(report_markdown(report), encoding="utf-8", newline="\n")
    (folder / "report.html").write_text(report_html(folder, report), encoding="utf-8", newline="\n")

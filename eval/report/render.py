"""The report as Markdown and as one HTML page that needs nothing else: images inside, no script, no network."""

import base64
import io
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from pathlib import Path
from typing import NamedTuple

import PIL.Image
import PIL.WebPImagePlugin  # else Pillow loads all its formats
from jinja2 import Environment
from markdown_it import MarkdownIt
from markupsafe import Markup, escape

from eval.figures.figure_style import FOR_PHONE
from eval.report.page import blocks
from eval.report.page.files import is_numeric, markdown, markdown_escape, texts
from eval.report.words import environment, template_text

POLICY = "default-src 'none'; img-src data:; style-src 'unsafe-inline'"
OF_FILMS = "; media-src 'self' file:"
"""Added to the policy of a page that shows films, which stay files beside it: nothing else may be loaded."""
QUALITY, METHOD = 60, 2
"""Of WebP. Method 2 takes half the time of 4, the default, for 4 % more bytes. At quality 60, lines drawn at two pixels
for a page pixel look the same (compared) at half the lossless size."""
THREADS = 2
LISTED = 3  # a page of fewer sections has no list of contents

Headed = tuple[blocks.Section, str]  # a section and the address of its heading


def write_report(folder: Path, report: blocks.Report) -> None:
    """Write `report.md`, `report.html` and its pages in `details/`; the figures must be there already, as PNG."""
    about = {"reading": blocks.READING, "numbers": blocks.Numbers()}
    plain = _templates(html=False).get_template("page.md.j2")
    text = plain.render(report=report, sections=blocks.with_fine_print(report), **about)
    written, made = {"report.md": text.strip() + "\n"}, blocks.pages(report)
    details = {page.title.removesuffix(": details"): place for place, page in made.items() if "/" in place}
    for place, page in made.items():
        up = "../" * place.count("/")
        written[place] = report_html(folder, page, {} if up else details, up)
    for place, text in written.items():
        (folder / place).parent.mkdir(exist_ok=True)
        (folder / place).write_text(text, encoding="utf-8", newline="\n")


def report_html(folder: Path, report: blocks.Report, details: Mapping[str, str], up: str = "") -> str:
    """One HTML page, `up` from the result folder; `details`: pages by title. FileNotFoundError: no such figure."""
    sections = blocks.with_fine_print(report)
    every = list(blocks.every_block([*report.introduction, *(b for s in (*report.first, *sections) for b in s.blocks)]))
    used: Counter[str] = Counter()
    first, rest = _chapters(report.first, used), _chapters(sections, used)
    contents = [headed for chapter in (*first, *rest) for headed in chapter if headed[0].level == 2]
    text = _templates(html=True).get_template("page.html.j2").render(
        report=report, up=up, details=details, first=first, rest=rest, reading=blocks.READING, numbers=blocks.Numbers(),
        skip=any(isinstance(b, blocks.Overview) for b in report.introduction), style=template_text("page.css"),
        contents=contents if len(contents) >= LISTED else [],
        images=images(folder, [b.stem for b in every if isinstance(b, blocks.Picture)]),
        policy=POLICY + (OF_FILMS if any(isinstance(b, blocks.Film) for b in every) else ""),
    )  # fmt: skip
    return text.strip() + "\n"


@cache
def _templates(*, html: bool) -> Environment:
    """The templates with what pages need besides; for HTML with escaping."""
    made = environment().overlay(autoescape=html)
    md = MarkdownIt("commonmark", {"html": False}).enable("table")
    made.filters = made.filters | {
        "kind": lambda block: type(block).__name__,
        "markdown": lambda text: Markup(md.render(text).rstrip("\n")),
        "inline": lambda text: Markup(md.renderInline(text)),
        "plain": markdown_escape,
        "alternative": lambda text: re.sub(r"[\[\]\\|]", "", text),
        "anchor": blocks.anchor,
        "slug": slug,
        "cut": blocks.cut,
        # names may be broken where their parts meet, and nowhere else
        "breakable": lambda name: Markup(re.sub(r"([:+/_])(?=\w)", r"\1<wbr>", str(escape(name)))),
        # heads, each with whether its column is of numbers, and rows
        "laid_out": lambda t: (
            {"heads": [(str(c), is_numeric(t.frame[c].tolist())) for c in t.frame.columns], "rows": texts(t.frame)}
        ),
        "table_markdown": lambda table: markdown(table.frame).rstrip(),
    }
    return made


def slug(heading: str) -> str:
    """Address of a heading as the usual viewers of Markdown make it: punctuation left out, spaces as hyphens."""
    return re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-")


def _chapters(sections: Sequence[blocks.Section], used: Counter[str]) -> list[list[Headed]]:
    """Sections of level 2 with those below them; a heading that was `used` gets an address of its own."""
    chapters: list[list[Headed]] = []
    for section in sections:
        name = blocks.anchor(section.heading)
        used[name] += 1
        headed = (section, name if used[name] == 1 else f"{name}-{used[name]}")
        if section.level == 2 or not chapters:
            chapters.append([headed])
        else:
            chapters[-1].append(headed)
    return chapters


class Image(NamedTuple):
    """A figure inside the page: its size in pixels of the page, its bytes as a source, and the same for a phone."""

    width: int
    height: int
    source: Markup
    narrow: "Image | None" = None


def images(folder: Path, stems: Sequence[str]) -> dict[str, Image]:
    """Each of `folder/figures/<stem>.png` as WebP, at two image pixels for a page pixel. FileNotFoundError: no such."""

    def both(stem: str) -> Image:
        there = (folder / "figures" / f"{stem}{FOR_PHONE}.png").exists()
        return packed(stem)._replace(narrow=packed(stem + FOR_PHONE) if there else None)

    def packed(stem: str) -> Image:
        pixels, file = PIL.Image.open(folder / "figures" / f"{stem}.png"), io.BytesIO()
        pixels.convert("RGB").save(file, "webp", quality=QUALITY, method=METHOD)
        source = f"data:image/webp;base64,{base64.b64encode(file.getvalue()).decode()}"
        return Image(pixels.width // 2, pixels.height // 2, Markup(source))

    wanted = list(dict.fromkeys(stems))
    with ThreadPoolExecutor(THREADS) as threads:
        return dict(zip(wanted, threads.map(both, wanted), strict=True))

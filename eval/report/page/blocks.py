"""What a report is made of: tables, figures, equations, films, folded text, the overview, and sections of them."""

import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import pandas as pd


@dataclass(frozen=True)
class Film:
    """A film saved as `figures/<stem>.webm`, beside the page as it is too large, with its caption (Markdown)."""

    stem: str
    caption: str

    @property
    def path(self) -> str:
        """Where it is, seen from the report."""
        return f"figures/{self.stem}.webm"


READING = "How to read this"  # Heading of the section with the fine print of all tables and figures, each text once
LINES = 280  # characters of a caption or a paragraph that stands in front: two lines of 1100 pixels


@dataclass(frozen=True)
class FinePrint:
    """What a caption leaves to the section `READING`: a title of a few words, and the text (Markdown)."""

    title: str
    text: str


@dataclass(frozen=True)
class Table:
    """A table with its caption (Markdown); `stem`: its name in `tables/`, `fine`: what the caption leaves out."""

    frame: pd.DataFrame
    caption: str
    stem: str | None = None
    fine: FinePrint | None = None


@dataclass(frozen=True)
class Picture:
    """A figure `figures/<stem>.png` (and `<stem>-narrow.png`), its caption (Markdown), and a text in its place."""

    stem: str
    caption: str
    alt: str
    place: str = ""  # where it stands, of a figure of a log: see `eval.figures.kinds`


@dataclass(frozen=True)
class Formula:
    """Equations: LaTeX as in math mode, and the same as MathML for browsers."""

    latex: str
    mathml: str


@dataclass(frozen=True)
class Mark:
    """A word with a symbol and a colour, so that neither is needed: tone is `good`, `fair`, `bad` or `none`."""

    word: str
    tone: str
    note: str = ""

    @property
    def symbol(self) -> str:
        """Of its tone."""
        return {"good": "✓", "fair": "▲", "bad": "✗", "none": "–"}[self.tone]


@dataclass(frozen=True)
class Sketch:
    """A small picture, as SVG with what it shows; `figures/<stem>.svg` holds it, too, if it was written there."""

    svg: str
    alt: str
    stem: str | None = None


@dataclass(frozen=True)
class Value:
    """A cell's text, and a note below it."""

    text: str
    note: str = ""


Cell = Mark | Value | Sketch | None


@dataclass(frozen=True)
class OverviewRow:
    """One log and task: its name, which points to the section of that heading, links (text, file), and its cells."""

    name: str
    section: str
    cells: tuple[Cell, ...]
    links: tuple[tuple[str, str], ...] = ()


@dataclass(frozen=True)
class Overview:
    """The first table of a report: a head for the names and one for each cell, the rows, and what they mean."""

    heads: tuple[str, ...]
    rows: tuple[OverviewRow, ...]
    caption: str


@dataclass(frozen=True)
class Folded:
    """Blocks that are shown on demand, below a line that says what they are."""

    summary: str
    blocks: "tuple[Block, ...]"


Block = str | Table | Picture | Formula | Film | Folded | Overview
"""A paragraph or list in Markdown, a table, a figure, equations, a film, something folded, or the overview."""


@dataclass(frozen=True)
class Section:
    """A heading of level 2 to 4 and the blocks below it."""

    heading: str
    blocks: tuple[Block, ...]
    level: int = 2
    facts: object = field(default=None, compare=False, repr=False)  # what it was written from, for report.json
    answer: str = field(default="", compare=False, repr=False)  # of a lab's question, in a line for the terminal
    page: str = ""  # name of its page in `details/`; empty: the report itself


@dataclass(frozen=True)
class Report:
    """A whole report: title, the command that makes it again, first screen, sections."""

    title: str
    command: str
    introduction: tuple[Block, ...]
    sections: tuple[Section, ...]
    # first: sections that stand right below the first screen, before the contents and the command
    first: tuple[Section, ...] = ()


class Numbers:
    """Counts tables and figures from 1, in reading order."""

    def __init__(self) -> None:
        self._count: Counter[bool] = Counter()

    def of(self, block: Table | Picture) -> int:
        """The number of the next table or figure."""
        self._count[isinstance(block, Table)] += 1
        return self._count[isinstance(block, Table)]


def anchor(heading: str) -> str:
    """Address of a heading within the page."""
    return re.sub(r"[^a-z0-9]+", "-", heading.lower()).strip("-") or "section"


def every_block(blocks: Sequence[Block]) -> Iterator[Block]:
    """All blocks in reading order, those that are folded, too."""
    for block in blocks:
        yield block
        if isinstance(block, Folded):
            yield from every_block(block.blocks)


def with_fine_print(report: Report) -> tuple[Section, ...]:
    """The sections; the one that is called `READING` (made if there is none) ends with the fine print of all tables."""
    blocks = [*report.introduction, *(b for s in (*report.first, *report.sections) for b in s.blocks)]
    fine = dict.fromkeys(b.fine for b in every_block(blocks) if isinstance(b, Table) and b.fine is not None)
    texts = [f"**{f.title}.** {f.text}" for f in fine]
    own = [b for s in report.sections if s.heading == READING for b in s.blocks]
    if not own and not texts:
        return report.sections
    reading = Section(READING, (Folded("Definitions of the quantities and columns", (*own, *texts)),))
    if not own:
        return (*report.sections, reading)
    return tuple(reading if s.heading == READING else s for s in report.sections)


def pages(report: Report) -> dict[str, Report]:
    """The report itself and its pages in `details/`, by file name; the first section of such a page gives its title."""
    made = {"report.html": replace(report, sections=tuple(s for s in report.sections if not s.page))}
    for name in dict.fromkeys(s.page for s in report.sections if s.page):
        first, *more = (s for s in report.sections if s.page == name)
        back = "[Back to the report](../report.html)"
        sections = tuple(replace(s, level=max(s.level - 1, 2)) for s in more)
        made[f"details/{name}.html"] = Report(first.heading, report.command, (back, *first.blocks), sections)
    return made


def cut(text: str, most: int = LINES) -> tuple[str, str]:
    """A text's first sentences of at most so many characters (the first one at least), and the rest."""
    if len(text) <= most:
        return text, ""
    ends = [m.end() for m in re.finditer(r"(?<=[\w)*`²%°])[.!?](?=\s+[^\Wa-z_]|\s+[*`])", text)]
    fitting = [e for e in ends if e <= most] or ends[:1]
    return (text, "") if not fitting else (text[: fitting[-1]].rstrip(), text[fitting[-1] :].strip())


def folded(text: str, summary: str, most: int = 420) -> tuple[Block, ...]:
    """A text or list with its first sentences (of three lines at most) in front and the rest folded."""
    if len(text) <= most:
        return (text,) if text else ()
    if text.startswith("* "):
        lines = text.split("\n* ")
        front, rest = cut(lines[0].removeprefix("* ").strip(), most)
        return (front, Folded(summary, ("\n".join(f"* {line}" for line in [*[rest] * bool(rest), *lines[1:]]),)))
    front, rest = cut(text, most)
    return (front, Folded(summary, (rest,))) if rest else (front,)

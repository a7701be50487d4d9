"""Numbers and tables as a person reads them, rounded, and as files: CSV with every digit, Markdown, LaTeX."""

import difflib
import math
import re
import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from textwrap import wrap
from typing import Any, NamedTuple

import pandas as pd

from association.names import METHOD_TABLE
from data.errors import UsageError
from data.log import folder_name
from data.words import environment, number as number
from eval.figures.figure_style import tex_escape
from eval.plan.flags.table import Output
from eval.referee.result_files import OF_DECISIONS, OF_ESTIMATES, is_blank
from eval.referee.score import Trial
from eval.replay.settings import ESTIMATOR_TABLE
from eval.report.page.blocks import FinePrint, Table


def interval(lower: float, upper: float) -> str:
    """`lower to upper`, both with as many decimals as the larger one needs for three digits."""
    size = max(abs(lower), abs(upper))
    places = min(max(2 - math.floor(math.log10(size)), 0), 6) if size > 0.0 else 0
    return f"{lower:.{places}f} to {upper:.{places}f}".replace("-", "−")


def is_numeric(column: Sequence[Any]) -> bool:
    """Whether a column holds numbers only, blanks aside."""
    known = [v for v in column if not is_blank(v)]
    return bool(known) and all(pd.api.types.is_number(v) and not isinstance(v, bool) for v in known)


NOTHING = 1e-6  # a number that is closer to zero is a rounding error of arithmetic, and written as 0


def cell_texts(column: Sequence[Any]) -> list[str]:
    """A column as text to read: integers whole, other numbers with three significant digits each."""
    numeric = is_numeric(column)
    whole = numeric and all(float(v).is_integer() for v in column if not is_blank(v))
    return ["" if is_blank(v) else _text(v, numeric, whole) for v in column]


def _text(value: Any, numeric: bool, whole: bool) -> str:
    if not numeric:
        return {True: "yes", False: "no"}[value] if isinstance(value, bool) else str(value)
    return str(int(value)) if whole else "0" if abs(float(value)) < NOTHING else number(float(value)).replace("-", "−")


def texts(frame: pd.DataFrame) -> list[list[str]]:
    """The body of a table as text, row by row."""
    return [list(row) for row in zip(*(cell_texts(frame[c].tolist()) for c in frame.columns), strict=True)]


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
    body = ([markdown_escape(t) for t in row] for row in texts(frame))
    rows = [[markdown_escape(str(c)) for c in frame.columns], rule, *body]
    return "".join(f"| {' | '.join(row)} |\n" for row in rows)


SYSTEMATIC = "systematic"  # picture and table of the systematic errors that were estimated along


def stem(trial: Trial, what: str = "") -> str:
    """Name of a trial's file, without suffix; without `what` that of its page in `details/`."""
    return "-".join(filter(None, (folder_name(trial.log.name), trial.task, what)))


def variants(trial: Trial, trials: Sequence[Trial]) -> tuple[Trial, ...]:
    """The variants of a trial: the same log with another setup or other knowledge."""
    if trial.variant_of is not None:
        return ()
    return tuple(t for t in trials if t.variant_of == trial.log.name and t.task == trial.task)


FORMATS = ("csv", "md", "tex")
HEADS: dict[str, Any] = tomllib.loads(Path(__file__).with_name("heads.toml").read_text(encoding="utf-8"))
TITLES: dict[str, str] = HEADS["titles"]
"""Of a LaTeX table, by a part of its name."""
LONGEST = 80  # characters of the first sentence of a caption that stands in a paper


def short_caption(stem: str, caption: str) -> str:
    """A caption of a few words: what kind of table, on which log and task (the first sentence, if it is short)."""
    title = next((t for part, t in TITLES.items() if part in stem.split("-") or stem.endswith(part)), "")
    if "-trust-" in stem:
        title = TITLES["trust"]
    first = caption.partition(". ")[0].partition(": ")[0].rstrip(".").replace("`", "")
    where = ", ".join([place(p) for p in first.split(", ")]) if len(first) <= LONGEST else ""
    return ": ".join(t for t in (title, where) if t) or stem


def write_table(
    frame: pd.DataFrame, folder: Path, stem: str, caption: str, formats: Sequence[str] = FORMATS, width: str = "page",
    columns: Sequence[str] = (), for_paper: pd.DataFrame | None = None, fine_print: str = "",
) -> list[Path]:  # fmt: skip
    """Write `folder/stem.csv|.md|.tex` (the caption of LaTeX in `notes.tex`); `width`, `columns`, `for_paper`: as of
    `sheet`, the last with more columns; `fine_print`: what else the note says. ValueError: an unknown format.
    """
    unknown = sorted(set(formats) - set(FORMATS))
    if unknown:
        raise ValueError(f"table format {unknown[0]!r}; known: {', '.join(FORMATS)}")
    folder.mkdir(parents=True, exist_ok=True)
    written = []
    for suffix in formats:
        if suffix == "csv":
            text = frame.astype(object).map(lambda v: "" if is_blank(v) else v).to_csv(index=False, lineterminator="\n")
        elif suffix == "md":
            text = f"{caption}\n\n{markdown(frame)}"
        else:
            whole = frame if for_paper is None else for_paper
            made = sheet(whole, stem, short_caption(stem, caption), width, columns)
            # without the log and task it begins with, so that tables of several logs share a note
            first, _, rest = caption.partition(". ")
            about = rest if rest and len(first) <= LONGEST and ": " not in first else caption
            add_note(folder, stem, f"{about} {fine_print}".strip(), made.left_out, made.heads)
            text = made.tex
        written.append(folder / f"{stem}.{suffix}")
        written[-1].write_text(text, encoding="utf-8", newline="\n")
    return written


def written_table(
    frame: pd.DataFrame, folder: Path, stem: str, caption: str, wanted: Output, *,
    for_paper: pd.DataFrame | None = None, fine: FinePrint | None = None,
) -> Table:  # fmt: skip
    """Write a table as `folder/tables/stem.<format>`; the report links to its CSV if there is one. `for_paper`: the
    same rows with more columns to choose from; `fine`: as of a `Table`.
    """
    formats = [f for f in wanted.formats if f in FORMATS]
    text, place = "" if fine is None else fine.text, folder / "tables"
    write_table(frame, place, stem, caption, formats, wanted.table_width, wanted.columns, for_paper, text)
    return Table(frame, caption, stem if "csv" in wanted.formats else None, fine)


class Known(NamedTuple):
    """A column: its key, its head in a paper, and its rank (the larger, the sooner it is left out)."""

    key: str
    short: str
    rank: float


SHORT: dict[str, str] = HEADS["short"]
"""Heads in a paper, most wanted first; the fine print says what they mean."""
_RANKS = {key: float(i) for i, key in enumerate(SHORT)}
_METRICS = {m.head: m for m in (*OF_ESTIMATES, *OF_DECISIONS)}
KNOWN: Mapping[str, Known] = {
    head: Known(
        m.column,
        SHORT.get(m.column, f"{m.heading} [{m.unit}]" if m.unit else m.heading),
        _RANKS.get(m.column, len(SHORT)),
    )
    for head, m in _METRICS.items()
} | {head: Known(*row) for head, row in HEADS["others"].items()}  # by the head of the report's tables
KEYS = tuple(dict.fromkeys(k.key for k in KNOWN.values()))


def check_columns(columns: Sequence[str]) -> None:
    """Raise UsageError for a column that no table has."""
    for name in columns:
        if name not in KEYS:
            near = difflib.get_close_matches(name, KEYS, 3)
            hint = f"; do you mean {' or '.join(near)}?" if near else ""
            raise UsageError(f"--columns {name}: no column of metrics.csv, association.csv or consistency.csv{hint}")


METHODS = {"none": ""} | {name: method.label for name, method in METHOD_TABLE.items()}
TASKS = {"slam": "SLAM", "localization": "localization"}
WORLDS: dict[str, str] = HEADS["worlds"]
LOGS = {"victoria-park": "Victoria Park"}


def estimators(text: str) -> str:
    """One estimator, or several separated by commas."""
    names = (name.strip() for name in text.split(","))
    return ", ".join(ESTIMATOR_TABLE[name].label if name in ESTIMATOR_TABLE else name for name in names)


def place(name: str) -> str:
    """A log, a task, or `association NAME`."""
    method = name.removeprefix("association ")
    return f"association {METHODS.get(method, method)}" if method != name else TASKS.get(name, log(name))


def log(name: str) -> str:
    """A log: `corridor:0:people+range=8` is corridor 0 (people, range 8); a name that somebody gave stays as it is."""
    parts = re.fullmatch(r"([a-z]+):(\d+)(?::(.*))?", name)
    if parts is None or parts[1] not in WORLDS:
        return LOGS.get(name, name)
    more = (parts[3] or "").replace("+", ", ").replace("=", " ").replace("-", " ").replace("_", " ")
    return f"{WORLDS[parts[1]]} {parts[2]}" + (f" ({more})" if more else "")


HEAD = "% What the tables mean; a paragraph can stand below its table or in the text.\n"


def add_note(
    folder: Path, stem: str, text: str, left_out: Sequence[str] = (), heads: Sequence[tuple[str, str]] = ()
) -> None:
    """Say what a table means; tables with the same fine print share its paragraph."""
    path = folder / "notes.tex"
    before = path.read_text(encoding="utf-8") if path.exists() else HEAD
    note = tex_escape(text)
    if heads:
        note += tex_escape(f" Columns: {'; '.join(f'{short}: {full}' for short, full in heads)}.")
    if left_out:
        note += tex_escape(f" Not shown for want of room: {', '.join(left_out)}.")
    paragraphs = [p for p in before.removeprefix(HEAD).split("\n\n") if p.strip()]
    reference = rf"\ref{{tab:{stem}}}"
    for i, paragraph in enumerate(paragraphs):
        first, _, rest = paragraph.strip().partition("\n")
        if rest == note:
            paragraphs[i] = f"{first.removesuffix('.}').replace('Table~', 'Tables~')}, {reference}.}}\n{rest}"
            break
    else:
        paragraphs.append(rf"\textbf{{Table~{reference}.}}" + f"\n{note}")
    path.write_text(HEAD + "\n" + "\n\n".join(p.strip() for p in paragraphs) + "\n", encoding="utf-8", newline="\n")


def notes_of(folder: Path, stems: Sequence[str]) -> str:
    """The notes of these tables only, so that no reference is left without its table."""
    path = folder / "notes.tex"
    paragraphs = path.read_text(encoding="utf-8").removeprefix(HEAD).split("\n\n") if path.exists() else []
    found = []
    for paragraph in filter(str.strip, paragraphs):
        first, _, note = paragraph.strip().partition("\n")
        there = [rf"\ref{{tab:{s}}}" for s in re.findall(r"\\ref\{tab:([^}]*)\}", first) if s in stems]
        if there:
            found.append(rf"\textbf{{Table{'s' * (len(there) > 1)}~{', '.join(there)}.}}" + f"\n{note}")
    return "\n\n".join(found)


WIDTHS = {"column": 252.0, "page": 516.0}  # pt (1/72.27 in). A column and both of an IEEE journal: 21 and 43 picas
CHARACTER = {"footnotesize": 4.7, "scriptsize": 4.35}
"""pt of a character in each type size where the text is 10 pt: digits of Computer Modern have 4.25 and 3.94, heads with
capitals up to a tenth more than this."""
GAP = 6.0  # pt between columns: twice the \tabcolsep that the tables set


def text_width(text: str, size: str = "footnotesize") -> float:
    """Width [pt] of a text that is not broken, as characters have it on average."""
    return CHARACTER[size] * len(text)


NAMES = ("log", "task", "scenario", "estimator", "association", "phase")
"""Columns that say what a row is about; they are never left out, only stated once where they are all the same."""
READ: dict[str, Callable[[str], str]] = {
    "log": log, "task": lambda t: TASKS.get(t, t), "association": lambda a: METHODS.get(a, a),
}  # fmt: skip
ESTIMATORS = ("filter", "smoother", "deciding for")  # heads of other columns that name estimators
NARROWEST, NARROWEST_NAMES = 60.0, 100.0  # pt. A column of text, or of names, is not broken into narrower lines
FIGURES = re.compile(r"[−-]?[\d.]+(?:e[+-]?\d+)?(?: ± [\d.]+|–[\d.]+)?")
"""Numbers, with a standard error or as an interval, that were made text."""
SIZES = ("footnotesize", "scriptsize")


@dataclass(frozen=True)
class Cells:
    """One column: its key, rank (None: never left out), lines of its head, cells, and whether they are numbers."""

    key: str
    rank: float | None
    head: str
    body: tuple[str, ...]
    numeric: bool
    width: float | None = None  # width: of a column of text broken into lines [pt]; None: as wide as it has to be
    full: str = ""  # the head as the report has it

    @property
    def narrowest(self) -> float:
        """Least width [pt] of its lines."""
        return NARROWEST_NAMES if self.rank is None else NARROWEST

    def natural(self, size: str) -> float:
        """Width [pt] without breaking cells; the head is broken between any two words."""
        if self.width is not None:
            return self.width
        words = (text_width(w, size) for w in _tied(self.head).split(" "))
        return max(*words, *(text_width(t, size) for t in self.body), 0.0)

    def lines(self, size: str) -> list[str]:
        """The head broken into lines that make the column no wider."""
        room = round(self.natural(size) / CHARACTER[size])
        return wrap(_tied(self.head), max(room, 1), break_long_words=False) or [""]


class Sheet(NamedTuple):
    """A table for a paper, its width [pt], and what its notes have to say."""

    tex: str
    width: float
    left_out: tuple[str, ...]
    common: tuple[str, ...]
    heads: tuple[tuple[str, str], ...]


def sheet(frame: pd.DataFrame, stem: str, caption: str, width: str = "page", columns: Sequence[str] = ()) -> Sheet:
    """The table as a float with label `tab:<stem>`; `width`: `column` or `page`. `columns`: keys of those wanted, in
    order; none: as many as there is room for, the most wanted first.
    """
    cells, common = _named(frame)
    chosen = [c for key in columns for c in cells if c.key == key]
    if chosen:
        cells = [c for c in cells if c.rank is None] + chosen
    room, left_out, size = WIDTHS[width], list[str](), SIZES[0]
    while total(cells, size) > room:
        narrowed = _narrowed(cells, size, room)
        spare = [c for c in cells if c.rank is not None]
        if narrowed is not None:
            cells = narrowed
        elif chosen and size != SIZES[-1]:
            size = SIZES[-1]
        elif chosen or len(spare) < 2:
            break
        else:
            last = max(spare, key=lambda c: c.rank or 0.0)
            cells = [c for c in cells if c is not last]
            left_out.append(last.head)
    whole = caption + (f" ({', '.join(common)})" if common else "")
    tex = _render(cells, stem, whole, size, wide=width == "page", total=total(cells, size), room=room)
    heads = tuple((c.head, c.full) for c in cells if c.full and c.full != c.head)
    return Sheet(tex, total(cells, size), tuple(reversed(left_out)), tuple(common), heads)


def total(cells: Sequence[Cells], size: str) -> float:
    """Width of the table [pt]."""
    return sum(c.natural(size) for c in cells) + GAP * (len(cells) - 1)


def _narrowed(cells: Sequence[Cells], size: str, room: float) -> list[Cells] | None:
    """The widest column of text broken into lines, as narrow as it must be; None where that does not help."""
    texts = [c for c in cells if not c.numeric and c.width is None and c.natural(size) > c.narrowest]
    if not texts:
        return None
    widest = max(texts, key=lambda c: c.natural(size))
    word = max(text_width(w, size) for t in (widest.head, *widest.body) for w in t.split() or [""])
    width = max(widest.natural(size) - (total(cells, size) - room), widest.narrowest, word)
    return None if width >= widest.natural(size) else [replace(c, width=width) if c is widest else c for c in cells]


def _named(frame: pd.DataFrame) -> tuple[list[Cells], list[str]]:
    """The columns with names to read, those of a run as one; and what is the same in every row."""
    common: list[str] = []
    cells: list[Cells] = []
    for head in [h for h in NAMES if h in frame.columns and h not in ("estimator", "phase")]:
        values = ["" if is_blank(v) else str(v) for v in frame[head].tolist()]
        read: list[str] = [READ[head](v) if head in READ else v for v in values]
        if len(set(read)) == 1 and read[0] and len(frame) > 1:
            common.append(f"association {read[0]}" if head == "association" else read[0])
        elif head != "association" or "estimator" not in frame.columns:
            cells.append(Cells(head, None, head, tuple(read), numeric=False))
    if "estimator" in frame.columns:
        cells.append(Cells("estimator", None, "estimator", tuple(_rows(frame)), numeric=False))
    elif "phase" in frame.columns:
        cells.append(Cells("phase", None, "phase", tuple(map(str, frame["phase"].tolist())), numeric=False))
    for place, head in enumerate(str(c) for c in frame.columns):
        if head not in NAMES:
            values, what = frame.iloc[:, place].tolist(), KNOWN.get(head, Known(head, head, 3.0 + 0.01 * place))
            body = cell_texts(values)
            if head in ESTIMATORS:
                body = [estimators(t) for t in body]
            numeric = is_numeric(values) or all(FIGURES.fullmatch(t) for t in body if t)
            cells.append(Cells(what.key, what.rank, what.short, tuple(body), numeric, full=head))
    return cells, common


def _rows(frame: pd.DataFrame) -> list[str]:
    """Estimator, with association and phase where rows differ in them."""
    columns = ("estimator", "association", "phase")
    who, how, when = (frame[c].astype(str).tolist() if c in frame else [""] * len(frame) for c in columns)
    how = [METHODS.get(v, v) for v in how]
    several = len({h for h in how if h}) > 1
    phases: dict[tuple[str, str], set[str]] = {}
    for w, h, p in zip(who, how, when, strict=True):
        phases.setdefault((w, h), set()).add(p)
    return [
        estimators(w) + (f", {h}" if several and h else "") + (f" ({p})" if len(phases[w, h]) > 1 and p else "")
        for w, h, p in zip(who, how, when, strict=True)
    ]


def _tied(head: str) -> str:
    """A head that is broken between words, but not before a percent sign."""
    return head.replace(" %", "\u00a0%")


def _render(cells: Sequence[Cells], stem: str, title: str, size: str, *, wide: bool, total: float, room: float) -> str:
    ragged = [r"\raggedright\arraybackslash " if c.width is not None else "" for c in cells]
    bodies = zip(*(c.body for c in cells), strict=True)
    rows = [" & ".join(r + tex_escape(t) for t, r in zip(row, ragged, strict=True)) for row in bodies]
    # {} keeps LaTeX from taking a bracket behind a line break for its optional argument
    heads = [r"\\{}".join(tex_escape(line) for line in c.lines(size)) for c in cells]
    made = environment("eval.report").get_template("table.tex.j2").render(
        cells=list(zip(cells, heads, strict=True)), packages="booktabs,array" if any(ragged) else "booktabs",
        rows=["{}" * cells[0].body[i].startswith("[") + row for i, row in enumerate(rows)], caption=tex_escape(title),
        stem=stem, size=size, wide=wide, total=total, room=room, gap=GAP / 2,
    )  # fmt: skip
    return f"{made.strip()}\n"

"""`write-up.tex`: the report's tables and figures as a text to go on from, one page per answer and per log."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from jinja2 import Template
from markdown_it import MarkdownIt
from markdown_it.token import Token

from eval.figures.figure_style import tex_escape
from eval.referee.result_files import rows_of, value_of
from eval.referee.score import Scores, Trial
from eval.report.page.blocks import Picture, Section, Table
from eval.report.page.files import notes_of, stem
from eval.report.words import environment

OTHERS = (r"$\omega$", r"$\varphi$", r"$\psi$", r"$\Delta$", r"$\pi$", r"$\to$", "'", "``", "''")
LETTERS = dict(zip("ωφψΔπ→’“”", OTHERS, strict=True))  # what `tex_escape` leaves as it is
MARKS = {
    "strong_open": r"\textbf{",
    "strong_close": "}",
    "em_open": r"\emph{",
    "em_close": "}",
    "softbreak": "\n",
    "hardbreak": "\\\\\n",
}  # tokens of Markdown that are no text, in LaTeX
KINDS = ("map", "error", "difference")  # pictures of a log's page, the first two there are beside each other


@dataclass(frozen=True)
class Best:
    """The run with the least position RMSE [m] of a phase."""

    phase: str
    rmse: float
    estimator: str
    association: str


@dataclass(frozen=True)
class LogPage:
    """The page of a log and task: how much it holds, who is nearest to the truth, stems of tables and figures."""

    log: str
    task: str
    frames: int
    observations: int
    best: tuple[Best, ...]
    tables: tuple[str, ...]
    pictures: tuple[str, ...]
    captions: tuple[str, ...]

    @property
    def width(self) -> float:
        """Of a figure, as a share of the line."""
        return min(0.98 / max(len(self.pictures), 1) - 0.01, 0.6)


def tex(markdown: str) -> str:
    """Markdown in LaTeX, paragraphs and items of lists parted by empty lines; of links the text."""
    tokens = MarkdownIt("commonmark", {"html": False}).parse(markdown)
    return "\n\n".join("".join(map(_inline, t.children or ())) for t in tokens if t.type == "inline")


def _inline(token: Token) -> str:
    text = plain(token.content)
    return rf"\texttt{{{text}}}" if token.type == "code_inline" else MARKS.get(token.type, text)


def plain(text: str) -> str:
    """A text as LaTeX prints it."""
    return "".join(LETTERS.get(c, tex_escape(c)) for c in text)


@cache
def _template() -> Template:
    """With delimiters that are nothing to LaTeX."""
    made = environment().overlay(
        block_start_string="<%",
        block_end_string="%>",
        variable_start_string="<<",
        variable_end_string=">>",
        comment_start_string="<#",
        comment_end_string="#>",
    )
    made.filters = made.filters | {"tex": tex, "plain": plain, "kind": lambda block: type(block).__name__}
    return made.get_template("write_up.tex.j2")


def write_up(
    folder: Path, trials: Sequence[Trial], scores: Scores, answers: Sequence[Section], sections: Sequence[Section]
) -> None:
    """Write the file: a page for each answer of a lab, then one for each log and task with its tables and figures."""
    logs = [log_page(folder, trial, scores, sections) for trial in trials if trial.variant_of is None]
    of_answers = [b.stem for section in answers for b in section.blocks if isinstance(b, Table) and b.stem]
    notes = notes_of(folder / "tables", [*of_answers, *(t for page in logs for t in page.tables)])
    text = _template().render(answers=answers, logs=logs, notes=notes).strip() + "\n"
    (folder / "write-up.tex").write_text(text, encoding="utf-8", newline="\n")


def log_page(folder: Path, trial: Trial, scores: Scores, sections: Sequence[Section]) -> LogPage:
    """What the page of a log shows, of the tables and figures that were written and drawn."""
    r = trial.log.recorded
    shown = [s for s in (stem(trial, k) for k in KINDS) if (folder / "figures" / f"{s}.png").exists()][:2]
    tables = [
        s for s in (stem(trial, k) for k in ("comparison", "association")) if (folder / "tables" / f"{s}.tex").exists()
    ]
    pictures = [b for s in sections for b in s.blocks if isinstance(b, Picture) and b.stem in shown]
    rows = rows_of(scores.metrics[(scores.metrics["log"] == trial.log.name) & (scores.metrics["task"] == trial.task)])
    best = []
    for phase in ("online", "final"):
        there = [
            Best(phase, value_of(row, "rmse_position_m"), str(row["estimator"]), str(row["association"]))
            for row in rows
            if row["phase"] == phase and row["status"] == "ok" and row["estimator"] != "dead-reckoning"
        ]
        known = [b for b in there if b.rmse >= 0.0]
        best += [min(known, key=lambda b: b.rmse)] if known else []
    captions = tuple(b.caption for b in pictures)
    sizes = len(r), len(r.observations.frame)
    return LogPage(trial.log.name, trial.task, *sizes, tuple(best), tuple(tables), tuple(shown), captions)

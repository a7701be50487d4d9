"""`write-up.tex`: the report's tables and figures as a text to go on from, one page per answer and per log."""

from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

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
    notes = notes_of(folder / "tables", [*of_answers, *(t for page in logs for t in page["tables"])])
    text = _template().render(answers=answers, logs=logs, notes=notes).strip() + "\n"
    (folder / "write-up.tex").write_text(text, encoding="utf-8", newline="\n")


def log_page(folder: Path, trial: Trial, scores: Scores, sections: Sequence[Section]) -> dict[str, Any]:
    """What the page of a log shows: its sizes, stems of tables and figures that were written and drawn, and `best`.
    `best` has phase, position RMSE [m], estimator and association of the run nearest to the truth in each phase.
    """
    r = trial.log.recorded
    shown = [s for s in (stem(trial, k) for k in KINDS) if (folder / "figures" / f"{s}.png").exists()][:2]
    tables = [stem(trial, k) for k in ("comparison", "association")]
    rows = rows_of(scores.metrics[(scores.metrics["log"] == trial.log.name) & (scores.metrics["task"] == trial.task)])
    best = []
    for phase in ("online", "final"):
        ended = [r for r in rows if (r["phase"], r["status"]) == (phase, "ok") and r["estimator"] != "dead-reckoning"]
        errors = [(value_of(r, "rmse_position_m"), r["estimator"], r["association"]) for r in ended]
        known = [each for each in errors if each[0] >= 0.0]
        best += [(phase, *min(known, key=lambda b: b[0]))] if known else []
    return {
        "log": trial.log.name,
        "task": trial.task,
        "frames": len(r),
        "observations": len(r.observations.frame),
        "best": best,
        "tables": [s for s in tables if (folder / "tables" / f"{s}.tex").exists()],
        "pictures": shown,
        "width": min(0.98 / max(len(shown), 1) - 0.01, 0.6),  # of a figure, as a share of the line
        "captions": [b.caption for s in sections for b in s.blocks if isinstance(b, Picture) and b.stem in shown],
    }

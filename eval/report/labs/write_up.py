"""`write-up.tex`: the report's tables and figures as a text to go on from, one page per answer and per log.

It is compiled in the result folder (`pdflatex write-up.tex`, twice for the numbers of tables), with packages that
come with every TeX.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

from eval.figures.paper import tex_escape
from eval.referee.score import Scores, Trial
from eval.report.names import stem
from eval.report.page.blocks import Film
from eval.report.page.document import Block, Folded, Formula, Overview, Picture, Section, Table
from eval.report.rows import rows_of, value_of

PREAMBLE = r"""% Made by eval.run_all --write-up. In this folder: pdflatex write-up.tex
\documentclass[10pt]{article}
\usepackage[T1]{fontenc}
\usepackage[utf8]{inputenc}
\IfFileExists{lmodern.sty}{\usepackage{lmodern}}{}
\usepackage{amsmath,array,booktabs,graphicx}
\usepackage[a4paper,hmargin=14mm,vmargin=18mm]{geometry} % tables are up to 516 pt wide
\setlength{\parindent}{0pt}
\setlength{\parskip}{4pt}
\makeatletter
% tables stand where they are input, and never float to another page
\renewenvironment{table}[1][]{\par\begin{minipage}{\linewidth}\def\@captype{table}}{\end{minipage}\par\medskip}
\renewenvironment{table*}[1][]{\begin{table}}{\end{table}}
\renewcommand{\@makecaption}[2]{{\footnotesize #1: #2\par}\smallskip}
% a page is shrunk if it would be more than one
\newsavebox{\onepage}
\newenvironment{page}[1]{\begin{lrbox}{\onepage}\begin{minipage}[b]{\textwidth}\setlength{\parskip}{4pt}%
  {\large\bfseries #1\par}\medskip}{\end{minipage}\end{lrbox}%
  \ifdim\dimexpr\ht\onepage+\dp\onepage\relax>\textheight
    \centerline{\resizebox*{!}{0.98\textheight}{\usebox{\onepage}}}%
  \else\usebox{\onepage}\fi\clearpage}
\newcommand{\beside}[3]{\begin{minipage}[t]{#1\linewidth}\def\@captype{figure}\centering
  \includegraphics[width=\linewidth,height=#2\textheight,keepaspectratio]{#3}\end{minipage}}
\makeatother
\begin{document}
"""
END = "\\end{document}\n"
LETTERS = {
    "ω": r"$\omega$", "φ": r"$\varphi$", "ψ": r"$\psi$", "Δ": r"$\Delta$", "ν": r"$\nu$", "π": r"$\pi$",
    "→": r"$\to$", "’": "'", "“": "``", "”": "''",
}  # fmt: skip
KINDS = ("map", "error")
"""Pictures of a log's page, beside each other."""


def tex(markdown: str) -> str:
    """A paragraph of the report in LaTeX: code, bold and links as they are meant."""
    text = re.sub(r"\[([^]]*)\]\([^)]*\)", r"\1", markdown)
    parts = re.split(r"(`[^`]*`|\*\*)", text)
    out, bold = [], False
    for part in parts:
        if part == "**":
            out.append("}" if bold else r"\textbf{")
            bold = not bold
        elif part.startswith("`"):
            out.append(r"\texttt{" + _escaped(part.strip("`")) + "}")
        else:
            out.append(_escaped(part))
    return "".join(out) + "}" * bold


def _escaped(text: str) -> str:
    return "".join(LETTERS.get(c, tex_escape(c)) for c in text)


def write_up(
    folder: Path, trials: Sequence[Trial], scores: Scores, answers: Sequence[Section], sections: Sequence[Section]
) -> None:
    """Write the file: a page for each answer of a lab, then one for each log and task with its tables and figures."""
    pages = [_answer(section) for section in answers]
    pages += [_log(folder, trial, scores, sections) for trial in trials if trial.beside is None]
    if (folder / "tables" / "notes.tex").exists():
        pages.append(_page("What the tables mean", [r"\footnotesize\input{tables/notes.tex}"]))
    text = PREAMBLE + "\n".join(pages) + END
    (folder / "write-up.tex").write_text(text, encoding="utf-8", newline="\n")


def _page(title: str, body: Sequence[str]) -> str:
    return "\n".join([f"\\begin{{page}}{{{_escaped(title)}}}", *(part for part in body if part), "\\end{page}\n"])


def _answer(section: Section) -> str:
    return _page(section.heading, [_block(block) for block in section.blocks])


def _block(block: Block) -> str:
    if isinstance(block, Table):
        return rf"\input{{tables/{block.stem}.tex}}" if block.stem else ""
    if isinstance(block, Picture):
        return (
            rf"\begin{{center}}\includegraphics[width=0.92\linewidth,height=0.42\textheight,keepaspectratio]"
            rf"{{figures/{block.stem}}}\\{{\footnotesize {tex(block.caption)}}}\end{{center}}"
        )
    if isinstance(block, Formula):
        return f"\\[\n{block.latex}\n\\]"
    if isinstance(block, Folded):
        return "\n\n".join(_block(b) for b in block.blocks)
    if isinstance(block, Film | Overview):  # paper shows none
        return ""
    lines = [line.removeprefix("* ") for line in block.split("\n")]
    return "\n\n".join(tex(line) for line in lines if line.strip()) + "\n"


def _log(folder: Path, trial: Trial, scores: Scores, sections: Sequence[Section]) -> str:
    """The page of a log: a sentence, its comparison, its decisions, and map and error beside each other."""
    shown = [k for k in (*KINDS, "difference") if (folder / "figures" / f"{stem(trial, k)}.png").exists()][:2]
    tables = [k for k in ("comparison", "association") if (folder / "tables" / f"{stem(trial, k)}.tex").exists()]
    width = 0.98 / max(len(shown), 1) - 0.01
    pictures = "\\hfill\n".join(rf"\beside{{{min(width, 0.6):.3f}}}{{0.4}}{{figures/{stem(trial, k)}}}" for k in shown)
    captions = [
        b.caption for s in sections for b in s.blocks
        if isinstance(b, Picture) and b.stem in {stem(trial, k) for k in shown}
    ]  # fmt: skip
    body = [
        tex(_sentence(trial, scores)),
        *(rf"\input{{tables/{stem(trial, k)}.tex}}" for k in tables),
        pictures and pictures + r"\par",
        *(r"{\footnotesize " + tex(c) + r"\par}" for c in captions),
    ]
    return _page(f"{trial.log.name}, {trial.task}", body)


def _sentence(trial: Trial, scores: Scores) -> str:
    """How much the log holds, and who is nearest to the truth in each phase."""
    r = trial.log.recorded
    text = f"`{trial.log.name}`: {len(r)} frames, {len(r.observations.frame)} observations."
    rows = rows_of(scores.metrics[(scores.metrics["log"] == trial.log.name) & (scores.metrics["task"] == trial.task)])
    for phase, what in (("online", "with the data up to each frame"), ("final", "with all data")):
        known = [row for row in rows if row["phase"] == phase and value_of(row, "rmse_position_m") >= 0.0]
        known = [row for row in known if row["status"] == "ok" and row["estimator"] != "dead-reckoning"]
        if known:
            best = min(known, key=lambda row: value_of(row, "rmse_position_m"))
            text += (
                f" Least position RMSE {what}: {value_of(best, 'rmse_position_m'):.3g} m"
                f" ({best['estimator']}, {best['association']})."
            )
    return text

"""The fine print of all tables for a paper, in one file: `tables/notes.tex`, a paragraph for each text."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from eval.figures.paper.tex import tex_escape

HEAD = "% What the tables mean; a paragraph can stand below its table or in the text.\n"


def add_note(
    folder: Path, stem: str, text: str, left_out: Sequence[str] = (), heads: Sequence[tuple[str, str]] = ()
) -> None:
    """Say what a table means; tables with the same fine print share its paragraph."""
    path = folder / "notes.tex"
    before = path.read_text(encoding="utf-8") if path.exists() else HEAD
    said = tex_escape(text)
    if heads:
        said += tex_escape(f" Columns: {'; '.join(f'{short}: {full}' for short, full in heads)}.")
    if left_out:
        said += tex_escape(f" Not shown for want of room: {', '.join(left_out)}.")
    paragraphs = [p for p in before.removeprefix(HEAD).split("\n\n") if p.strip()]
    reference = rf"\ref{{tab:{stem}}}"
    for i, paragraph in enumerate(paragraphs):
        first, _, rest = paragraph.strip().partition("\n")
        if rest == said:
            paragraphs[i] = f"{first.removesuffix('.}').replace('Table~', 'Tables~')}, {reference}.}}\n{rest}"
            break
    else:
        paragraphs.append(rf"\textbf{{Table~{reference}.}}" + f"\n{said}")
    path.write_text(HEAD + "\n" + "\n\n".join(p.strip() for p in paragraphs) + "\n", encoding="utf-8", newline="\n")

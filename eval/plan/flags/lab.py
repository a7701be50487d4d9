"""Flags of a lab's hand-in: which lab is done as a whole, and whether a text to be handed in is left beside it."""

from __future__ import annotations

from dataclasses import dataclass, field

from eval.replay.flag import flag, switch, text


@dataclass(frozen=True)
class LabFlags:
    """The rows of `run_all`."""

    lab: str | None = field(
        default=None,
        metadata=flag(
            text("a lab"), "NAME|FOLDER", "do a whole lab and answer its questions at the top of the report: "
            "corridor:SEED+KEY=VALUE (four conditions, every method, with and without map maintenance), visual:SEED, or "
            "a folder of recorded runs or with images; the lab's one gate (--new-gate as --gate) unless stated",
        ),
    )  # fmt: skip
    write_up: bool = field(
        default=False,
        metadata=flag(
            switch, "", "leave write-up.tex, which sets tables and figures, one page per log, for pdflatex",
            numbers=False,
        ),
    )  # fmt: skip

"""Flags of a lab's hand-in: which lab is done as a whole, and whether a text to be handed in is left beside it."""

from __future__ import annotations

from dataclasses import dataclass, field

from eval.replay.flag import flag, one_of, switch, text

FACTORS = ("1", "2", "5", "10", "20", "50", "auto")


@dataclass(frozen=True)
class LabFlags:
    """The rows of `run_all`."""

    lab: str | None = field(
        default=None,
        metadata=flag(
            text("a lab"), "NAME|FOLDER", "do a whole lab and answer its questions at the top of the report: "
            "corridor:SEED+KEY=VALUE (four conditions, every method, with and without map maintenance), visual:SEED, "
            "or a folder of recorded runs or with images; the lab's one gate (--new-gate as --gate) unless stated",
        ),
    )  # fmt: skip
    ellipses: str = field(
        default="1",
        metadata=flag(
            one_of(FACTORS), "FACTOR", f"ellipses in the plan of a camera log, so many times as large as they are: of "
            f"{', '.join(FACTORS)} (default: 1; auto: as large as is needed, as --lab shows beside it)", numbers=False,
        ),
    )  # fmt: skip
    lab_text: bool = field(
        default=False,
        metadata=flag(
            switch, "", "leave lab.txt with each run: its steps as the lab's program prints them, numbers from 1",
            numbers=False,
        ),
    )  # fmt: skip
    write_up: bool = field(
        default=False,
        metadata=flag(
            switch, "", "leave write-up.tex, which sets tables and figures, one page per log, for pdflatex",
            numbers=False,
        ),
    )  # fmt: skip

    @property
    def ellipse_factor(self) -> int | None:
        """By how much ellipses are enlarged, None for as is needed."""
        return None if self.ellipses == "auto" else int(self.ellipses)

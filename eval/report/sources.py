"""What came of fixes and closures, source by source: lines of the terminal, and the section on a log."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from data.notice import Notice
from eval.plan.flags.table import Output
from eval.referee.result_files import Row, is_blank, rows_of, value_of
from eval.referee.score import Scores, Trial
from eval.replay.settings import FILTERS
from eval.report.page.blocks import Section
from eval.report.page.files import stem, written_table
from eval.report.page.tables import drop_blank_columns, interval
from eval.report.words import of_runs, paragraph, say

HEADS = {
    "estimator": "estimator",
    "association": "association",
    "phase": "phase",
    "source": "source",
    "kind": "measures",
    "count": "in the log",
    "used": "accepted",
    "nis_mean": "NIS per dof",
    "bounds": "95 % bounds of NIS",
    "verdict": "verdict",
    "tp": "TP",
    "tn": "TN",
    "fp": "FP",
    "fn": "FN",
}
"""Columns of sources.csv (or made here) and their heads."""


@dataclass(frozen=True)
class SourceFacts:
    """One source in one run: a row of sources.csv; NaN, None: unknown."""

    estimator: str
    association: str
    phase: str
    source: str
    kind: str
    count: int
    used: int
    nis: float
    low: float
    high: float
    verdict: str
    outcomes: tuple[int, int, int, int] | None  # TP, TN, FP, FN

    @property
    def wrong(self) -> int | None:
        """Outliers accepted and inliers rejected; None: unknown."""
        return None if self.outcomes is None else self.outcomes[2] + self.outcomes[3]


def source_facts(scores: Scores, log: str, task: str) -> list[SourceFacts]:
    """The rows of a log and task, as facts."""
    own = [r for r in rows_of(scores.sources) if (r["log"], r["task"]) == (log, task)]
    return [_facts(r) for r in own]


def _facts(row: Row) -> SourceFacts:
    estimator, association, phase, source, kind = (
        str(row[c]) for c in ("estimator", "association", "phase", "source", "kind")
    )
    nis, low, high = (value_of(row, c) for c in ("nis_mean", "nis_low", "nis_high"))
    outcomes = None
    if not is_blank(row["tp"]):
        tp, tn, fp, fn = (int(value_of(row, c)) for c in ("tp", "tn", "fp", "fn"))
        outcomes = tp, tn, fp, fn
    counts = int(value_of(row, "count")), int(value_of(row, "used"))
    verdict = "" if is_blank(row["verdict"]) else str(row["verdict"])
    return SourceFacts(
        estimator, association, phase, source, kind, *counts, nis=nis, low=low, high=high, verdict=verdict,
        outcomes=outcomes,
    )  # fmt: skip


def main_sources(found: Sequence[SourceFacts]) -> list[SourceFacts]:
    """Each source once: as the first filter took it online, else as the first run that used it, else as not used."""
    order = sorted(found, key=lambda s: (not s.used, s.phase != "online", s.estimator not in FILTERS))
    first: dict[tuple[str, str], SourceFacts] = {}
    for s in order:
        first.setdefault((s.source, s.kind), s)
    return [first[key] for key in dict.fromkeys((s.source, s.kind) for s in found)]


def source_lines(found: Sequence[SourceFacts]) -> list[str]:
    """The lines of the terminal, one for each source."""
    return [paragraph("sources#line", s=s) for s in main_sources(found)]


def source_section(
    folder: Path, output: Output, trial: Trial, scores: Scores, found: Sequence[Notice]
) -> list[Section]:
    """Words and table on the sources of a log and task, with the notices about them; none where it has none."""
    facts = source_facts(scores, trial.log.name, trial.task)
    if not facts:
        return []
    where = f"{trial.log.name}, {trial.task}"
    table = scores.sources[(scores.sources["log"] == trial.log.name) & (scores.sources["task"] == trial.task)]
    bounds = [interval(s.low, s.high) if math.isfinite(s.low) else None for s in facts]
    made = table.astype(object).assign(bounds=pd.Series(bounds, index=table.index, dtype=object))
    shown = drop_blank_columns(made[list(HEADS)].rename(columns=HEADS))
    asking = of_runs(n for n in found if "source" in n.named)
    words = say("sources#about", sources=main_sources(facts), asking=asking)
    caption = paragraph("sources#caption", where=where, truth=any(s.outcomes is not None for s in facts))
    blocks = (words, written_table(shown.reset_index(drop=True), folder, stem(trial, "sources"), caption, output))
    return [Section(f"Fixes and closures: {where}", blocks, 3, tuple(facts))]

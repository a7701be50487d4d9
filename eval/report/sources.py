"""What came of fixes and closures, source by source: lines of the terminal, and the section on a log."""

import math
from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from data.notice import Notice
from eval.plan.flags.table import Output
from eval.referee.result_files import Row, rows_of, value_of
from eval.referee.score import Scores, Trial
from eval.replay.settings import FILTERS
from eval.report.page.blocks import Section
from eval.report.page.files import HEADS, drop_blank_columns, interval, stem, written_table
from eval.report.words import of_runs, paragraph, say

COLUMNS: dict[str, str] = HEADS["sources"]
"""Columns of sources.csv (or made here) and their heads."""


def source_facts(scores: Scores, log: str, task: str) -> list[Row]:
    """The rows of sources.csv of a log and task."""
    return [r for r in rows_of(scores.sources) if (r["log"], r["task"]) == (log, task)]


def main_sources(found: Sequence[Row]) -> list[Row]:
    """Each source once: as the first filter took it online, else as the first run that used it, else as not used."""
    order = sorted(found, key=lambda s: (s["used"] == 0, s["phase"] != "online", s["estimator"] not in FILTERS))
    first = {(s["source"], s["kind"]): s for s in reversed(order)}
    return [first[key] for key in dict.fromkeys((s["source"], s["kind"]) for s in found)]


def source_lines(found: Sequence[Row]) -> list[str]:
    """The lines of the terminal, one for each source."""
    return [paragraph("sources#line", s=s) for s in main_sources(found)]


def source_section(folder: Path, output: Output, trial: Trial, scores: Scores, said: Sequence[Notice]) -> list[Section]:
    """Words and table on the sources of a log and task, with the notices about them; none where it has none."""
    facts = source_facts(scores, trial.log.name, trial.task)
    if not facts:
        return []
    where = f"{trial.log.name}, {trial.task}"
    bounds = [(value_of(s, "nis_low"), value_of(s, "nis_high")) for s in facts]
    made = [s | {"bounds": interval(*b) if math.isfinite(b[0]) else None} for s, b in zip(facts, bounds, strict=True)]
    shown = drop_blank_columns(pd.DataFrame(made, dtype=object)[list(COLUMNS)].rename(columns=COLUMNS))
    words = say("sources#about", sources=main_sources(facts), asking=of_runs(n for n in said if "source" in n.named))
    caption = paragraph("sources#caption", where=where, truth=any(s["tp"] is not None for s in facts))
    blocks = (words, written_table(shown, folder, stem(trial, "sources"), caption, output))
    return [Section(f"Fixes and closures: {where}", blocks, 3, tuple(facts))]

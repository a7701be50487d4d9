"""The report's section on the tutorials: their steps, from labels and map given to nothing, with our runs."""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from data.log import folder_name
from eval.figures.studies import Known, knowledge_figure
from eval.figures.style import save
from eval.plan.flags.table import Output
from eval.plan.tutorials import is_tutorial, original_of
from eval.referee.confusion import OUTCOMES
from eval.referee.metrics import heads
from eval.referee.result_files import is_blank
from eval.referee.score import Scores, Trial
from eval.report.page.blocks import Block, Picture, Section
from eval.report.page.files import written_table
from eval.report.page.tables import drop_blank_columns
from eval.report.words import say

SQUARES = "Σ e² [m²]"
HEADS = heads(("rmse_position_m", "rmse_heading_deg", "rmse_landmark_m", "landmarks"))
COUNTS = heads(OUTCOMES)


def given(task: str, association: str) -> str:
    """What the estimator is given."""
    names = [name for name, yes in (("map", task == "localization"), ("labels", association == "known")) if yes]
    return " and ".join(names) or "nothing"


def logs_with_tutorials(trials: Sequence[Trial]) -> list[str]:
    """Names of the logs with two tutorials or more as variants."""
    variants = [t.variant_of for t in trials if t.variant_of is not None and is_tutorial(t)]
    return [name for name in dict.fromkeys(variants) if variants.count(name) > 1]


@dataclass(frozen=True)
class Row:
    """A run in the table: who, given what, its row of `metrics.csv`, and the counts of its decisions."""

    name: str
    given: str
    estimator: str
    association: str
    tutorial: bool
    metrics: Mapping[Hashable, object]
    counts: Mapping[str, int]
    # original: of a tutorial whose own program was run on this recording: sum of squares [m^2], position RMSE [m]
    original: tuple[float, float] | None


def rows_of(log: str, trials: Sequence[Trial], scores: Scores) -> list[Row]:
    """Rows of the tutorials on a log by what is given, after each group our runs; of two phases the final one."""
    counts, metrics = (
        {(r["log"], r["task"], r["estimator"], r["association"]): r for r in table.to_dict("records")}
        for table in (scores.association[scores.association["phase"] == "online"], scores.metrics)
    )  # the last row of a run is its final phase
    made = []
    for trial in trials:
        if trial.log.name != log and not (trial.variant_of == log and is_tutorial(trial)):
            continue
        for run in trial.runs:
            if run.association == "none":
                continue
            key = (trial.log.name, trial.task, run.estimator, run.association)
            last, tutorial = metrics[key], is_tutorial(trial)
            decided = counts.get(key, {})
            counted = {c: int(decided[c]) for c in OUTCOMES if not is_blank(decided.get(c))}
            name = trial.log.name.removeprefix(f"{log}:") if tutorial else f"ours: {run.estimator} ({last['phase']})"
            known = given(run.task, run.association)
            original = original_of(trial) if tutorial else None
            made.append(Row(name, known, run.estimator, run.association, tutorial, last, counted, original))
    order = ["map and labels", "map", "labels", "nothing"]
    return sorted(made, key=lambda r: (order.index(r.given), not r.tutorial))


def table_of(rows: Sequence[Row]) -> pd.DataFrame:
    """The rows as a table."""
    error, *others = HEADS
    made = []
    for row in rows:
        rmse, squares = (None, None) if row.original is None else (row.original[1], row.original[0])
        cells = {
            "run": row.name,
            "given": row.given,
            "association": row.association,
            HEADS[error]: row.metrics[error],
            "original RMSE [m]": rmse,
            **{HEADS[c]: row.metrics[c] for c in others},
            **({SQUARES: row.metrics["sse_position_m2"], "original Σ e² [m²]": squares} if row.tutorial else {}),
            **{COUNTS[c]: row.counts.get(c) for c in OUTCOMES},
            "status": None if row.metrics["status"] == "ok" else row.metrics["status"],
        }
        made.append(cells)
    return drop_blank_columns(pd.DataFrame(made, dtype=object))


def tutorial_sections(folder: Path, wanted: Output, trials: Sequence[Trial], scores: Scores) -> list[Section]:
    """For each log with several tutorials: one table over all its tasks, and the same as a figure."""
    blocks: list[Block] = []
    facts: dict[str, list[Row]] = {}
    for log in logs_with_tutorials(trials):
        rows, name = rows_of(log, trials, scores), f"{folder_name(log)}-knowledge"
        facts[log] = rows
        caption = say("tutorials#caption", log=log, originals=any(r.original for r in rows))
        blocks.append(written_table(table_of(rows), folder, name, caption, wanted))
        if not wanted.no_plots:
            figure = knowledge_figure(f"{log}: knowledge taken away", [_drawn(r) for r in rows])
            save(figure, folder / "figures", name)
            alt = f"Position RMSE and share of wrong decisions on {log}, from map and labels given to nothing"
            blocks.append(Picture(name, say("tutorials#picture", log=log), alt))
    return [Section("From labels and map to nothing", tuple(blocks), facts=facts)] if blocks else []


def _drawn(row: Row) -> Known:
    """A row of the table as the figure takes it."""
    decided = sum(row.counts.values())
    wrong = (row.counts["fp"] + row.counts["fn"]) / decided if decided and row.association != "known" else None
    rmse = row.metrics["rmse_position_m"]
    name, original = f"{row.name}, {row.association}", None if row.original is None else row.original[1]
    rmse = None if is_blank(rmse) else float(str(rmse))
    return Known(name, row.given, row.estimator, row.tutorial, rmse, original, wrong)


def variant_note(trial: Trial, rows: pd.DataFrame) -> str:
    """The rows of a variant in a sentence; of a tutorial the sums of squares, the original's, and its notes."""
    if not is_tutorial(trial):
        return say("tutorials#variant", name=trial.log.name, about=trial.about)
    squares = [
        (what, float(row[column]))
        for row in rows.to_dict("records")
        for column, what in (("sse_position_m2", "positions"), ("sse_landmark_m2", "landmarks"))
        if not is_blank(row[column])
    ]
    known = {"squares": squares, "original": original_of(trial), "notes": trial.runs[0].notes}
    return say("tutorials#variant", name=trial.log.name, about=trial.about, **known)

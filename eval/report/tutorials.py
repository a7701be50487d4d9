"""The report's section on the tutorials: table and figure of knowledge taken away, and the notes beside their rows."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from data.log import folder_name
from eval.figures.knowledge import Known, knowledge_figure
from eval.figures.style import save
from eval.page.document import Block, Picture, Section, written_table
from eval.page.numbers import number
from eval.page.tables import is_blank
from eval.plan.flags.options import Options
from eval.plan.tutorials.recording import is_tutorial, original_of
from eval.referee.score import Scores, Trial
from eval.report.tutorials.table import CAPTION, ORIGINAL, Row, logs_with_tutorials, rows_of, table_of


def tutorial_sections(folder: Path, options: Options, trials: Sequence[Trial], scores: Scores) -> list[Section]:
    """For each log with several tutorials beside it: one table over all its tasks, and the same as a figure."""
    blocks: list[Block] = []
    for log in logs_with_tutorials(trials):
        rows, name = rows_of(log, trials, scores), f"{folder_name(log)}-knowledge"
        caption = CAPTION.format(log=log) + (ORIGINAL if any(r.original for r in rows) else "")
        blocks.append(written_table(table_of(rows), folder, name, caption, options))
        if not options.no_plots:
            figure = knowledge_figure(f"{log}: knowledge taken away", [_drawn(r) for r in rows])
            save(figure, folder / "figures", name, ("png",) if options.quick else ("pdf", "png"))
            alt = f"Position RMSE and share of wrong decisions on {log}, from map and labels given to nothing"
            blocks.append(Picture(name, f"`{log}`: the rows of the table. {MARKS}", alt))
    return [Section("From labels and map to nothing", tuple(blocks))] if blocks else []


MARKS = "Open squares: the tutorials' own programs; hatched bars: the tutorials' treatment."


def _drawn(row: Row) -> Known:
    """A row of the table as the figure takes it."""
    decided = sum(row.counts.values())
    wrong = (row.counts["fp"] + row.counts["fn"]) / decided if decided and row.association != "known" else None
    rmse = row.metrics["rmse_position_m"]
    return Known(
        f"{row.name}, {row.association}", row.given, row.estimator, row.tutorial,
        None if is_blank(rmse) else float(str(rmse)), None if row.original is None else row.original[1], wrong,
    )  # fmt: skip


def beside_note(trial: Trial, rows: pd.DataFrame) -> str:
    """What the rows of a trial beside are; of a tutorial the sums of squares, the original's, and its notes."""
    notes = [f"`{trial.log.name}` is {trial.about}."]
    if not is_tutorial(trial):
        return notes[0]
    for row in rows.to_dict("records"):
        for column, what in (("sse_position_m2", "positions"), ("sse_landmark_m2", "landmarks")):
            if not is_blank(row[column]):
                notes.append(f"Sum of squared errors of {what}: {number(float(row[column]), 5)} m².")
    original = original_of(trial)
    if original is not None:
        notes.append(f"The original program: {original[0]:g} m², position RMSE {original[1]:g} m.")
    return " ".join([*notes, *trial.runs[0].notes])

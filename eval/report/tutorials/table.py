"""One table of the tutorials' steps, from labels and map given to nothing, with our runs on the same log."""

from __future__ import annotations

from collections.abc import Sequence

import pandas as pd

from eval.page.tables import drop_blank_columns
from eval.plan.tutorials.recording import is_tutorial
from eval.referee.confusion import OUTCOMES
from eval.referee.metrics import heads
from eval.referee.score import Scores, Trial

CAPTION = (
    "Knowledge taken away, on the same recording: {log}. Given are the map, the labels, or neither; errors in the world"
    " frame without alignment. TP, TN, FP and FN count decisions about the observations, as they were online."
)
HEADS = heads(("rmse_position_m", "rmse_heading_deg", "rmse_landmark_m", "landmarks"))
COUNTS = heads(OUTCOMES)


def given(task: str, association: str) -> str:
    """What the estimator is given."""
    names = [name for name, yes in (("map", task == "localization"), ("labels", association == "known")) if yes]
    return " and ".join(names) or "nothing"


def logs_with_tutorials(trials: Sequence[Trial]) -> list[str]:
    """Names of the logs beside which two tutorials or more stand."""
    beside = [t.beside for t in trials if t.beside is not None and is_tutorial(t)]
    return [name for name in dict.fromkeys(beside) if beside.count(name) > 1]


def tutorial_table(log: str, trials: Sequence[Trial], scores: Scores) -> pd.DataFrame:
    """Rows of the tutorials beside a log in the order of their names, after each those of ours that are given as much.

    An estimator with two phases stands with its final one; dead reckoning uses no observations and is left out.
    """
    counts = {
        (r["log"], r["task"], r["estimator"], r["association"]): r
        for r in scores.association.to_dict("records")
        if r["phase"] == "online"
    }
    made: list[dict[str, object]] = []
    for trial in trials:
        if trial.log.name != log and not (trial.beside == log and is_tutorial(trial)):
            continue
        for run in trial.runs:
            if run.association == "none":
                continue
            key = (trial.log.name, trial.task, run.estimator, run.association)
            rows = scores.metrics[
                (scores.metrics["log"] == key[0])
                & (scores.metrics["task"] == key[1])
                & (scores.metrics["estimator"] == key[2])
                & (scores.metrics["association"] == key[3])
            ].to_dict("records")
            last, scored = rows[-1], counts.get(key, {})
            name = trial.log.name.removeprefix(f"{log}:")
            made.append({
                "run": name if is_tutorial(trial) else f"ours: {run.estimator} ({last['phase']})",
                "given": given(run.task, run.association), "association": run.association,
                **{head: last[c] for c, head in HEADS.items()}, **{head: scored.get(c) for c, head in COUNTS.items()},
                "status": None if last["status"] == "ok" else last["status"],
            })  # fmt: skip
    order = ["map and labels", "map", "labels", "nothing"]
    made.sort(key=lambda r: (order.index(str(r["given"])), str(r["run"]).startswith("ours")))
    return drop_blank_columns(pd.DataFrame(made, dtype=object))

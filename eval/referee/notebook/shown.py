"""HTML of a trial and of its scores: the main numbers, and the paths of all runs over the true one."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import cycle

import pandas as pd

from data.log import Log
from data.notebook import card
from data.result import Run
from eval.referee import consistency, errors
from eval.referee.metrics import RUN

HEADS = ("estimator", "association", "phase", "status", "position RMSE [m]", "pose NEES (3 expected)")
SHOWN = (*RUN, "status", "rmse_position_m", "rmse_heading_deg", "nees_pose", "nis")


def trial_html(log: Log, task: str, runs: Sequence[Run]) -> str:
    """A row for each run at its last phase, and a map."""
    true = log.truth.pose
    paths = [] if true is None else [card.Path("true path", true[:, :2], card.BLACK)]
    rows = []
    for run, colour in zip(runs, cycle(card.COLOURS), strict=False):
        rmse = nees = ""
        if run.failure is None and run.phases:
            t = run.trajectory(run.phases[-1])
            reckoned = run.estimator == "dead-reckoning"
            paths.append(card.Path(run.estimator, t.pose[:, :2], card.GREY if reckoned else colour, reckoned))
            if true is not None:
                rmse = f"{errors.rms(errors.position_distance(t.pose, true)):.3g}"
                mean = consistency.mean_or_nan(consistency.nees(t.pose, t.covariance, true, "pose"))
                nees = f"{mean:.3g}" if math.isfinite(mean) else ""
        rows.append((run.estimator, run.association, run.phases[-1] if run.phases else "", run.status, rmse, nees))
    return card.side_by_side(f"{log.name}, {task}", card.columns_table(HEADS, rows), card.drawing(paths, ()))


def scores_html(tables: Mapping[str, pd.DataFrame]) -> str:
    """The main columns of `metrics`, and how large each table is."""
    shown = tables["metrics"][list(SHOWN)].to_html(index=False, na_rep="", float_format="{:.3g}".format)
    return f"{shown}<small>{', '.join(f'{name}: {len(table)} rows' for name, table in tables.items())}</small>"

"""Which of two estimators is better on one log: filters against smoothers on the same frames, with interval and p."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from data.log import Log
from data.result import Run
from eval.referee.along import Along
from eval.referee.files import top
from eval.referee.intervals import SEED, run_differences
from eval.referee.paths.given import log_of

DIFFERENCES = top.DIFFERENCES.names
"""Columns of a row; differences are a minus b, `…_why` says why an interval is missing."""


def difference_rows(
    log: Log, task: str, runs: Sequence[Run], errors: Mapping[tuple[int, str], Along]
) -> list[dict[str, object]]:
    """A row for each filter (online) against each smoother (final) under the same association on a log with truth.

    Args:
        log: the log; its name is in the rows.
        task: of the runs.
        runs: all runs of the trial; one without a final path is a filter.
        errors: along the log, by the run's place in `runs` and phase; runs without truth or that failed are missing,
            implausible ones are compared with nobody.

    See `intervals.run_differences` for the numbers; every pair is resampled from the same seed.
    """
    rows: list[dict[str, object]] = []
    for (a, ours), (b, theirs) in _pairs(runs, {k: v for k, v in errors.items() if log_of(runs[k[0]], log) is log}):
        rmse, nees = run_differences(
            (ours.distance**2, theirs.distance**2),
            (ours.nees["pose"], theirs.nees["pose"]),
            np.random.default_rng(SEED),
        )
        row: dict[str, object] = {
            "log": log.name, "task": task, "association": a.association, "a": a.estimator, "b": b.estimator,
            "phase_a": "online", "phase_b": "final", "rmse_position_m": rmse.value, "nees_pose": nees.value,
            "block_frames": rmse.block if not rmse.why else nees.block,
        }  # fmt: skip
        for name, found in (("rmse_position", rmse), ("nees_pose", nees)):
            row |= {f"{name}_lower": found.lower, f"{name}_upper": found.upper, f"{name}_p": found.p}
            row[f"{name}_why"] = found.why or None
        rows.append(row)
    return rows


def _pairs(
    runs: Sequence[Run], errors: Mapping[tuple[int, str], Along]
) -> Iterator[tuple[tuple[Run, Along], tuple[Run, Along]]]:
    kept = {(i, phase) for i, phase in errors if runs[i].flaw is None}
    filters = [(r, errors[i, "online"]) for i, r in enumerate(runs) if r.final is None and (i, "online") in kept]
    smoothers = [(r, errors[i, "final"]) for i, r in enumerate(runs) if (i, "final") in kept]
    for a in filters:
        yield from ((a, b) for b in smoothers if a[0].association == b[0].association)

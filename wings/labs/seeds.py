"""Question 4 over several seeds of a simulated corridor: one log is one draw of noise and of people."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import pandas as pd

from data.log import Log
from data.logs import open_scored
from data.se2 import Array
from eval.plan.provenance import input_digest
from eval.plan.work import Job
from eval.referee.errors import aligned_rmse, position_distance, rms
from eval.referee.score import confusion_of
from eval.replay.run import step_by_step
from eval.replay.settings import Setup
from eval.report.words import plus_minus
from wings.labs.corridor import THE_LABS

SEEDS = 20
JCBB = THE_LABS["jcbb"][0]
METHODS = ("known", "nn", "singles", JCBB)
COLUMNS = ("FP", "FN", "RMSE [m]", "aligned RMSE [m]")


@dataclass(frozen=True)
class Seed:
    """The log of one seed, and a row of `COLUMNS` for each of `METHODS`, online; None: one of them stopped."""

    log: str
    outcomes: tuple[tuple[float, ...], ...] | None


@dataclass(frozen=True)
class OverSeeds:
    """Mean and standard deviation over the seeds in which all methods reached their end, by method and column."""

    logs: tuple[str, ...]  # of these seeds; a single one: the lab's log, which has no generator
    mean: dict[str, tuple[float, ...]]
    deviation: dict[str, tuple[float, ...]]
    # seeds in which JCBB's path is nearer to the truth than the one with labels, as it is and after alignment
    nearer: int
    nearer_aligned: int

    def text(self, method: str, column: str) -> str:
        """Mean ± standard deviation."""
        i = COLUMNS.index(column)
        return plus_minus(self.mean[method][i], self.deviation[method][i])

    @property
    def labels_win(self) -> bool:
        """Whether right pairings give the smaller RMSE on average."""
        return self.mean["known"][2] < self.mean[JCBB][2]


def seed_jobs(log: Log, setup: Setup) -> list[Job[str]]:
    """A job for each seed from the log's own one on; none for a log that no generator makes again."""
    seed = log.source.get("seed")
    if log.source.get("kind") != "corridor" or not isinstance(seed, int):
        return []
    _, _, rest = log.name.removeprefix("corridor:").partition(":")
    names = [f"corridor:{seed + k}" + (f":{rest}" if rest else "") for k in range(SEEDS)]
    if not names or names[0] != log.name or input_digest(open_scored(names[0])) != input_digest(log):
        return []
    return [Job(name, partial(one_seed, name, setup)) for name in names]


def one_seed(name: str, setup: Setup) -> Seed:
    """The filter with every method on one simulated corridor."""
    log = open_scored(name)
    rows = []
    for method in METHODS:
        run = step_by_step("ekf", log.inputs(labels=method == "known").without_map(), "slam", method, setup)
        counts, truth = confusion_of(run, log, "online"), log.truth.pose
        if run.failure is not None or run.online is None or counts is None or truth is None:
            return Seed(name, None)
        path: Array = run.online.pose
        rows.append((counts.fp, counts.fn, rms(position_distance(path, truth)), aligned_rmse(path, truth)))
    return Seed(name, tuple(rows))


def over_seeds(log: Log, seeds: Sequence[Seed]) -> OverSeeds:
    """Mean and spread; without several seeds those of one log, with no numbers."""
    order = {s.log: s for s in sorted(seeds, key=lambda s: int(s.log.split(":")[1]))}
    kept = {name: s.outcomes for name, s in order.items() if s.outcomes is not None}
    if len(kept) < 2:
        return OverSeeds((log.name,), {}, {}, 0, 0)
    table = np.array(list(kept.values()), float)  # (seeds, methods, columns)
    mean, deviation = table.mean(axis=0), table.std(axis=0, ddof=1)
    known, jcbb = METHODS.index("known"), METHODS.index(JCBB)
    nearer = (table[:, jcbb, 2:] < table[:, known, 2:]).sum(axis=0)
    return OverSeeds(
        tuple(kept),
        {m: tuple(row) for m, row in zip(METHODS, mean.tolist(), strict=True)},
        {m: tuple(row) for m, row in zip(METHODS, deviation.tolist(), strict=True)},
        *nearer.tolist(),
    )


def seeds_table(found: OverSeeds) -> pd.DataFrame:
    """A row for each method."""
    rows = [{"method": m, **{c: found.text(m, c) for c in COLUMNS}} for m in METHODS]
    return pd.DataFrame(rows, dtype=object)

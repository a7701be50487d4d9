"""The corridor lab's answers over many seeds: means, intervals of the differences, and how often an answer reverses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import numpy as np
import pandas as pd
import scipy

from data.logs import open_scored
from data.se2 import Array
from eval.plan.work import Job
from eval.referee.errors import aligned_rmse, position_distance, rms
from eval.referee.score import confusion_of
from eval.replay.run import step_by_step
from eval.replay.settings import Setup
from eval.report.words import plus_minus
from wings.labs.corridor import BLIND, JCBB, NAMES, ODOMETRY, PEOPLE, condition
from wings.labs.plan import CONDITIONS, corridor_names

SEEDS = 20
FIRST = JCBB[0]
COLUMNS = ("FP", "FN", "RMSE [m]", "aligned RMSE [m]")


class Case(NamedTuple):
    """A condition of the lab and an association method of its filter."""

    method: str
    people: bool = False
    odometry: bool = True
    maintained: bool = False

    @property
    def condition(self) -> str:
        """As the lab's tables call it."""
        return condition(self.people, self.odometry, self.maintained)

    @property
    def name(self) -> str:
        """As a sentence has it."""
        method = "labels" if self.method == "known" else NAMES[self.method]
        return method if self.condition == "no people" else f"{method} ({self.condition})"


METHODS = ("known", "nn", "singles", FIRST)
CASES = (
    *(Case(m, *ODOMETRY) for m in METHODS),
    *(Case(m, *PEOPLE) for m in METHODS),
    Case(FIRST, *PEOPLE, maintained=True),
    *(Case(m, *BLIND) for m in ("known", FIRST)),
)
CLAIMS = {
    "nn": (("RMSE [m]", Case("nn"), Case("known")),),
    "singles": (("RMSE [m]", Case("nn"), Case("singles")),),
    "people": (("RMSE [m]", Case("nn", *PEOPLE), Case("nn")), ("RMSE [m]", Case("singles", *PEOPLE), Case("singles"))),
    "jcbb": (
        ("FP", Case("nn", *PEOPLE), Case(FIRST, *PEOPLE)),
        ("RMSE [m]", Case("nn", *PEOPLE), Case(FIRST, *PEOPLE)),
    ),
    "blind": (("RMSE [m]", Case(FIRST, *BLIND), Case(FIRST)),),
    "maintenance": tuple((c, Case(FIRST, *PEOPLE), Case(FIRST, *PEOPLE, maintained=True)) for c in ("FP", "RMSE [m]")),
}
"""For each question what is expected to be larger than what."""


@dataclass(frozen=True)
class Seed:
    """The lab of one seed, and a row of `COLUMNS` for each of `CASES`, online; None: one of them stopped."""

    lab: str
    outcomes: tuple[tuple[float, ...], ...] | None


@dataclass(frozen=True)
class Compared:
    """Mean of larger - smaller over the seeds with its 95 % interval (Student's t); seeds with the other sign."""

    column: str
    larger: Case
    smaller: Case
    mean: float
    lower: float
    upper: float
    reversed: int
    seeds: int


@dataclass(frozen=True)
class OverSeeds:
    """Outcomes (seeds, cases, columns) of the seeds in which every case reached its end, in their order."""

    labs: tuple[str, ...]
    outcomes: Array

    def of(self, column: str, case: Case) -> Array:
        """Values (seeds,) of a case."""
        return np.asarray(self.outcomes[:, CASES.index(case), COLUMNS.index(column)])

    def compared(self, question: str) -> list[Compared]:
        """What a question claims."""
        return [self._compared(*claim) for claim in CLAIMS[question]]

    def _compared(self, column: str, larger: Case, smaller: Case) -> Compared:
        off = self.of(column, larger) - self.of(column, smaller)
        n = len(off)
        half = float(scipy.stats.t.ppf(0.975, n - 1) * off.std(ddof=1) / np.sqrt(n))
        mean = float(off.mean())
        return Compared(column, larger, smaller, mean, mean - half, mean + half, int((off * mean < 0.0).sum()), n)

    def nearer(self, column: str) -> int:
        """In how many seeds with people JCBB's path is nearer to the truth than the one with labels."""
        jcbb, known = (self.of(column, Case(m, *PEOPLE)) for m in (FIRST, "known"))
        return int((jcbb < known).sum())

    @property
    def labels_win(self) -> bool:
        """Whether right pairings give the smaller RMSE on average, with people."""
        jcbb, known = (self.of("RMSE [m]", Case(m, *PEOPLE)) for m in (FIRST, "known"))
        return bool(known.mean() < jcbb.mean())

    def table(self) -> pd.DataFrame:
        """A row for each case: mean ± standard deviation."""
        rows = [
            {"condition": case.condition, "method": case.method}
            | {c: plus_minus(float(self.of(c, case).mean()), float(self.of(c, case).std(ddof=1))) for c in COLUMNS}
            for case in CASES
        ]
        return pd.DataFrame(rows, dtype=object)


def seed_jobs(lab: str, setup: Setup) -> list[Job[str]]:
    """A job for each seed from that of `corridor:SEED+KEY=VALUE` on; none for recorded logs."""
    world, _, rest = lab.partition(":")
    seed, plus, keys = rest.replace(":", "+", 1).partition("+")
    if world != "corridor" or not seed.isdigit():
        return []
    names = [f"corridor:{int(seed) + k}{plus}{keys}" for k in range(SEEDS)]
    return [Job(name, partial(one_seed, name, setup)) for name in names]


def one_seed(lab: str, setup: Setup) -> Seed:
    """The filter in every case of one simulated lab."""
    logs = {condition: open_scored(name) for condition, name in zip(CONDITIONS, corridor_names(lab), strict=True)}
    rows = []
    for case in CASES:
        log, how = logs[case.people, case.odometry], replace(setup, maintain=case.maintained)
        inputs = log.inputs(labels=case.method == "known").without_map()
        run = step_by_step("ekf", inputs, "slam", case.method, how)
        counts, truth = confusion_of(run, log, "online"), log.truth.pose
        if run.failure is not None or run.online is None or counts is None or truth is None:
            return Seed(lab, None)
        path: Array = run.online.pose
        rows.append((counts.fp, counts.fn, rms(position_distance(path, truth)), aligned_rmse(path, truth)))
    return Seed(lab, tuple(rows))


def over_seeds(seeds: Sequence[Seed]) -> OverSeeds | None:
    """All seeds together; None if there are not two."""
    order = sorted((s for s in seeds if s.outcomes is not None), key=lambda s: int(s.lab.split(":")[1].split("+")[0]))
    return OverSeeds(tuple(s.lab for s in order), np.array([s.outcomes for s in order])) if len(order) > 1 else None

"""The consistency study: many seeded arenas through the same estimators, and the verdicts on their NEES and NIS."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from data.arena import Arena, simulate
from data.result import Run
from data.se2 import Array
from eval import consistency, errors
from eval.consistency import QUANTITIES, Verdict, verdict
from eval.replay import compare
from eval.score import CONSISTENCY, Trial, frame_of

SCENARIO = "arena"
ARENA = Arena()
ESTIMATORS = ("ekf", "isam2", "batch")
MUST_BE_CONSISTENT = frozenset(("localization", e) for e in ESTIMATORS)
"""Declared: localization in the arena is close enough to linear that a right estimator is consistent. SLAM is not."""

DOF = {**{q: len(c) for q, c in QUANTITIES.items()}, "landmarks": 2, "nis": 1}

Key = tuple[str, str, str, str]
"""(task, estimator, association, phase)"""


@dataclass(frozen=True)
class Sample:
    """What one run contributes: its mean of each quantity (NaN: not available) and its pose NEES per frame (N,)."""

    means: dict[str, float]
    nees_pose: Array
    failure: str | None


@dataclass(frozen=True)
class Study:
    """A finished study: samples by estimator and phase, one per seed in order."""

    scenario: str
    seeds: tuple[int, ...]
    time: Array
    samples: dict[Key, list[Sample]]

    def anees(self, task: str, phase_of: dict[str, str]) -> dict[str, Array]:
        """Average pose NEES (N,) over the runs that did not fail, for the given estimators and phases."""
        result = {}
        for (t, estimator, _, phase), samples in self.samples.items():
            if t == task and phase_of.get(estimator) == phase:
                good = [s.nees_pose for s in samples if s.failure is None]
                if good:
                    result[estimator] = np.mean(good, axis=0)
        return result


def sample(run: Run, phase: str, trial: Trial) -> Sample:
    """Reduce a run to what the verdicts need."""
    truth = trial.log.truth
    if run.failure is not None or truth.pose is None:
        why = "no truth" if run.failure is None else f"frame {run.failure.frame}: {run.failure.why}"
        return Sample({}, np.empty(0), why)
    t = run.trajectory(phase)
    each = {q: consistency.nees(t.pose, t.covariance, truth.pose, q) for q in QUANTITIES}
    means = {q: consistency.mean_or_nan(v) for q, v in each.items()}
    if run.map is not None and len(run.map):
        ids = errors.landmark_true_ids(run.created, truth, run.map.number)
        off = errors.landmark_errors(run.map.xy, ids, truth)
        means["landmarks"] = consistency.mean_or_nan(consistency.squared_distance(off, run.map.covariance))
    if phase == "online" and run.innovations is not None:
        formed = np.isfinite(run.innovations.nis)
        dof = int(run.innovations.dof[formed].sum())
        means["nis"] = float(run.innovations.nis[formed].sum()) / dof if dof else math.nan
    elif phase == "final" and run.total_nis is not None and run.total_nis[1] > 0:
        means["nis"] = run.total_nis[0] / run.total_nis[1]
    return Sample(means, each["pose"], None)


def one_seed(seed: int, tasks: Sequence[str], estimators: Sequence[str], arena: Arena = ARENA) -> dict[Key, Sample]:
    """All tasks and estimators on the arena of one seed."""
    log = simulate(arena, seed)
    result = {}
    for task in tasks:
        trial = Trial(log, task, tuple(compare(log.inputs(labels=True), task, estimators)))
        for run in trial.runs:
            for phase in run.phases:
                result[(task, run.estimator, run.association, phase)] = sample(run, phase, trial)
    return result


def study_of(seeds: Sequence[int], results: Sequence[dict[Key, Sample]], arena: Arena = ARENA) -> Study:
    """The study made of the results of `one_seed`, one per seed in order."""
    samples: dict[Key, list[Sample]] = {}
    for result in results:
        for key, value in result.items():
            samples.setdefault(key, []).append(value)
    return Study(SCENARIO, tuple(seeds), arena.period * np.arange(arena.frames, dtype=np.float64), samples)


@dataclass(frozen=True)
class Judged:
    """One line of consistency.csv: what was tested and what came out."""

    key: Key
    quantity: str
    verdict: Verdict
    diverged: int

    @property
    def declared(self) -> bool:
        """Whether the scenario says this has to be consistent."""
        return self.key[:2] in MUST_BE_CONSISTENT and self.quantity in QUANTITIES


def judge(study: Study) -> list[Judged]:
    """Every verdict of a study. Runs that failed are counted, never averaged in."""
    result = []
    for key, samples in study.samples.items():
        good = [s for s in samples if s.failure is None]
        for quantity, dof in DOF.items():
            means = np.array([s.means.get(quantity, math.nan) for s in good])
            missing = not np.isfinite(means).all() if good else quantity not in QUANTITIES
            if not missing:
                result.append(Judged(key, quantity, verdict(means, dof), len(samples) - len(good)))
    return result


def consistency_table(scenario: str, judged: Sequence[Judged]) -> pd.DataFrame:
    """Rows of consistency.csv."""
    rows = []
    for j in judged:
        task, estimator, association, phase = j.key
        v = j.verdict
        rows.append({
            "scenario": scenario, "estimator": estimator, "quantity": j.quantity, "dof": v.dof, "runs": v.runs,
            "mean": v.mean, "lower": v.lower, "upper": v.upper, "verdict": v.word, "task": task,
            "association": association, "phase": phase, "power": v.power, "diverged": j.diverged,
        })  # fmt: skip
    return frame_of(rows, CONSISTENCY)


def failed_declarations(judged: Sequence[Judged]) -> list[Judged]:
    """Declared verdicts that Holm's procedure rejects at family level 0.1 % (they decide the exit status).

    Fewer than `MIN_RUNS` runs decide nothing. A declared estimator that diverged in some run has failed outright.
    """
    declared = [j for j in judged if j.declared and j.verdict.runs + j.diverged >= consistency.MIN_RUNS]
    tested = [j for j in declared if math.isfinite(j.verdict.p_value)]
    rejected = consistency.holm_rejected([j.verdict.p_value for j in tested])
    bad = [j for j, r in zip(tested, rejected, strict=True) if r]
    return bad + [j for j in declared if j.diverged and j not in bad]

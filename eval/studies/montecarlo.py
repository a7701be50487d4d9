"""Consistency studies: many seeded runs of a scenario through the same estimators; verdicts, and published numbers."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import pandas as pd

from data.inputs import ERRORS
from data.log import Log
from data.result import Run, Systematics
from data.se2 import Array
from data.terminal import in_columns
from eval.compare import compare
from eval.referee import consistency, errors
from eval.referee.consistency import QUANTITIES, Verdict, gated
from eval.referee.plausibility import IMPLAUSIBLE
from eval.referee.result_files import CONSISTENCY, PUBLISHED
from eval.referee.score import nis_of
from eval.replay.external.adapter import able
from eval.studies.scenario import Scenario

DOF = {**{q: len(c) for q, c in QUANTITIES.items()}, "landmarks": 2, "nis": 1}
Key = tuple[str, str, str, str]  # (task, estimator, association, phase)
Result = dict[Key, "Sample"]  # one run of a scenario
COVERED = 0.95  # share of runs whose systematic error is expected inside its claimed interval


@dataclass(frozen=True)
class Sample:
    """Contribution of one run, by quantity; what does not apply is missing, what has no value is NaN."""

    # mean over the run of the NEES (pose, position, heading, landmarks), `nis` per dof over its expectation under the
    # gates, and `whiteness`, the lag-1 correlation of the innovations
    means: Mapping[str, float] = field(default_factory=dict)
    # NEES at the last frame; `error_...`: of an estimated systematic error
    ends: Mapping[str, float] = field(default_factory=dict)
    squares: Mapping[str, float] = field(default_factory=dict)  # mean squares of `position` [m^2], `heading` [rad^2]
    published: Mapping[str, float] = field(default_factory=dict)  # NEES averaged as the scenario's published ones
    nees_pose: Array = field(default_factory=lambda: np.empty(0))  # (N,) pose NEES of frames that count, else NaN
    failure: str | None = None  # where and why it stopped, or is `implausible`; then nothing else is filled in
    trace: str = ""  # the traceback of crashed foreign code
    implausible: bool = False


class Lost(NamedTuple):
    """A failed or implausible run: which, its seed, and where and why."""

    key: Key
    seed: int
    why: str
    implausible: bool


@dataclass(frozen=True)
class Study:
    """A finished study: samples by estimator and phase, one per seed in order; `time` (N,) of the frames."""

    scenario: Scenario
    seeds: tuple[int, ...]
    time: Array
    time_is_index: bool
    samples: dict[Key, list[Sample]]

    def good(self, key: Key) -> list[Sample]:
        """The complete and plausible runs."""
        return [s for s in self.samples[key] if s.failure is None]

    def shown(self, task: str, association: str) -> dict[str, list[Sample]]:
        """Complete runs by estimator, for figures: filters and incremental smoothers online, batch smoothers final."""
        own = [k for k in self.samples if k[0] == task and k[2] in (association, "none")]
        keys = {k[1]: k for k in sorted(own, key=lambda k: k[3] == "online")}
        return {n: good for n in self.scenario.estimators if n in keys and (good := self.good(keys[n]))}

    def failures(self) -> list[Lost]:
        """Every failed or implausible run."""
        each = ((k, n, s) for k, samples in self.samples.items() for n, s in zip(self.seeds, samples, strict=True))
        return [Lost(k, n, s.failure, s.implausible) for k, n, s in each if s.failure is not None]


def traces(study: Study) -> list[str]:
    """The first traceback of each estimator whose foreign code crashed."""
    return [
        f"{study.scenario.name}, {k[0]}: {k[1]} ({k[2]}), seed {seed}:\n{s.trace.rstrip()}"
        for k, samples in study.samples.items()
        for seed, s in [next(((n, s) for n, s in zip(study.seeds, samples, strict=True) if s.trace), (0, Sample()))]
        if s.trace
    ]


def sample(run: Run, phase: str, log: Log, scenario: Scenario) -> Sample:
    """Reduce a run to what the verdicts need."""
    truth = log.truth
    if run.flaw is not None:
        why = f"frame {run.flaw.frame}: {run.flaw.why}"
        return Sample(failure=why, trace=run.flaw.trace, implausible=run.flaw.status == IMPLAUSIBLE)
    assert truth.pose is not None  # a simulator knows
    t = run.trajectory(phase)
    each = {q: consistency.nees(t.pose, t.covariance, truth.pose, q) for q in QUANTITIES}
    first = scenario.from_frame
    means = {q: consistency.mean_or_nan(v[first:]) for q, v in each.items()}
    if run.map is not None and len(run.map):
        off = errors.landmark_errors(run.map.xy, errors.true_ids_of(run, log), truth, log.recorded.sensor)
        means["landmarks"] = consistency.mean_or_nan(consistency.squared_distance(off, run.map.covariance))
    if (total := nis_of(run, phase)) is not None:
        means["nis"] = total[0] / total[1] / gated(run, phase)[0] if total[1] else math.nan
    if phase == "online" and run.innovations is not None:
        correlation, _ = consistency.lag1(run.innovations.white, log.recorded.observations.frame, run.decisions)
        if math.isfinite(correlation):
            means["whiteness"] = correlation
    p = scenario.published
    found = run.errors_online if phase == "online" else run.errors_final
    position = errors.rms(errors.position_distance(t.pose, truth.pose)) ** 2
    return Sample(
        means, {q: float(v[-1]) for q, v in each.items()} | _errors(found, truth.errors),
        {"position": position, "heading": math.radians(errors.heading_rmse_deg(t.pose, truth.pose)) ** 2},
        {q: p.average(v, len(QUANTITIES[q]), first) for q, v in each.items()} if p is not None else {},
        np.concatenate([np.full(min(first, len(t.pose)), np.nan), each["pose"][first:]]),
    )  # fmt: skip


def _errors(found: Systematics | None, truth: Systematics | None) -> dict[str, float]:
    """Squared error of each systematic error at the last frame over its variance; of no truth, errors are zero."""
    if found is None:
        return {}
    true = {} if truth is None else dict(zip(truth.names, truth.mean[-1].tolist(), strict=True))
    off = [m - true.get(name, 0.0) for name, m in zip(found.names, found.mean[-1].tolist(), strict=True)]
    return {f"error_{n}": (o / s) ** 2 for n, o, s in zip(found.names, off, found.sigma[-1].tolist(), strict=True)}


def one_run(scenario: Scenario, seed: int) -> Result:
    """All tasks, association methods and estimators on the log of one seed."""
    result: Result = {}
    for changed in dict.fromkeys(m.world for m in scenario.members):
        names = [m.name for m in scenario.members if m.world == changed]
        log = scenario.simulate(seed, changed)
        for task in scenario.task:
            for association in scenario.association:
                inputs = log.inputs(labels=association == "known")
                there = able(names, task, association, scenario.setup)
                for run in compare(inputs, task, there, association, scenario.setup):
                    for phase in run.phases:
                        result[(task, run.estimator, run.association, phase)] = sample(run, phase, log, scenario)
    return result


def study_of(scenario: Scenario, seeds: Sequence[int], results: Sequence[Result]) -> Study:
    """The study of results of `one_run`, one per seed in order."""
    keys = dict.fromkeys(key for result in results for key in result)
    samples = {key: [_of_phase(result, key) for result in results] for key in keys}
    whole = {key[:3] for key, found in samples.items() if any(s.failure is None for s in found)}
    # a run that failed at once may be filed under a phase that its estimator does not have
    samples = {k: v for k, v in samples.items() if k[:3] not in whole or any(s.failure is None for s in v)}
    recorded = scenario.simulate(seeds[0]).recorded
    order = {name: i for i, name in enumerate(scenario.estimators)}
    ranked = sorted(samples, key=lambda k: (scenario.task.index(k[0]), k[2], order[k[1]], k[3] == "final"))
    return Study(scenario, tuple(seeds), recorded.time, recorded.time_is_index, {k: samples[k] for k in ranked})


def _of_phase(result: Result, key: Key) -> Sample:
    """What one run gives to a phase; if it stopped before that, or has none, its failure."""
    if key in result:
        return result[key]
    other = next((s for k, s in result.items() if k[:3] == key[:3] and s.failure is not None), None)
    return other if other is not None else Sample(failure=f"it has no {key[3]} estimate")


@dataclass(frozen=True)
class Judged:
    """One line of consistency.csv; `declared`: whether the exit status depends on it."""

    scenario: str
    key: Key
    quantity: str
    verdict: Verdict
    diverged: int
    declared: bool = False


@dataclass(frozen=True)
class EstimatorJudgement:
    """An estimator of a study in one phase: its verdicts, and the word that follows from their marks."""

    study: str  # study, runs: name of the scenario, and its number of runs; `diverged`: of these, failed or implausible
    runs: int
    key: Key
    judged: tuple[Judged, ...]  # a verdict for each quantity
    diverged: int
    rmse: float  # of the position [m], over all complete runs
    outside: float  # share of the instants whose NEES, averaged over the runs, is outside its 95 % band

    @property
    def marks(self) -> dict[str, str]:
        """Of the means that are not as claimed, + or −, by quantity."""
        own = (j for j in self.judged if not j.quantity.startswith("coverage"))
        return {j.quantity: consistency.MARKS[j.verdict.word] for j in own if j.verdict.word in consistency.MARKS}

    @property
    def word(self) -> str:
        """The first of `WORDS` among the marked means; else `UNEVEN`, or `consistent`; empty without NEES of poses."""
        words = {j.verdict.word for j in self.judged if j.quantity in self.marks}
        if words:
            return next(word for word in WORDS if word in words)
        if any(j.verdict.word == consistency.TOO_FEW for j in self.judged):
            return consistency.TOO_FEW
        if not any(j.quantity in QUANTITIES for j in self.judged):
            return ""
        return UNEVEN if self.outside > OUTSIDE else consistency.CONSISTENT

    def mean(self, quantity: str) -> float:
        """The mean of a quantity over the runs; NaN without one."""
        return next((j.verdict.mean for j in self.judged if j.quantity == quantity), math.nan)


UNEVEN = "uneven over time"  # the mean fits, but the covariance is too small at some instants and too large at others
OUTSIDE = 0.3
"""Share of instants outside the band of the average NEES from which it is `UNEVEN`. Errors are correlated along a run,
so a consistent estimator has more than 0.05 of them outside: up to 0.09 (docs/notes/verdicts.md)."""
WORDS = (
    consistency.OVERCONFIDENT, consistency.LARGE, consistency.CORRELATED, consistency.CONSERVATIVE, consistency.SMALL,
    consistency.ANTICORRELATED,
)  # fmt: skip
"""Words on marked means, the strongest first."""


def judge_estimators(study: Study, judged: Sequence[Judged]) -> list[EstimatorJudgement]:
    """Each estimator of a study in its last phase; `judged` may be of several studies."""
    found = []
    for key in {k[:3]: k for k in study.samples}.values():
        good = study.good(key)
        own = tuple(j for j in judged if j.scenario == study.scenario.name and j.key == key)
        squares = [s.squares["position"] for s in good]
        rmse = math.sqrt(sum(squares) / len(squares)) if squares else math.nan
        missing = len(study.samples[key]) - len(good)
        found.append(EstimatorJudgement(study.scenario.name, len(study.seeds), key, own, missing, rmse, _outside(good)))
    return found


def _outside(good: Sequence[Sample]) -> float:
    """Share of the instants whose NEES averaged over runs is outside its band; NaN: logs of unequal length."""
    if len({len(s.nees_pose) for s in good}) != 1:
        return math.nan
    average = np.mean([s.nees_pose for s in good], axis=0)
    known = average[np.isfinite(average)]
    lower, upper = consistency.anees_band(DOF["pose"], len(good))
    return float(np.mean((known < lower) | (known > upper))) if len(known) else math.nan


def judge(study: Study) -> list[Judged]:
    """Every verdict of a study. Failed and implausible runs are counted, never averaged."""
    result = []
    for key, samples in study.samples.items():
        good = study.good(key)
        diverged = len(samples) - len(good)
        demanded = study.scenario.declared(key[0], key[1])
        for quantity, v in verdicts(good):
            result.append(Judged(study.scenario.name, key, quantity, v, diverged, demanded and quantity in QUANTITIES))
    return result


def verdicts(good: Sequence[Sample]) -> list[tuple[str, Verdict]]:
    """Every quantity that all these runs have, with its verdict."""
    found: list[tuple[str, Verdict]] = []
    for quantity, dof in DOF.items():
        means = np.array([s.means.get(quantity, math.nan) for s in good])
        if np.isfinite(means).all() if good else quantity in QUANTITIES:
            words = consistency.INNOVATIONS if quantity == "nis" else consistency.ERRORS
            found.append((quantity, consistency.verdict(means, dof, words=words)))
    if good and all("whiteness" in s.means for s in good):
        found.append(("whiteness", consistency.whiteness(np.array([s.means["whiteness"] for s in good]))))
    ends = np.array([s.ends.get("position", math.nan) for s in good])
    if len(ends) and np.isfinite(ends).all():
        for p in consistency.COVERAGE_LEVELS:
            found.append((f"coverage_{100 * p:.0f}", consistency.coverage(ends, DOF["position"], p)))
    for name in ERRORS:
        squares = np.array([s.ends.get(f"error_{name}", math.nan) for s in good])
        if len(squares) and np.isfinite(squares).all():
            found.append((f"covers_{name}", consistency.coverage(squares, 1, COVERED)))
    return found


def consistency_table(judged: Sequence[Judged]) -> pd.DataFrame:
    """The table consistency.csv."""
    rows = []
    for j in judged:
        who = dict(zip(("task", "estimator", "association", "phase"), j.key, strict=True))
        measured = {name: getattr(j.verdict, name) for name in ("dof", "runs", "mean", "lower", "upper", "power")}
        what = {"scenario": j.scenario, "quantity": j.quantity, "verdict": j.verdict.word, "diverged": j.diverged}
        rows.append(who | measured | what)
    return CONSISTENCY.table(rows)


def failed_declarations(judged: Sequence[Judged]) -> list[Judged]:
    """Declared verdicts that Holm's procedure rejects at family level 0.1 % (they decide the exit status). Fewer than
    `MIN_RUNS` runs decide nothing. A declared estimator that diverged in some run has failed.
    """
    declared = [j for j in judged if j.declared and j.verdict.runs + j.diverged >= consistency.MIN_RUNS]
    tested = [j for j in declared if math.isfinite(j.verdict.p_value)]
    bad = [j for j, r in zip(tested, consistency.holm_rejected([j.verdict.p_value for j in tested]), strict=True) if r]
    return bad + [j for j in declared if j.diverged and j not in bad]


SQUARES = {"rmse_position_m": ("position", 1.0), "rmse_heading_deg": ("heading", 180.0 / np.pi)}


@dataclass(frozen=True)
class Estimate:
    """Our number with its standard error, from `runs` independent runs."""

    value: float
    se: float
    runs: int


def mean_of(values: Sequence[float]) -> Estimate:
    """Mean and its standard error."""
    x = np.asarray(values, float)
    return Estimate(float(x.mean()), float(x.std(ddof=1) / math.sqrt(len(x))) if len(x) > 1 else math.nan, len(x))


def rms_of(squares: Sequence[float], scale: float = 1.0) -> Estimate:
    """Pooled root mean square of each run's mean squared error; standard error to first order."""
    m = mean_of(squares)
    root = math.sqrt(m.value)
    return Estimate(scale * root, scale * m.se / (2.0 * root) if root > 0 else math.nan, m.runs)


def difference(ours: Estimate, published: float, se_published: float) -> float:
    """Difference in standard errors of the difference."""
    spread = math.hypot(ours.se, se_published)
    return (ours.value - published) / spread if spread > 0 else math.nan


def published_rows(study: Study) -> list[Mapping[str, object]]:
    """Rows of published.csv for every published number of a study's scenario whose estimator ran."""
    p, rows = study.scenario.published, list[Mapping[str, object]]()
    for row in () if p is None else p.rows:
        if (ours := ours_of(study, row.estimator, row.quantity)) is not None:
            who, off = (study.scenario.name, row.estimator, row.quantity), difference(ours, row.value, row.se)
            values = *who, ours.value, ours.se, row.value, row.se or math.nan, off
            rows.append(dict(zip(PUBLISHED.names, values, strict=True)))
    return rows


def ours_of(study: Study, estimator: str, quantity: str) -> Estimate | None:
    """Our value (filters online) and standard error; None: the estimator has no complete run."""
    found = [k for k in study.samples if k[1] == estimator]
    key = next((k for k in found if k[3] == "online"), found[0] if found else None)
    good = [] if key is None else study.good(key)
    if not good:
        return None
    if quantity in SQUARES:
        name, scale = SQUARES[quantity]
        return rms_of([s.squares[name] for s in good], scale)
    return mean_of([s.published[quantity.removeprefix("nees_")] for s in good])


def lines(rows: Sequence[Mapping[str, object]]) -> list[str]:
    """The rows as terminal text: ours, published, difference in standard errors."""
    if not rows:
        return []
    table = [("scenario", "estimator", "quantity", "ours", "published", "difference [SE]")]
    for r in rows:
        who = str(r["scenario"]), str(r["estimator"]), str(r["quantity"])
        both = _pair(r["ours"], r["se_ours"]), _pair(r["published"], r["se_published"])
        table.append((*who, *both, f"{float(str(r['difference_in_se'])):+.2f}"))
    return in_columns(table)


def _pair(value: object, se: object) -> str:
    v, s = float(str(value)), float(str(se))
    return f"{v:.4g} ± {s:.2g}" if np.isfinite(s) else f"{v:.6g}"

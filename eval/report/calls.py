"""One call from Python for what a command does: a Monte Carlo study, a diagnosis from replicates, scores of files."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from data.errors import UsageError
from data.log import Log
from eval.compare import compare
from eval.judgement.causes import Terms, terms_of
from eval.plan.execute import trusted
from eval.plan.experiment import Experiment, Unfinished, Work
from eval.plan.flags.table import TWINS, Execution, Options, Output, Scoring, Study as Simulated
from eval.plan.work import Job, work
from eval.referee.score import Trial
from eval.replay.external.adapter import Loaded, Thing, adopt, load, objects, text_of
from eval.replay.external.spec import introduce, is_foreign, name_of
from eval.replay.flag import read_values, rows
from eval.replay.settings import Setup
from eval.report.diagnosis import first_words
from eval.report.results import scored, scores
from eval.studies import montecarlo
from eval.studies.diagnosis import Trust, trust_table
from eval.studies.montecarlo import DOF, Result, consistency_table, judge, one_run, study_of
from eval.studies.scenario import OWN, Member, Scenario

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Maker = Callable[[int], Log]
LISTED = "logs"  # name of a study of given logs


@dataclass(frozen=True, eq=False)
class Study:
    """A finished Monte Carlo study; `done` holds every run.

    Example:
        >>> found = slamref.study([log], ["ekf"], task="localization")
        >>> found.verdicts[["estimator", "phase", "quantity", "mean", "lower", "upper", "power", "verdict"]]
        >>> found.figure().savefig("anees.pdf")
    """

    done: montecarlo.Study

    @property
    def verdicts(self) -> pd.DataFrame:
        """Rows of consistency.csv: mean of each quantity over the runs, its 95 % bounds, power, and verdict."""
        return consistency_table(judge(self.done))

    @property
    def runs(self) -> pd.DataFrame:
        """A row for each run of each estimator: seed, RMSE, the means that are judged, and why it failed, if so."""
        rows = []
        for key, samples in self.done.samples.items():
            for seed, s in zip(self.done.seeds, samples, strict=True):
                who = dict(zip(("task", "estimator", "association", "phase"), key, strict=True))
                rmse = {f"rmse_{q}_{unit}": s.squares.get(q, np.nan) ** 0.5 for q, unit in UNITS}
                nees = {q if q in ("nis", "whiteness") else f"nees_{q}": value for q, value in s.means.items()}
                rows.append({"seed": seed, **who, **rmse, **nees, "failure": s.failure or ""})
        return pd.DataFrame(rows)

    def figure(self, task: str | None = None, association: str | None = None) -> Figure:
        """NEES averaged over the runs at each frame with its 95 % band, as in the report. Raises UsageError: no run of
        this task and association method is good, or the logs differ in length.
        """
        from eval.figures.claims import anees_figure

        d, s = self.done, self.done.scenario
        task = task or s.task[0]
        shown = d.shown(task, association or name_of(s.association[0]))
        lengths = {len(x.nees_pose) for found in shown.values() for x in found}
        if len(lengths) != 1:
            raise UsageError("no good run" if not lengths else "the logs differ in length, so there is no common time")
        average = {name: np.mean([x.nees_pose for x in found], axis=0) for name, found in shown.items()}
        runs, title = min(map(len, shown.values())), f"{s.name}, {task}"
        return anees_figure(d.time, average, DOF["pose"], runs, title=title, time_is_index=d.time_is_index)

    def __repr__(self) -> str:
        shown = self.verdicts[["task", "estimator", "phase", "quantity", "mean", "lower", "upper", "verdict"]]
        return f"{len(self.done.seeds)} runs of {self.done.scenario.name}\n{shown.to_string(index=False)}"

    def _repr_html_(self) -> str:
        return str(self.verdicts.to_html(index=False, na_rep="", float_format="{:.3g}".format))


UNITS = (("position", "m"), ("heading", "rad"))


def study(
    world: Maker | Sequence[Log] | str, estimators: Sequence[str | Thing] = ("ekf", "batch"),
    associations: Sequence[str | Thing] = ("known",), *, task: str = "slam", runs: int = 50, seed: int = 0,
    jobs: int = 1, setup: Setup | None = None, from_frame: int = 0,
) -> Study:  # fmt: skip
    """Many logs through the same estimators, and whether each is consistent.

    Args:
        world: a function that makes the log of a seed, with truth; or logs; or the text `./mine.py:make`.
        estimators: names, texts `FILE.py:NAME`, or classes (docs/extending.md).
        associations: the same, or functions.
        task: `slam` or `localization`.
        runs: their number; of logs: all.
        seed: the first one.
        jobs: processes; the numbers are the same for any.
        setup: gates and other settings.
        from_frame: the first frame whose NEES counts.

    Raises:
        UsageError: an unknown name, an impossible combination, or a world that makes no log.

    Example:
        >>> found = slamref.study(lambda seed: slamref.open_log(f"arena:{seed}:frames=30"), ["ekf"], runs=2)
        >>> found.runs[["seed", "estimator", "rmse_position_m", "nees_pose"]]
    """
    logs = None if callable(world) or isinstance(world, str) else list(world)
    seeds = range(seed, seed + runs) if logs is None else range(len(logs))
    if not seeds:
        raise UsageError("a study needs at least one log")
    maker = text_of(world if logs is None else _always(logs[0]), "world")  # type: ignore[arg-type]
    members = tuple(Member(text_of(e, "estimator")) for e in estimators)
    methods = tuple(text_of(a, "association") for a in associations)
    texts = (*(m.name for m in members), *methods)
    for text in filter(is_foreign, (*texts, maker)):
        load(text)
    introduce(name_of(text) for text in texts if is_foreign(text))
    named = LISTED if logs is not None else name_of(maker)
    about = (named, "", "", "", len(seeds), (task,), methods, members, OWN, ())
    scenario = Scenario(*about, maker=maker, setup=setup or Setup(), from_frame=from_frame)
    live = objects((*texts, maker))
    own = {s: live if logs is None else live | {maker: replace(live[maker], thing=_always(logs[s]))} for s in seeds}
    done = dict(work([Job(s, _one, (own[s], scenario, s)) for s in seeds], Execution(jobs=jobs)))
    adopt(own[seeds[0]])
    return Study(study_of(scenario, list(seeds), [done[s] for s in seeds]))


def _always(log: Log) -> Maker:
    def make(seed: int) -> Log:
        return log

    return make


def _one(live: dict[str, Loaded], scenario: Scenario, seed: int) -> Result:
    adopt(live)
    return one_run(scenario, seed)


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """What replicates of a log say about it, without ground truth.

    Example:
        >>> found = slamref.twins(log, count=19, task="localization")
        >>> print(found.cause, found.p, found.words())
    """

    trust: Trust
    terms: Terms

    @property
    def table(self) -> pd.DataFrame:
        """Rows of trust.csv: each statistic, what the replicates have, and its p values."""
        return trust_table([self.trust])

    @property
    def cause(self) -> str:
        """`nothing`, `noise`, `associations`, `estimator`, or that it is not in the list; empty without a diagnosis."""
        return "" if self.trust.blame is None else self.trust.blame.cause

    @property
    def p(self) -> float:
        """The smallest family-wise p value; NaN without a diagnosis."""
        return float("nan") if self.trust.blame is None else self.trust.blame.p

    def words(self) -> str:
        """The answer in a sentence or two, as in the report."""
        return first_words(self.trust, terms=self.terms)

    def __repr__(self) -> str:
        return self.words()


def twins(
    log: Log, estimators: Sequence[str | Thing] = ("ekf", "batch"), association: str | Thing = "known", *,
    task: str = "slam", count: int = TWINS, seed: int = 0, jobs: int = 1, setup: Setup | None = None,
) -> Diagnosis:  # fmt: skip
    """Diagnose a log without ground truth, from bootstrap replicates of its own noise model.

    Args:
        log: its truth is not used.
        estimators: as for `compare`; `batch` is always among them.
        association: as for `compare`.
        task: `slam` or `localization`.
        count: replicates, at least 19.
        seed: the first of theirs.
        jobs: processes.
        setup: gates and other settings.

    Raises:
        UsageError: an unknown name, or a log of which no replicates can be drawn.

    Example:
        >>> slamref.twins(log, ["ekf"], count=19, task="localization").table
    """
    settings = setup or Setup()
    if jobs > 1 and not all(isinstance(what, str) for what in (*estimators, association)):
        raise UsageError("with several processes, estimators and association methods are given as FILE.py:NAME")
    texts = [text_of(e, "estimator") for e in dict.fromkeys([*estimators, "batch"])]
    method = text_of(association, "association")
    inputs = log.inputs(labels=method == "known")
    made = compare(inputs if task == "localization" else inputs.without_map(), task, texts, method, settings)
    experiment = Experiment(log, task, (Work(method, tuple(texts)),), settings)
    trial = Trial(log, task, tuple(made))
    with tempfile.TemporaryDirectory() as folder:  # replicates are kept only until the end
        output, execution = Output(out=Path(folder) / "none"), Execution(jobs=jobs, quiet=True)
        options = Options(study=Simulated(twins=count, seed=seed), output=output, execution=execution)
        found = trusted([experiment], [trial], options, Unfinished(1), lambda done, of: None)
    if not found:
        raise UsageError(f"{log.name}: no run to diagnose")
    return Diagnosis(found[0], terms_of(log.recorded))


def score_files(estimate: str | Path, truth: str | Path, **reading: object) -> dict[str, float]:
    """The numbers of `slamref score ESTIMATE TRUTH` by name: errors, relative errors, NEES; in space where both are.

    Args:
        estimate: a trajectory file (docs/results-files.md).
        truth: another one, or a log.
        reading: the flags of `slamref score`, as in `align="se2"`, `cov="estimate.cov"` or `unit=["truth=ns"]`.

    Raises:
        DataError: a file that cannot be read, or matched.
        UsageError: an unknown flag or value.

    Example:
        >>> slamref.score_files("estimate.tum", "truth.tum", align="se2")["rmse_position_m"]
    """
    if unknown := sorted(set(reading) - set(rows(Scoring))):
        raise UsageError(f"{unknown[0]}: unknown; known: {', '.join(rows(Scoring))}")
    flags = Scoring(**read_values(Scoring, reading, lambda row: f"{row.name} ="))
    return scores(scored(str(estimate), str(truth), flags))

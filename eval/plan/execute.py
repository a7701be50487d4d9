"""Execution of a plan in parallel; the numbers are the same for any number of processes, and on a cluster."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from typing import Any

from data.log import Log
from data.notice import Notice
from data.result import Run
from eval.plan.calibrate import settle
from eval.plan.console import say_kept
from eval.plan.diagnoses import trusted
from eval.plan.experiment import MISSING_RUN, Experiment, Unfinished, Work, estimate, incomplete, wanted
from eval.plan.experiments import Plan
from eval.plan.flags.table import Options
from eval.plan.results import with_results
from eval.plan.work import Job, work
from eval.referee.score import Trial
from eval.studies import store
from eval.studies.diagnosis import Trust
from eval.studies.montecarlo import Study, one_run, published_rows, study_of


@dataclass(frozen=True)
class Part:
    """Owner of a job: a part of the work of the experiment with this number."""

    experiment: int
    work: Work


@dataclass(frozen=True)
class Seeded:
    """Owner of a job: a run of the study with this number."""

    study: int
    seed: int


Owner = Part | Seeded


@dataclass(frozen=True)
class Outcome:
    """All results."""

    trials: tuple[Trial, ...]  # trials, studies: of logs, and of scenarios
    studies: tuple[Study, ...]
    published: tuple[Mapping[str, object], ...] = ()  # rows of published.csv
    skipped: tuple[str, ...] = ()  # messages about work that could not be done
    trust: tuple[Trust, ...] = ()  # consistency of each log without ground truth, per association method
    missing: tuple[Notice, ...] = ()  # results missing for lack of memory


def execute(plan: Plan, options: Options, progress: Callable[[int, int], None]) -> Outcome:
    """Run everything as independent jobs: those with iSAM2 first (they take longest), one per seed. Runs of studies are
    cached on disk. Results of jobs that run out of memory are missing.
    """
    execution, watched = options.execution, not options.output.no_plots
    lost = Unfinished(execution.jobs)
    experiments = settle(plan.experiments, execution, lost)
    seeds = {(i, options.study.seed + k): s for i, (s, runs) in enumerate(plan.studies) for k in range(runs)}
    folders = [store.folder_of(options.output.kept, scenario) for scenario, _ in plan.studies]
    done: dict[Owner, Any] = {Seeded(i, n): r for i, n in seeds if (r := store.load(folders[i], n)) is not None}
    parts = [Part(i, part) for i, e in enumerate(experiments) for w in e.work for part in w.parts()]
    jobs: list[Job[Owner]] = []
    for part in sorted(parts, key=lambda part: "isam2" not in part.work.estimators):
        e = experiments[part.experiment]
        jobs.append(Job(part, estimate, (e, part.work, watched), seconds_of(e.log, part.work)))
    jobs += [Job(Seeded(*key), one_run, (s, key[1])) for key, s in seeds.items() if Seeded(*key) not in done]
    say_kept(len(done), len(seeds), execution.quiet)
    progress(0, len(jobs))
    near, far = jobs, list[Job[Owner]]()
    if execution.scheduler:  # a cluster does the runs of studies, which come first
        near = [job for job in jobs if not isinstance(job.owner, Seeded)]
        far = [job for job in jobs if isinstance(job.owner, Seeded)]
    results = chain(work(far, execution, far=True, lost=lost), work(near, execution, lost=lost))
    for count, (owner, result) in enumerate(results, start=1):
        done[owner] = result
        if isinstance(owner, Seeded):
            store.save(folders[owner.study], owner.seed, result)
        progress(count, len(jobs))
    trials = _trials(experiments, done, lost)

    def more(count: int, of: int) -> None:
        progress(len(jobs) + count, len(jobs) + of)

    trust = trusted(experiments, trials, options, lost, more)
    for missing, why in lost.jobs.items():
        if isinstance(missing, Seeded):
            lost.say("study", why, name=plan.studies[missing.study][0].name, seed=missing.seed)
    studies = []
    for i, (scenario, _) in enumerate(plan.studies):
        own = sorted(owner.seed for owner in done if isinstance(owner, Seeded) and owner.study == i)
        if own:
            studies.append(study_of(scenario, own, [done[Seeded(i, seed)] for seed in own]))
    return Outcome(
        trials=tuple(with_results(trials, plan.given)), studies=tuple(studies),
        published=tuple(row for study in studies for row in published_rows(study)), skipped=plan.skipped, trust=trust,
        missing=tuple(lost.messages),
    )  # fmt: skip


def seconds_of(log: Log, work: Work) -> float:
    """Approximate processor time: 0.2 ms an observation with labels, 2 ms without; infinite for laser logs."""
    if log.recorded.scans is not None:
        return math.inf
    each = 2e-4 if work.association == "known" else 2e-3
    return each * len(log.recorded.observations.frame) * len(work.estimators)


def _trials(experiments: Sequence[Experiment], done: Mapping[Owner, list[Run]], lost: Unfinished) -> list[Trial]:
    """The runs of every experiment; those of parts that ran out of memory are incomplete."""
    trials = []
    for i, e in enumerate(experiments):
        groups = [runs for owner, runs in done.items() if isinstance(owner, Part) and owner.experiment == i]
        runs = {(r.association, r.estimator): r for group in groups for r in group}
        for part, why in lost.jobs.items():
            for name in part.work.estimators if isinstance(part, Part) and part.experiment == i else ():
                run = incomplete(name, part.work.association, e.task, e.log.recorded, why)
                runs[run.association, run.estimator] = run
                about = MISSING_RUN.about(log=e.log.name, task=e.task, estimator=name)
                lost.say("run", why, about.about(association=part.work.association))
        trials.append(Trial(e.log, e.task, tuple(runs[key] for key in wanted(e.work)), e.variant_of, e.about))
    return trials

"""Execution of a plan in parallel, and diagnoses of its logs; the numbers are the same for any number of processes."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain, pairwise
from pathlib import Path
from typing import Any

from data.errors import UsageError
from data.log import Log
from data.notice import Code, Notice, notice
from data.result import Failure, Run
from eval.plan.calibrate import settle
from eval.plan.console import say_kept
from eval.plan.experiment import MISSING_RUN, Experiment, Unfinished, Work, estimate, wanted
from eval.plan.experiments import Plan
from eval.plan.flags.table import TWINS, Options, Study as Simulated
from eval.plan.results import with_results
from eval.plan.work import Job, cached, work
from eval.referee.score import Trial
from eval.replay.external.spec import is_foreign, name_of
from eval.replay.recorder import missing_run
from eval.replay.settings import FILTERS, Setup, steps
from eval.studies import store, twins
from eval.studies.diagnosis import FEWEST, Trust, judged, settled, slopes_p
from eval.studies.montecarlo import Study, one_run, published_rows, study_of
from eval.studies.twins import Sample, Source, digest_of, inputs_of, one_twin, sample_of, smoother_of, source_of


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
                run = missing_run(name, part.work.association, e.task, e.log.recorded, Failure("incomplete", 0, why))
                runs[run.association, run.estimator] = run
                about = MISSING_RUN.about(log=e.log.name, task=e.task, estimator=name)
                lost.say("run", why, about.about(association=part.work.association))
        trials.append(Trial(e.log, e.task, tuple(runs[key] for key in wanted(e.work)), e.variant_of, e.about))
    return trials


LOOK = 20  # twins after which it is asked whether more would change the answer
Progress = Callable[[int, int], None]


@dataclass(frozen=True, eq=False)
class Group:
    """All runs of a log and task with one association method; `twins`: estimators to run on twins (none: no twins).
    `association` and `twins` are spelled as for `compare`, names in `runs` as in tables.
    """

    log: Log
    task: str
    association: str
    setup: Setup
    runs: tuple[Run, ...]
    twins: tuple[str, ...]

    def lacks(self, lost: Unfinished, why: Notice, seed: int | None = None) -> None:
        """Report to `lost` that a result is missing."""
        about = MISSING_RUN.about(log=self.log.name, task=self.task, association=name_of(self.association))
        lost.say("trust", why, about, seed=seed)


def trusted(
    experiments: Sequence[Experiment], trials: Sequence[Trial], options: Options, lost: Unfinished, progress: Progress
) -> tuple[Trust, ...]:
    """Consistency of each log and association method, in order; what runs out of memory is reported to `lost`."""
    groups = [g for e, t in zip(experiments, trials, strict=True) for g in _groups(e, t, options.study)]
    jobs = [Job(i, statistics_of, (g,)) for i, g in enumerate(groups)]
    found = dict(work(jobs, options.execution, lost=lambda i, why: groups[i].lacks(lost, why)))
    return _with_twins([(groups[i], *found[i]) for i in sorted(found)], _count(options.study), options, lost, progress)


def _count(study: Simulated) -> int:
    return (TWINS if study.full else 0) if study.twins is None else study.twins


def _groups(e: Experiment, trial: Trial, study: Simulated) -> list[Group]:
    groups = []
    for association in dict.fromkeys(w.association for w in e.work):
        runs = tuple(r for r in trial.runs if r.association == name_of(association))
        texts = {name_of(text): text for w in e.work for text in w.estimators if is_foreign(text)}
        filters = tuple(texts.get(r.estimator, r.estimator) for r in runs if r.estimator in (*FILTERS, *texts))
        twins = filters or tuple(r.estimator for r in runs if steps(r.estimator))
        if study.full and study.twins is None:
            own = tuple(f for f in filters if f == "ekf" or is_foreign(f))
            twins = own if association == "known" and "ekf" in filters else ()
        if not _count(study) or e.variant_of is not None:
            twins = ()
        groups.append(Group(e.log, e.task, association, e.setup, runs, twins))
    return [g for g in groups if any(steps(r.estimator) for r in g.runs)]


def statistics_of(group: Group) -> tuple[Sample, Run | None]:
    """Statistics of a log, and its smoother; None without batch and twins."""
    inputs = inputs_of(group.log, group.task, group.association)
    smoother = None
    if group.twins or any(r.estimator == "batch" for r in group.runs):
        smoother = smoother_of(group.runs, inputs)
    return sample_of(group.log, group.task, group.association, group.runs, smoother), smoother


def _with_twins(
    real: Sequence[tuple[Group, Sample, Run | None]], count: int, options: Options, lost: Unfinished, progress: Progress
) -> tuple[Trust, ...]:
    """Every log compared with its twins, whose statistics are cached on disk."""
    sources: dict[int, tuple[Source, Path]] = {}
    none: dict[int, Notice] = {}
    for i, (group, _, smoother) in enumerate(real):
        if group.twins and smoother is not None:
            try:
                source = source_of(group.log, smoother, group.twins, group.setup, group.association)
            except UsageError as fault:
                none[i] = notice(Code.NO_TWINS, why=str(fault))
                continue
            sources[i] = source, store.kept_folder(options.output.kept, f"{group.log.name}-twins", digest_of(source))
    seeds = range(options.study.seed, options.study.seed + count)

    def missing(owner: tuple[int, int], why: Notice) -> None:
        real[owner[0]][0].lacks(lost, why, owner[1])

    groups = {i: real[i][0] for i in sources}
    slopes = {i: slopes_p(g.log, g.task, g.association, *real[i][1:]) for i, g in groups.items()}
    kept: dict[tuple[int, int], Sample] = {}

    def own(i: int) -> list[Sample]:
        return [kept[i, seed] for seed in seeds if (i, seed) in kept]

    for before, upto in pairwise([0, *range(FEWEST, count - LOOK + 1, LOOK), count]):
        jobs = [
            (Job((i, seed), one_twin, (source, seed)), folder / f"{seed}.json")
            for i, (source, folder) in sources.items() if not (before and settled(real[i][1], own(i), slopes[i]))
            for seed in seeds[before:upto]
        ]  # fmt: skip
        kept |= cached(jobs, twins.load, twins.save, options.execution, missing, progress)
    judgements = []
    for i, (group, sample, smoother) in enumerate(real):
        judgements.append(Job(i, judged, (group.log, group.task, name_of(group.association), sample, own(i), smoother)))
    result = dict(work(judgements, options.execution))
    if 0 < count < FEWEST:
        few = notice(Code.TOO_FEW_TWINS, twins=count, least=FEWEST)
        none = {i: few for i, (group, _, _) in enumerate(real) if group.twins} | none
    for i, why in none.items():
        result[i] = replace(result[i], notices=(*result[i].notices, why))
    return tuple(result[i] for i in range(len(real)))

"""What a run consists of (logs, tasks, estimators, ways of association, studies), done in parallel.

The numbers are the same for any number of processes, and on a cluster.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from joblib import Parallel, delayed

from data.log import Log
from data.result import Run
from eval.plan.cluster import Call, on_cluster
from eval.plan.experiments import Experiment, Plan, Work
from eval.plan.options import Options
from eval.plan.tutorial import ABOUT, tutorial_run, variant_log
from eval.plan.variant import Variant
from eval.referee.score import Trial
from eval.replay.run import compare
from eval.studies import store
from eval.studies.montecarlo import Result, Study, one_run, study_of
from eval.studies.reproduced import published_rows
from eval.studies.stored_run import replay_stored

Owner = tuple[str, int, int]
"""What a job belongs to: its kind, which of them, and (of a study) the seed."""


@dataclass(frozen=True)
class Outcome:
    """Everything done; `published`: the rows of published.csv, `skipped`: what could not be done, a sentence each."""

    trials: tuple[Trial, ...]
    studies: tuple[Study, ...]
    published: tuple[Mapping[str, object], ...] = ()
    skipped: tuple[str, ...] = ()


def _estimate(experiment: Experiment, work: Work) -> list[Run]:
    log, known = experiment.log, work.association == "known"
    return compare(log.inputs(labels=known), experiment.task, work.estimators, work.association, experiment.setup)


def _tutorial(log: Log, variant: Variant) -> Trial:
    changed = variant_log(log, variant)
    return Trial(changed, variant.task, (tutorial_run(changed, variant),), log.name, ABOUT)


def execute(plan: Plan, options: Options, progress: Callable[[int, int], None]) -> Outcome:
    """Run everything as independent jobs: those with iSAM2 first (they take longest), each seed by itself.

    A run of a study is kept on disk as soon as it is done, and taken from there if it was done before.
    """
    jobs: list[tuple[Owner, Call]] = []
    for i, experiment in enumerate(plan.experiments):
        jobs += [(("trial", i, 0), (_estimate, (experiment, p))) for work in experiment.work for p in work.parts()]
    variants = [(e, v) for e in plan.experiments for v in options.variants if e.task == v.task and e.beside is None]
    jobs += [(("variant", i, 0), (_tutorial, (e.log, v))) for i, (e, v) in enumerate(variants)]
    jobs += [(("stored", i, 0), (replay_stored, asked)) for i, asked in enumerate(plan.stored)]
    jobs.sort(key=lambda job: not (job[0][0] == "trial" and "isam2" in job[1][1][1].estimators))
    studies = [range(options.seed, options.seed + runs) for _, runs in plan.studies]
    kept: dict[tuple[int, int], Result] = {}
    folders = [store.folder_of(options.out.absolute().parent, scenario) for scenario, _ in plan.studies]
    for i, (scenario, _) in enumerate(plan.studies):
        for seed in studies[i]:
            found = store.load(folders[i], seed)
            if found is None:
                jobs.append((("study", i, seed), (one_run, (scenario, seed))))
            else:
                kept[i, seed] = found
    results: dict[tuple[str, int], list[Any]] = {}
    for done, ((kind, i, seed), result) in enumerate(_work(jobs, options), start=1):
        if kind == "study":
            store.save(folders[i], seed, result)
            kept[i, seed] = result
        else:
            results.setdefault((kind, i), []).append(result)
        progress(done, len(jobs))
    trials = []
    for i, e in enumerate(plan.experiments):
        runs = {(r.association, r.estimator): r for group in results.get(("trial", i), []) for r in group}
        wanted = [("none" if n == "dead-reckoning" else w.association, n) for w in e.work for n in w.estimators]
        trials.append(Trial(e.log, e.task, tuple(runs[key] for key in dict.fromkeys(wanted)), e.beside, e.about))
    trials += [results["variant", i][0] for i in range(len(variants))]
    replayed = [results["stored", i][0] for i in range(len(plan.stored))]
    finished = tuple(
        study_of(scenario, seeds, [kept[i, seed] for seed in seeds])
        for i, ((scenario, _), seeds) in enumerate(zip(plan.studies, studies, strict=True))
    )
    published = [row for _, rows in replayed for row in rows] + [row for s in finished for row in published_rows(s)]
    return Outcome((*trials, *(t for t, _ in replayed)), finished, tuple(published), plan.skipped)


def _work(jobs: list[tuple[Owner, Call]], options: Options) -> Iterator[tuple[Owner, Any]]:
    """Results with their owners as they come; with `--scheduler` the runs of studies are done on the cluster."""
    far = [job for job in jobs if job[0][0] == "study"] if options.scheduler else []
    near = [job for job in jobs if not far or job[0][0] != "study"]
    if options.scheduler:
        for i, result in on_cluster(options.scheduler, [call for _, call in far]) if far else ():
            yield far[i][0], result
    pool = Parallel(n_jobs=min(options.jobs, max(len(near), 1)), return_as="generator_unordered")
    for i, result in pool(delayed(_numbered)(i, *call) for i, (_, call) in enumerate(near)):
        yield near[i][0], result


def _numbered(i: int, function: Callable[..., Any], arguments: tuple[Any, ...]) -> tuple[int, Any]:
    return i, function(*arguments)

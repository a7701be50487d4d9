"""What a run consists of (logs, tasks, estimators, ways of association, studies), done in parallel.

The numbers are the same for any number of processes, and on a cluster.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import chain
from typing import Any

from data.log import Log
from data.result import Run
from eval.plan.cluster import Call
from eval.plan.experiments import Experiment, Plan, Work
from eval.plan.options import Options
from eval.plan.trust import trusted
from eval.plan.tutorial import ABOUT, tutorial_run, variant_log
from eval.plan.validation import validated
from eval.plan.variant import Variant
from eval.plan.work import work
from eval.referee.score import Trial
from eval.replay.run import compare
from eval.studies import store
from eval.studies.montecarlo import Result, Study, one_run, study_of
from eval.studies.reproduced import published_rows
from eval.studies.stored_run import replay_stored
from eval.studies.trusted import Trust
from eval.studies.validation import Examined, Validation

Owner = tuple[str, int, int]
"""What a job belongs to: its kind, which of them, and (of a study) the seed."""


@dataclass(frozen=True)
class Outcome:
    """Everything done.

    Attributes:
        trials, studies: logs, and scenarios.
        published: the rows of published.csv.
        skipped: what could not be done, a sentence each.
        trust: what each log says about itself, with each way of association.
        validations: studies of the battery, each with what came out for every log.
    """

    trials: tuple[Trial, ...]
    studies: tuple[Study, ...]
    published: tuple[Mapping[str, object], ...] = ()
    skipped: tuple[str, ...] = ()
    trust: tuple[Trust, ...] = ()
    validations: tuple[tuple[Validation, tuple[Examined, ...]], ...] = ()


def _estimate(experiment: Experiment, part: Work) -> list[Run]:
    log, known = experiment.log, part.association == "known"
    return compare(log.inputs(labels=known), experiment.task, part.estimators, part.association, experiment.setup)


def _tutorial(log: Log, variant: Variant) -> Trial:
    changed = variant_log(log, variant)
    return Trial(changed, variant.task, (tutorial_run(changed, variant),), log.name, ABOUT)


def execute(plan: Plan, options: Options, progress: Callable[[int, int], None]) -> Outcome:
    """Run everything as independent jobs: those with iSAM2 first (they take longest), each seed by itself.

    A run of a study is kept on disk as soon as it is done, and taken from there if it was done before.
    """
    jobs: list[tuple[Owner, Call]] = []
    for i, experiment in enumerate(plan.experiments):
        jobs += [(("trial", i, 0), (_estimate, (experiment, p))) for w in experiment.work for p in w.parts()]
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
    far = [job for job in jobs if job[0][0] == "study"]
    near = [job for job in jobs if job[0][0] != "study"]
    finishing = chain(work(far, options, far=True), work(near, options)) if options.scheduler else work(jobs, options)
    for done, ((kind, i, seed), result) in enumerate(finishing, start=1):
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
    # before the variants, which share a log's name with its trial
    said = trusted(plan.experiments, trials, options, lambda more, of: progress(len(jobs) + more, len(jobs) + of))
    tested = validated(plan.validations, options, lambda more, of: progress(len(jobs) + more, len(jobs) + of))
    trials += [results["variant", i][0] for i in range(len(variants))]
    replayed = [results["stored", i][0] for i in range(len(plan.stored))]
    finished = tuple(
        study_of(scenario, seeds, [kept[i, seed] for seed in seeds])
        for i, ((scenario, _), seeds) in enumerate(zip(plan.studies, studies, strict=True))
    )
    published = [row for _, rows in replayed for row in rows] + [row for s in finished for row in published_rows(s)]
    return Outcome((*trials, *(t for t, _ in replayed)), finished, tuple(published), plan.skipped, said, tested)

"""What a run consists of (logs, tasks, estimators, ways of association), done in parallel.

The numbers are the same for any number of processes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

from joblib import Parallel, delayed

from data.log import Log
from data.result import Run
from eval.experiments import Experiment, Plan, Work
from eval.montecarlo import ESTIMATORS as STUDIED
from eval.montecarlo import Study, one_seed, study_of
from eval.options import Options, Variant
from eval.replay import compare
from eval.score import Trial
from eval.tutorial import ABOUT, tutorial_run, variant_log


@dataclass(frozen=True)
class Outcome:
    """Everything done."""

    trials: tuple[Trial, ...]
    study: Study | None


def _estimate(experiment: Experiment, work: Work) -> list[Run]:
    log, known = experiment.log, work.association == "known"
    return compare(log.inputs(labels=known), experiment.task, work.estimators, work.association, experiment.setup)


def execute(plan: Plan, options: Options, progress: Callable[[int, int], None]) -> Outcome:
    """Run everything as independent jobs: those with iSAM2 first (they take longest), each seed by itself."""
    jobs: list[Any] = []
    owner: list[tuple[str, int]] = []
    for i, experiment in enumerate(plan.experiments):
        for work in experiment.work:
            for part in work.parts():
                jobs.append(delayed(_estimate)(experiment, part))
                owner.append(("trial", i))
    variants = [(e, v) for e in plan.experiments for v in options.variants if e.task == v.task and e.beside is None]
    for i, (experiment, variant) in enumerate(variants):
        jobs.append(delayed(_tutorial)(experiment.log, variant))
        owner.append(("variant", i))
    for seed in range(options.seed, options.seed + plan.study_runs):
        jobs.append(delayed(one_seed)(seed, ("localization", "slam"), STUDIED))
        owner.append(("seed", seed))
    order = sorted(range(len(jobs)), key=lambda j: not (owner[j][0] == "trial" and "isam2" in jobs[j][1][1].estimators))
    results: dict[tuple[str, int], list[object]] = {}
    pool: Iterable[object] = Parallel(n_jobs=min(options.jobs, max(len(jobs), 1)), return_as="generator")(
        jobs[j] for j in order
    )
    for done, (j, result) in enumerate(zip(order, pool, strict=True), start=1):
        results.setdefault(owner[j], []).append(result)
        progress(done, len(jobs))
    trials = []
    for i, e in enumerate(plan.experiments):
        runs = {(r.association, r.estimator): r for group in results.get(("trial", i), []) for r in group}  # type: ignore[attr-defined]
        wanted = [("none" if n == "dead-reckoning" else w.association, n) for w in e.work for n in w.estimators]
        trials.append(Trial(e.log, e.task, tuple(runs[key] for key in dict.fromkeys(wanted)), e.beside, e.about))
    trials += [results[("variant", i)][0] for i in range(len(variants))]  # type: ignore[misc]
    study = None
    if plan.study_runs:
        seeds = range(options.seed, options.seed + plan.study_runs)
        study = study_of(seeds, [results[("seed", s)][0] for s in seeds])  # type: ignore[misc]
    return Outcome(tuple(trials), study)


def _tutorial(log: Log, variant: Variant) -> Trial:
    changed = variant_log(log, variant)
    return Trial(changed, variant.task, (tutorial_run(changed, variant),), log.name, ABOUT)

"""What a run consists of (logs, tasks, estimators, ways of association, studies), done in parallel.

The numbers are the same for any number of processes, and on a cluster.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from itertools import chain
from typing import Any

from data.log import Log
from eval.plan.calibrate import Calibration, examine, settle, with_systematic
from eval.plan.experiments import Plan
from eval.plan.flags.options import Options
from eval.plan.flags.table import Variant
from eval.plan.results import with_results
from eval.plan.trust import trusted
from eval.plan.tutorials import ABOUT, tutorial_run, variant_log
from eval.plan.unfinished import Unfinished, estimate, estimate_one, incomplete, wanted
from eval.plan.validation import validated
from eval.plan.work import Call, work
from eval.referee.score import Trial
from eval.studies import store
from eval.studies.montecarlo import Result, Study, one_run, study_of
from eval.studies.reproduced import published_rows, replay_stored
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
        calibrations: logs whose systematic errors were estimated along.
        missing: what had not enough memory, a sentence each; everything else is whole.
    """

    trials: tuple[Trial, ...]
    studies: tuple[Study, ...]
    published: tuple[Mapping[str, object], ...] = ()
    skipped: tuple[str, ...] = ()
    trust: tuple[Trust, ...] = ()
    validations: tuple[tuple[Validation, tuple[Examined, ...]], ...] = ()
    calibrations: tuple[Calibration, ...] = ()
    missing: tuple[str, ...] = ()


def _tutorial(log: Log, variant: Variant) -> Trial:
    changed = variant_log(with_systematic(log, None), variant)
    return Trial(changed, variant.task, (tutorial_run(changed, variant),), log.name, ABOUT)


def execute(plan: Plan, options: Options, progress: Callable[[int, int], None]) -> Outcome:
    """Run everything as independent jobs: those with iSAM2 first (they take longest), each seed by itself.

    A run of a study is kept on disk as soon as it is done, and taken from there if it was done before. What has not
    enough memory is tried again an estimator at a time, and then missing; the rest is as it would be.
    """
    lost = Unfinished(options)
    settled, calibrations = settle(plan.experiments, options, lost)
    plan = replace(plan, experiments=settled)
    watched = not options.no_plots
    parts = [(i, p) for i, e in enumerate(plan.experiments) for w in e.work for p in w.parts()]
    jobs: list[tuple[Owner, Call]] = [
        (("trial", i, k), (estimate, (plan.experiments[i], p, watched))) for k, (i, p) in enumerate(parts)
    ]
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
    finishing = (
        chain(work(far, options, far=True, lost=lost), work(near, options, lost=lost))
        if options.scheduler
        else work(jobs, options, lost=lost)
    )
    for done, ((kind, i, seed), result) in enumerate(finishing, start=1):
        if kind == "study":
            store.save(folders[i], seed, result)
            kept[i, seed] = result
        else:
            results.setdefault((kind, i), []).append(result)
        progress(done, len(jobs))
    again = [(owner, parts[owner[2]]) for owner in lost.jobs if owner[0] == "trial"]
    one_by_one = [
        ((i, p, n), (estimate_one, (plan.experiments[i], p, n, watched))) for _, (i, p) in again for n in p.estimators
    ]
    gone = Unfinished(options)
    for (i, _, _), result in work(one_by_one, options, lost=gone, apart=True):
        results.setdefault(("trial", i), []).append(result)
    trials = []
    for i, e in enumerate(plan.experiments):
        runs = {(r.association, r.estimator): r for group in results.get(("trial", i), []) for r in group}
        for (_, part, name), why in ((o, w) for o, w in gone.jobs.items() if o[0] == i):
            run = incomplete(name, part.association, e.task, e.log.recorded, why)
            runs[run.association, run.estimator] = run
            lost.say(f"{e.log.name}, {e.task}: no run of {name} with association {part.association}", why)
        trials.append(Trial(e.log, e.task, tuple(runs[key] for key in wanted(e.work)), e.beside, e.about))
    calibrations = examine(calibrations, plan.experiments, trials, options, lost)
    # before the variants, which share a log's name with its trial
    said = trusted(plan.experiments, trials, options, lost, lambda more, of: progress(len(jobs) + more, len(jobs) + of))
    tested = validated(plan.validations, options, lost, lambda more, of: progress(len(jobs) + more, len(jobs) + of))
    for (kind, i, seed), why in lost.jobs.items():
        if kind == "study":
            lost.say(f"scenario {plan.studies[i][0].name}: no run with seed {seed}", why)
        elif kind == "variant":
            lost.say(f"{variants[i][0].log.name}, {variants[i][1].task}: no run of {variants[i][1].name}", why)
        elif kind == "stored":
            lost.say(f"scenario {plan.stored[i][0].name}: no run", why)
    trials = list(with_results(trials, plan.given))
    trials += [results["variant", i][0] for i in range(len(variants)) if ("variant", i) in results]
    replayed = [results["stored", i][0] for i in range(len(plan.stored)) if ("stored", i) in results]
    finished = []
    for i, ((scenario, _), seeds) in enumerate(zip(plan.studies, studies, strict=True)):
        there = [seed for seed in seeds if (i, seed) in kept]
        if there:
            finished.append(study_of(scenario, there, [kept[i, seed] for seed in there]))
    published = [row for _, rows in replayed for row in rows] + [row for s in finished for row in published_rows(s)]
    return Outcome(
        (*trials, *(t for t, _ in replayed)), tuple(finished), tuple(published), plan.skipped, said, tested,
        calibrations, tuple(lost.said),
    )  # fmt: skip

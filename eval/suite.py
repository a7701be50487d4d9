"""What a run consists of (logs, tasks, estimators), done in parallel: the same numbers for any number of processes."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from joblib import Parallel, delayed

from data.errors import UsageError
from data.log import Log
from data.result import Run
from eval.logs import find_logs, open_log
from eval.montecarlo import ESTIMATORS as STUDIED
from eval.montecarlo import Study, one_seed, study_of
from eval.options import QUICK_RUNS, Options, Variant
from eval.replay import compare
from eval.score import Trial
from eval.tutorial import tutorial_run, variant_log

DEFAULT_RUNS = 50
DEFAULT_LOGS = ("victoria-park", "arena:0")
QUICK_FRAMES = 1500
"""Frames of a log that a quick report looks at."""


@dataclass(frozen=True)
class Plan:
    """Everything to do: trials as (log, task), and the seeds of the consistency study."""

    trials: tuple[tuple[Log, str], ...]
    study_runs: int


@dataclass(frozen=True)
class Outcome:
    """Everything done."""

    trials: tuple[Trial, ...]
    study: Study | None


def make_plan(options: Options, say: Callable[[str], None]) -> Plan:
    """Open the logs and settle tasks; raises UsageError for what makes no sense together."""
    default = [] if options.log else [open_log(name) for name in DEFAULT_LOGS]
    logs = [*default, *(open_log(name) for name in options.log)]
    for folder in options.data:
        found = [load() for load in find_logs(Path(folder), say)]
        if not found:
            raise UsageError(f"--data {folder}: no dataset found")
        logs += found
    names = [log.name for log in logs]
    for name in names:
        if names.count(name) > 1:
            raise UsageError(f"two logs are named {name!r}; rename one (the name stands in its log.toml)")
    trials = []
    for log in logs:
        for task in _tasks(log, options, default=any(log is d for d in default)):
            trials.append((shortened(log, QUICK_FRAMES) if options.quick else log, task))
    runs = options.runs
    if runs is None:
        runs = 0 if options.log else QUICK_RUNS if options.quick else DEFAULT_RUNS
    return Plan(tuple(trials), runs)


def _tasks(log: Log, options: Options, *, default: bool) -> Sequence[str]:
    has_map = log.recorded.map is not None
    tasks: Sequence[str] = options.task
    if not tasks:
        tasks = ("localization", "slam") if default and has_map else ("localization",) if has_map else ("slam",)
    elif default:  # nobody asked for this log by name
        tasks = [t for t in tasks if t == "slam" or has_map]
    if "localization" in tasks and not has_map:
        raise UsageError(f"--task localization: log {log.name!r} has no map (landmarks.csv); only slam makes sense")
    if "known" in options.association and not log.has_labels:
        raise UsageError(f"--association known: log {log.name!r} has no labels (true_id or label in observations.csv)")
    return tasks


def shortened(log: Log, n: int) -> Log:
    """The first n frames of a log, for a quick look; a shorter log as it is."""
    r = log.recorded
    if len(r) <= n:
        return log
    o = r.observations
    m = int(r.start[n])
    recorded = replace(
        r,
        time=r.time[:n],
        increments=replace(r.increments, mean=r.increments.mean[:n], covariance=r.increments.covariance[:n]),
        observations=replace(o, frame=o.frame[:m], z=o.z[:m], R=o.R[:m]),
    )
    t = log.truth
    truth = replace(
        t,
        pose=None if t.pose is None else t.pose[:n],
        landmark_of=None if t.landmark_of is None else t.landmark_of[:m],
    )
    label = None if log.label is None else log.label[:m]
    return replace(
        log, recorded=recorded, truth=truth, label=label, notes=(*log.notes, f"Only the first {n} frames (quick).")
    )


def _estimate(log: Log, task: str, estimators: Sequence[str], gate_known: float | None) -> list[Run]:
    return compare(log.inputs(labels=True), task, estimators, gate_known=gate_known)


def execute(plan: Plan, options: Options, progress: Callable[[int, int], None]) -> Outcome:
    """Run everything as independent jobs: iSAM2 apart from the rest (it takes longest), each seed by itself."""
    apart = [e for e in options.estimator if e == "isam2"]
    rest = [e for e in options.estimator if e != "isam2"]
    jobs: list[Any] = []
    owner: list[tuple[str, int]] = []
    for i, (log, task) in enumerate(plan.trials):
        for group in (apart, rest):
            if group:
                jobs.append(delayed(_estimate)(log, task, group, options.gate_known))
                owner.append(("trial", i))
    variants = [(log, v) for log, task in plan.trials for v in options.variants if task == v.task]
    for i, (log, variant) in enumerate(variants):
        jobs.append(delayed(_tutorial)(log, variant))
        owner.append(("variant", i))
    for seed in range(options.seed, options.seed + plan.study_runs):
        jobs.append(delayed(one_seed)(seed, ("localization", "slam"), STUDIED))
        owner.append(("seed", seed))
    results: dict[tuple[str, int], list[object]] = {}
    pool: Iterable[object] = Parallel(n_jobs=min(options.jobs, max(len(jobs), 1)), return_as="generator")(jobs)
    for done, (who, result) in enumerate(zip(owner, pool, strict=True), start=1):
        results.setdefault(who, []).append(result)
        progress(done, len(jobs))
    trials = []
    for i, (log, task) in enumerate(plan.trials):
        runs = {r.estimator: r for group in results.get(("trial", i), []) for r in group}  # type: ignore[attr-defined]
        trials.append(Trial(log, task, tuple(runs[e] for e in options.estimator)))
    trials += [results[("variant", i)][0] for i in range(len(variants))]  # type: ignore[misc]
    study = None
    if plan.study_runs:
        seeds = range(options.seed, options.seed + plan.study_runs)
        study = study_of(seeds, [results[("seed", s)][0] for s in seeds])  # type: ignore[misc]
    return Outcome(tuple(trials), study)


def _tutorial(log: Log, variant: Variant) -> Trial:
    changed = variant_log(log, variant)
    return Trial(changed, variant.task, (tutorial_run(changed, variant),), beside=log.name)

"""Consistency statistics of a log without truth, and of a twin also with it; kept on disk."""

import gc
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from data.inputs import Inputs
from data.log import Log
from data.result import Run
from data.whole import whole_file
from eval.compare import compare
from eval.referee import consistency, errors, truth_free
from eval.referee.plausibility import with_plausibility
from eval.referee.score import confusion_of
from eval.referee.truth_free import Key, Statistic
from eval.replay.batch import batch
from eval.replay.settings import FILTERS, steps
from eval.studies.twins import Source, inputs_of, twin

PLAIN, STAND_IN = "batch", "batch-cauchy"  # the smoother for comparison, and its replacement if it is implausible


@dataclass(frozen=True)
class Sample:
    """Truth-free consistency statistics of one log, and of a twin the errors of its estimators."""

    measured: Mapping[Key, Statistic]  # the statistics; none of a failed estimator
    failures: Mapping[str, str] = field(default_factory=dict)  # reasons, by estimator
    # RMS [m] between an online path and the batch smoother's, by estimator
    apart: Mapping[str, float] = field(default_factory=dict)
    nees: Mapping[tuple[str, str], float] = field(default_factory=dict)  # mean pose NEES by estimator and phase (twins)
    # tp, tn, fp, fn of the final decisions by estimator (of a twin)
    counts: Mapping[str, tuple[int, int, int, int]] = field(default_factory=dict)


def smoother_of(runs: Sequence[Run], inputs: Inputs) -> Run | None:
    """Batch over the decisions of the first filter, else of the first stepping estimator; None: all failed."""
    if len(runs) == 1 and runs[0].estimator == PLAIN:
        return runs[0]
    fronts = [r for r in runs if steps(r.estimator) and r.failure is None]
    fronts.sort(key=lambda r: r.estimator not in FILTERS)
    return same_decisions(fronts[0], runs, inputs) if fronts else None


def same_decisions(front: Run, runs: Sequence[Run], inputs: Inputs) -> Run:
    """The batch smoother under the final decisions of `front`: one of the runs, or a new one. If it is implausible, the
    robust `STAND_IN` under the same decisions, if that is plausible.
    """
    alike = {r.estimator: r for r in runs if np.array_equal(r.final_decisions, front.final_decisions)}
    plain = alike.get(PLAIN) or with_plausibility(batch(PLAIN, inputs, front), inputs)
    if plain.implausible is None:
        return plain
    robust = alike.get(STAND_IN) or with_plausibility(batch(STAND_IN, inputs, front), inputs)
    return robust if robust.flaw is None else plain


def sample_of(log: Log, task: str, association: str, runs: Sequence[Run], smoother: Run | None) -> Sample:
    """Statistics of a log from its runs with one association method; `smoother`: see `smoother_of`."""
    inputs = inputs_of(log, task, association)
    measured: dict[Key, Statistic] = {}
    failures: dict[str, str] = {}
    apart: dict[str, float] = {}
    for run in runs:
        if not steps(run.estimator):
            continue
        if run.failure is not None:
            failures[run.estimator] = run.failure.text
            continue
        own = None if smoother is None else same_decisions(run, [*runs, smoother], inputs)
        own = own if own is not None and own.flaw is None else None
        measured |= {(run.estimator, name): m for name, m in truth_free.of_online(run, own, inputs).items()}
        if own is not None and own.final is not None and run.online is not None:
            apart[run.estimator] = errors.rms(errors.position_distance(run.online.pose, own.final.pose))
    if smoother is not None and smoother.flaw is not None:
        failures[smoother.estimator] = smoother.flaw.why if smoother.implausible is None else smoother.implausible.text
    if smoother is None or smoother.flaw is not None:
        return Sample(measured, failures, apart=apart)
    measured |= {(smoother.estimator, name): m for name, m in truth_free.of_smoother(smoother, inputs).items()}
    return Sample(measured, failures, apart=apart)


def one_twin(source: Source, seed: int) -> Sample:
    """All estimators on a twin, with statistics and errors."""
    if not gc.get_freeze_count():  # or every collection searches all that is loaded: a tenth of the time
        gc.freeze()
    with threadpool_limits(1):  # the same bytes for any number of cores
        log = twin(source, seed)
        inputs = inputs_of(log, source.task, source.association)
        runs = compare(inputs, source.task, source.estimators, source.association, source.setup)
        return twin_sample(source, log, runs, smoother_of(runs, inputs))


def twin_sample(source: Source, log: Log, runs: Sequence[Run], smoother: Run | None) -> Sample:
    """Statistics of a twin, and the errors of its runs."""
    sample = sample_of(log, source.task, source.association, runs, smoother)
    nees: dict[tuple[str, str], float] = {}
    counts: dict[str, tuple[int, int, int, int]] = {}
    for run in runs:
        if run.flaw is not None or run.estimator == "dead-reckoning":
            continue
        for phase in run.phases:
            t = run.trajectory(phase)
            each = consistency.nees(t.pose, t.covariance, source.path, "pose")
            thin = consistency.nearly_singular(t.covariance, log.recorded.covariance_floor)
            nees[run.estimator, phase] = consistency.mean_or_nan(np.where(thin, math.nan, each))
        found = confusion_of(run, log, "final")
        if found is not None:
            counts[run.estimator] = found.tp, found.tn, found.fp, found.fn
    return replace(sample, nees=nees, counts=counts)


PLAIN_FIELDS = ("failures", "apart")  # stored without conversion


def save(path: Path, sample: Sample) -> None:
    """Keep a sample; the file is written atomically."""
    kept = {
        "measured": [[*key, *m] for key, m in sample.measured.items()],
        "nees": [[*key, value] for key, value in sample.nees.items()],
        **{name: getattr(sample, name) for name in (*PLAIN_FIELDS, "counts")},
    }
    with whole_file(path) as partial:
        partial.write_bytes(json.dumps(kept).encode())


def load(path: Path) -> Sample | None:
    """A kept sample; None if it is missing or damaged."""
    try:
        kept = json.loads(path.read_bytes())
        measured = {(e, name): Statistic(*m) for e, name, *m in kept["measured"]}
        nees = {(e, phase): v for e, phase, v in kept["nees"]}
        counts = {e: (tp, tn, fp, fn) for e, (tp, tn, fp, fn) in kept["counts"].items()}
        return Sample(measured, nees=nees, counts=counts, **{name: kept[name] for name in PLAIN_FIELDS})
    except (FileNotFoundError, ValueError, KeyError, TypeError):
        return None

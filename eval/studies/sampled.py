"""What a log and its estimators say about themselves, and a twin beside that about their errors; kept on disk."""

from __future__ import annotations

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
from eval.referee import consistency, errors, trust
from eval.referee.plausibility import with_plausibility
from eval.referee.score import confusion_of
from eval.referee.trust import Key, Measured
from eval.replay.batch import batch
from eval.replay.settings import FILTERS, steps
from eval.studies.twins import Source, inputs_of, twin

PLAIN, STAND_IN = "batch", "batch-cauchy"
"""The smoother that all is compared with, and which one takes its place where it is implausible."""


@dataclass(frozen=True)
class Sample:
    """What one log says about itself, and, of a twin, how far its estimators are from the truth.

    Attributes:
        measured: the statistics; of an estimator that failed there are none.
        failures: why, by estimator.
        outlying, typical: of the smoother's residuals, see `trust.Smoothed`.
        apart: RMS [m] between an online path and the batch smoother's, by estimator.
        nees: mean pose NEES by estimator and phase (a twin's).
        counts: tp, tn, fp, fn of the final decisions by estimator (a twin's).
    """

    measured: Mapping[Key, Measured]
    failures: Mapping[str, str] = field(default_factory=dict)
    outlying: int = 0
    typical: Mapping[str, float] = field(default_factory=dict)
    apart: Mapping[str, float] = field(default_factory=dict)
    nees: Mapping[tuple[str, str], float] = field(default_factory=dict)
    counts: Mapping[str, tuple[int, int, int, int]] = field(default_factory=dict)


def smoother_of(runs: Sequence[Run], inputs: Inputs) -> Run | None:
    """Batch over the decisions of the first filter, else of the first that steps; None: none got to the end."""
    fronts = [r for r in runs if steps(r.estimator) and r.failure is None]
    fronts.sort(key=lambda r: r.estimator not in FILTERS)
    return same_decisions(fronts[0], runs, inputs) if fronts else None


def same_decisions(front: Run, runs: Sequence[Run], inputs: Inputs) -> Run:
    """The batch smoother under the final decisions of `front`: one of the runs, or a new one.

    Where that is implausible, the robust `STAND_IN` under the same decisions, unless that is, too.
    """
    alike = {r.estimator: r for r in runs if np.array_equal(r.final_decisions, front.final_decisions)}
    plain = alike.get(PLAIN) or with_plausibility(batch(PLAIN, inputs, front), inputs)
    if plain.implausible is None:
        return plain
    robust = alike.get(STAND_IN) or with_plausibility(batch(STAND_IN, inputs, front), inputs)
    return robust if robust.flaw is None else plain


def sample_of(
    log: Log,
    task: str,
    association: str,
    runs: Sequence[Run],
    smoother: Run | None,
    said: trust.Smoothed | None = None,
) -> Sample:
    """What a log says about itself, from its runs with one way of association.

    `smoother`: see `smoother_of`; `said`: what `trust.of_smoother` makes of it, if that is known already.
    """
    inputs = inputs_of(log, task, association)
    measured: dict[Key, Measured] = {}
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
        found = trust.of_online(run, own, inputs)
        measured |= {(run.estimator, name): m for name, m in found.items()}
        if own is not None and own.final is not None and run.online is not None:
            apart[run.estimator] = errors.rms(errors.position_distance(run.online.pose, own.final.pose))
    if smoother is not None and smoother.flaw is not None:
        failures[smoother.estimator] = smoother.flaw.why if smoother.implausible is None else smoother.implausible.text
    if smoother is None or smoother.flaw is not None:
        return Sample(measured, failures, apart=apart)
    if said is None:
        said = trust.of_smoother(smoother, inputs)
    measured |= {(smoother.estimator, name): m for name, m in said.statistics.items()}
    return Sample(measured, failures, said.outlying, said.typical, apart)


def one_twin(source: Source, seed: int) -> Sample:
    """All estimators on a twin, what it says about itself, and how far they are from its truth."""
    with threadpool_limits(1):  # the same bytes for any number of cores, and no waiting for threads
        log = twin(source, seed)
        inputs = inputs_of(log, source.task, source.association)
        runs = compare(inputs, source.task, source.estimators, source.association, source.setup)
        return twin_sample(source, log, runs, smoother_of(runs, inputs))


def twin_sample(
    source: Source, log: Log, runs: Sequence[Run], smoother: Run | None, said: trust.Smoothed | None = None
) -> Sample:
    """What a twin says about itself, and how far its runs are from its truth; arguments as of `sample_of`."""
    sample = sample_of(log, source.task, source.association, runs, smoother, said)
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


AS_THEY_ARE = ("failures", "outlying", "typical", "apart")  # fields of a sample that a file has as they are


def save(path: Path, sample: Sample) -> None:
    """Keep a sample; the file appears whole or not at all."""
    kept = {
        "measured": [[*key, *m] for key, m in sample.measured.items()],
        "nees": [[*key, value] for key, value in sample.nees.items()],
        **{name: getattr(sample, name) for name in (*AS_THEY_ARE, "counts")},
    }
    with whole_file(path) as partial:
        partial.write_bytes(json.dumps(kept).encode())


def load(path: Path) -> Sample | None:
    """A kept sample, or None; a file that is damaged counts as none."""
    try:
        kept = json.loads(path.read_bytes())
        measured = {(e, name): Measured(*m) for e, name, *m in kept["measured"]}
        nees = {(e, phase): v for e, phase, v in kept["nees"]}
        counts = {e: (tp, tn, fp, fn) for e, (tp, tn, fp, fn) in kept["counts"].items()}
        return Sample(measured, nees=nees, counts=counts, **{name: kept[name] for name in AS_THEY_ARE})
    except (FileNotFoundError, ValueError, KeyError, TypeError):
        return None

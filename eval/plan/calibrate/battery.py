"""The errors that a log names under plain estimators, and its battery of trust with and without them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from threadpoolctl import threadpool_limits

from data.errors import UsageError
from data.inputs import Systematic
from data.log import Log
from data.result import Run
from eval.plan.calibrate.named import names_of
from eval.replay.foreign.spec import name_of
from eval.replay.run import compare
from eval.replay.settings import Setup
from eval.studies.sampled import Sample, sample_of, smoother_of, twin_sample
from eval.studies.trusted import FEWEST, Trust, judged
from eval.studies.twins import Source, inputs_of, source_of, twin

FRONT = ("ekf", "batch")
"""What decides where labels are withheld, and the smoother whose residuals are looked at."""


def with_systematic(log: Log, systematic: Systematic | None) -> Log:
    """The log whose estimators estimate these errors along (None: none)."""
    return replace(log, recorded=replace(log.recorded, systematic=systematic))


def plainly(log: Log, task: str, association: str, setup: Setup) -> tuple[tuple[Run, ...], tuple[str, ...]]:
    """A log under plain estimators, and the errors that it names."""
    with threadpool_limits(1):
        inputs = inputs_of(with_systematic(log, None), task, association)
        runs = compare(inputs, task, FRONT, association, setup)
        smoother = smoother_of(runs, inputs)
        return tuple(runs), () if smoother is None else names_of(inputs, smoother)


def examined(log: Log, task: str, association: str, setup: Setup, runs: Sequence[Run]) -> Trust:
    """The battery of a log, less the errors that its estimators estimate along; `runs`: those there are already.

    Residuals of batch and as many twins as a verdict needs, of batch alone under its own decisions. Twins have no
    errors, and estimate them all the same with the same priors.
    """
    with threadpool_limits(1):
        inputs = inputs_of(log, task, association)
        smoother = smoother_of(runs or compare(inputs, task, FRONT, association, setup), inputs)
        real = sample_of(log, task, association, (), smoother)
        twins: list[Sample] = []
        notes: tuple[str, ...] = ()
        if smoother is not None:
            try:
                source = source_of(log, smoother, (), setup, "known")
            except UsageError as fault:
                notes = (str(fault),)
            else:
                twins = [_twin(source, seed) for seed in range(FEWEST)]
        trust = judged(log, task, name_of(association), real, twins, smoother)
        return replace(trust, notes=(*trust.notes, *notes))


def _twin(source: Source, seed: int) -> Sample:
    """What a twin's smoother says, under the twin's own labels."""
    log = twin(source, seed)
    inputs = inputs_of(log, source.task, source.association)
    (smoother,) = compare(inputs, source.task, ("batch",), source.association, source.setup)
    return twin_sample(source, log, (smoother,), smoother)

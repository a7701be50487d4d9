"""The battery of trust of one log under plain estimators, and under those that estimate its systematic errors along."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from threadpoolctl import threadpool_limits

from data.errors import UsageError
from data.inputs import Systematic
from data.log import Log
from data.result import Run
from eval.plan.calibrate.corrected import less_errors
from eval.plan.calibrate.named import named, wanders
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


def before(log: Log, task: str, association: str, setup: Setup) -> tuple[Trust, tuple[str, ...]]:
    """The battery of a log under plain estimators, and the errors that it names."""
    plain = with_systematic(log, None)
    trust, smoother = _examined(plain, task, association, setup, ())
    if trust.blame is None or smoother is None or smoother.final is None:
        return trust, ()
    inputs = inputs_of(plain, task, association)
    return trust, named(trust.blame.findings, wandering=wanders(inputs, smoother.final.pose), inputs=inputs)


def after(log: Log, task: str, association: str, setup: Setup, runs: Sequence[Run]) -> Trust:
    """The battery of a log less the errors that its smoother estimated along; `runs`: those there are already.

    Its twins have no errors, and estimate them all the same with the same priors.
    """
    return _examined(log, task, association, setup, runs)[0]


def _examined(log: Log, task: str, association: str, setup: Setup, runs: Sequence[Run]) -> tuple[Trust, Run | None]:
    """Residuals of batch and as many twins as a verdict needs, of batch alone under its own decisions."""
    with threadpool_limits(1):
        inputs = inputs_of(log, task, association)
        smoother = smoother_of(runs, inputs) if runs else None
        if smoother is None:
            smoother = smoother_of(compare(inputs, task, FRONT, association, setup), inputs)
        rest = log if smoother is None else less_errors(log, [smoother])
        real = sample_of(rest, task, association, (), smoother)
        twins: list[Sample] = []
        notes: tuple[str, ...] = ()
        if smoother is not None:
            try:
                source = source_of(rest, smoother, (), setup, "known")
            except UsageError as fault:
                notes = (str(fault),)
            else:
                twins = [_twin(source, seed) for seed in range(FEWEST)]
        trust = judged(rest, task, name_of(association), real, twins, smoother)
        return replace(trust, notes=(*trust.notes, *notes)), smoother


def _twin(source: Source, seed: int) -> Sample:
    """What a twin's smoother says, under the twin's own labels."""
    log = twin(source, seed)
    inputs = inputs_of(log, source.task, source.association)
    (smoother,) = compare(inputs, source.task, ("batch",), source.association, source.setup)
    return twin_sample(source, log, (smoother,), smoother)

"""What a log would be with the systematic errors and the noise that its twins find wrong put right, tried at once.

A quick calibration, not a fit: correct what is found, draw a few twins of the corrected log, look again. `eval.tune`
fits the same parameters by maximum likelihood, which takes minutes on a long log.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import replace

import numpy as np

from data.inputs import Increments, Inputs, Observations
from data.log import Log
from data.motion.corrected_inputs import corrected_inputs
from data.result import Run
from eval.referee import attribution, effects, residuals
from eval.replay.batch import batch
from eval.replay.plausible import with_doubt
from eval.replay.run import compare
from eval.replay.settings import Setup
from eval.studies.twins import Source, inputs_of, source_of, twin

ROUNDS = 3
"""Corrections one after the other: a noise that the odometry hides comes out in halves."""
TWINS = 4
"""Twins a round: their residuals are the reference of the noise, known to some 2 % on a log of 200 frames."""


def with_noise(inputs: Inputs, factors: Mapping[str, float]) -> Inputs:
    """The inputs with the stated sigma of components multiplied by factors (correlations stay)."""
    motion = np.array([factors.get(name, 1.0) for name in residuals.COMPONENTS[:3]])
    reading = np.array([factors.get(name, 1.0) for name in residuals.COMPONENTS[3:]])
    increments, o = inputs.increments, inputs.observations
    return replace(
        inputs,
        increments=Increments(increments.mean, motion[:, None] * increments.covariance * motion),
        observations=replace(o, R=reading[:, None] * o.R * reading),
    )


def calibrated(
    log: Log, task: str, association: str, smoother: Run, setup: Setup, names: Collection[str]
) -> tuple[Log, dict[str, float]]:
    """The log corrected, and what was done: sizes of systematic errors taken out, factors of sigmas (`sigma_...`).

    Under the decisions of `smoother` throughout; of systematic errors only `names` are corrected. The log comes back as
    it is where nothing is found.
    """
    inputs = inputs_of(log, task, association)
    done: dict[str, float] = {}
    for number in range(ROUNDS):
        if smoother.flaw is not None or smoother.final is None:
            break
        used = residuals.used_by(smoother, inputs)
        source = source_of(replace(log, recorded=_recorded(log, inputs)), smoother, (), setup)
        usual = [_typical(source, seed) for seed in range(number * TWINS, (number + 1) * TWINS)]
        rest = corrected_inputs(inputs, smoother.errors_final)
        found = residuals.smoothed_residuals(rest, smoother.final.pose, used)
        factors = attribution.factors_of(residuals.typical(found, outliers=True), usual)
        wrong = {f.name: f.size for f in attribution.noise_errors(factors, usual, attribution.THRESHOLD)}
        scored = effects.scored(inputs, smoother.final.pose, used, smoother.errors_final)
        chosen = np.array([i for i, name in enumerate(scored.names) if name in names], np.int64)
        sizes, errors = scored.together(chosen)
        taken = {scored.names[i]: float(s) for i, s, e in zip(chosen, sizes, errors, strict=True) if abs(s) > e}
        if not taken and not wrong:
            break
        inputs = with_noise(effects.without(inputs, smoother.final.pose, used, taken), wrong)
        for name, size in taken.items():
            done[name] = done.get(name, 0.0) + size
        for name, factor in wrong.items():
            done[f"sigma_{name}"] = done.get(f"sigma_{name}", 1.0) * factor
        smoother = with_doubt(batch("batch", inputs, replace(smoother, online=smoother.final)), inputs)
    return replace(log, recorded=_recorded(log, inputs)), done


def _typical(source: Source, seed: int) -> dict[str, float]:
    """Spread of a twin's residuals under the smoother's decisions."""
    made = twin(source, seed)
    inputs = inputs_of(made, source.task, "known")
    (smoother,) = compare(inputs, source.task, ("batch",), "known", source.setup)
    if smoother.flaw is not None or smoother.final is None:
        return {}
    used = residuals.used_by(smoother, inputs)
    rest = corrected_inputs(inputs, smoother.errors_final)
    return residuals.typical(residuals.smoothed_residuals(rest, smoother.final.pose, used), outliers=True)


def _recorded(log: Log, inputs: Inputs) -> Inputs:
    """What of the inputs is corrected, as the log has it: with its map, without labels."""
    o = inputs.observations
    return replace(log.recorded, increments=inputs.increments, observations=Observations(o.frame, o.z, o.R))

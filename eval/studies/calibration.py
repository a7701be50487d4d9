"""What a log would be with the systematic errors and the noise that its twins find wrong put right, tried at once.

A quick calibration, not a fit: correct what is found, draw a few twins of the corrected log, look again. `eval.tune`
fits the same parameters by maximum likelihood, which takes minutes on a long log.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from data.inputs import Increments, Inputs, Observations
from data.log import Log
from data.result import Run
from eval.referee import attribution, effects, residuals, trust
from eval.replay.batch import batch
from eval.replay.settings import Setup
from eval.studies.sampled import one_twin
from eval.studies.twins import inputs_of, source_of

ROUNDS = 4
"""Corrections one after the other: a noise that the odometry hides comes out in halves."""
TWINS = 6
"""Twins a round: their median residual is the reference of the noise, known to some 2 % on a log of 200 frames."""


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


def calibrated(log: Log, task: str, association: str, smoother: Run, setup: Setup) -> tuple[Log, dict[str, float]]:
    """The log corrected, and what was done: sizes of systematic errors taken out, factors of sigmas (`sigma_...`).

    Under the decisions of `smoother` throughout. The log comes back as it is where nothing is found.
    """
    inputs = inputs_of(log, task, association)
    done: dict[str, float] = {}
    for number in range(ROUNDS):
        if smoother.failure is not None or smoother.final is None:
            break
        now = replace(log, recorded=_recorded(log, inputs))
        source = source_of(now, smoother, ("ekf", "batch"), setup)
        typical = [one_twin(source, seed).typical for seed in range(number * TWINS, (number + 1) * TWINS)]
        used = residuals.used_by(smoother, inputs)
        said = trust.of_smoother(smoother, inputs)
        factors = attribution.factors_of(said.typical, typical)
        found = attribution.systematic_errors(said.scored, factors, attribution.THRESHOLD)
        sizes = {f.name: f.size for f in found}
        wrong = {f.name: f.size for f in attribution.noise_errors(factors, typical, attribution.THRESHOLD)}
        if not sizes and not wrong:
            break
        inputs = with_noise(effects.without(inputs, smoother.final.pose, used, sizes), wrong)
        for name, size in sizes.items():
            done[name] = done.get(name, 0.0) + size
        for name, factor in wrong.items():
            done[f"sigma_{name}"] = done.get(f"sigma_{name}", 1.0) * factor
        smoother = batch("batch", inputs, replace(smoother, online=smoother.final))
    return replace(log, recorded=_recorded(log, inputs)), done


def _recorded(log: Log, inputs: Inputs) -> Inputs:
    """What of the inputs is corrected, as the log has it: with its map, without labels."""
    o = inputs.observations
    return replace(log.recorded, increments=inputs.increments, observations=Observations(o.frame, o.z, o.R))

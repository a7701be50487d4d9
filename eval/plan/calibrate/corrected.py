"""A log less the systematic errors that were estimated on it: what its residuals and its twins are about."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from data.inputs import ERRORS, Increments, Inputs, Observations
from data.log import Log
from data.motion.systematic import corrected_all
from data.result import Run, Systematics
from data.se2 import wrap_angle
from data.sensors import RangeBearing

OF_SENSOR = ("range", "bearing")


def less_errors(log: Log, runs: Sequence[Run]) -> Log:
    """The log as it is read with the last word of a smoother on its errors, of batch if it ran; else as it is.

    The errors that are estimated stay so: what is left of them is zero, and known as well as before.
    """
    told = [r for r in runs if r.errors_final is not None and r.flaw is None]
    told.sort(key=lambda r: r.estimator != "batch")
    if not told or told[0].errors_final is None:
        return log
    return replace(log, recorded=_less(log.recorded, told[0].errors_final))


def _less(inputs: Inputs, errors: Systematics) -> Inputs:
    """Increments corrected, readings brought to what the sensor would read without errors, covariances along."""
    of = dict(zip(errors.names, errors.mean.T, strict=True))
    names = [n for n in errors.names if n not in OF_SENSOR]
    increments = inputs.increments
    if names:
        place = np.array([list(ERRORS).index(n) for n in names], np.int64)
        each = np.stack([of[n] for n in names], axis=1)
        found = corrected_all(increments.mean, increments.covariance, each, place, np.zeros(3))
        increments = Increments(found.mean, found.covariance)
    o = inputs.observations
    nothing = np.zeros(len(inputs))
    size, turn = 1.0 + of.get("range", nothing)[o.frame], of.get("bearing", nothing)[o.frame]
    c, s = np.cos(turn) / size, np.sin(turn) / size
    M = np.array([[1.0 / size, 0.0 * size], [0.0 * size, 1.0 + 0.0 * size]] if _polar(inputs) else [[c, s], [-s, c]])
    M = M.transpose(2, 0, 1)
    z = np.einsum("mij,mj->mi", M, o.z)
    if _polar(inputs):
        z[:, 1] = wrap_angle(z[:, 1] - turn)
    return replace(inputs, increments=increments, observations=Observations(o.frame, z, M @ o.R @ M.transpose(0, 2, 1)))


def _polar(inputs: Inputs) -> bool:
    return isinstance(inputs.sensor, RangeBearing)

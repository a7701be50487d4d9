"""Where the fit starts: near every maximum of the likelihood that noise and latency may have, not only at the log's.

Noise first: with sigmas stated wrong by factors, the other parameters are pulled to where they excuse innovations that
are too large.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import product

import numpy as np

from data.se2 import Array
from eval.tuning.model import LATENCY, Model

FACTORS = (1 / 16, 1 / 4, 1.0, 4.0, 16.0)
"""On the sigmas of motion and of the readings, each with each."""
LATENCIES = 41
"""Latencies tried, evenly within the parameter's bounds: 0.05 s apart, where robots take longer to change speed."""
STARTS = 3
"""The best local maxima over the latencies that a fit is started from."""

Cost = Callable[[Array], float]


def starting_points(cost: Cost, model: Model) -> list[Array]:
    """Parameters (n,) to start from, the most likely first; cost: minus the log-likelihood at parameters (n,)."""
    names = [p.name for p in model.parameters]
    theta = _noise(cost, np.zeros(len(names)), names)
    if LATENCY not in names:
        return [theta]
    k = names.index(LATENCY)
    bound = model.parameters[k].bound
    tried = []
    for latency in np.linspace(-bound, bound, LATENCIES):
        tried.append(theta.copy())
        tried[-1][k] = latency
    costs = np.array([cost(point) for point in tried])
    around = np.concatenate([[np.inf], costs, [np.inf]])
    lowest = np.flatnonzero((costs <= around[:-2]) & (costs < around[2:]))
    best = sorted(lowest, key=lambda i: costs[i])[:STARTS]
    return sorted((_noise(cost, tried[i], names) for i in best), key=cost)


def _noise(cost: Cost, theta: Array, names: list[str]) -> Array:
    """Theta with the factors on motion noise and on the readings' noise that suit it best."""
    motion = np.array([name.startswith("motion_") and name != "motion_lateral" for name in names])
    sensor = np.array([name.startswith("sigma_") for name in names])
    tried = []
    for a, b in product(np.log(FACTORS) if motion.any() else [0.0], np.log(FACTORS) if sensor.any() else [0.0]):
        tried.append(np.where(motion, a, np.where(sensor, b, theta)))
    return min(tried, key=cost)

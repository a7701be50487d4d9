"""Full twins of a graph: measurements drawn from each factor's own noise around the values, and optimized again.

Relations and priors of poses are drawn as measurements. Any other factor with a noise model gets its drawn residual
added at the values, the same to first order in the noise. A robust noise is drawn as its Gaussian and stays robust.
"""

from __future__ import annotations

from typing import Any

import gtsam
import numpy as np

from data.se2 import Array
from wings.audit.factored import factorize, ordering
from wings.audit.factors import directions, log_p_values
from wings.audit.files import optimized
from wings.audit.linear import linearize

BETWEEN = (gtsam.BetweenFactorPose2, gtsam.BetweenFactorPose3)
PRIOR = (gtsam.PriorFactorPose2, gtsam.PriorFactorPose3)


def simulated(
    graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, rng: np.random.Generator
) -> gtsam.NonlinearFactorGraph:
    """A graph with the same factors, drawn around the values; factors without a noise model stay as they are."""
    planar = set(gtsam.utilities.allPose2s(values).keys())
    out = gtsam.NonlinearFactorGraph()
    for i in range(graph.size()):
        if graph.exists(i):
            out.add(_drawn(graph.at(i), values, planar, rng))
    return out


def _drawn(
    factor: gtsam.NonlinearFactor, values: gtsam.Values, planar: set[int], rng: np.random.Generator
) -> gtsam.NonlinearFactor:
    if not isinstance(factor, gtsam.NoiseModelFactor) or factor.noiseModel() is None:
        return factor
    model: Any = factor.noiseModel()
    plain = model.noise() if isinstance(model, gtsam.noiseModel.Robust) else model
    e = np.asarray(plain.unwhiten(rng.standard_normal(factor.dim())))
    if isinstance(factor, BETWEEN + PRIOR):
        poses: list[Any] = [values.atPose2(k) if k in planar else values.atPose3(k) for k in list(factor.keys())]
        z = poses[0] if isinstance(factor, PRIOR) else poses[0].between(poses[1])
        make: Any = type(factor)
        made: gtsam.NonlinearFactor = make(*factor.keys(), z.retract(-e), model)
        return made
    keys, at_values = list(factor.keys()), np.asarray(factor.unwhitenedError(values))

    def error(_: gtsam.CustomFactor, v: gtsam.Values, H: list[Array] | None) -> Array:
        blocks = gtsam.JacobianVector([np.empty((0, 0))] * len(keys))
        r = factor.unwhitenedError(v, blocks) if H is not None else factor.unwhitenedError(v)
        if H is not None:
            for j, block in enumerate(blocks):
                H[j] = block
        out: Array = np.asarray(r) - at_values + e
        return out

    return gtsam.CustomFactor(model, keys, error)


def smallest_p_optimized(
    graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, count: int, rng: np.random.Generator
) -> Array:
    """Smallest p value (count,) of all factors in each of full twins."""
    out = np.ones(count)
    for n in range(count):
        drawn = simulated(graph, values, rng)
        system = linearize(drawn, optimized(drawn, values, quick=True))
        f = factorize(system, ordering(system))
        out[n] = np.exp(min((float(np.nanmin(p, initial=0.0)) for p in log_p_values(directions(f))), default=0.0))
    return out

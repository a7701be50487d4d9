"""Twins of a graph: residuals of its own noise, r* = (I - H) e, and the family-wise p value of its largest test.

Full twins are measurements drawn from each factor's own noise around the values, and optimized again. Relations and
priors of poses are drawn as measurements. Any other factor with a noise model gets its drawn residual added at the
values, the same to first order in the noise. A robust noise is drawn as its Gaussian and stays robust.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import gtsam
import numpy as np

from data.se2 import Array
from data.tails import log_tail
from wings.audit.components import residuals, weighted_rows
from wings.audit.factors import Directions, directions, log_p_of, tests
from wings.audit.files import optimized
from wings.audit.kinds import plain_noise
from wings.audit.linear import PART, Factored, factorize, linearize, ordering

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
    e = np.asarray(plain_noise(factor)[0].unwhiten(rng.standard_normal(factor.dim())))
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
    """Logarithm of the smallest p value (count,) of all factors in each of full twins."""
    out = np.zeros(count)
    for n in range(count):
        drawn = simulated(graph, values, rng)
        system = linearize(drawn, optimized(drawn, values, quick=True))
        f = factorize(system, ordering(system))
        out[n] = log_p_of(*tests(f, directions(f))).min(initial=0.0)
    return out


def smallest_p(f: Factored, seen: Sequence[Directions], count: int, rng: np.random.Generator) -> Array:
    """Logarithm of the smallest p value of all factors in each of `count` draws on the linear model.

    The rows of a robust noise are drawn as stated, and weighted as at the values.
    """
    A = weighted_rows(f)
    root = np.concatenate([np.repeat(np.sqrt(g.weight), g.r.shape[1]) for g in f.system.groups])[:, None]
    out = np.zeros(count)
    for first in range(0, count, PART):
        part = slice(first, min(count, first + PART))
        e = rng.standard_normal((A.shape[0], part.stop - part.start))
        r = residuals(f, A, root * e) / root
        largest: dict[int, Array] = {}
        at = 0
        for g, s in zip(f.system.groups, seen, strict=True):
            n, d = g.r.shape
            T = s.tested(r[at : at + n * d].reshape(n, d, -1))
            rank = np.sum(s.R > 0.0, 1)
            for k in np.unique(rank[rank > 0]).tolist():
                most = T[rank == k].max(0)
                largest[k] = np.maximum(largest[k], most) if k in largest else most
            at += n * d
        for k, most in largest.items():
            out[part] = np.minimum(out[part], log_tail(most, k))
    return out


def independent(smallest: Array) -> float:
    """Number of independent tests whose least p value is distributed as those drawn (logarithms), where it is small.

    It is exponential in -log(1 - p); the maximum-likelihood rate from the lower half, the rest is censored.
    """
    y = -np.log1p(-np.exp(np.sort(smallest)))
    k = (len(y) + 1) // 2
    return float(k / max(y[:k].sum() + (len(y) - k) * y[k - 1], 1e-300))


def family(log_p: Array, smallest: Array) -> Array:
    """Family-wise p values (F,) of logarithms of p values, from the smallest of each draw; NaN stays."""
    below = np.searchsorted(np.sort(smallest), log_p, side="right")
    return np.where(np.isfinite(log_p), (1.0 + below) / (1.0 + len(smallest)), np.nan)

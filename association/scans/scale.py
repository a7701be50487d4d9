"""How much too small (or large) scan-matching covariances are, learned from how well loop closures fit the graph."""

from __future__ import annotations

import math

import numpy as np
from scipy.special import gammaln

from data.inputs import IntArray
from data.se2 import Array, BoolArray, between, wrap_angle

DOF = 3
TAILS = np.geomspace(2.5, 200.0, 40)
"""Degrees of freedom of Student's t that are tried: 2.5 has hardly a variance, 200 is as good as Gaussian."""


def residuals(poses: Array, key1: IntArray, key2: IntArray, relative: Array, covariance: Array) -> Array:
    """Squared Mahalanobis distances (E,) of relative poses (E, 3) with covariances (E, 3, 3) from key poses (K, 3)."""
    error = between(poses[key1], poses[key2]) - relative
    error[:, 2] = wrap_angle(error[:, 2])
    d2: Array = np.einsum("ki,ki->k", error, np.linalg.solve(covariance, error[:, :, None])[:, :, 0])
    return d2


def spanned(keys: int, key1: IntArray, key2: IntArray) -> BoolArray:
    """Which steps of the chain (K - 1,), from each of K key poses to the next, some loop closure key1 -> key2 spans.

    The others fit exactly at the optimum, whatever their errors: they tell nothing of a scale.
    """
    ends = np.zeros(keys, np.int64)
    np.add.at(ends, np.minimum(key1, key2), 1)
    np.add.at(ends, np.maximum(key1, key2), -1)
    return np.cumsum(ends)[:-1] > 0


def learned_scale(d2: Array, closures: int) -> tuple[float, float]:
    """Factor for the covariances of a pose graph, and its standard error.

    `d2` (E,) are the `residuals` of its loop closures and of the steps that they span, at its optimum; `closures` of
    them are loop closures. The optimum has eaten as many residuals as there are poses, which leaves closures / E of
    each one's variance (on average). The residuals' tails are heavy, so that a Student's t of three dimensions is
    fitted (Lange, Little, Taylor 1989), its tail by likelihood; the factor is that of its covariance, the error that of
    its scale (their Fisher information).
    Raises ValueError without loop closures.
    """
    if closures < 1 or len(d2) < closures:
        raise ValueError("a scale needs loop closures: a chain alone fits itself")
    d2 = np.asarray(d2, float) * (len(d2) / closures)
    best = (-math.inf, 1.0, 1.0)
    for nu in TAILS:
        scale = float(np.median(d2)) / DOF + 1e-300
        for _ in range(200):
            weight = (nu + DOF) / (nu + d2 / scale)
            new = float(np.mean(weight * d2)) / DOF
            done = abs(new - scale) <= 1e-10 * scale
            scale = new
            if done:
                break
        constant = gammaln(0.5 * (nu + DOF)) - gammaln(0.5 * nu) - 0.5 * DOF * math.log(nu * scale)
        likelihood = float(np.sum(constant - 0.5 * (nu + DOF) * np.log1p(d2 / (nu * scale))))
        best = max(best, (likelihood, float(nu), scale))
    _, nu, scale = best
    factor = scale * nu / (nu - 2.0)
    return factor, factor * math.sqrt(2.0 * (nu + DOF + 2.0) / (len(d2) * DOF * nu))

"""Logarithms of tail probabilities of a chi-square variable: they rank where the probabilities are 0 or 1."""

import numpy as np
from scipy import special

from data.inputs import IntArray
from data.se2 import Array

LEAST = 1e-290  # probability that is told from zero
ROUNDED = -30.0  # logarithm of a p value below which the corrections of Bonferroni and Sidak are one
TERMS = 400  # of the series of the lower tail: the k-th is below (x / a)^k


def log_tail(square: Array | float, dof: Array | IntArray | float) -> Array:
    """Logarithm of the probability that a chi-square variable exceeds `square`; it ties neither at 0 nor at 1. Where
    the probability underflows, from the asymptotic expansion of the incomplete gamma function (DLMF 8.11.2).
    """
    x, a = np.broadcast_arrays(0.5 * np.asarray(square, float), 0.5 * np.asarray(dof, float))
    tail, far = special.gammaincc(a, x), np.maximum(x, 1.0)
    with np.errstate(invalid="ignore", divide="ignore"):
        series = np.log1p((a - 1.0) / far * (1.0 + (a - 2.0) / far))
        beyond = (a - 1.0) * np.log(far) - x - special.gammaln(a) + series
        near = np.where(tail < 0.5, np.log(np.maximum(tail, LEAST)), np.log1p(-special.gammainc(a, x)))
    return np.asarray(np.where(tail > LEAST, near, beyond))


def log_below(square: Array | float, dof: Array | IntArray | float) -> Array:
    """Logarithm of the probability that a chi-square variable is below `square`; -inf at 0. Where the probability
    underflows, from the series of the incomplete gamma function (DLMF 8.11.4).
    """
    x, a = np.broadcast_arrays(0.5 * np.asarray(square, float), 0.5 * np.asarray(dof, float))
    share = special.gammainc(a, x)
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        powers = np.cumsum(np.log(x / (a + np.arange(1, TERMS)[:, *[None] * x.ndim])), axis=0)
        series = np.log1p(np.exp(np.where(x < a, powers, -np.inf)).sum(0))
        beyond = a * np.log(x) - x - special.gammaln(a + 1.0) + series
        near = np.where(share < 0.5, np.log(np.maximum(share, LEAST)), np.log1p(-special.gammaincc(a, x)))
    return np.asarray(np.where(share > LEAST, near, beyond))


def least_of(log_p: Array | float, count: Array | float) -> Array:
    """Logarithm of the probability that the least of `count` independent p values is below one of logarithm `log_p`."""
    log_p, bound = np.asarray(log_p, float), np.minimum(np.asarray(log_p) + np.log(count), 0.0)
    with np.errstate(divide="ignore"):
        sidak = np.log(-np.expm1(count * np.log1p(-np.exp(log_p))))
    return np.where(bound < ROUNDED, bound, sidak)

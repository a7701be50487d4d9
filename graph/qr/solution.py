"""The step of an eliminated problem and its covariances, with what its further right-hand sides stand for.

With residuals A x + C c - b and a standard normal prior on c (q,), the right-hand sides of the elimination are b and
the columns of C. What of them no x explains, `left`, gives the least-squares problem of c alone; given c, x = x_b - X c
with the solutions of the right-hand sides, so that cov(x) = cov(x | c) + X cov(c) X' and cov(x, c) = -X cov(c).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from data.se2 import Array
from graph.linear.elimination import Rows, Triangle
from graph.linear.marginals import marginals, means
from graph.linear.symbolic import Structure


class Solution(NamedTuple):
    """A step to the minimum of the linearized problem.

    Attributes:
        step: (V, 3), of the variables.
        constants: (q,), of the constant errors, in sigmas.
        length: of all of it, in sigmas: half its square is what the cost falls by.
        columns: (V, 3, q); -columns is by what the variables follow the constant errors.
        covariance: (q, q) of the constant errors, in sigmas.
    """

    step: Array
    constants: Array
    length: float
    columns: Array
    covariance: Array


def solve(rows: Rows, s: Structure, t: Triangle, now: Array) -> Solution:
    """The step, from errors that are `now` (q,) sigmas from where their prior has them."""
    x, d = means(rows, s, t), t.d[:, :, :1]
    square = float(np.einsum("vic,vic->", d, d))
    if not len(now):
        return Solution(x[:, :, 0], now, float(np.sqrt(square)), x[:, :, 1:], np.empty((0, 0)))
    slope = t.left[1:, 0] - now
    covariance = np.linalg.inv(t.left[1:, 1:] + np.eye(len(now)))
    covariance = 0.5 * (covariance + covariance.T)
    constants = covariance @ slope
    length = float(np.sqrt(square + slope @ constants))
    return Solution(x[:, :, 0] - x[:, :, 1:] @ constants, constants, length, x[:, :, 1:], covariance)


def covariances(rows: Rows, s: Structure, t: Triangle, solution: Solution) -> Array:
    """Marginal covariances (V, 3, 3) of the variables; beyond a variable's dimension 0."""
    own = marginals(rows, s, t)
    if len(solution.constants):
        X = solution.columns
        own += X @ solution.covariance @ X.transpose(0, 2, 1)
    return own

"""Graduated non-convexity on a whole smoothing problem: fixes and closures beside observations, bearings and ranges.

Yang, Antonante, Tzoumas and Carlone, "Graduated Non-Convexity for Robust Spatial Perception", IEEE RA-L 5(2), 2020,
with truncated least squares. gtsam's optimizer of that name cannot evaluate factors in Python, and optimizes to the end
in every round; here a round is one Gauss-Newton step by sparse QR.
"""

from __future__ import annotations

from typing import NamedTuple

import gtsam
import numpy as np

from data.inputs import IntArray
from data.se2 import Array, BoolArray
from graph.problem import Problem
from graph.qr.elimination import Rows, eliminate
from graph.qr.rows import Linearizer
from graph.qr.solution import solve

GROW = 1.4  # growth of the control parameter in each round, as in the paper
ROUNDS = 200  # upper bound: 100 take the control parameter from 1e-7 to 1e7
SHORTEST = 1e-3  # share of a step below which it is not tried
LEAST = 1e-9  # least weight: a landmark of rejected observations alone keeps a position


class _At(NamedTuple):
    """An estimate, linearized, with squared whitened residuals of the measurements (k,) and of all else together."""

    values: gtsam.Values
    rows: Rows
    square: Array
    rest: float

    def cost(self, weight: Array) -> float:
        """Weighted sum of squares."""
        return self.rest + float(weight @ self.square)


def graduated(problem: Problem, values: gtsam.Values, threshold: Array) -> tuple[gtsam.Values, BoolArray]:
    """The estimate reached from `values`, and which measurements have a weight above one half there.

    Measurements are the observations, then fixes and closures, all in use; each has a threshold (k,) of its squared
    whitened residual. Prior and motion are trusted. The control parameter starts from the residuals at `values`.
    """
    linearizer = Linearizer(problem)
    blocks = linearizer.frames + np.arange(len(threshold))
    now = _at(linearizer, values, blocks)
    share = now.square / threshold
    largest = float(share.max(initial=0.0))
    if largest <= 1.0:
        return values, np.ones(len(threshold), np.bool_)
    mu = 1.0 / max(2.0 * largest - 1.0, 1.0)
    for _ in range(ROUNDS):
        weight = _weights(share, mu)
        now = _step(linearizer, now, blocks, weight)
        share = now.square / threshold
        if mu > 1.0 and ((weight == 0.0) | (weight == 1.0)).all():
            break
        mu *= GROW
    return now.values, weight > 0.5


def _weights(share: Array, mu: float) -> Array:
    """Weights (k,) of squared residuals in thresholds (eq. 14 of the paper)."""
    low, high = mu / (mu + 1.0), (mu + 1.0) / mu
    middle = np.sqrt(mu * (mu + 1.0) / np.maximum(share, low)) - mu
    return np.where(share <= low, 1.0, np.where(share >= high, 0.0, np.clip(middle, 0.0, 1.0)))


def _at(linearizer: Linearizer, values: gtsam.Values, blocks: IntArray) -> _At:
    rows = linearizer(values)
    every = (rows.b[:, :, 0] ** 2).sum(axis=1)
    return _At(values, rows, every[blocks], float(every.sum() - every[blocks].sum()))


def _step(linearizer: Linearizer, now: _At, blocks: IntArray, weight: Array) -> _At:
    """One Gauss-Newton step of the weighted problem, shortened until its cost falls; none if no share helps."""
    scale = np.ones(len(now.rows.b))
    scale[blocks] = np.sqrt(np.maximum(weight, LEAST))
    rows = now.rows._replace(A=now.rows.A * scale[:, None, None], b=now.rows.b * scale[:, None, None])
    triangle = eliminate(rows, linearizer.structure)
    if triangle.free >= 0:
        return now
    solution = solve(rows, linearizer.structure, triangle, linearizer.constants(now.values))
    delta, share, cost = linearizer.tangent(solution, now.values), 1.0, now.cost(weight)
    while share > SHORTEST:
        moved = _at(linearizer, linearizer.moved(now.values, share * delta, share * solution.constants), blocks)
        if moved.cost(weight) < cost:
            return moved
        share *= 0.5
    return now

"""Minimum of a smooth function of bounded parameters, and its curvature there, from values alone."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from scipy.optimize import Bounds, minimize

from data.inputs import IntArray
from data.se2 import Array

Objective = Callable[[Array], float]


def search(objective: Objective, theta: Array, moving: IntArray, scale: Array, bound: Array) -> Array:
    """Minimise over the parameters `moving` of theta (n,), in units of `scale`, by a quasi-Newton method in bounds."""
    unit = scale[moving]

    def full(x: Array) -> Array:
        point = theta.copy()
        point[moving] = x * unit
        return point

    def value(x: Array) -> float:
        return objective(full(x))

    def gradient(x: Array) -> Array:
        return slope(value, x, np.arange(len(x)), np.full(len(x), 1e-3))

    found = minimize(
        value,
        theta[moving] / unit,
        jac=gradient,
        method="L-BFGS-B",
        bounds=Bounds(-bound[moving] / unit, bound[moving] / unit),
        options={"maxiter": 300, "maxcor": 20, "ftol": 1e-13, "gtol": 1e-3},
    )
    return full(found.x)


def slope(objective: Objective, theta: Array, moving: IntArray, step: Array) -> Array:
    """Gradient (k,) over the parameters `moving` by central differences over `step` (k,) each way."""
    gradient = np.empty(len(moving))
    for i, (k, h) in enumerate(zip(moving, step, strict=True)):
        up, down = theta.copy(), theta.copy()
        up[k] += h
        down[k] -= h
        gradient[i] = (objective(up) - objective(down)) / (2.0 * h)
    return gradient


def curvature(objective: Objective, theta: Array, moving: IntArray, limit: Array) -> Array:
    """Hessian (k, k) over the parameters `moving` by central differences; limit (n,): the largest error of interest.

    The steps change the log-likelihood by about 1/4 each: half of the law's own width, far above rounding.
    """
    here = objective(theta)

    def at(*moves: tuple[int, float]) -> float:
        point = theta.copy()
        for i, h in moves:
            point[moving[i]] += h
        return objective(point)

    k = len(moving)
    step = 0.01 * limit[moving]
    for i in range(k):
        second = (at((i, step[i])) + at((i, -step[i])) - 2.0 * here) / step[i] ** 2
        if second > 0.0:
            step[i] = min(max(math.sqrt(0.5 / second), 0.1 * step[i]), 30.0 * step[i])
    H = np.empty((k, k))
    for i in range(k):
        H[i, i] = (at((i, step[i])) + at((i, -step[i])) - 2.0 * here) / step[i] ** 2
        for j in range(i):
            corners = [at((i, a * step[i]), (j, b * step[j])) * a * b for a in (1.0, -1.0) for b in (1.0, -1.0)]
            H[i, j] = H[j, i] = sum(corners) / (4.0 * step[i] * step[j])
    return H

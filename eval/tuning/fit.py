"""Noise and biases from a log's innovations: maximum likelihood, standard errors, and how white they are.

The likelihood of all readings is the product of the innovations' densities N(nu; 0, S) (Schweppe, IEEE Trans. Inf.
Theory 11, 1965; Bar-Shalom, Li and Kirubarajan, section 5.4), here of the EKF with known association.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import Bounds, minimize

from association.known import known_decisions
from data.errors import DataError
from data.inputs import Increments, Inputs, IntArray, LabelledObservations
from data.result import DISCARD
from data.se2 import Array
from ekf.whole_run import run_filter
from eval.referee.consistency import chi2_bounds, lag1_correlation
from eval.tuning.model import Model, apply

FITTED, HELD, AT_BOUND = "fitted", "not determined", "at its bound"
HOPELESS = 1e6
"""Added to the start's objective where the filter fails: worse than any likelihood, and finite for the optimizer."""
ROUNDS = 30
"""Fits at most: each drops a parameter or improves the optimum."""
DECREMENT = 1e-2
"""Gain of log-likelihood that a Newton step may still promise at an optimum."""


@dataclass(frozen=True, eq=False)
class Fit:
    """Parameters (n,) at the largest likelihood, their standard errors (NaN unless fitted), and how each fared (n,).

    `gain` is the log-likelihood won over the log as stated.
    """

    theta: Array
    error: Array
    status: tuple[str, ...]
    gain: float


@dataclass(frozen=True)
class Score:
    """What the innovations of some frames say: total log-likelihood, NIS per dof with its bounds, lag-1 correlation."""

    log_likelihood: float
    dof: int
    nis: float
    lower: float
    upper: float
    lag1: float
    lag1_error: float


def pairings(inputs: Inputs, threshold: float = math.inf) -> IntArray:
    """Decisions (M,) by label; those that the filter as stated finds outside `threshold` are discarded once for all.

    Leaving outliers out by the noise as stated, and not by the one tried, keeps the likelihoods comparable.

    Raises:
        DataError: no pairing is left, or the filter fails on the inputs as they are.
    """
    decisions, _ = known_decisions(inputs)
    run = run_filter(inputs, decisions, threshold=threshold)
    if run.failure is not None:
        frame, why = run.failure
        raise DataError(f"with the noise as stated the filter fails at frame {frame} ({why}); state a larger one first")
    if not (run.decisions >= 0).any():
        seen = "no label is in the map" if inputs.map is not None else "no landmark is seen twice"
        raise DataError(f"nothing to fit to: {seen if len(decisions) else 'there are no observations'}")
    return run.decisions if inputs.map is None else np.where(decisions >= 0, run.decisions, DISCARD)


def middle(inputs: Inputs, decisions: IntArray) -> int:
    """The frame by which half of the pairings have been made."""
    frames = inputs.observations.frame[decisions >= 0]
    return int(frames[len(frames) // 2])


def score(inputs: Inputs, decisions: IntArray, begin: int = 0, end: int | None = None) -> Score:
    """Innovations of the frames from `begin` up to, not including, `end`, of a filter that ran from frame 0.

    Raises DataError if the filter fails.
    """
    run = run_filter(inputs, decisions)
    if run.failure is not None:
        raise DataError(f"the filter fails at frame {run.failure[0]} ({run.failure[1]})")
    span = slice(begin, end)
    frame = inputs.observations.frame
    inside = (frame >= begin) & (frame < (len(inputs) if end is None else end))
    dof = int(run.dof[span].sum())
    r, error = lag1_correlation(run.white, frame, np.where(inside, decisions, DISCARD))
    lower, upper = chi2_bounds(dof)
    nis = float(run.nis[span].sum()) / dof if dof else math.nan
    return Score(float(run.log_likelihood[span].sum()), dof, nis, lower, upper, r, error)


def fit(model: Model, decisions: IntArray, frames: int | None = None) -> Fit:
    """Maximise the innovation likelihood of the first `frames` frames (all, if None).

    Quasi-Newton in bounds, then the Hessian by central differences over about half a standard error each way. A
    parameter whose standard error exceeds its limit goes back to 0 and the rest is fitted again, the least determined
    first; one at its bound stays there. Standard errors are those of white innovations: on a recording whose
    errors last, they are too small.

    Raises:
        DataError: no optimum is found.
    """
    shorter = model if frames is None else replace(model, inputs=_head(model.inputs, frames))
    if len(shorter.inputs.observations.frame) == 0:
        raise DataError("nothing to fit to: there are no observations")
    decided = decisions[: len(shorter.inputs.observations.frame)]
    objective = _objective(shorter, decided)
    n = len(model)
    bound, limit = np.array([p.bound for p in model.parameters]), np.array([p.limit for p in model.parameters])
    theta, error, free = np.zeros(n), np.full(n, np.nan), np.ones(n, bool)
    start = objective(theta)
    edge = np.zeros(n, bool)
    for _ in range(ROUNDS):
        moving = np.flatnonzero(free & ~edge)
        if not len(moving):
            break
        theta = _search(objective, theta, moving, 0.1 * limit, bound)
        at = moving[np.abs(theta[moving]) > 0.999 * bound[moving]]
        if len(at):
            edge[at] = True
            continue
        H, gradient = _curvature(objective, theta, moving, limit)
        values, vectors = np.linalg.eigh(H * np.outer(limit[moving], limit[moving]))
        if values[0] < 1.0:  # along this direction a step of the limit changes the likelihood by less than 1/2
            vague = moving[int(np.argmax(np.abs(vectors[:, 0])))]
            theta[vague], free[vague] = 0.0, False
            continue
        covariance = np.linalg.inv(H)
        error[:] = np.nan
        error[moving] = np.sqrt(np.diag(covariance))
        step = covariance @ gradient
        if 0.5 * float(gradient @ step) < DECREMENT:
            break
        tried = theta.copy()
        tried[moving] = np.clip(theta[moving] - step, -bound[moving], bound[moving])
        if objective(tried) < objective(theta):
            theta = tried
    else:
        raise DataError("the likelihood has no clear maximum on this log; fit fewer parameters")
    status = tuple(HELD if not f else AT_BOUND if e else FITTED for f, e in zip(free, edge, strict=True))
    return Fit(theta, error, status, start - objective(theta))


def _head(inputs: Inputs, frames: int) -> Inputs:
    """The inputs up to, not including, frame `frames`."""
    o, rows = inputs.observations, int(inputs.start[frames])
    if not isinstance(o, LabelledObservations):
        raise ValueError("known association was not granted to these inputs")
    return replace(
        inputs,
        time=inputs.time[:frames],
        increments=Increments(inputs.increments.mean[:frames], inputs.increments.covariance[:frames]),
        observations=LabelledObservations(o.frame[:rows], o.z[:rows], o.R[:rows], o.label[:rows]),
    )


Objective = Callable[[Array], float]


def _objective(model: Model, decisions: IntArray) -> Objective:
    """Minus the log-likelihood at parameters (n,)."""
    stated = -float(run_filter(apply(model, np.zeros(len(model))), decisions).log_likelihood.sum())

    def objective(theta: Array) -> float:
        run = run_filter(apply(model, theta), decisions)
        value = -float(run.log_likelihood.sum())
        return value if run.failure is None and math.isfinite(value) else stated + HOPELESS

    return objective


def _search(objective: Objective, theta: Array, moving: IntArray, scale: Array, bound: Array) -> Array:
    """Minimise over the parameters `moving`, in units of `scale`."""
    unit = scale[moving]

    def full(x: Array) -> Array:
        point = theta.copy()
        point[moving] = x * unit
        return point

    def value(x: Array) -> float:
        return objective(full(x))

    def gradient(x: Array) -> Array:
        slope = np.empty(len(x))
        for i in range(len(x)):
            h = np.zeros(len(x))
            h[i] = 1e-3
            slope[i] = (value(x + h) - value(x - h)) / 2e-3
        return slope

    found = minimize(
        value,
        theta[moving] / unit,
        jac=gradient,
        method="L-BFGS-B",
        bounds=Bounds(-bound[moving] / unit, bound[moving] / unit),
        options={"maxiter": 300, "maxcor": 20, "ftol": 1e-13, "gtol": 1e-3},
    )
    return full(found.x)


def _curvature(objective: Objective, theta: Array, moving: IntArray, limit: Array) -> tuple[Array, Array]:
    """Hessian (k, k) and gradient (k,) over the parameters `moving` by central differences.

    The steps change the log-likelihood by about 1/4 each: half of the law's own width, far above rounding and kinks.
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
    H, gradient = np.empty((k, k)), np.empty(k)
    for i in range(k):
        up, down = at((i, step[i])), at((i, -step[i]))
        H[i, i] = (up + down - 2.0 * here) / step[i] ** 2
        # nearer, or the third derivative would pass for a slope
        gradient[i] = (at((i, 0.1 * step[i])) - at((i, -0.1 * step[i]))) / (0.2 * step[i])
        for j in range(i):
            corners = [at((i, a * step[i]), (j, b * step[j])) * a * b for a in (1.0, -1.0) for b in (1.0, -1.0)]
            H[i, j] = H[j, i] = sum(corners) / (4.0 * step[i] * step[j])
    return H, gradient

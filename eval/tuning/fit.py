"""Maximum likelihood of noise and biases from a log's innovations, with standard errors and whiteness.

The likelihood of all observations is the product of the innovations' densities N(nu; 0, S) (Schweppe, IEEE Trans. Inf.
Theory 11, 1965; Bar-Shalom, Li and Kirubarajan, section 5.4), here of the EKF with known association. It is minimized
over bounded parameters, and its curvature taken, from values alone.

Noise is fitted first: with misstated sigmas the other parameters are pulled to values that excuse large innovations.
Fits start near every maximum over the latency.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
import scipy

from association.decide import known_decisions
from data.errors import DataError
from data.inputs import Increments, Inputs, IntArray, LabelledObservations
from data.result import DISCARD
from data.se2 import Array, BoolArray
from ekf.whole_run import run_filter
from eval.referee.consistency import chi2_bounds, lag1_correlation
from eval.tuning.model import LATENCY, Model, apply

Objective = Callable[[Array], float]


def search(objective: Objective, theta: Array, moving: IntArray, scale: Array, bound: Array) -> Array:
    """Minimize over the parameters `moving` of theta (n,), in units of `scale`, by a quasi-Newton method in bounds."""
    unit = scale[moving]

    def full(x: Array) -> Array:
        point = theta.copy()
        point[moving] = x * unit
        return point

    def value(x: Array) -> float:
        return objective(full(x))

    def gradient(x: Array) -> Array:
        return slope(value, x, np.arange(len(x)), np.full(len(x), 1e-3))

    found = scipy.optimize.minimize(
        value,
        theta[moving] / unit,
        jac=gradient,
        method="L-BFGS-B",
        bounds=scipy.optimize.Bounds(-bound[moving] / unit, bound[moving] / unit),
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

    Steps change the log-likelihood by about 1/4: half the width of its maximum, far above rounding.
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


FACTORS = (1 / 16, 1 / 4, 1.0, 4.0, 16.0)  # on the sigmas of motion and of observations, all combinations
LATENCIES = 41
"""Latencies tried, evenly within the parameter's bounds: 0.05 s apart, less than robots take to change speed."""
STARTS = 3  # fits, from the best local maxima over the latencies


def starting_points(cost: Objective, model: Model) -> list[Array]:
    """Parameters (n,) to start from, the most likely first; cost: negative log-likelihood at parameters (n,)."""
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


def _noise(cost: Objective, theta: Array, names: list[str]) -> Array:
    """Theta with the most likely factors on the noise of motion and observations."""
    motion = np.array([name.startswith("motion_") and name != "motion_lateral" for name in names])
    sensor = np.array([name.startswith("sigma_") for name in names])
    factors = product(np.log(FACTORS) if motion.any() else [0.0], np.log(FACTORS) if sensor.any() else [0.0])
    return min((np.where(motion, a, np.where(sensor, b, theta)) for a, b in factors), key=cost)


FITTED, HELD, AT_BOUND = "fitted", "not determined", "at its bound"
HOPELESS = 1e6
"""Added to the start's objective where the filter fails: worse than any likelihood, and finite for the optimizer."""
ROUNDS = 30  # largest number of fits: each drops a parameter or improves the optimum
STEPS = 10  # Newton steps after each
APART = 2.0  # standard errors either way for the slope of the score in the latency
VAGUE = 2.0
"""Standard error of a latency over that by curvature, above which it follows from the odometry's noise, not its motion.
"""
DECREMENT = 1e-3  # remaining gain of log-likelihood of a Newton step at an optimum: 1/20 of a standard error


@dataclass(frozen=True, eq=False)
class Fit:
    """Parameters (n,) at the largest likelihood, standard errors (NaN unless fitted), and status (n,).

    `gain`: increase of log-likelihood over the log as stated.
    """

    theta: Array
    error: Array
    status: tuple[str, ...]
    gain: float


@dataclass(frozen=True)
class Score:
    """Innovations of some frames: total log-likelihood, NIS per dof with its bounds, lag-1 correlation."""

    log_likelihood: float
    dof: int
    nis: float
    lower: float
    upper: float
    lag1: float
    lag1_error: float


def pairings(inputs: Inputs, threshold: float = math.inf) -> IntArray:
    """Decisions (M,) by label; those outside `threshold` of the filter as stated are discarded.

    Outliers are chosen under the stated noise, not the fitted one, so that likelihoods are comparable. Raises
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
    """Innovations of the frames from `begin` to before `end`, of a filter that ran from frame 0.

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
    """Maximize the innovation likelihood of the first `frames` frames (all, if None).

    Quasi-Newton in bounds from the best starting points, then Newton's method with the Hessian by central differences
    over half a standard error each way; odometry.csv is cut at the latency reached. A parameter whose standard error
    exceeds its limit returns to 0 and the rest is fitted again, the least determined first; one at its bound stays
    there. Standard errors are those of white innovations: too small for recordings with lasting errors. Raises
    DataError: no optimum is found.
    """
    shorter = model if frames is None else replace(model, inputs=_head(model.inputs, frames))
    if len(shorter.inputs.observations.frame) == 0:
        raise DataError("nothing to fit to: there are no observations")
    cost = _cost(shorter, decisions[: len(shorter.inputs.observations.frame)])
    n = len(model)
    latency = np.array([p.name == LATENCY for p in model.parameters])
    bound, limit = np.array([p.bound for p in model.parameters]), np.array([p.limit for p in model.parameters])

    def near(theta: Array) -> Objective:
        cut = float(theta[latency].sum())
        return lambda x: cost(x, cut)

    def here(theta: Array) -> float:
        return near(theta)(theta)

    starts = starting_points(here, shorter)
    if len(starts) > 1:
        starts = [search(near(start), start, np.arange(n), 0.1 * limit, bound) for start in starts]
    theta = min(starts, key=here)
    error, free, edge = np.full(n, np.nan), np.ones(n, bool), np.zeros(n, bool)
    for _ in range(ROUNDS):
        error[:] = np.nan
        moving = np.flatnonzero(free & ~edge)
        if not len(moving):
            break
        theta = search(near(theta), theta, moving, 0.1 * limit, bound)
        at = moving[np.abs(theta[moving]) > 0.999 * bound[moving]]
        if len(at):
            edge[at] = True
            continue
        H = curvature(near(theta), theta, moving, limit)
        values, vectors = np.linalg.eigh(H * np.outer(limit[moving], limit[moving]))
        if values[0] < 1.0:  # along this direction a step of the limit changes the likelihood by less than 1/2
            vague = moving[int(np.argmax(np.abs(vectors[:, 0])))]
            theta[vague], free[vague] = 0.0, False
            continue
        theta, done = _settle(near, theta, moving, H, bound)
        if not done:
            continue
        error[moving] = np.sqrt(np.diag(_covariance(near, theta, moving, H, latency)))
        claimed = np.full(n, np.inf)
        claimed[moving] = np.sqrt(np.diag(np.linalg.inv(H)))
        lost = np.flatnonzero(latency & (error > np.minimum(limit, VAGUE * claimed)))
        if not len(lost):
            break
        theta[lost], free[lost] = 0.0, False
    else:
        raise DataError("the likelihood has no clear maximum on this log; fit fewer parameters")
    status = tuple(HELD if not f else AT_BOUND if e else FITTED for f, e in zip(free, edge, strict=True))
    return Fit(theta, error, status, here(np.zeros(n)) - here(theta))


def _settle(
    near: Callable[[Array], Objective], theta: Array, moving: IntArray, H: Array, bound: Array
) -> tuple[Array, bool]:
    """Newton steps with a Hessian (k, k), each cutting the odometry at the last latency; whether they converged."""
    covariance = np.linalg.inv(H)
    # near, or the third derivative adds to the slope
    reach = 0.1 * np.sqrt(0.5 / np.diag(H))
    for _ in range(STEPS):
        gradient = slope(near(theta), theta, moving, reach)
        step = covariance @ gradient
        if 0.5 * float(gradient @ step) < DECREMENT:
            return theta, True
        theta = theta.copy()
        theta[moving] = np.clip(theta[moving] - step, -bound[moving], bound[moving])
    return theta, False


def _covariance(
    near: Callable[[Array], Objective], theta: Array, moving: IntArray, H: Array, latency: BoolArray
) -> Array:
    """Covariance (k, k) of the parameters `moving`: J^-1 H J^-T, J the derivative of a score of variance H.

    J is H except for the latency (n,): odometry cut at another latency has other noise, which adds to the score's
    variance and not to its slope (sandwich of estimating equations: Huber, Proc. 5th Berkeley Symposium, 1967).
    """
    J = H.copy()
    reach = 0.1 * np.sqrt(0.5 / np.diag(H))
    for i in np.flatnonzero(latency[moving]):
        h = APART * math.sqrt(np.linalg.inv(H)[i, i])
        later, sooner = theta.copy(), theta.copy()
        later[moving[i]] += h
        sooner[moving[i]] -= h
        J[:, i] = (slope(near(later), later, moving, reach) - slope(near(sooner), sooner, moving, reach)) / (2.0 * h)
    # pinv: without signal the error becomes large
    inverse = np.linalg.pinv(J, rcond=1e-12)
    return np.asarray(inverse @ H @ inverse.T)


def _head(inputs: Inputs, frames: int) -> Inputs:
    o, rows = inputs.observations, int(inputs.start[frames])
    if not isinstance(o, LabelledObservations):
        raise ValueError("known association was not granted to these inputs")
    fixes, closures = inputs.fixes, inputs.closures
    which = None if o.sensor is None else o.sensor[:rows]
    return replace(
        inputs,
        time=inputs.time[:frames],
        increments=Increments(inputs.increments.mean[:frames], inputs.increments.covariance[:frames]),
        observations=replace(
            o, frame=o.frame[:rows], z=o.z[:rows], R=o.R[:rows], label=o.label[:rows], sensor=which, appearance=None
        ),
        fixes=None if fixes is None else fixes.before(frames),
        closures=None if closures is None else closures.before(frames),
    )


def _cost(model: Model, decisions: IntArray) -> Callable[[Array, float], float]:
    """Negative log-likelihood at parameters (n,), with odometry.csv cut at a latency [s]."""
    stated = -float(run_filter(apply(model, np.zeros(len(model))), decisions).log_likelihood.sum())

    def cost(theta: Array, cut: float) -> float:
        run = run_filter(apply(model, theta, cut=cut), decisions)
        value = -float(run.log_likelihood.sum())
        return value if run.failure is None and math.isfinite(value) else stated + HOPELESS

    return cost

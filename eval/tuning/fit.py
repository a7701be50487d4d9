"""Noise and biases from a log's innovations: maximum likelihood, standard errors, and how white they are.

The likelihood of all readings is the product of the innovations' densities N(nu; 0, S) (Schweppe, IEEE Trans. Inf.
Theory 11, 1965; Bar-Shalom, Li and Kirubarajan, section 5.4), here of the EKF with known association.

Minimum of a smooth function of bounded parameters, and its curvature there, from values alone.

Where the fit starts: near every maximum of the likelihood that noise and latency may have, not only at the log's.

Noise first: with sigmas stated wrong by factors, the other parameters are pulled to where they excuse innovations that
are too large.
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


FACTORS = (1 / 16, 1 / 4, 1.0, 4.0, 16.0)  # on the sigmas of motion and of the readings, each with each
LATENCIES = 41
"""Latencies tried, evenly within the parameter's bounds: 0.05 s apart, where robots take longer to change speed."""
STARTS = 3  # the best local maxima over the latencies that a fit is started from

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


FITTED, HELD, AT_BOUND = "fitted", "not determined", "at its bound"
HOPELESS = 1e6
"""Added to the start's objective where the filter fails: worse than any likelihood, and finite for the optimizer."""
ROUNDS = 30  # fits at most: each drops a parameter or improves the optimum
STEPS = 10  # newton's steps after each
APART = 2.0  # standard errors either way over which the slope of the score in the latency is taken
VAGUE = 2.0
"""Standard error of a latency over that by curvature from which on the odometry's noise, not its motion, tells it."""
DECREMENT = 1e-3  # gain of log-likelihood that a Newton step may still promise at an optimum: 1/20 of a standard error


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

    Quasi-Newton in bounds from the best of several starting points, then Newton's method with the Hessian by central
    differences over about half a standard error each way, at every step with odometry.csv cut at the latency reached.
    A parameter whose standard error exceeds its limit goes back to 0 and the rest is fitted again, the least determined
    first; one at its bound stays there. Standard errors are those of white innovations: on a recording whose
    errors last, they are too small.

    Raises:
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
    """Newton's steps with a Hessian (k, k), each cutting the odometry where the last one led; whether they ended."""
    covariance = np.linalg.inv(H)
    # near, or the third derivative would pass for a slope
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

    J is H but for the latency (n,): odometry that is cut anew has other noise in it, so its noise adds to the score's
    variance and not to its slope (the sandwich of estimating equations: Huber, Proc. 5th Berkeley Symposium, 1967).
    """
    J = H.copy()
    reach = 0.1 * np.sqrt(0.5 / np.diag(H))
    for i in np.flatnonzero(latency[moving]):
        h = APART * math.sqrt(np.linalg.inv(H)[i, i])
        later, sooner = theta.copy(), theta.copy()
        later[moving[i]] += h
        sooner[moving[i]] -= h
        J[:, i] = (slope(near(later), later, moving, reach) - slope(near(sooner), sooner, moving, reach)) / (2.0 * h)
    # pinv: where no signal is left the error is to be large, not the program to end
    inverse = np.linalg.pinv(J, rcond=1e-12)
    return np.asarray(inverse @ H @ inverse.T)


def _head(inputs: Inputs, frames: int) -> Inputs:
    """The inputs up to, not including, frame `frames`."""
    o, rows = inputs.observations, int(inputs.start[frames])
    if not isinstance(o, LabelledObservations):
        raise ValueError("known association was not granted to these inputs")
    return replace(
        inputs,
        time=inputs.time[:frames],
        increments=Increments(inputs.increments.mean[:frames], inputs.increments.covariance[:frames]),
        observations=replace(o, frame=o.frame[:rows], z=o.z[:rows], R=o.R[:rows], label=o.label[:rows]),
    )


def _cost(model: Model, decisions: IntArray) -> Callable[[Array, float], float]:
    """Minus the log-likelihood at parameters (n,), with odometry.csv cut at a latency [s]."""
    stated = -float(run_filter(apply(model, np.zeros(len(model))), decisions).log_likelihood.sum())

    def cost(theta: Array, cut: float) -> float:
        run = run_filter(apply(model, theta, cut=cut), decisions)
        value = -float(run.log_likelihood.sum())
        return value if run.failure is None and math.isfinite(value) else stated + HOPELESS

    return cost

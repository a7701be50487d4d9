"""Maximum likelihood of noise and biases from a log's innovations, with standard errors and whiteness.

The likelihood of all observations is the product of the innovations' densities N(nu; 0, S) (Schweppe, IEEE Trans. Inf.
Theory 11, 1965; Bar-Shalom, Li and Kirubarajan, section 5.4), here of the EKF with known association. It is minimized
over bounded parameters, and its curvature taken, from values alone.

Noise is fitted first: with misstated sigmas the other parameters are pulled to values that excuse large innovations.
Fits start near every maximum over the latency.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

import numpy as np
import scipy

from association.decide import known_decisions
from data import se2
from data.columns.header import HEADER, read_header
from data.columns.parts import ODOMETRY
from data.csv_table import read_table
from data.errors import DataError, UsageError, unknown
from data.inputs import Increments, Inputs, IntArray, LabelledObservations
from data.motion.velocity import MAX_HOLD, WITH_ALPHAS, VelocityModel, VelocityNoise, floor_covariances, preintegrate
from data.result import DISCARD
from data.se2 import Array, BoolArray
from data.sensors import RangeBearing
from ekf.whole_run import run_filter
from eval.referee.consistency import chi2_bounds, lag1_correlation

# Effects of noise, biases, odometry scales and a latency on a log's inputs, fitted by `eval.tuning`.
#
# Every parameter is 0 for the log as stated: the logarithm of a factor (noise, odometry scale), a bias in its unit, or
# seconds. The truth is not used. A scale of odometry is that of the best prediction: noisy odometry is shrunk by the
# share of noise in its mean square.
#
# A latency that averages two noisy samples would be favoured, because an increment cut between two samples has less
# noise. The likelihood then has maxima half a sample before and after the right latency (the interpolation artefact of
# image registration: Pluim, Maintz and Viergever, Computer Vision and Image Understanding 77, 2000). So an increment is
# cut once and moved from there with the velocity averaged over `HALF_WIDTH` either side. The covariance of this average
# with the noise of the increment is the same at both ends and cancels (instrumental variables: Söderström and Stoica,
# System Identification, 1989, chapter 8).

HALF_WIDTH = 0.3
"""s; time either side of an instant for its velocity: many samples, and short against a robot's manoeuvres."""
SAMPLES = 3  # least number of odometry samples either side for a velocity


@dataclass(frozen=True, eq=False)
class Odometry:
    """odometry.csv as recorded: stamps [s], v [m/s], omega [rad/s] (K,), and the velocity model."""

    time: Array
    v: Array
    omega: Array
    model: VelocityModel


def read_odometry(folder: Path) -> Odometry | None:
    """The recorded odometry of a log folder that has loaded; None with frames.csv, or for a log by name."""
    if not (folder / ODOMETRY).is_file():
        return None
    motion = read_header(folder / HEADER).motion
    if motion is None:
        raise DataError.at(folder / HEADER, f"no [motion] table; {ODOMETRY} needs one")
    table = read_table(folder / ODOMETRY, ("t", "v", "omega"))
    return Odometry(table.columns["t"], table.columns["v"], table.columns["omega"], motion)


def smooth_velocity(odometry: Odometry, at: Array) -> Array:
    """Mean v [m/s] and omega [rad/s] (N, 2) over the same time before and after each instant `at` (N,); 0 in gaps."""
    time = odometry.time
    if len(time) < 2:
        return np.zeros((len(at), 2))
    length = np.diff(time)
    width = max(HALF_WIDTH, SAMPLES * float(np.median(length)))
    hold = np.minimum(length, MAX_HOLD)
    # distance and rotation so far, at the end of every sample and of its hold
    knots = np.column_stack([time[:-1], time[:-1] + hold]).ravel()
    mean = np.empty((len(at), 2))
    for column, rate in enumerate((odometry.v, odometry.omega)):
        moved = rate[:-1] * hold
        end = np.cumsum(moved)
        so_far = np.column_stack([end - moved, end]).ravel()
        mean[:, column] = (np.interp(at + width, knots, so_far) - np.interp(at - width, knots, so_far)) / (2.0 * width)
    return mean


def moved_later(increments: Increments, velocity: Array, by: float) -> Increments:
    """Increments (N, 3) between instants `by` s later, at velocities (N, 2) of the instants; the same noise."""
    arc = _arc(by * velocity[:, 0], by * velocity[:, 1])
    mean = increments.mean.copy()
    mean[1:] = se2.compose(se2.inverse(arc[:-1]), se2.compose(mean[1:], arc[1:]))
    return Increments(mean, increments.covariance)


def _arc(distance: Array, rotation: Array) -> Array:
    """End (N, 3) of arcs of constant curvature."""
    half = 0.5 * rotation
    chord = distance * np.sinc(half / np.pi)
    return np.column_stack([chord * np.cos(half), chord * np.sin(half), rotation])


GROUPS = ("motion", "sensor", "bias", "odometry", "latency", "growth")
"""Groups of parameters; `growth` only on request."""
DEFAULT_GROUPS = GROUPS[:-1]
LATENCY = "latency"
CLOSEST = 0.1  # m; the noise of nearer observations does not shrink further


@dataclass(frozen=True)
class Parameter:
    """One parameter, 0 for the log as stated."""

    name: str  # in reports and in the copy's log.toml
    unit: str  # of the fitted value; empty for a factor, whose logarithm is the parameter
    bound: float  # the parameter is within -bound and bound
    limit: float  # a larger standard error means that the log does not determine the parameter
    about: str  # description in a few words

    @property
    def is_factor(self) -> bool:
        """Whether exp(parameter) multiplies a stated value."""
        return not self.unit

    def value(self, theta: float) -> float:
        """The factor, or the number in its unit."""
        return math.exp(theta) if self.is_factor else float(theta)

    def parameter(self, value: float) -> float:
        """The inverse of `value`."""
        return math.log(value) if self.is_factor else value


@dataclass(frozen=True, eq=False)
class Model:
    """A log's inputs as stated (labels granted), its recorded odometry if any, and the parameters."""

    inputs: Inputs
    odometry: Odometry | None
    parameters: tuple[Parameter, ...]

    def __len__(self) -> int:
        return len(self.parameters)


def make_model(inputs: Inputs, odometry: Odometry | None, groups: Collection[str] = DEFAULT_GROUPS) -> Model:
    """The parameters of `groups` that the log allows: no growth without ranges, no latency without odometry.csv.

    Increments integrated beforehand cannot be cut again: interpolation averages neighbouring errors, which the
    likelihood takes for a better instant.
    """
    sigma = np.sqrt(np.median(np.einsum("nii->ni", inputs.observations.R), axis=0))
    polar = isinstance(inputs.sensor, RangeBearing)
    first, second = ("range", "bearing") if polar else ("x", "y")
    noise, scale = math.log(1e3), math.log(2.0)
    found: list[Parameter] = []
    if "motion" in groups:
        found += [Parameter(name, "", noise, 1.0, about) for name, about in _motion_parameters(odometry)]
    if "sensor" in groups:
        found += [
            Parameter(f"sigma_{name}", "", noise, 1.0, f"factor on the sigma of {name}") for name in (first, second)
        ]
    if "growth" in groups and polar:
        found.append(Parameter("range_growth", "log(m)", 3.0, 0.5, "sigma of range also times (range / 1 m)^this"))
    if "bias" in groups:
        for name, s, unit in zip((first, second), sigma.tolist(), inputs.sensor.units, strict=True):
            largest = min(20.0 * s, 1.0) if unit == "rad" else 20.0 * s
            found.append(Parameter(f"bias_{name}", unit, largest, s, f"measured minus true {name}"))
    if "odometry" in groups:
        found.append(Parameter("odometry_v", "", scale, 0.2, "true distance per odometry distance"))
        found.append(Parameter("odometry_omega", "", scale, 0.2, "true rotation per odometry rotation"))
    if "latency" in groups and odometry is not None:
        found.append(Parameter(LATENCY, "s", 1.0, 0.2, "observations were taken this long before their stamp"))
    return Model(inputs, odometry, tuple(found))


def stated_groups(text: str, inputs: Inputs, odometry: Odometry | None) -> tuple[str, ...]:
    """Groups of parameters in a comma list; UsageError for an unknown one, or one that the log does not allow."""
    groups = tuple(text.split(","))
    for group in groups:
        if group not in GROUPS:
            raise UsageError(f"--fit {group}: {unknown(group, GROUPS)}")
    if LATENCY in groups and odometry is None:
        what = "the log has increments (frames.csv), which cannot be cut at other instants"
        remedy = "convert it with v and omega, which become odometry.csv, or try `--time-offset observations=-S` there"
        raise UsageError(f"--fit latency: {what}; {remedy}")
    if "growth" in groups and not isinstance(inputs.sensor, RangeBearing):
        raise UsageError("--fit growth: the sensor observes x and y; the exponent is that of a range")
    return groups


def _motion_parameters(odometry: Odometry | None) -> list[tuple[str, str]]:
    """Names and meanings of the factors on motion noise: of [motion], or of the increments' components."""
    if odometry is None:
        return [
            ("motion_along", "factor on the sigma of increments, forward"),
            ("motion_heading", "the same, heading and sideways"),
            ("motion_lateral", "the same, sideways, beyond that of heading"),
        ]
    noise = odometry.model.noise
    if noise.kind in WITH_ALPHAS:
        return [(f"motion_alpha{i}", f"factor on alphas[{i - 1}]") for i in range(1, len(noise.alphas) + 1)]
    return [("motion_v", "factor on sigma[0] of [motion]"), ("motion_omega", "factor on sigma[1] of [motion]")]


def vector(model: Model, values: Mapping[str, float]) -> Array:
    """Parameters (n,) from values by name (`Parameter.value`); others stay as stated.

    Raises UsageError for a name that this log has no parameter for.
    """
    names = [p.name for p in model.parameters]
    for name in values:
        if name not in names:
            raise UsageError(f"{name} was fitted, and this log has no such parameter; it has {', '.join(names)}")
    return np.array([p.parameter(values[p.name]) if p.name in values else 0.0 for p in model.parameters])


def apply(model: Model, theta: Sequence[float] | Array, *, floor: bool = False, cut: float | None = None) -> Inputs:
    """The inputs with parameters theta (n,).

    With odometry.csv the velocity is scaled and preintegrated between frames `latency` earlier, at the true instants of
    the observations. Otherwise an increment is scaled as an arc of constant curvature.

    `floor` adds the log's covariance floor, as loading does (an EKF does not need it). `cut` [s]: latency at which
    odometry.csv is cut into increments, which are moved with the smoothed velocity to the latency of theta.
    """
    value = {p.name: float(t) for p, t in zip(model.parameters, theta, strict=True)}
    inputs = model.inputs
    increments = _increments(model, value, cut)
    covariance, floored = increments.covariance, inputs.floored
    if floor:
        covariance, more = floor_covariances(covariance, inputs.covariance_floor)
        floored = more if model.odometry is not None else max(floored, more)
    o = inputs.observations
    if not isinstance(o, LabelledObservations):
        raise ValueError("known association was not granted to these inputs")
    z, R = _readings(model, value)
    return replace(
        inputs,
        time=inputs.time - value.get(LATENCY, 0.0),
        increments=Increments(increments.mean, covariance),
        observations=replace(o, z=z, R=R),
        floored=floored,
    )


def _increments(model: Model, value: Mapping[str, float], cut: float | None) -> Increments:
    forward, turn = math.exp(value.get("odometry_v", 0.0)), math.exp(value.get("odometry_omega", 0.0))
    if model.odometry is not None:
        odometry, latency = model.odometry, value.get(LATENCY, 0.0)
        noisy = replace(odometry.model, noise=_scaled(odometry.model.noise, value))
        at = model.inputs.time - (latency if cut is None else cut)
        cutting = preintegrate(noisy, odometry.time, forward * odometry.v, turn * odometry.omega, at)[0]
        if cut is None or cut == latency:
            return cutting
        return moved_later(cutting, smooth_velocity(odometry, at) * np.array([forward, turn]), cut - latency)
    stated = model.inputs.increments
    # a chord is half the arc's turn off the first heading
    half = 0.5 * (turn - 1.0) * stated.mean[:, 2]
    c, s = forward * np.cos(half), forward * np.sin(half)
    dx, dy = stated.mean[:, 0], stated.mean[:, 1]
    mean = np.column_stack([c * dx - s * dy, s * dx + c * dy, turn * stated.mean[:, 2]])
    heading = value.get("motion_heading", 0.0)
    # a turning robot's sideways noise comes from its heading, unless the log separates them
    D = np.exp([value.get("motion_along", 0.0), heading + value.get("motion_lateral", 0.0), heading])
    return Increments(mean, D[:, None] * stated.covariance * D)


def _scaled(noise: VelocityNoise, value: Mapping[str, float]) -> VelocityNoise:
    sigma = (
        noise.sigma[0] * math.exp(value.get("motion_v", 0.0)),
        noise.sigma[1] * math.exp(value.get("motion_omega", 0.0)),
    )
    alphas = tuple(a * math.exp(value.get(f"motion_alpha{i}", 0.0)) for i, a in enumerate(noise.alphas, 1))
    return replace(noise, sigma=sigma, alphas=alphas)


def _readings(model: Model, value: Mapping[str, float]) -> tuple[Array, Array]:
    """Corrected observations (M, 2) and their noise (M, 2, 2)."""
    inputs = model.inputs
    o, sensor = inputs.observations, inputs.sensor
    polar = isinstance(sensor, RangeBearing)
    first, second = ("range", "bearing") if polar else ("x", "y")
    D = np.empty_like(o.z)
    D[:] = np.exp([value.get(f"sigma_{first}", 0.0), value.get(f"sigma_{second}", 0.0)])
    if value.get("range_growth", 0.0):
        D[:, 0] *= np.maximum(o.z[:, 0], CLOSEST) ** value["range_growth"]
    R = D[:, :, None] * o.R * D[:, None, :]
    z = o.z - np.array([value.get(f"bias_{first}", 0.0), value.get(f"bias_{second}", 0.0)])
    if polar:
        z = np.column_stack([np.maximum(z[:, 0], 0.0), se2.wrap_angle(z[:, 1])])
    return z, R


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
    cost = _cost(model, decisions, frames)
    n = len(model)
    latency = np.array([p.name == LATENCY for p in model.parameters])
    bound, limit = np.array([p.bound for p in model.parameters]), np.array([p.limit for p in model.parameters])

    def near(theta: Array) -> Objective:
        cut = float(theta[latency].sum())
        return lambda x: cost(x, cut)

    def here(theta: Array) -> float:
        return near(theta)(theta)

    starts = starting_points(here, model)
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


def _cost(model: Model, decisions: IntArray, frames: int | None) -> Callable[[Array, float], float]:
    """Negative log-likelihood of the first frames at parameters (n,), with odometry.csv cut at a latency [s]."""
    span = slice(frames)
    stated = -float(run_filter(apply(model, np.zeros(len(model))), decisions).log_likelihood[span].sum())

    def cost(theta: Array, cut: float) -> float:
        run = run_filter(apply(model, theta, cut=cut), decisions)
        value = -float(run.log_likelihood[span].sum())
        fails = run.failure is not None and (frames is None or run.failure[0] < frames)
        return stated + HOPELESS if fails or not math.isfinite(value) else value

    return cost

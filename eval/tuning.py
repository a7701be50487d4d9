"""Maximum likelihood of noise and biases from a log's innovations, with standard errors and whiteness.

The likelihood of all observations is the product of the innovations' densities N(nu; 0, S) (Schweppe, IEEE Trans. Inf.
Theory 11, 1965; Bar-Shalom, Li and Kirubarajan, section 5.4), here of the EKF with known association. The truth is not
used. Every parameter is 0 for the log as stated: the logarithm of a factor (noise, odometry scale), a bias in its unit,
or seconds. A scale of odometry is that of the best prediction: noisy odometry is shrunk by the share of noise in its
mean square.

A latency that averages two noisy samples would be favoured, because an increment cut between two samples has less
noise: the interpolation artefact of image registration (Pluim, Maintz and Viergever, Computer Vision and Image
Understanding 77, 2000). So an increment is cut once and moved from there with the velocity averaged over `HALF_WIDTH`
either side. The covariance of this average with the noise of the increment is the same at both ends and cancels
(instrumental variables: Söderström and Stoica, System Identification, 1989, chapter 8).
"""

import math
from collections import defaultdict
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from pathlib import Path
from typing import NamedTuple

import numpy as np
import scipy

from association.decide import known_decisions
from association.expectation import gate_threshold
from data import se2
from data.columns.header import HEADER, read_header
from data.columns.parts import ODOMETRY, TRUTH
from data.columns.poses import POSE
from data.csv_table import read_table
from data.errors import DataError, UsageError, unknown
from data.inputs import Increments, Inputs, IntArray, LabelledObservations
from data.log import Log
from data.motion.velocity import WITH_ALPHAS, VelocityModel, preintegrate
from data.origin import Origin
from data.result import DISCARD
from data.se2 import Array, BoolArray
from data.sensors import RangeBearing, Sensor
from data.timeline import truth_at, usual_gap
from data.truth_windows import scored, unscored
from ekf.whole_run import run_filter
from eval.referee.consistency import correlated, lag1_correlation, mean_or_nan, nees, nis_bounds
from eval.referee.errors import heading_rmse_deg, position_distance, rms

HALF_WIDTH = 0.3  # s either side of an instant for its velocity: many samples, and short against a robot's manoeuvres
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
    hold = np.minimum(length, usual_gap(time))
    # distance and rotation so far, at each sample and at the end of its hold
    knots = np.column_stack([time[:-1], time[:-1] + hold]).ravel()
    moved = hold * np.stack([odometry.v[:-1], odometry.omega[:-1]])
    end = np.cumsum(moved, axis=1)
    so_far = np.stack([end - moved, end], axis=2).reshape(2, -1)
    moved = np.column_stack([np.interp(at + width, knots, s) - np.interp(at - width, knots, s) for s in so_far])
    return moved / (2.0 * width)


def moved_later(increments: Increments, velocity: Array, by: float) -> Increments:
    """Increments (N, 3) between instants `by` s later, at velocities (N, 2) of the instants; the same noise."""
    arc = se2.along_arcs(by * velocity[:, 0], by * velocity[:, 1])
    mean = increments.mean.copy()
    mean[1:] = se2.compose(se2.inverse(arc[:-1]), se2.compose(mean[1:], arc[1:]))
    return Increments(mean, increments.covariance)


GROUPS = ("motion", "sensor", "bias", "odometry", "latency", "growth")  # groups of parameters; `growth` only on request
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

    def value(self, theta: float) -> float:
        """The number in its unit, or the factor."""
        return float(theta) if self.unit else math.exp(theta)

    def parameter(self, value: float) -> float:
        """The inverse of `value`."""
        return value if self.unit else math.log(value)


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
    first, second = _readings_of(inputs.sensor)
    noise, scale = math.log(1e3), math.log(2.0)
    found: list[Parameter] = []
    if "motion" in groups:
        if odometry is None:
            motion = {
                "along": "factor on the sigma of increments, forward", "heading": "the same, heading and sideways",
                "lateral": "the same, sideways, beyond that of heading",
            }  # fmt: skip
        elif odometry.model.noise.kind in WITH_ALPHAS:
            motion = {f"alpha{i + 1}": f"factor on alphas[{i}]" for i in range(len(odometry.model.noise.alphas))}
        else:
            motion = {"v": "factor on sigma[0] of [motion]", "omega": "factor on sigma[1] of [motion]"}
        found += [Parameter(f"motion_{name}", "", noise, 1.0, about) for name, about in motion.items()]
    if "sensor" in groups:
        found += [Parameter(f"sigma_{n}", "", noise, 1.0, f"factor on the sigma of {n}") for n in (first, second)]
    if "growth" in groups and first == "range":
        found.append(Parameter("range_growth", "log(m)", 3.0, 0.5, "sigma of range also times (range / 1 m)^this"))
    if "bias" in groups:
        sigma = np.sqrt(np.median(np.einsum("nii->ni", inputs.observations.R), axis=0))
        for name, s, unit in zip((first, second), sigma.tolist(), inputs.sensor.units, strict=True):
            largest = min(20.0 * s, 1.0) if unit == "rad" else 20.0 * s
            found.append(Parameter(f"bias_{name}", unit, largest, s, f"measured minus true {name}"))
    if "odometry" in groups:
        found.append(Parameter("odometry_v", "", scale, 0.2, "true distance per odometry distance"))
        found.append(Parameter("odometry_omega", "", scale, 0.2, "true rotation per odometry rotation"))
    if "latency" in groups and odometry is not None:
        found.append(Parameter(LATENCY, "s", 1.0, 0.2, "observations were taken this long before their stamp"))
    return Model(inputs, odometry, tuple(found))


def _readings_of(sensor: Sensor) -> tuple[str, str]:
    return ("range", "bearing") if isinstance(sensor, RangeBearing) else ("x", "y")


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


def vector(model: Model, values: Mapping[str, float]) -> Array:
    """Parameters (n,) from values by name (`Parameter.value`), others as stated. UsageError for an unknown name."""
    names = [p.name for p in model.parameters]
    for name in values:
        if name not in names:
            raise UsageError(f"{name} was fitted, and this log has no such parameter; it has {', '.join(names)}")
    return np.array([p.parameter(values[p.name]) if p.name in values else 0.0 for p in model.parameters])


def apply(model: Model, theta: Array, cut: float | None = None) -> Inputs:
    """The inputs with parameters theta (n,), without the log's covariance floor, which loading adds.

    With odometry.csv the velocity is scaled and preintegrated between frames `latency` earlier, at the true instants of
    the observations. Otherwise an increment is scaled as an arc of constant curvature. `cut` [s]: latency at which
    odometry.csv is cut into increments, which are moved with the smoothed velocity to the latency of theta.
    """
    of = defaultdict(float, zip((p.name for p in model.parameters), map(float, theta), strict=True))
    inputs, o = model.inputs, model.inputs.observations
    if not isinstance(o, LabelledObservations):
        raise ValueError("known association was not granted to these inputs")
    first, second = _readings_of(inputs.sensor)
    D = np.exp([of[f"sigma_{first}"], of[f"sigma_{second}"]]) * np.ones_like(o.z)
    z = o.z - [of[f"bias_{first}"], of[f"bias_{second}"]]
    if first == "range":
        D[:, 0] *= np.maximum(o.z[:, 0], CLOSEST) ** of["range_growth"]
        z = np.column_stack([np.maximum(z[:, 0], 0.0), se2.wrap_angle(z[:, 1])])
    increments = _increments(model, of, of[LATENCY] if cut is None else cut)
    seen = replace(o, z=z, R=D[:, :, None] * o.R * D[:, None, :])
    return replace(inputs, time=inputs.time - of[LATENCY], increments=increments, observations=seen)


def _increments(model: Model, of: Mapping[str, float], cut: float) -> Increments:
    scale = np.exp([of["odometry_v"], of["odometry_omega"]])
    if model.odometry is not None:
        odometry, noise = model.odometry, model.odometry.model.noise
        sigma = (noise.sigma[0] * math.exp(of["motion_v"]), noise.sigma[1] * math.exp(of["motion_omega"]))
        alphas = tuple(a * math.exp(of[f"motion_alpha{i}"]) for i, a in enumerate(noise.alphas, 1))
        noisy = replace(odometry.model, noise=replace(noise, sigma=sigma, alphas=alphas))
        at = model.inputs.time - cut
        increments, _ = preintegrate(noisy, odometry.time, scale[0] * odometry.v, scale[1] * odometry.omega, at)
        if cut == of[LATENCY]:
            return increments
        return moved_later(increments, scale * smooth_velocity(odometry, at), cut - of[LATENCY])
    stated = model.inputs.increments
    half = 0.5 * (scale[1] - 1.0) * stated.mean[:, 2]  # a chord is half the arc's turn off the first heading
    c, s = scale[0] * np.cos(half), scale[0] * np.sin(half)
    dx, dy = stated.mean[:, 0], stated.mean[:, 1]
    mean = np.column_stack([c * dx - s * dy, s * dx + c * dy, scale[1] * stated.mean[:, 2]])
    # a turning robot's sideways noise comes from its heading, unless the log separates them
    D = np.exp([of["motion_along"], of["motion_heading"] + of["motion_lateral"], of["motion_heading"]])
    return Increments(mean, D[:, None] * stated.covariance * D)


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


def score(inputs: Inputs, decisions: IntArray, begin: int = 0) -> Score:
    """Innovations of the frames from `begin`, of a filter that ran from frame 0; DataError if it fails."""
    run = run_filter(inputs, decisions)
    if run.failure is not None:
        raise DataError(f"the filter fails at frame {run.failure[0]} ({run.failure[1]})")
    dof = int(run.dof[begin:].sum())
    frame = inputs.observations.frame
    r, error = lag1_correlation(run.white, frame, np.where(frame >= begin, decisions, DISCARD))
    nis = float(run.nis[begin:].sum()) / dof if dof else math.nan
    return Score(float(run.log_likelihood[begin:].sum()), dof, nis, *nis_bounds(dof), r, error)


Objective = Callable[[Array], float]
FACTORS = np.log([1 / 16, 1 / 4, 1.0, 4.0, 16.0])  # Of the sigmas of motion and observations; all pairs are tried
LATENCIES = np.linspace(-1.0, 1.0, 41)  # s; 0.05 s apart, less than robots take to change speed
FITTED, HELD, AT_BOUND = "fitted", "not determined", "at its bound"
HOPELESS = 1e6  # Added to the objective where the filter fails: worse than any likelihood, finite for the optimizer
ROUNDS = 60  # largest number of searches: each moves the cut or drops a parameter
SETTLED = 1e-3  # gain of log-likelihood of a search below which it has arrived
STEP = 1e-3  # of differences for the slope, in limits of standard errors; 10 times it for the curvature
APART = 2.0  # standard errors either way for the slope of the score in the latency
VAGUE = 2.0  # Standard error of a latency over that by curvature, above which it follows from noise, not motion


@dataclass(frozen=True, eq=False)
class Fit:
    """Parameters (n,) of largest likelihood, standard errors (NaN: not fitted), status; `gain` over the log stated."""

    theta: Array
    error: Array
    status: tuple[str, ...]
    gain: float

    def fitted(self, model: Model) -> dict[int, Parameter]:
        """The parameters that the log determines, by their place."""
        return {i: p for i, p in enumerate(model.parameters) if self.status[i] != HELD}

    def spread(self, model: Model, i: int) -> float:
        """Standard error of a parameter in its printed unit, to first order."""
        p = model.parameters[i]
        return float(self.error[i]) * (1.0 if p.unit else p.value(self.theta[i]))


def starting_point(cost: Objective, model: Model) -> Array:
    """Parameters (n,) to start from: noise first, since misstated sigmas pull all others, then latency, noise again."""
    names = [p.name for p in model.parameters]
    motion = np.array([name.startswith("motion_") and name != "motion_lateral" for name in names])
    sensor = np.array([name.startswith("sigma_") for name in names])
    late = np.array([name == LATENCY for name in names])
    factors = list(product(FACTORS if motion.any() else [0.0], FACTORS if sensor.any() else [0.0]))
    theta = np.zeros(len(names))
    for _ in range(2 if late.any() else 1):
        theta = min((np.where(motion, a, np.where(sensor, b, theta)) for a, b in factors), key=cost)
        if late.any():
            theta = min((np.where(late, latency, theta) for latency in LATENCIES), key=cost)
    return theta


def fit(model: Model, decisions: IntArray, frames: int | None = None) -> Fit:
    """Maximize the innovation likelihood of the first `frames` frames (all, if None).

    A quasi-Newton search in bounds is repeated with odometry.csv cut at the latency reached. A parameter whose standard
    error exceeds its limit returns to 0 and the rest is fitted again, the least determined first. Standard errors are
    those of white innovations: too small for recordings with lasting errors. Raises DataError: no optimum is found.
    """
    cost = _cost(model, decisions, frames)
    late = np.array([p.name == LATENCY for p in model.parameters])
    bound, limit = np.array([(p.bound, p.limit) for p in model.parameters]).T

    def here(theta: Array) -> float:
        return cost(theta, float(theta[late].sum()))

    def near(theta: Array, moving: BoolArray) -> Objective:
        """Cost over the parameters `moving`, in their limits; the odometry is cut at the latency of theta (n,)."""

        def value(x: Array) -> float:
            point = theta.copy()
            point[moving] = x * limit[moving]
            return cost(point, float(theta[late].sum()))

        return value

    def score_of(theta: Array, moving: BoolArray) -> Array:
        return _slope(near(theta, moving), (theta / limit)[moving], STEP)

    theta, free = starting_point(here, model), np.ones(len(model), bool)
    for _ in range(ROUNDS):
        objective, start, largest = near(theta, free), (theta / limit)[free], (bound / limit)[free]
        found = scipy.optimize.minimize(
            objective, start, jac=partial(_slope, objective, step=STEP), method="L-BFGS-B",
            bounds=scipy.optimize.Bounds(-largest, largest),
            options={"maxiter": 300, "maxcor": 20, "ftol": 1e-9, "gtol": 0.03},
        )  # fmt: skip
        theta = theta.copy()
        theta[free] = found.x * limit[free]
        if objective(start) - found.fun > SETTLED:
            continue
        error, edge = np.full(len(model), np.nan), np.abs(theta) > 0.999 * bound
        moving = free & ~edge
        if not moving.any():
            break
        H = _slope(partial(_slope, near(theta, moving), step=10.0 * STEP), (theta / limit)[moving], 10.0 * STEP)
        values, vectors = np.linalg.eigh(H)
        if values[0] < 1.0:  # along this direction a step of the limit changes the likelihood by less than 1/2
            vague = np.flatnonzero(moving)[np.argmax(np.abs(vectors[:, 0]))]
            theta[vague], free[vague] = 0.0, False
            continue
        # Sandwich J^-1 H J^-T of estimating equations (Huber, Proc. 5th Berkeley Symposium, 1967); J, the derivative of
        # a score of variance H, is H except for the latency: odometry cut elsewhere has other noise, which adds to the
        # score's variance and not to its slope.
        J, claimed = H.copy(), np.sqrt(np.diag(np.linalg.inv(H)))
        for i in np.flatnonzero(late[moving]):
            h = APART * claimed[i]
            ahead = h * limit * late
            J[:, i] = (score_of(theta + ahead, moving) - score_of(theta - ahead, moving)) / (2.0 * h)
        inverse = np.linalg.pinv(J, rcond=1e-12)  # without signal the error becomes large
        errors = np.sqrt(np.diag(inverse @ H @ inverse.T))
        error[moving] = errors * limit[moving]
        lost = np.flatnonzero(moving)[late[moving] & (errors > np.minimum(1.0, VAGUE * claimed))]
        if not len(lost):
            break
        theta[lost], free[lost] = 0.0, False
    else:
        raise DataError("the likelihood has no clear maximum on this log; fit fewer parameters")
    status = tuple(HELD if not f else AT_BOUND if e else FITTED for f, e in zip(free, edge, strict=True))
    return Fit(theta, error, status, here(np.zeros(len(model))) - here(theta))


def _slope(function: Callable[[Array], float | Array], x: Array, step: float) -> Array:
    """Derivative (..., k) of a function of x (k,), by central differences."""
    return np.array([function(x + h) - function(x - h) for h in step * np.eye(len(x))]).T / (2.0 * step)


def _cost(model: Model, decisions: IntArray, frames: int | None) -> Callable[[Array, float], float]:
    """Negative log-likelihood of the first frames at parameters (n,), with odometry.csv cut at a latency [s]."""
    span = slice(frames)
    stated = -float(run_filter(model.inputs, decisions).log_likelihood[span].sum())

    def cost(theta: Array, cut: float) -> float:
        run = run_filter(apply(model, theta, cut), decisions)
        value = -float(run.log_likelihood[span].sum())
        fails = run.failure is not None and (frames is None or run.failure[0] < frames)
        return stated + HOPELESS if fails or not math.isfinite(value) else value

    return cost


TUNED = "tuned"  # Title of scores and errors after the fit, key of [source] in log.toml: fitted values and their log
DOUBT = """\
innovations stay correlated (lag-1 {:+.2f} ± {:.2f}, expected 0), so the sigmas, fitted as if they were white, are not \
to be believed: NIS is right by construction, the covariance is not. Remove the cause first: a latency, a bias, slip \
(--fit {} fits no sigma)"""
ITSELF = """\
Noise and biases were fitted to this log by `slamref tune`, so its NIS is right by construction: do not report results \
on it; apply its values to another log with --use."""


class Numbers(NamedTuple):
    """Fitted values by parameter name, and the log they were fitted to."""

    fitted_to: str
    values: Mapping[str, float]


@dataclass(frozen=True, eq=False)
class Tuning:
    """A tuned log, with scores (or the reason for none) and errors by title: RMSE of position [m] and heading [deg],
    mean pose NEES (of a truth of positions alone NaN, and that of the position), without windows of bad ground truth.
    """

    log: Log
    model: Model
    fit: Fit | None
    theta: Array
    scores: Mapping[str, Score | str]
    errors: Mapping[str, tuple[float, float, float]]
    doubtful: str | None  # why sigmas fitted to innovations that stay correlated are not to be believed


def tune(
    log: Log, folder: Path | None = None, *, groups: str | None = None, gate: float | None = None,
    use: Numbers | None = None, keep_truth: bool = False,
) -> Tuning:  # fmt: skip
    """Fit noise and biases of a log with labels, or apply those of another tuned log (`use`), and score both.

    `folder`: of the log, for its odometry.csv. `groups`: comma list of `GROUPS`; None: the default ones. `gate`:
    chi-square probability beyond which pairings are rejected, under the stated noise. `keep_truth`: score windows of
    bad ground truth, too. UsageError: no labels, several sensors, a tuned copy, or invalid options. DataError: no
    observations to fit to, or the filter fails.
    """
    if not log.has_labels:
        raise UsageError(f"log {log.name!r} has no labels; a fit needs them (label in observations.csv)")
    if log.recorded.several_or_partial:
        what = f"log {log.name!r} has several sensors, or one of bearings or ranges alone"
        raise UsageError(f"{what}; a fit needs one that measures two numbers")
    if TUNED in log.source:
        raise UsageError(f"log {log.name!r} is a tuned copy; tune the original")
    inputs = log.inputs(labels=True)
    odometry = None if folder is None else read_odometry(folder)
    wanted = DEFAULT_GROUPS if groups is None else stated_groups(groups, inputs, odometry)
    decisions = pairings(inputs, gate_threshold(gate))
    model = make_model(inputs, odometry, wanted if use is None else GROUPS)
    found = None
    if use is None:
        found = fit(model, decisions)
        theta, fitted = found.theta, found.fitted(model)
        errors_of = {p.name: found.spread(model, i) for i, p in fitted.items()}
        values = {p.name: p.value(theta[i]) for i, p in fitted.items()}
        record: dict[str, object] = {"fitted_to": log.name, "values": values, "standard_errors": errors_of}
        record, note = record | {"log_likelihood_gain": found.gain}, ITSELF
    else:
        theta, record = vector(model, use.values), use._asdict()
        note = f"Noise and biases are those that `slamref tune` fitted to log {use.fitted_to!r}."
    if inputs.fixes is not None or inputs.closures is not None:
        note += " Fixes and closures took no part in the fit."
    tuned, truth = apply(model, theta), log.truth
    if folder is not None and truth.pose is not None and (tuned.time != inputs.time).any():
        table = read_table(folder / TRUTH, ("t", *POSE), may_be_blank=POSE)
        truth = replace(truth, pose=truth_at(table.columns["t"], table.stack(POSE), tuned.time))
    judged, errors = scored(log, keep=keep_truth), {}
    for title, replayed, pose in (("as stated", inputs, log.truth.pose), (TUNED, tuned, truth.pose)):
        if pose is not None:
            pose = np.where(unscored(judged, replayed.time)[:, None], np.nan, pose)
            run = run_filter(replayed, decisions)
            of = "pose" if np.isfinite(pose[:, 2]).any() else "position"
            mean = mean_or_nan(nees(run.pose, run.covariance, pose, of))
            errors[title] = rms(position_distance(run.pose, pose)), heading_rmse_deg(run.pose, pose), mean
    scores = _scores(model, decisions, found, tuned)
    doubt, notes = _doubt(model, found, scores[TUNED]), [*log.notes, note]
    if doubt is not None:
        notes.append(f"In this fit, {doubt}.")
    origins = {**log.origins, **dict.fromkeys(("odometry_noise", "observation_noise"), Origin.INFERRED)}
    copy = replace(log, recorded=tuned.without_labels(), truth=truth, notes=tuple(notes), origins=origins)
    return Tuning(replace(copy, source={**log.source, TUNED: record}), model, found, theta, scores, errors, doubt)


def _scores(model: Model, decisions: IntArray, found: Fit | None, tuned: Inputs) -> dict[str, Score | str]:
    """Scores before and after; after a fit a cross-check, too, fitted to one half, scored on the other."""

    def after(inputs: Callable[[], Inputs], begin: int = 0) -> Score | str:
        try:
            return score(inputs(), decisions, begin)
        except DataError as fault:
            return str(fault)

    scores = {"as stated": score(model.inputs, decisions), TUNED: after(lambda: tuned)}
    if found is not None:
        frames = model.inputs.observations.frame[decisions >= 0]
        half = int(frames[len(frames) // 2])  # by which half of the pairings have been made
        scores["second half, as stated"] = score(model.inputs, decisions, half)
        first = "second half, tuned on the first"
        scores[first] = after(lambda: apply(model, fit(model, decisions, half).theta), half)
    return scores


def _doubt(model: Model, found: Fit | None, after: Score | str) -> str | None:
    if found is None or isinstance(after, str) or not correlated(after.lag1, after.lag1_error):
        return None
    if not any(p.name.startswith(("motion_", "sigma_")) for p in found.fitted(model).values()):
        return None
    causes = "bias,odometry" if model.odometry is None else "bias,odometry,latency"
    return DOUBT.format(after.lag1, after.lag1_error, causes)

"""Effects of noise, biases, odometry scales and a latency on a log's inputs, fitted by `eval.tuning.fit`.

Every parameter is 0 for the log as stated: the logarithm of a factor (noise, odometry scale), a bias in its unit, or
seconds. The truth is not used. A scale of odometry is that of the best prediction: noisy odometry is shrunk by the
share of noise in its mean square.

A latency that averages two noisy samples would be favoured, because an increment cut between two samples has less
noise. The likelihood then has maxima half a sample before and after the right latency (the interpolation artefact of
image registration: Pluim, Maintz and Viergever, Computer Vision and Image Understanding 77, 2000). So an increment is
cut once and moved from there with the velocity averaged over `HALF_WIDTH` either side. The covariance of this average
with the noise of the increment is the same at both ends and cancels (instrumental variables: Söderström and Stoica,
System Identification, 1989, chapter 8).
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from data import se2
from data.columns.header import HEADER, read_header
from data.csv_table import read_table
from data.errors import DataError, UsageError, unknown
from data.formats.open_log.reader import ODOMETRY
from data.inputs import Increments, Inputs, LabelledObservations
from data.motion.velocity import MAX_HOLD, WITH_ALPHAS, VelocityModel, VelocityNoise, floor_covariances, preintegrate
from data.se2 import Array
from data.sensors import RangeBearing

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

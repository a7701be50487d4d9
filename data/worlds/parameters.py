"""Shared parts of simulated worlds: checked parameters, a drive by noisy velocities, a prior of the first pose.

Systematic errors of a robot: `data.motion.systematic` defines them; here they are applied: the odometry, once
corrected, is the motion with the stated noise. The true path and the observed landmarks stay. All are errors, zero for
none: `scale=-0.1` for a robot that goes only 0.9 of the measured distance.

Appearance of landmarks: a descriptor such as a trunk's diameter, a class, or both.
"""

import math
from collections.abc import Collection, Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from typing import Any

import numpy as np

from data import se2
from data.appearance import UNREAD, Appearance, drawn
from data.errors import UsageError, unknown
from data.inputs import ERRORS, Increments, Prior, Systematic
from data.log import Log
from data.motion.systematic import BEARING, DRIFT, RANGE, stated_all
from data.motion.velocity import VelocityModel, VelocityNoise, floor_covariances, preintegrate
from data.result import Systematics
from data.se2 import Array, wrap_angle
from data.sensors import RangeBearing, Sensor
from data.worlds.registry import written

FLOOR = 1e-10  # m^2, rad^2; smallest eigenvalue of an increment's covariance


def check_parameters(
    world: str, values: Any, *, positive: Collection[str], signed: Collection[str] = (),
    choices: Mapping[str, Collection[str]] | None = None,
) -> None:  # fmt: skip
    """Check every field of a dataclass: words by their `choices`; numbers are `positive`, `signed`, or from zero up.

    A field has its default's type (floats accept any number); None stands for an optional number. UsageError names
    world, key and value.
    """
    for f in fields(values):
        value = getattr(values, f.name)
        where = f"{world}: {f.name} = {written(f, value) if 'unit' in f.metadata else repr(value)}"
        if isinstance(f.default, str):
            known = (choices or {})[f.name]
            if value not in known:
                raise UsageError(f"{where}: {unknown(value, known)}")
            continue
        if isinstance(f.default, bool):
            if not isinstance(value, bool):
                raise UsageError(f"{where}; on or off is needed")
            continue
        if f.default is None and value is None:
            continue
        whole, erring = isinstance(f.default, int), isinstance(values, Imperfect) and f.name in ERRONEOUS
        if isinstance(value, bool) or not isinstance(value, int if whole else (int, float)):
            raise UsageError(f"{where}; a {'whole ' if whole else ''}number is needed")
        if not math.isfinite(value):
            raise UsageError(f"{where}; a finite number is needed")
        if f.name in positive and not value > 0:
            raise UsageError(f"{where}; {'at least 1' if whole else 'a positive number'} is needed")
        if value < 0 and f.name not in signed and (not erring or f.name == "drift"):
            raise UsageError(f"{where}; must not be negative")
        if value > 1 and "most" in f.metadata:
            raise UsageError(f"{where}; a {f.metadata['most']} is needed")
        if erring and f.name in RELATIVE and not abs(value) <= LARGEST:
            right = f"an error from -{LARGEST} to {LARGEST} is needed, 0 is none (a factor of 0.9 is -0.1)"
            raise UsageError(f"{where}; {right}")
    if isinstance(values, Imperfect):
        if values.classes == 1 or values.classes > 26:
            raise UsageError(f"{world}: classes = {values.classes}; 2 to 26 are needed, or 0 for none")
        if not 0.0 < values.class_error < 0.5:
            right = "a probability above 0 and below 0.5 is needed"
            raise UsageError(f"{world}: class_error = {values.class_error}; {right}")


def told(value: Any, help: str, **more: str) -> Any:
    """A parameter with its default, and its text for `--help`; `most`: what it is called that is at most 1."""
    return field(default=value, metadata={"help": help, **more})


def in_degrees(value: float, help: str) -> Any:
    """A parameter in radians whose value is written in degrees, in a log's name and as a flag."""
    return told(math.radians(value), help, unit="deg")


def streams(seed: int, count: int) -> list[np.random.Generator]:
    """Independent generators of a seed."""
    return [np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(count)]


SURVEY, DRIFT_STREAM, LOOKS_STREAM = 0x50E7, 0xD41F7, 0x1004
"""Separate the random streams of a map's errors, of the drift and of appearance from others of the same seed."""


def surveyed(log: Log, sigma: float, seed: int) -> Log:
    """The log with a map whose landmarks are off by `sigma` [m] in x and y, as it states; 0: unchanged."""
    known = log.recorded.map
    if known is None or sigma == 0.0:
        return log
    rng = np.random.default_rng(np.random.SeedSequence([seed, SURVEY]))
    stated = np.full(known.xy.shape, sigma)
    off = replace(known, xy=known.xy + stated * rng.standard_normal(stated.shape), sigma=stated)
    return replace(log, recorded=replace(log.recorded, map=off))


def driven(
    period: float, v: Array, omega: Array, at: Array, start: Array, density: tuple[float, float],
    rng: np.random.Generator,
) -> tuple[Array, Increments, int]:  # fmt: skip
    """True poses (N, 3) at the frames `at` (N,), noisy increments, and how many got the floor: v [m/s], omega [rad/s]
    every `period` [s], held, with noise densities `density` [m and rad per sqrt(s)].
    """
    time = period * np.arange(len(v), dtype=np.float64)
    exact, _ = preintegrate(VelocityModel(VelocityNoise("density")), time, v, omega, at)
    truth = np.zeros((len(at), 3))
    truth[0] = start
    for k in range(1, len(truth)):
        truth[k] = se2.compose(truth[k - 1], exact.mean[k])
    root = math.sqrt(period)
    noisy_v = v + density[0] / root * rng.standard_normal(len(time))
    noisy_omega = omega + density[1] / root * rng.standard_normal(len(time))
    increments, _ = preintegrate(VelocityModel(VelocityNoise("density", density)), time, noisy_v, noisy_omega, at)
    covariance, floored = floor_covariances(increments.covariance, FLOOR)
    return truth, Increments(increments.mean, covariance), floored


def drawn_prior(pose: Array, sigma: float, sigma_heading: float, rng: np.random.Generator) -> Prior:
    """A prior with standard deviations [m, rad], its mean drawn about the true pose (3,)."""
    sigmas = np.array([sigma, sigma, sigma_heading])
    mean = pose + sigmas * rng.standard_normal(3)
    mean[2] = se2.wrap_angle(mean[2])
    return Prior(mean, np.diag(sigmas**2))


LARGEST = 0.5  # Largest relative error: 0.9 or 1.1 would be a factor
OF_SENSOR = {"range": "range_error", "bearing": "bearing_error"}  # Parameter names that differ from the error's


@dataclass(frozen=True)
class Imperfect:
    """Systematic errors of the robot, and appearance of landmarks and of false alarms, which look like some of them."""

    scale: float = told(
        0.0, "error of the odometry's distances: the robot goes (1 + scale) times the measured one (0.9 times: -0.1)"
    )
    curvature: float = told(0.0, "rad/m, unmeasured turn to the left with every metre")
    left: float = told(0.0, "the robot turns (1 + left) times the measured angle")
    right: float = told(0.0, "error of turns to the right, likewise")
    drift: float = told(0.0, "rad/m, standard deviation of a varying curvature, with a correlation of 1/e over 50 m")
    range_error: float = told(0.0, "error of measured ranges, which are (1 + range_error) times the true ones")
    bearing_error: float = told(0.0, "rad, error of measured bearings, which are the true ones + bearing_error")
    descriptor_sigma: float = told(
        0.0,
        "standard deviation of a measured descriptor, whose mean differs from landmark to landmark with a standard "
        "deviation of 1; 0: there is none",
    )  # fmt: skip
    classes: int = told(0, "number of classes, equally frequent; 0: there are none")
    class_error: float = told(0.05, "probability that a class is read wrongly")

    @property
    def is_plain(self) -> bool:
        """Whether landmarks look like nothing."""
        return not self.descriptor_sigma and not self.classes


NAMES = tuple(f.name for f in fields(Imperfect))
ERRONEOUS, LOOKS, RELATIVE = NAMES[:-3], NAMES[-3:], ("scale", "left", "right", "range_error")


def described(values: Any) -> dict[str, Any]:
    """The parameters of a world by name, without zero errors, for its log's source."""
    return {k: v for k, v in asdict(values).items() if k not in ERRONEOUS or v != 0.0}


def reported(values: Imperfect, increments: Increments, seed: int) -> tuple[Increments, Systematics | None]:
    """Odometry of noisy motions, and the errors by frame (None and unchanged without errors). Covariances stay: in the
    robot's frame the correction does not change the odometry's noise.
    """
    mean = increments.mean
    size = {name: getattr(values, OF_SENSOR.get(name, name)) for name in ERRORS}
    if not any(size.values()):
        return increments, None
    each = np.tile([float(v) for v in size.values()], (len(mean), 1))
    each[:, DRIFT] = 0.0
    if values.drift:
        rng = np.random.default_rng(np.random.SeedSequence([seed, DRIFT_STREAM]))
        each[:, DRIFT] = values.drift * _wandering(np.hypot(mean[:, 0], mean[:, 1]), rng)
    names = tuple(name for name, v in size.items() if v)
    true = Systematics(names, each[:, [list(ERRORS).index(name) for name in names]], np.zeros((len(mean), len(names))))
    of_odometry, left = each.copy(), np.ones(len(mean), np.bool_)
    of_odometry[:, [RANGE, BEARING]] = 0.0
    for _ in range(2):  # which turn error applies, and then its effect
        said = stated_all(mean, of_odometry, left)[0]
        left = said[:, 2] > 0.0
    said[:, 2] = wrap_angle(said[:, 2])
    return Increments(said, increments.covariance), true


def _wandering(distance: Array, rng: np.random.Generator) -> Array:
    """An Ornstein-Uhlenbeck process (N,) of unit variance, sampled after each of the distances (N,) [m]."""
    drawn = rng.standard_normal(len(distance))
    kept = np.exp(-distance / Systematic.length)
    value = np.empty(len(distance))
    value[0] = drawn[0]
    for k in range(1, len(value)):
        value[k] = kept[k] * value[k - 1] + math.sqrt(1.0 - kept[k] ** 2) * drawn[k]
    return value


def as_read(values: Imperfect, sensor: Sensor, exact: Array) -> Array:
    """The sensor's noise-free measurement with errors, instead of `exact` (m, 2)."""
    if not (values.range_error or values.bearing_error):
        return exact
    polar = sensor.polar(exact)
    r, b = (1.0 + values.range_error) * polar[:, 0], wrap_angle(polar[:, 1] + values.bearing_error)
    if isinstance(sensor, RangeBearing):
        return np.stack([r, b], axis=1)
    return np.stack([r * np.cos(b), r * np.sin(b)], axis=1)


def dressed(values: Imperfect, log: Log, seed: int) -> Log:
    """The log with the appearance of its landmarks and observations; unchanged where there is none."""
    truth, known = log.truth, log.truth.landmarks
    if values.is_plain or known is None or truth.landmark_of is None:
        return log
    rng = np.random.default_rng(np.random.SeedSequence([seed, LOOKS_STREAM]))
    n, row = len(known.id), known.rows(truth.landmark_of)
    classes = min(values.classes, n)
    mean, category = rng.standard_normal(n), rng.permutation(np.arange(n) % max(classes, 1))
    mean = mean if values.descriptor_sigma else np.full(n, np.nan)
    names = tuple("abcdefghijklmnopqrstuvwxyz"[:classes])
    zero = np.zeros(n)
    looks = Appearance(mean, zero, category if values.classes else np.full(n, UNREAD), zero, names)
    m = len(row)
    sigma, error = np.full(m, values.descriptor_sigma or 1.0), np.full(m, values.class_error if values.classes else 0.5)
    like = looks.only(np.where(row >= 0, row, rng.integers(0, n, m)))  # a false alarm reads what some landmark would
    seen = drawn(Appearance(like.descriptor, sigma, like.category, error, names), looks, row, rng)
    places = replace(known, appearance=looks)
    recorded = replace(
        log.recorded, observations=replace(log.recorded.observations, appearance=seen),
        map=None if log.recorded.map is None else places,
    )  # fmt: skip
    return replace(log, recorded=recorded, truth=replace(truth, landmarks=places))

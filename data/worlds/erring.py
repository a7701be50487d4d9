"""Systematic errors of a simulated robot: its odometry and observations with errors.

`data.motion.systematic` defines the errors; here they are applied: the odometry, once corrected, is the motion with the
stated noise. The true path and the observed landmarks stay. All parameters are errors, zero for none: `scale=-0.1` for
a robot that goes only 0.9 of the measured distance.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, fields
from typing import Any

import numpy as np

from data.errors import UsageError
from data.inputs import ERRORS, Increments, Systematic
from data.motion.systematic import CURVATURE, DRIFT, LEFT, RIGHT, SCALE
from data.result import Systematics
from data.se2 import Array, wrap_angle
from data.sensors import RangeBearing, Sensor

LARGEST = 0.5
"""Largest relative error: 0.9 or 1.1 would be a factor."""
STREAM = 0xD41F7
"""Separates the drift's random stream from others of the same seed."""
OF_SENSOR = {"range": "range_error", "bearing": "bearing_error"}
"""Parameter names that differ from the error's."""


@dataclass(frozen=True)
class Erring:
    """Systematic errors, as parameters of a world.

    Attributes:
        scale: error of the odometry's distances: the robot goes (1 + scale) times the measured one (0.9 times: -0.1).
        curvature: rad/m, unmeasured turn to the left with every metre.
        left: error of turns to the left: the robot turns (1 + left) times the measured angle.
        right: error of turns to the right, likewise.
        drift: rad/m, standard deviation of a varying curvature, with a correlation of 1/e over 50 m.
        range_error: error of measured ranges, which are (1 + range_error) times the true ones.
        bearing_error: rad, error of measured bearings, which are the true ones + bearing_error.
    """

    scale: float = 0.0
    curvature: float = 0.0
    left: float = 0.0
    right: float = 0.0
    drift: float = 0.0
    range_error: float = 0.0
    bearing_error: float = 0.0


NAMES = tuple(f.name for f in fields(Erring))


def check_erring(world: str, values: Erring) -> None:
    """UsageError for invalid errors, naming world, key and value."""
    for name in NAMES:
        value = getattr(values, name)
        where = f"{world}: {name} = {value!r}"
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
            raise UsageError(f"{where}; a finite number is needed")
        if name == "drift" and value < 0.0:
            raise UsageError(f"{where}; must not be negative")
        if name in ("scale", "left", "right", "range_error") and not abs(value) <= LARGEST:
            right = f"an error from -{LARGEST} to {LARGEST} is needed, 0 is none (a factor of 0.9 is -0.1)"
            raise UsageError(f"{where}; {right}")


def described(values: Any) -> dict[str, Any]:
    """The parameters of a world by name, without zero errors, for its log's source."""
    return {k: v for k, v in asdict(values).items() if k not in NAMES or v != 0.0}


def reported(values: Erring, increments: Increments, seed: int) -> tuple[Increments, Systematics | None]:
    """Odometry of noisy motions, and the errors by frame (None and unchanged without errors).

    Covariances stay: in the robot's frame the correction does not change the odometry's noise.
    """
    mean = increments.mean
    size = {name: getattr(values, OF_SENSOR.get(name, name)) for name in ERRORS}
    if not any(size.values()):
        return increments, None
    each = np.tile([float(v) for v in size.values()], (len(mean), 1))
    each[:, DRIFT] = 0.0
    if values.drift:
        rng = np.random.default_rng(np.random.SeedSequence([seed, STREAM]))
        each[:, DRIFT] = values.drift * _wandering(np.hypot(mean[:, 0], mean[:, 1]), rng)
    names = tuple(name for name, v in size.items() if v)
    there = [list(ERRORS).index(name) for name in names]
    true = Systematics(names, each[:, there], np.zeros((len(mean), len(names))))
    return Increments(_undone(mean, each), increments.covariance), true


def _wandering(distance: Array, rng: np.random.Generator) -> Array:
    """An Ornstein-Uhlenbeck process (N,) of unit variance, sampled after each of the distances (N,) [m]."""
    drawn = rng.standard_normal(len(distance))
    kept = np.exp(-distance / Systematic.length)
    value = np.empty(len(distance))
    value[0] = drawn[0]
    for k in range(1, len(value)):
        value[k] = kept[k] * value[k - 1] + math.sqrt(1.0 - kept[k] ** 2) * drawn[k]
    return value


def _undone(motion: Array, errors: Array) -> Array:
    """Increments (N, 3) whose correction by errors (N, 7) is `motion` (N, 3).

    The driving direction is found from the result; if noise fits neither, forwards is taken.
    """
    forwards, backwards = (_undone_in(motion, errors, sense) for sense in (1.0, -1.0))
    back = (forwards[:, 0] < 0.0) & (backwards[:, 0] < 0.0)
    return np.where(back[:, None], backwards, forwards)


def _undone_in(motion: Array, errors: Array, sense: float) -> Array:
    """The same for a known direction, 1 forwards and -1 backwards."""
    x, y, turn = motion.T
    d = sense * np.hypot(x, y) / (1.0 + errors[:, SCALE])
    read = turn - d * (errors[:, CURVATURE] + errors[:, DRIFT])
    read = read / (1.0 + np.where(read > 0.0, errors[:, LEFT], errors[:, RIGHT]))
    half = 0.5 * (turn - read)
    c, s = np.cos(half), np.sin(half)
    away = np.stack([c * x + s * y, c * y - s * x], axis=1) / (1.0 + errors[:, SCALE])[:, None]
    return np.column_stack([away, wrap_angle(read)])


def as_read(values: Erring, sensor: Sensor, exact: Array) -> Array:
    """The sensor's noise-free measurement with errors, instead of `exact` (m, 2)."""
    if not (values.range_error or values.bearing_error):
        return exact
    polar = sensor.polar(exact)
    r, b = (1.0 + values.range_error) * polar[:, 0], wrap_angle(polar[:, 1] + values.bearing_error)
    if isinstance(sensor, RangeBearing):
        return np.stack([r, b], axis=1)
    return np.stack([r * np.cos(b), r * np.sin(b)], axis=1)

"""Systematic errors of a simulated robot: odometry and readings as a robot with them would have reported them.

What the errors do is said in `data.motion.systematic`; here it is undone: the odometry is what, once corrected,
is the motion with the noise as stated. The true path and what is seen of which landmark stay as they are. All
parameters are errors, zero where there is none: `scale=-0.1` for a robot that goes only 0.9 of what its wheels say.
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
"""Share by which a world may err: whoever writes 0.9 or 1.1 means a factor."""
STREAM = 0xD41F7
"""Sets the drift's random numbers apart from all others of the same seed."""
OF_SENSOR = {"range": "range_error", "bearing": "bearing_error"}
"""Parameters that are not named as the error is: a world has a range of its own."""


@dataclass(frozen=True)
class Erring:
    """Systematic errors, as parameters of a world.

    Attributes:
        scale: error of the odometry's distances: the robot goes (1 + scale) times what it reads (0.9 times: -0.1).
        curvature: rad/m, what the robot turns to the left with every metre and does not read.
        left: error of turns to the left: the robot turns (1 + left) times what it reads.
        right: error of turns to the right, likewise.
        drift: rad/m, standard deviation of a curvature that comes and goes, forgotten over 50 m (to 1/e).
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
    """Refuse errors with which there is no robot: UsageError naming world, key and value."""
    for name in NAMES:
        value = getattr(values, name)
        where = f"{world}: {name} = {value!r}"
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
            raise UsageError(f"{where}; a finite number is needed")
        if name == "drift" and value < 0.0:
            raise UsageError(f"{where}; must not be negative")
        if name in ("scale", "left", "right", "range_error") and not abs(value) <= LARGEST:
            raise UsageError(
                f"{where}; an error from -{LARGEST} to {LARGEST} is needed, 0 is none (a factor of 0.9 is -0.1)"
            )


def described(values: Any) -> dict[str, Any]:
    """The parameters of a world by name, for the source of its log; errors that there are not are not in it."""
    return {k: v for k, v in asdict(values).items() if k not in NAMES or v != 0.0}


def reported(values: Erring, increments: Increments, seed: int) -> tuple[Increments, Systematics | None]:
    """What odometry reads of noisy motions, and the errors by frame (None: there are none, and nothing is changed).

    Covariances stay: in the robot's frame the correction hands the noise of the odometry on as it is.
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
    told = Systematics(names, each[:, there], np.zeros((len(mean), len(names))))
    return Increments(_undone(mean, each), increments.covariance), told


def _wandering(distance: Array, rng: np.random.Generator) -> Array:
    """An Ornstein-Uhlenbeck process (N,) of unit variance, at the end of each of the distances (N,) [m]."""
    drawn = rng.standard_normal(len(distance))
    stays = np.exp(-distance / Systematic.length)
    value = np.empty(len(distance))
    value[0] = drawn[0]
    for k in range(1, len(value)):
        value[k] = stays[k] * value[k - 1] + math.sqrt(1.0 - stays[k] ** 2) * drawn[k]
    return value


def _undone(motion: Array, errors: Array) -> Array:
    """Increments (N, 3) that are `motion` (N, 3) once corrected by errors (N, 7).

    Which way the robot went is read off the result; where noise turned the sense of a motion to the side, by less than
    the errors turn it, neither sense fits and forwards is taken.
    """
    forwards, backwards = (_undone_in(motion, errors, sense) for sense in (1.0, -1.0))
    back = (forwards[:, 0] < 0.0) & (backwards[:, 0] < 0.0)
    return np.where(back[:, None], backwards, forwards)


def _undone_in(motion: Array, errors: Array, sense: float) -> Array:
    """The same for a robot of which the sense is known, 1 forwards and -1 backwards."""
    x, y, turn = motion.T
    d = sense * np.hypot(x, y) / (1.0 + errors[:, SCALE])
    read = turn - d * (errors[:, CURVATURE] + errors[:, DRIFT])
    read = read / (1.0 + np.where(read > 0.0, errors[:, LEFT], errors[:, RIGHT]))
    half = 0.5 * (turn - read)
    c, s = np.cos(half), np.sin(half)
    away = np.stack([c * x + s * y, c * y - s * x], axis=1) / (1.0 + errors[:, SCALE])[:, None]
    return np.column_stack([away, wrap_angle(read)])


def as_read(values: Erring, sensor: Sensor, exact: Array) -> Array:
    """What the sensor would read, without noise, where it should read `exact` (m, 2)."""
    if not (values.range_error or values.bearing_error):
        return exact
    polar = sensor.polar(exact)
    r, b = (1.0 + values.range_error) * polar[:, 0], wrap_angle(polar[:, 1] + values.bearing_error)
    if isinstance(sensor, RangeBearing):
        return np.stack([r, b], axis=1)
    return np.stack([r * np.cos(b), r * np.sin(b)], axis=1)

"""Systematic errors as variables of a graph: the constants in one vector, the drift by knot, in prior sigmas."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import gtsam
import numpy as np

from data.errors import UsageError
from data.inputs import Increments, IntArray, Prior, Systematic
from data.motion.systematic import BETWEEN_KNOTS, SensorFrame, corrected_all, knots, places, sensor_frame
from data.se2 import Array
from data.sensors import Sensor
from graph.factors import between_factors

NO_SENSOR_ERRORS = (
    "systematic errors of range or bearing are not estimated beside fixes or closures: those of odometry are "
    "(--calibrate scale,curvature,left,right,drift)"
)

CONSTANTS = gtsam.symbol("c", 0)  # key of all constant systematic errors, a vector in units of their prior sigmas


def drift_key(knot: int) -> int:
    """Key of the drift of a knot, a vector (1,) in units of its sigma."""
    return int(gtsam.symbol("d", knot))


@dataclass(frozen=True, eq=False)
class Errors:
    """Systematic errors to estimate, and the place of each (p,) in the graph; q of them are constant."""

    systematic: Systematic  # names, sigmas, length of the drift
    frame: SensorFrame  # in which the sensor has no errors; the frame of the graph

    @cached_property
    def place(self) -> IntArray:
        """Index of each error (p,) among all."""
        return places(self.systematic)

    @cached_property
    def drift(self) -> int:
        """Index of the drift, -1: none."""
        return self.systematic.names.index("drift") if self.systematic.drifts else -1

    @cached_property
    def constant(self) -> IntArray:
        """Indices (q,) of the constant errors."""
        return np.array([j for j in range(len(self.systematic.names)) if j != self.drift], np.int64)

    @property
    def step(self) -> float:
        """Metres from knot to knot."""
        return BETWEEN_KNOTS * self.systematic.length

    @property
    def order(self) -> IntArray:
        """Error (p,) of each coordinate of the variables: the constants, then the drift."""
        return np.append(self.constant, [self.drift] * (self.drift >= 0)).astype(np.int64)

    @property
    def sizes(self) -> dict[str, int]:
        """Dimensions of the variables, by the character of their keys."""
        found = {"c": len(self.constant), "d": int(self.drift >= 0)}
        return {name: size for name, size in found.items() if size}

    def keys(self, knot: int) -> list[int]:
        """Their variables while the drift is that of a knot."""
        return [CONSTANTS] * bool(len(self.constant)) + [drift_key(knot)] * (self.drift >= 0)

    def zero(self, keys: Iterable[int]) -> gtsam.Values:
        """Some of the variables at zero."""
        values, sizes = gtsam.Values(), self.sizes
        for key in keys:
            values.insert(key, np.zeros(sizes[chr(gtsam.symbolChr(key))]))
        return values

    def of_variables(self, at: Array) -> Array:
        """The errors (p,), or their sigmas, from those of the variables (p,)."""
        found = np.empty(len(self.place))
        found[self.order] = at
        return found * self.systematic.sigma

    def terms(self, J: Array, knot: int) -> list[tuple[int, Array]]:
        """A Jacobian (m, p) to the errors in prior sigmas, by variable."""
        found = [(CONSTANTS, J[:, self.constant])] if len(self.constant) else []
        if self.drift >= 0:
            found.append((drift_key(knot), J[:, self.drift : self.drift + 1]))
        return found


def refuse_pose_measurements(frame: SensorFrame) -> None:
    """Raise UsageError for fixes or closures beside errors of the sensor, whose frame is not the world."""
    if not frame.same:
        raise UsageError(NO_SENSOR_ERRORS)


def errors_of(systematic: Systematic, sensor: Sensor, prior: Prior) -> Errors:
    """The errors to estimate by a smoother that begins at the prior."""
    return Errors(systematic, sensor_frame(systematic, sensor, prior))


@dataclass(frozen=True, eq=False)
class Calibrated(Errors):
    """Systematic errors along a whole path of N poses."""

    increments: Increments  # of the log, as stated by odometry

    @cached_property
    def _knots(self) -> tuple[IntArray, Array]:
        return knots(self.systematic, self.increments.mean)

    @property
    def of(self) -> IntArray:
        """Knot (N,) of the drift into each frame."""
        return self._knots[0]

    @property
    def ended(self) -> Array:
        """Length [m] (K - 1,) of each knot but the last."""
        return self._knots[1]

    @property
    def knots(self) -> int:
        """Number of knots, 0 without a drift."""
        return len(self.ended) + 1 if self.drift >= 0 else 0

    def errors(self, values: gtsam.Values) -> Array:
        """The errors (N, p) into each frame, in their units."""
        found = np.empty((len(self.of), len(self.place)))
        if len(self.constant):
            found[:, self.constant] = values.atVector(CONSTANTS)
        if self.drift >= 0:
            found[:, self.drift] = np.array([values.atVector(drift_key(j))[0] for j in range(self.knots)])[self.of]
        return found * self.systematic.sigma

    def insert(self, values: gtsam.Values, errors: Array) -> None:
        """Errors (N, p) as start values; the drift of a knot is that of its first frame."""
        units = errors / self.systematic.sigma
        if len(self.constant):
            values.insert(CONSTANTS, units[-1, self.constant])
        for j, k in enumerate(np.searchsorted(self.of, np.arange(self.knots)).tolist()):
            values.insert(drift_key(j), units[k, [self.drift]])

    def remove(self, values: gtsam.Values) -> None:
        """Erase the errors from `values`."""
        keys = [CONSTANTS] if len(self.constant) else []
        for key in [*keys, *(drift_key(j) for j in range(self.knots))]:
            values.erase(key)

    def motion(self, errors: Array | None = None) -> list[gtsam.BetweenFactorPose2]:
        """The increments as factors in the frame, under errors (N, p) or none. Raises DataError for a singular one."""
        given = self.increments
        if errors is None:
            errors = np.zeros((len(given.mean), len(self.place)))
        mean, covariance, _ = corrected_all(given.mean, given.covariance, errors, self.place, self.frame.mount)
        return between_factors(1, mean[1:], covariance[1:])[0]

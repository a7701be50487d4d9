"""Systematic errors as variables of a graph: the constants in one vector, the drift knot by knot, in prior sigmas."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import gtsam
import numpy as np

from data.inputs import IntArray, Prior, Systematic
from data.motion.systematic import BETWEEN_KNOTS, SensorFrame, places, sensor_frame
from data.se2 import Array
from data.sensors import Sensor
from graph.engine import Engine
from graph.problem import CONSTANTS, drift_key


@dataclass(frozen=True, eq=False)
class Errors:
    """What is estimated, and where each error (p,) is found in the graph.

    Attributes:
        systematic: names, sigmas, length of the drift.
        frame: in which the sensor has no errors; all of the graph is there.
        place: (p,) where they stand among all errors.
        constant: (q,) which of them are constants.
        drift: which of them is the drift, -1: none.
    """

    systematic: Systematic
    frame: SensorFrame
    place: IntArray
    constant: IntArray
    drift: int

    @property
    def step(self) -> float:
        """Metres from knot to knot."""
        return BETWEEN_KNOTS * self.systematic.length

    @property
    def order(self) -> IntArray:
        """Which error (p,) each coordinate of the variables is: the constants, then the drift."""
        return np.append(self.constant, [self.drift] * (self.drift >= 0)).astype(np.int64)

    @property
    def sizes(self) -> dict[str, int]:
        """Of the variables, by the character of their keys."""
        found = {"c": len(self.constant), "d": int(self.drift >= 0)}
        return {name: size for name, size in found.items() if size}

    def keys(self, knot: int) -> list[int]:
        """Their variables while the drift is that of a knot."""
        return [CONSTANTS] * bool(len(self.constant)) + [drift_key(knot)] * (self.drift >= 0)

    def zero(self, keys: Iterable[int]) -> gtsam.Values:
        """Some of the variables at zero, from where they count."""
        values, sizes = gtsam.Values(), self.sizes
        for key in keys:
            values.insert(key, np.zeros(sizes[chr(gtsam.symbolChr(key))]))
        return values

    def read(self, engine: Engine, knot: int) -> Array:
        """The errors (p,) as the graph has them, with the drift of a knot."""
        found = np.empty(len(self.place))
        found[self.order] = np.concatenate([engine.vector(key) for key in self.keys(knot)])
        return found * self.systematic.sigma

    def read_from(self, values: gtsam.Values) -> Array:
        """The errors (p,) of the first increment."""
        found = np.empty(len(self.place))
        found[self.order] = np.concatenate([values.atVector(key) for key in self.keys(0)])
        return found * self.systematic.sigma

    def terms(self, J: Array, knot: int) -> list[tuple[int, Array]]:
        """A Jacobian (m, p) to the errors in prior sigmas, in terms of their variables."""
        found = [(CONSTANTS, J[:, self.constant])] if len(self.constant) else []
        if self.drift >= 0:
            found.append((drift_key(knot), J[:, self.drift : self.drift + 1]))
        return found


def errors_of(systematic: Systematic, sensor: Sensor, prior: Prior) -> Errors:
    """The errors to be estimated by a smoother that begins at the prior."""
    drift = systematic.names.index("drift") if systematic.drifts else -1
    constant = np.array([j for j in range(len(systematic.names)) if j != drift], np.int64)
    return Errors(systematic, sensor_frame(systematic, sensor, prior), places(systematic), constant, drift)

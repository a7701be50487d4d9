"""Sightings that may be of a new landmark, put off until several agree.

What lies outside a landmark's usual spread but inside what the stated noise allows is a new landmark next to it, or
the landmark itself after the robot slipped. The next sightings tell: after a slip, no landmark is where it is expected
until the pose is right again; next to a new landmark, the others stay where they are.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from association.evidence import constants
from association.expectation import gate_threshold
from data.se2 import Array


class Sighting(NamedTuple):
    """Place (2,) [m] in the world, its covariance (2, 2) by the sensor alone, the distance travelled [m] until then."""

    xy: Array
    covariance: Array
    travelled: float

    def distance(self, other: Sighting) -> float:
        """Squared Mahalanobis distance to another one."""
        nu = self.xy - other.xy
        return float(nu @ np.linalg.solve(self.covariance + other.covariance, nu))


@dataclass(eq=False)
class _Place:
    """The latest sighting, how many there were, and the pairings in the run before the first."""

    last: Sighting
    times: int
    pairings: int


class Tentative:
    """Places where something was seen that may be new."""

    def __init__(self) -> None:
        """None yet."""
        self._places: list[_Place] = []
        self._doubts: list[Sighting] = []

    def see(self, sighting: Sighting, pairings: int, reach: float) -> bool:
        """Another such sighting; whether it is a new landmark by now.

        `pairings` so far in the run: one between the first sighting and this one says that the pose is right. A place
        is forgotten after `reach` [m] travelled since its last sighting.
        """
        self._places = [p for p in self._places if sighting.travelled - p.last.travelled <= reach]
        self._doubts = [d for d in self._doubts if sighting.travelled - d.travelled <= reach]
        near = min(self._places, key=lambda p: p.last.distance(sighting), default=None)
        if near is None or near.last.distance(sighting) >= gate_threshold(constants.AGREE_GATE):
            self._places.append(_Place(sighting, 1, pairings))
            return False
        near.last, near.times = sighting, near.times + 1
        if near.times < constants.AGREE or pairings <= near.pairings:
            return False
        self._places.remove(near)
        return True

    def doubt(self, sighting: Sighting) -> None:
        """It was counted as one that a landmark's gate left out."""
        self._doubts.append(sighting)

    def settle(self, sighting: Sighting) -> int:
        """A landmark was initialized there: how many were counted that are its own; they are forgotten."""
        own = [d for d in self._doubts if d.distance(sighting) < gate_threshold(constants.AGREE_GATE)]
        self._doubts = [d for d in self._doubts if not any(d is o for o in own)]
        return len(own)

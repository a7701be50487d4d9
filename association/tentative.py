"""Sightings that may be of a new landmark, put off until several agree.

What lies outside a landmark's usual spread but inside what the stated noise allows is a new landmark beside it, or the
landmark itself after the robot slipped. The next sightings tell: after a slip, no landmark is where it is expected
until the pose is right again; beside a new landmark, the others stay where they are.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from association.expectation import gate_threshold
from data.se2 import Array

AGREE = 3
"""Sightings that must agree with each other, and with no landmark."""
GATE = 0.99
"""Chi-square probability, 2 dof, inside which two sightings agree, by the stated noise of the sensor."""


@dataclass(eq=False)
class _Place:
    """Latest sighting (2,) and covariance (2, 2) in the world; `times` it was seen, `way` [m] and pairings then."""

    xy: Array
    covariance: Array
    times: int
    way: float
    pairings: int


class Tentative:
    """Places where something was seen that may be new."""

    def __init__(self) -> None:
        """None yet."""
        self._places: list[_Place] = []

    def see(self, xy: Array, covariance: Array, way: float, pairings: int, reach: float) -> int:
        """Another such sighting; how many agree on a new landmark by now, 0: none.

        Args:
            xy: (2,) m, in the world. covariance: (2, 2) by the sensor alone.
            way: m, travelled so far; a place is forgotten `reach` [m] after its last sighting.
            pairings: so far in the run: one between the first sighting and this one says that the pose is right.
        """
        self._places = [p for p in self._places if way - p.way <= reach]
        best, least = None, gate_threshold(GATE)
        for p in self._places:
            nu = xy - p.xy
            d2 = float(nu @ np.linalg.solve(covariance + p.covariance, nu))
            if d2 < least:
                best, least = p, d2
        if best is None:
            self._places.append(_Place(xy, covariance, 1, way, pairings))
            return 0
        best.xy, best.covariance, best.way = xy, covariance, way
        best.times += 1
        if best.times < AGREE or pairings <= best.pairings:
            return 0
        self._places = [p for p in self._places if p is not best]
        return best.times

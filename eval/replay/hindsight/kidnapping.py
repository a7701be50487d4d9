"""SLAM's monitor: has the robot been moved unseen, and where in its own map is it then?

A robot that pairs nothing where certain landmarks should be in view is not where it thinks; one that explores misses
nothing. From then on its motion is taken for unknown, and the scan since is looked for in the map without a prior.
"""

from __future__ import annotations

import math

import numpy as np

from association.evidence import constants
from association.geometry.local_map import EMPTY, extended, moved
from association.geometry.relocalize import Place, relocalize
from data.inputs import Increment, IntArray, LandmarkMap, Sightings
from data.se2 import Array
from data.sensors import Sensor


class Whereabouts:
    """The sum of what speaks for having been moved, and the scan since the alarm.

    Attributes:
        lost: since an alarm, until the place is found or landmarks of the map are paired again.
        alarms: frames of them.
        found: frames in which the place was found again.
    """

    def __init__(self, sensor: Sensor) -> None:
        """At the start all is well."""
        self.sensor = sensor
        self.lost = False
        self.alarms: list[int] = []
        self.found: list[int] = []
        self._score, self._scan = 0.0, EMPTY
        self._before = 0

    def move(self, increment: Increment) -> None:
        """The robot moved."""
        if self.lost:
            self._scan = moved(self._scan, increment)

    def watch(self, frame: int, seen: int, created: int, paired: int, surprise: float) -> bool:
        """Whether this frame raises the alarm.

        `seen`: observations; `created`: landmarks so far; `paired`: with certain ones; `surprise`: log-likelihood ratio
        of lost against healthy of all that it missed. It counts where several observations say that the sensor sees.
        """
        if self._score == 0.0 and not self.lost:
            self._before = created
        self._score = max(
            0.0,
            self._score
            + (surprise if seen >= constants.ALARM_OBSERVATIONS else 0.0)
            - constants.PAIRING_TRUST * paired,
        )
        if self.lost or self._score < constants.ALARM:
            return False
        self.lost, self._score, self._scan = True, 0.0, EMPTY
        self.alarms.append(frame)
        return True

    def search(
        self, frame: int, seen: Sightings, rows: IntArray, known: LandmarkMap
    ) -> tuple[Place, dict[int, int]] | None:
        """The place of the scan with this frame's observations, and the landmark of each of its rows that has one.

        Landmarks founded since the trouble began are no part of the map: the scan would find itself.
        """
        old = known.id < self._before
        known = LandmarkMap(known.id[old], known.xy[old])
        self._scan = extended(self._scan, self.sensor, seen, rows)
        place = relocalize(self._scan, known)
        if place is None:
            return None
        self.recover(frame)
        pairs = zip(place.pairings.tolist(), self._scan.rows, strict=True)
        return place, {row: number for number, of in pairs if number >= 0 for row in of}

    def recover(self, frame: int) -> None:
        """It is known again where the robot is."""
        self.lost, self._score = False, 0.0
        self.found.append(frame)


def unknown(xy: Array, reach: float) -> Array:
    """Covariance (3, 3) of a motion to anywhere in a map (n, 2), or as far from it as the sensor reaches."""
    size = float(np.hypot(*np.ptp(xy, axis=0))) if len(xy) else 0.0
    return np.diag([(size + reach) ** 2, (size + reach) ** 2, math.pi**2])

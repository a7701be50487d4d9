"""Gates learned in a run of SLAM: what they left out, and what waits because only the stated noise explains it.

See `association.evidence.scales` for the scales and `association.evidence.tentative` for what waits.
"""

from __future__ import annotations

import math

import numpy as np

from association.evidence import constants
from association.evidence.scales import Scales, counted, relearned
from association.evidence.tentative import Sighting, Tentative
from association.expectation import Expectation
from data.inputs import Increment, IntArray
from data.result import NEW
from data.se2 import Array
from data.sensors import Sensor


class LearnedGates:
    """How wide gates are in this log.

    Attributes:
        scales: what was learned.
    """

    def __init__(self, sensor: Sensor) -> None:
        """Before the first frame."""
        self.sensor = sensor
        self.scales = Scales()
        self._tentative = Tentative()
        self._way, self._pairings = 0.0, 0
        self._asked: dict[tuple[int, bool], float] = {}
        """Where (way) a landmark's gate was judged last, by whether the sighting was inside."""

    def move(self, increment: Increment) -> None:
        """The robot moved."""
        self._way += math.hypot(*increment.mean[:2])

    def learn(self, e: Expectation, decisions: IntArray) -> None:
        """Take in how well the pairings of a frame fit what was expected, as stated."""
        self.scales = relearned(self.scales, e, decisions)

    def judge(self, e: Expectation, decisions: IntArray, stated: IntArray, pose: Array, reach: float) -> IntArray:
        """Decisions (m,): those by the stated noise, but `NEW` where enough sightings agree on a new landmark.

        Args:
            e: what is expected, by the stated noise.
            decisions: (m,) by the noise that there is.
            stated: the same, with `DISCARD` for what is new by these and inside the stated gate of a landmark.
            pose: (3,) of the robot.
            reach: m, the sensor's range.
        """
        stated, nearest = stated.copy(), e.individual_distances()
        paired = stated[stated >= 0].tolist()
        self._pairings += len(paired)
        inside, outside = sum(self._elsewhere(n, True, reach) for n in paired), 0
        for i in np.flatnonzero(stated < 0).tolist():
            xy, _, Gz = self.sensor.inverse(pose, e.z[i : i + 1])
            sighting = Sighting(xy[0], Gz[0] @ e.R[i] @ Gz[0].T, self._way)
            if decisions[i] == NEW != stated[i] and self._tentative.see(sighting, self._pairings, reach):
                stated[i] = NEW
            if stated[i] == NEW:
                # what was in doubt there was not of the landmark beside it
                outside -= self._tentative.settle(sighting)
            elif self._elsewhere(int(e.number[np.argmin(nearest[i])]), False, reach):
                self._tentative.doubt(sighting)
                outside += 1
        self.scales = counted(self.scales, inside, outside)
        return stated

    def _elsewhere(self, number: int, inside: bool, reach: float) -> bool:
        """Whether a landmark's gate was not judged so from here before: from one place it is one case."""
        if self._way - self._asked.get((number, inside), -math.inf) < constants.SAME_PLACE * reach:
            return False
        self._asked[number, inside] = self._way
        return True

"""Parked landmarks come back into a filter's state when they may be seen again, or when something is paired with them.

A bound on each one's uncertainty says when that may be, so that what is parked costs nothing in the meantime.
"""

from __future__ import annotations

import numpy as np

from association.candidates import Drift, may_be_in_view
from data.inputs import Increment, IntArray, Sightings
from data.sensors import Sensor
from eval.replay.estimators import Estimator
from eval.replay.map_management import MapManagement


class Parking:
    """Parks landmarks of an estimator and restores them.

    Attributes:
        largest: how many states the estimator had at most.
        restored: how many landmarks came back, counted each time.
    """

    def __init__(self, estimator: Estimator, management: MapManagement, sensor: Sensor) -> None:
        """Nothing parked."""
        self.estimator, self.management, self.sensor = estimator, management, sensor
        self.largest, self.restored = 0, 0
        self._drift = Drift()

    def move(self, increment: Increment) -> None:
        """The robot moved."""
        self._drift.move(increment)

    def restore_in_view(self) -> None:
        """Restore what may be in view, before anything is expected."""
        parked = self.estimator.parked
        if len(parked):
            pose, covariance = self.estimator.estimate()
            bounds = self._drift.sigmas(parked, covariance)
            self._restore(parked[may_be_in_view(self.sensor, pose, self.estimator.parked_xy(), *bounds)])

    def restore(self, numbers: IntArray) -> None:
        """Restore those of some landmarks (n,) that are parked; decisions that are no landmark are left alone."""
        if len(parked := self.estimator.parked):
            self._restore(np.intersect1d(numbers, parked))

    def _restore(self, numbers: IntArray) -> None:
        if len(numbers):
            self.estimator.restore(numbers)
            self.management.restored(numbers)
            self.restored += len(numbers)

    def see(self, sightings: Sightings, numbers: IntArray) -> None:
        """Landmarks (m,) were seen."""
        self._drift.see(self.sensor, sightings, numbers, self.estimator.estimate().covariance)

    def measure(self) -> None:
        """How large the state is now."""
        self.largest = max(self.largest, self.estimator.size)

    def park(self, numbers: IntArray) -> None:
        """Landmarks (n,) leave the state."""
        if len(numbers):
            self.estimator.park(numbers)

"""Landmarks of SLAM that wait for more observations, since a bearing or a range alone does not locate them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from association.triangulate import triangulate
from data.inputs import Frame, FrameObservations, IntArray
from data.se2 import Array
from data.sensors import Sensor
from eval.replay.estimators import Delaying

MOST = 16
"""Observations of a landmark that wait; of more, every second one is left out, so that they span the way since the
first. They cost the filter a pose each."""


class Waiting(NamedTuple):
    """One observation: its frame, row of the log, numbers (2,), covariance (2, 2) and sensor."""

    frame: int
    row: int
    z: Array
    R: Array
    sensor: Sensor


class Begun(NamedTuple):
    """A landmark that began: its label and number, the rows (m,) of its observations, and the statistics of `nis`."""

    label: int
    number: int
    rows: IntArray
    nis: float
    dof: int
    log_likelihood: float


class WaitingLandmarks:
    """By label, the observations of landmarks that are not in the map yet."""

    def __init__(self) -> None:
        self._of: dict[int, list[Waiting]] = {}
        self._fresh = set[int]()

    def add(self, frame: Frame, rows: IntArray, sensor: Sensor, estimator: Delaying) -> None:
        """Observations `rows` (m,) of (a part of) a frame, whose labels are not in the map."""
        assert frame.label is not None
        for i in rows.tolist():
            label = int(frame.label[i])
            seen = Waiting(frame.number, frame.first + i, frame.observations.z[i], frame.observations.R[i], sensor)
            waiting = self._of.setdefault(label, [])
            waiting.append(seen)
            if len(waiting) > MOST:
                self._of[label] = waiting[::-2][::-1]
                self._release(waiting[-2::-2], estimator)
            self._fresh.add(label)
            estimator.hold(frame.number)

    def begin(self, estimator: Delaying) -> list[Begun]:
        """Initialize the landmarks of the present frame whose places are now determined."""
        begun = []
        for label in sorted(self._fresh):
            waiting = self._of[label]
            sensors = [w.sensor for w in waiting]
            if sum(len(s.measures) for s in sensors) < 3:
                continue
            frames = np.array([w.frame for w in waiting])
            seen = FrameObservations(np.array([w.z for w in waiting]), np.array([w.R for w in waiting]))
            place = triangulate(sensors, *estimator.held(frames), *seen)
            if place is not None:
                number, nis, dof, likelihood = estimator.initialize(frames, sensors, seen, place.xy)
                begun.append(Begun(label, number, np.array([w.row for w in waiting]), nis, dof, likelihood))
                del self._of[label]
                self._release(waiting, estimator)
        self._fresh.clear()
        return begun

    def _release(self, waiting: list[Waiting], estimator: Delaying) -> None:
        """Keep the poses of these observations no longer, unless others need them."""
        needed = {w.frame for other in self._of.values() for w in other}
        for frame in {w.frame for w in waiting} - needed:
            estimator.release(frame)

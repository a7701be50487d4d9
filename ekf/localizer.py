"""EKF localization: three states, a known map, observations paired with the map's ids."""

from __future__ import annotations

import math

import numpy as np

from association.candidates import Places, reading_radius
from association.expectation import Expectation
from data.inputs import IntArray, LandmarkMap, Prior, Sightings
from data.result import Finished, MapState, Updated
from data.se2 import Array
from data.sensors import Sensor
from ekf.filter import DEFAULT, Filter, FilterOptions


class EkfLocalizer(Filter):
    """Extended Kalman filter over the pose (Probabilistic Robotics, Table 7.2, with one stacked update per frame).

    Attributes:
        map: the known landmarks.
        within: `expect` may leave out landmarks that are beyond this squared distance of every reading.
    """

    def __init__(self, prior: Prior, sensor: Sensor, known: LandmarkMap, options: FilterOptions = DEFAULT) -> None:
        """Start at the prior with a map taken as exact."""
        super().__init__(prior, sensor, options)
        self.map, self.within = known, math.inf
        self._places = Places(known.xy)

    def rows_of(self, decisions: IntArray) -> IntArray:
        """Row of the map for each decision; raises ValueError for an id the map does not have."""
        rows = self.map.rows(decisions)
        if np.any(rows < 0):
            raise ValueError(f"decisions {decisions.tolist()} name a landmark the map does not have")
        return rows

    def expect(self, sightings: Sightings) -> Expectation:
        """What the filter expects of the landmarks of the map. Valid until the next `predict` or `update`."""
        near = self._places.around(self._mean[:2], reading_radius(self.sensor, self._P[:3, :3], sightings, self.within))
        return self._expect(sightings, self.map.id[near], np.full(len(near), -1, np.int64), self.map.xy[near])

    def update(
        self,
        sightings: Sightings,
        decisions: IntArray,
        *,
        threshold: float = np.inf,
        at: Array | None = None,
        innovations: bool = True,
    ) -> Updated:
        """One update with every observation whose decision is a landmark id and whose d^2 is below `threshold`.

        It is first linearized at the prediction, or at the pose `at` (3,) if that is known to be better. A filter
        forms its innovations whether they are asked for or not.
        """
        paired = np.flatnonzero(decisions >= 0)
        known = self.map.xy[self.rows_of(decisions[paired])]
        given = np.full(len(paired), -1, np.int64)
        keep, stats, white = self._correct(sightings, paired, given, known, threshold, at)
        used, whitened = np.zeros(len(decisions), np.bool_), np.full((len(decisions), 2), np.nan)
        used[paired], whitened[paired] = keep, white
        nothing = np.full(len(decisions), -1, np.int64)
        return Updated(used, nothing, float(stats[0]), int(stats[2]), float(stats[1]), whitened)

    def reset(self, mean: Array, covariance: Array) -> None:
        """Believe another pose (3,) of covariance (3, 3), whatever was believed before."""
        self._version += 1
        self._mean[:3], self._P[:3, :3] = mean, covariance
        if len(self._first):
            self._first[:3] = mean

    def remove(self, numbers: IntArray) -> None:
        """A known map does not change: asking for it is an error."""
        raise ValueError("a localizer's map is given; landmarks cannot be removed from it")

    def merge(self, merged: IntArray, kept: IntArray) -> None:
        """No two landmarks of a known map are one: asking for it is an error."""
        raise ValueError("a localizer's map is given; its landmarks cannot be joined")

    def landmarks(self) -> MapState:
        """The given map, which has no covariance."""
        return MapState(self.map.id, self.map.xy, np.zeros((len(self.map.id), 2, 2)))

    def finish(self) -> Finished:
        """Nothing to smooth, no map of its own."""
        return Finished(None, None)

"""EKF localization: the pose (and systematic errors), a known map, observations paired with the map's ids."""

from __future__ import annotations

import math

import numpy as np

from association.candidates import Places, reading_radius
from association.expectation import Expectation
from data.inputs import FrameObservations, IntArray, LandmarkMap, Prior, Systematic
from data.result import Finished, MapState, Updated
from data.se2 import Array
from data.sensors import Sensor
from ekf.filter import DEFAULT, Filter, FilterOptions
from ekf.systematic import expect_known, hold_known


class EkfLocalizer(Filter):
    """Extended Kalman filter over the pose (Probabilistic Robotics, Table 7.2, with one stacked update per frame).

    Attributes:
        map: the known landmarks.
        within: `expect` may leave out landmarks that are beyond this squared distance of every reading.
    """

    def __init__(
        self,
        prior: Prior,
        sensor: Sensor,
        known: LandmarkMap,
        options: FilterOptions = DEFAULT,
        *,
        systematic: Systematic | None = None,
    ) -> None:
        """Start at the prior with a map taken as exact; `systematic`: errors to estimate along."""
        super().__init__(prior, sensor, options, systematic)
        self.map, self.within = known, math.inf
        self._places = Places(known.xy)

    def rows_of(self, decisions: IntArray) -> IntArray:
        """Row of the map for each decision; raises ValueError for an id the map does not have."""
        rows = self.map.rows(decisions)
        if np.any(rows < 0):
            raise ValueError(f"decisions {decisions.tolist()} name a landmark the map does not have")
        return rows

    def expect(self, observations: FrameObservations) -> Expectation:
        """What the filter expects of the landmarks of the map. Valid until the next `predict` or `update`."""
        near = self._places.around(*self._surroundings(observations))
        return self._expect(observations, self.map.id[near], np.full(len(near), -1, np.int64), self.map.xy[near])

    def _surroundings(self, observations: FrameObservations) -> tuple[Array, float]:
        """Where (2,) in the world, and within what radius [m], the landmarks of `within` must be."""
        P, a = self._P, self._errors.range_at
        radius = reading_radius(self.sensor, P[:3, :3], observations, self.within)
        if a < 0 or not math.isfinite(radius):
            return self._mean[:2], radius
        # a landmark that stands r from the sensor in the world and q from the origin is expected at (1 + range) r, and
        # that is uncertain by at most the sum of what the pose and what q, at most r and the sensor's own way, bring
        size, sigmas = 1.0 + self._mean[a], math.sqrt(self.within * P[a, a])
        centre = self._frame.points_out(self._mean[None, :2], self._mean[3 : self.base])[0][0]
        swing = math.hypot(*(centre - self._errors.origin)) * sigmas
        return centre, (radius + swing) / (size - sigmas) if size > sigmas else math.inf

    def _look(self, state: Array, at: IntArray, known: Array, z_hat: Array, blocks: Array) -> None:
        if self._errors.range_at < 0:
            super()._look(state, at, known, z_hat, blocks)
            return
        expect_known(
            self._kind, self._extrinsic, state, self._P, known, z_hat, blocks, self._first, self._errors
        )  # fmt: skip

    def _seen_at(self, known: Array) -> Array:
        return self._frame.points_in(known, self._mean[3 : self.base])[0]

    def _gathered(self, state: Array, at: IntArray, known: Array) -> tuple[Array, Array, Array, IntArray]:
        if self._errors.range_at < 0:
            return super()._gathered(state, at, known)
        d, b = self.base + 2 * len(at), self.base
        mean, P, first = np.zeros(d), np.zeros((d, d)), self._first
        mean[:b], P[:b, :b] = state[:b], self._P[:b, :b]
        if len(first):
            first = np.concatenate([first[:b], np.zeros(d - b)])
        hold_known(mean, P, b, known, first, self._errors)
        return mean, P, first, b + 2 * np.arange(len(at), dtype=np.int64)

    def update(
        self,
        observations: FrameObservations,
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
        if self._errors.range_at >= 0:
            # states while the update lasts
            self._grow(len(paired))
            hold_known(self._mean, self._P, self.base, known, self._first, self._errors)
            given, self._carried = self.base + 2 * np.arange(len(paired), dtype=np.int64), 2 * len(paired)
        keep, stats, white = self._correct(observations, paired, given, known, threshold, at)
        self._carried = 0
        used, whitened = np.zeros(len(decisions), np.bool_), np.full((len(decisions), 2), np.nan)
        used[paired], whitened[paired] = keep, white
        nothing = np.full(len(decisions), -1, np.int64)
        return Updated(used, nothing, float(stats[0]), int(stats[2]), float(stats[1]), whitened)

    def reset(self, mean: Array, covariance: Array) -> None:
        """Believe another pose (3,) of covariance (3, 3), whatever was believed before; errors are as they were."""
        self._version += 1
        b = self.base
        self._mean[:3] = self._frame.poses_in(mean[None], self._mean[None, 3:b])[0]
        self._P[:3, :3], self._P[:3, 3:b], self._P[3:b, :3] = covariance, 0.0, 0.0
        if not self._frame.same:
            back = np.eye(b)
            back[:3, :3] = self._inside()
            _, J = self._frame.poses_out(self._mean[None, :3], self._mean[None, 3:b])
            back[:3, 3:] = -back[:3, :3] @ J[0, :, 3:]
            P = back @ self._P[:b, :b] @ back.T
            self._P[:b, :b] = 0.5 * (P + P.T)
        if len(self._first):
            self._first[:3] = self._mean[:3]

    def landmarks(self) -> MapState:
        """The given map, which has no covariance."""
        return MapState(self.map.id, self.map.xy, np.zeros((len(self.map.id), 2, 2)))

    def finish(self) -> Finished:
        """Nothing to smooth, no map of its own."""
        return Finished(None, None)

"""EKF localization: pose and systematic errors, with a known map."""

from __future__ import annotations

import math

import numpy as np

from association.candidates import Places, gate_radius
from association.expectation import Expectation
from data.inputs import FrameObservations, IntArray, LandmarkMap, Prior, Systematic
from data.result import Finished, MapState, Updated
from data.se2 import Array
from data.sensors import Sensor
from ekf.filter import DEFAULT, Filter, FilterOptions
from ekf.systematic import expect_known, hold_known


class EkfLocalizer(Filter):
    """Extended Kalman filter over the pose (Probabilistic Robotics, Table 7.2, with one stacked update per frame)."""

    def __init__(
        self,
        prior: Prior,
        sensor: Sensor,
        known: LandmarkMap,
        options: FilterOptions = DEFAULT,
        *,
        systematic: Systematic | None = None,
    ) -> None:
        """Start at the prior with an exact map; `systematic`: errors to estimate."""
        super().__init__(prior, sensor, options, systematic)
        self.map, self.within = known, math.inf  # within: squared distance beyond which `expect` may omit landmarks
        self._places = Places(known.xy)

    def expect(self, observations: FrameObservations) -> Expectation:
        """Expectation of the map's landmarks, valid until the next `predict` or `update`."""
        near = self._places.around(*self._search_circle(observations))
        return self._expect(observations, self.map.id[near], np.full(len(near), -1, np.int64), self.map.xy[near])

    def _search_circle(self, observations: FrameObservations) -> tuple[Array, float]:
        """Centre (2,) in the world and radius [m] of a circle around all landmarks of `within`."""
        P, a = self._P, self._errors.range_at
        radius = gate_radius(self.sensor, P[:3, :3], observations, self.within)
        if a < 0 or not math.isfinite(radius):
            return self._mean[:2], radius
        # a landmark at r from the sensor and q from the origin is expected at (1 + range) r, uncertain by at most the
        # sum of the pose's part and that of q, which is at most r and the sensor's distance from the origin
        size, sigmas = 1.0 + self._mean[a], math.sqrt(self.within * P[a, a])
        centre = self._frame.points_out(self._mean[None, :2], self._mean[3 : self.base])[0][0]
        swing = math.hypot(*(centre - self._errors.origin)) * sigmas
        return centre, (radius + swing) / (size - sigmas) if size > sigmas else math.inf

    def _predict_measurements(self, state: Array, at: IntArray, known: Array, z_hat: Array, blocks: Array) -> None:
        if self._errors.range_at < 0:
            super()._predict_measurements(state, at, known, z_hat, blocks)
            return
        expect_known(self._kind, self._extrinsic, state, self._P, known, z_hat, blocks, self._first, self._errors)

    def _in_frame(self, known: Array) -> Array:
        return self._frame.points_in(known, self._mean[3 : self.base])[0]

    def _substate(self, state: Array, at: IntArray, known: Array) -> tuple[Array, Array, Array, IntArray]:
        if self._errors.range_at < 0:
            return super()._substate(state, at, known)
        d, b = self.base + 2 * len(at), self.base
        mean, P, first = np.zeros(d), np.zeros((d, d)), self._first
        mean[:b], P[:b, :b] = state[:b], self._P[:b, :b]
        if len(first):
            first = np.concatenate([first[:b], np.zeros(d - b)])
        hold_known(mean, P, b, known, 0, len(known), first, self._errors)
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
        Linearized first at the prediction, or at a pose `at` (3,). A filter always forms its innovations.
        """
        paired = (decisions >= 0).nonzero()[0]
        rows = self.map.rows(decisions[paired])
        if len(rows) and rows.min() < 0:
            raise ValueError(f"decisions {decisions[paired].tolist()} name a landmark the map does not have")
        known = self.map.xy[rows]
        given = np.full(len(paired), -1, np.int64)
        if self._errors.range_at >= 0:
            # temporary states of the update
            self._grow(len(paired))
            hold_known(self._mean, self._P, self._used, known, 0, len(known), self._first, self._errors)
            given = self._used + 2 * np.arange(len(paired), dtype=np.int64)
            self._carried += 2 * len(paired)
        updated = self._updated(observations, decisions, given, known, threshold, at)
        self._carried = self.kept
        return updated

    def reset(self, mean: Array, covariance: Array) -> None:
        """Set pose (3,) and covariance (3, 3), and keep the systematic errors; earlier poses are no longer known."""
        self._version += 1
        self._clones.frames.clear()
        self._carried = 0
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
        """No smoothed path, and no map of its own."""
        return Finished(None, None)

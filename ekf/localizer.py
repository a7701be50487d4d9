"""EKF localization: pose and systematic errors, with a known map, and its landmarks where that is uncertain.

A landmark's error in the map is the same in all its observations: a bias, which no noise of the observations can stand
for. So a landmark with standard deviations is a state, with its place in the map as prior, from its first use on; until
then it is independent of all else, and nothing is lost. As an estimated state it learns from the observations, and the
filter equals the smoothers of a linear problem; a consider state (Schmidt, "Application of state-space methods to
navigation problems", Advances in Control Systems 3, 1966; Jazwinski, "Stochastic processes and filtering theory", 1970,
section 8.4) would cost the same and learn nothing.
"""

import math

import numpy as np

from association.candidates import Places, gate_radius
from association.expectation import Expectation
from data.blocks import coordinates_from
from data.compiled import njit
from data.inputs import FrameObservations, IntArray, LandmarkMap, Prior, Systematic, not_estimable, row_of
from data.result import Finished, MapState, Updated, map_with
from data.se2 import Array
from data.sensors import Sensor
from ekf.filter import DEFAULT, Filter, FilterOptions
from ekf.systematic import hold_known

EXACT, ABSENT = -1, -2  # offsets of landmarks that are no states: without an error; uncertain, minus the row in the map


@njit
def look_up(id_: IntArray, xy: Array, slot: IntArray, decisions: IntArray, at: IntArray, known: Array) -> bool:
    """Fill `at` (m,) from `slot` (L,), and `known` (m, 2), of the landmarks in decisions (m,), `EXACT` for none. False
    if one is not in the map: id_ (L,) ascending, xy (L, 2).
    """
    there = True
    for i in range(len(decisions)):
        at[i], known[i, 0], known[i, 1] = EXACT, 0.0, 0.0
        if decisions[i] >= 0:
            row = row_of(id_, decisions[i])
            if row < 0:
                there = False
            else:
                at[i], known[i, 0], known[i, 1] = slot[row], xy[row, 0], xy[row, 1]
    return there


class EkfLocalizer(Filter):
    """Extended Kalman filter over the pose (Probabilistic Robotics, Table 7.2, with one stacked update per frame)."""

    def __init__(
        self, prior: Prior, sensor: Sensor, known: LandmarkMap, options: FilterOptions = DEFAULT, *,
        systematic: Systematic | None = None,
    ) -> None:  # fmt: skip
        """Start at the prior. Raises ValueError for an uncertain map beside a range error, or of walls."""
        super().__init__(prior, sensor, options, systematic)
        self.map, self.within = known, math.inf  # within: squared distance beyond which `expect` may omit landmarks
        self._places = Places(known.xy)
        self._sigma = np.zeros((len(known.id), 2)) if known.sigma is None else known.sigma
        self._slot = np.where(self._sigma.any(axis=1), ABSENT - np.arange(len(known.id)), EXACT)
        """Of each row of the map: offset in the state, `EXACT`, or `ABSENT` minus the row."""
        if why := not_estimable(systematic, known, sensor):
            raise ValueError(why)

    def expect(self, observations: FrameObservations) -> Expectation:
        """Expectation of the map's landmarks, valid until the next `predict` or `update`."""
        near = self._places.around(*self._search_circle(observations))
        return self._expect(observations, self.map.id[near], self._slot[near], self.map.xy[near])

    def _search_circle(self, observations: FrameObservations) -> tuple[Array, float]:
        """Centre (2,) in the world and radius [m] of a circle around all landmarks of `within`, by the map."""
        P, a = self._P, self._errors.range_at
        radius = gate_radius(self.sensor, P[:3, :3], observations, self.within)
        if self.map.sigma is not None and math.isfinite(radius):
            moved = self._mean[self._at].reshape(-1, 2) - self.map.xy[self._slot >= 0]
            radius += math.sqrt(self.within) * float(np.hypot(*self._sigma.T).max())
            radius += float(np.hypot(*moved.T).max(initial=0.0))
        if a < 0 or not math.isfinite(radius):
            return self._mean[:2], radius
        # a landmark at r from the sensor and q from the origin is expected at (1 + range) r, uncertain by at most the
        # sum of the pose's part and that of q, which is at most r and the sensor's distance from the origin
        size, sigmas = 1.0 + self._mean[a], math.sqrt(self.within * P[a, a])
        centre = self._frame.points_out(self._mean[None, :2], self._mean[3 : self.base])[0][0]
        swing = math.hypot(*(centre - self._errors.origin)) * sigmas
        return centre, (radius + swing) / (size - sigmas) if size > sigmas else math.inf

    @property
    def _at(self) -> IntArray:
        """Offsets (2n,) of their coordinates."""
        return coordinates_from(self._slot[self._slot >= 0])

    def _in_frame(self, known: Array) -> Array:
        return self._frame.points_in(known, self._mean[3 : self.base])[0]

    def _substate(self, state: Array, at: IntArray, known: Array) -> tuple[Array, Array, Array, IntArray]:
        if self._errors.range_at < 0:
            mean, P, first, moved = super()._substate(state, at, known)
            absent = np.flatnonzero(at <= ABSENT)
            if not len(absent):
                return mean, P, first, moved
            moved = moved.copy()
            d, xy = len(mean), known[absent].ravel()
            mean, first = np.concatenate([mean, xy]), np.concatenate([first, xy]) if len(first) else first
            whole = np.diag(np.concatenate([np.zeros(d), self._sigma[ABSENT - at[absent]].ravel() ** 2]))
            whole[:d, :d] = P[:d, :d]
            moved[absent] = d + 2 * np.arange(len(absent))
            return mean, whole, first, moved
        d, b = self.base + 2 * len(at), self.base
        mean, P, first = np.zeros(d), np.zeros((d, d)), self._first
        mean[:b], P[:b, :b] = state[:b], self._P[:b, :b]
        if len(first):
            first = np.concatenate([first[:b], np.zeros(d - b)])
        hold_known(mean, P, b, known, 0, len(known), first, self._errors)
        return mean, P, first, b + 2 * np.arange(len(at), dtype=np.int64)

    def update(
        self, observations: FrameObservations, decisions: IntArray, *, threshold: float = np.inf,
        at: Array | None = None, innovations: bool = True,
    ) -> Updated:  # fmt: skip
        """One update with every observation whose decision is a landmark id and whose d^2 is below `threshold`.
        Linearized first at the prediction, or at a pose `at` (3,). A filter always forms its innovations.
        """
        decisions, m = np.array(decisions, np.int64), len(decisions)
        given, known = np.empty(m, np.int64), np.empty((m, 2))
        if not look_up(self.map.id, self.map.xy, self._slot, decisions, given, known):
            raise ValueError(f"decisions {decisions[decisions >= 0].tolist()} name a landmark the map does not have")
        if self.map.sigma is not None and given.min(initial=EXACT) <= ABSENT:
            self._join(ABSENT - given[given <= ABSENT])
            look_up(self.map.id, self.map.xy, self._slot, decisions, given, known)
        if self._errors.range_at >= 0:
            places = known[decisions >= 0]  # temporary states of the update
            k = len(places)
            self._grow(k)
            hold_known(self._mean, self._P, self._used, places, 0, k, self._first, self._errors)
            given[decisions >= 0] = self._used + 2 * np.arange(k, dtype=np.int64)
            self._carried += 2 * k
        updated = self._updated(observations, decisions, given, known, threshold, at)
        self._carried = self.kept
        return updated

    def _join(self, rows: IntArray) -> None:
        """Make uncertain landmarks, by rows of the map (k,), states in this order; none is one yet."""
        new = np.array(list(dict.fromkeys(rows.tolist())), np.int64)
        self._grow(len(new))
        d, e = self.size, self._used
        end = e + 2 * len(new)
        self._mean[e:end] = self.map.xy[new].ravel()
        self._P[e:end, :end], self._P[:end, e:end] = 0.0, 0.0
        self._P[np.arange(e, end), np.arange(e, end)] = self._sigma[new].ravel() ** 2
        if len(self._first):
            self._first[e:end] = self._mean[e:end]
        self._before_carried(d, e, end)
        self._slot[new] = d + 2 * np.arange(len(new))
        self.size += 2 * len(new)

    def reset(self, mean: Array, covariance: Array) -> None:
        """Set pose (3,) and covariance (3, 3), keep the errors; earlier poses are lost, landmarks as in the map."""
        self._version += 1
        self._clones.frames.clear()
        self._carried = 0
        joined = np.flatnonzero(self._slot >= 0)
        self._slot[joined] = ABSENT - joined
        b = self.size = self.base
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
        """The map, without covariance where it is exact; landmarks that were used are where they are estimated."""
        at = self._at.reshape(-1, 2)
        blocks = self._P[at[:, :, None], at[:, None, :]]
        return map_with(self.map, MapState(self.map.id[self._slot >= 0], self._mean[self._at].reshape(-1, 2), blocks))

    def finish(self) -> Finished:
        """No smoothed path; the map as estimated, if it is uncertain."""
        return Finished(None, None if self.map.sigma is None else self.landmarks())

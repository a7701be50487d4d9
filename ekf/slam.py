"""EKF-SLAM: landmarks behind pose and systematic errors, with full cross-covariance, removable and parkable."""

from __future__ import annotations

import numpy as np

from association.expectation import Expectation
from data.inputs import FrameObservations, IntArray
from data.result import NEW, Finished, Updated
from data.se2 import Array, wrap_angle
from ekf import kernels
from ekf.parkable import SlamState
from ekf.parking import symmetric

JOINED = 1e-4
"""m, of a wall also rad; standard deviation of the difference of two merged landmarks."""


class EkfSlam(SlamState):
    """Extended Kalman filter over the pose and all landmarks (Probabilistic Robotics, section 10.2).

    For buffers and parked landmarks see `ekf.parkable`.
    """

    def expect(self, observations: FrameObservations) -> Expectation:
        """Expectation of every active landmark, valid until the next `predict` or `update`."""
        at = self.base + 2 * np.arange(len(self._number), dtype=np.int64)
        return self._expect(observations, self._number, at, np.zeros((len(self._number), 2)))

    def update(
        self,
        observations: FrameObservations,
        decisions: IntArray,
        *,
        threshold: float = np.inf,
        at: Array | None = None,
        innovations: bool = True,
    ) -> Updated:
        """One update with all pairings below `threshold`, then new landmarks in order, from the updated pose.

        Linearized first at the prediction, or at a pose `at` (3,). A filter always forms its innovations. Raises
        ValueError for a decision that names a landmark that is not in the map, or parked.
        """
        try:
            offset = np.array([self._offset[n] for n in decisions[decisions >= 0].tolist()], np.int64)
        except KeyError as unknown:
            if self._parked.holds(unknown.args[0]):
                raise ValueError(f"landmark {unknown} is parked: restore it first") from None
            raise ValueError(f"no landmark has number {unknown}") from None
        updated = self._updated(observations, decisions, offset, np.zeros((len(offset), 2)), threshold, at)
        fresh = np.flatnonzero(decisions == NEW)
        self._grow(len(fresh))
        end = self._used
        for i in fresh:
            distance = float(self.sensor.polar(observations.z[i : i + 1])[0, 0])
            kernels.augment(
                self._kind, self._extrinsic, self._mean, self._P, end,
                observations.z[i], observations.R[i], self.options.augment_variance(distance), self._first,
            )  # fmt: skip
            end += 2
        if self._carried and len(fresh):
            d, e = self.size, self._used
            order = np.concatenate([np.arange(e, end), np.arange(d, e)])
            self._mean[d:end] = self._mean[order]
            self._P[:end, d:end] = self._P[:end, order]
            self._P[d:end, :end] = self._P[order, :end]
            if len(self._first):
                self._first[d:end] = self._first[order]
        for i in fresh:
            self._offset[self.created] = self.size
            updated.created[i] = self.created
            self._number = np.append(self._number, self.created)
            self.created += 1
            self.size += 2
        return updated

    def remove(self, numbers: IntArray) -> None:
        """Marginalize landmarks out, active or parked."""
        removed, parked = np.isin(self._number, numbers), np.isin(self.parked, numbers)
        if removed.sum() + parked.sum() != len(set(np.asarray(numbers).tolist())):
            raise ValueError(f"cannot remove {np.asarray(numbers).tolist()}: not all are in the map")
        self._version += 1
        kept = np.concatenate([np.ones(self.base, np.bool_), np.repeat(~removed, 2), np.ones(self._carried, np.bool_)])
        self._select(np.flatnonzero(kept))
        self.size -= 2 * int(removed.sum())
        self._renumber(self._number[~removed])
        if parked.any():
            self._marginalize_parked(self.parked[parked])

    @property
    def xy(self) -> Array:
        """Means (a, 2) of the active landmarks, in the frame of the state (copies)."""
        return self._mean[self.base : self.size].reshape(-1, 2).copy()

    def position(self, numbers: IntArray) -> tuple[Array, Array]:
        """Means (2n,) and joint covariance (2n, 2n) of active landmarks, in the frame of the state."""
        at = self._at(numbers)
        return self._mean[at], self._P[np.ix_(at, at)]

    def places(self, numbers: IntArray) -> tuple[Array, Array]:
        """Means (n, 2) of active landmarks, and the variance of x plus that of y (n,)."""
        at = self._at(numbers).reshape(-1, 2)
        return self._mean[at], self._P[at, at].sum(axis=1)

    def merge(self, merged: IntArray, kept: IntArray) -> None:
        """Merge active landmarks `merged` (k,) into `kept` (k,) by the measurement that their difference is zero."""
        self._version += 1
        e, a, b = self._used, self._at(merged), self._at(kept)
        P, mean = self._P[:e, :e], self._mean[:e]
        apart, sign = mean[a] - mean[b], np.ones(len(a))
        if not self.sensor.sees_points:
            apart = self.sensor.residual(mean[a].reshape(-1, 2), mean[b].reshape(-1, 2)).ravel()
            turned = np.cos(mean[a[1::2]] - mean[b[1::2]]) < 0.0  # the same wall with the other normal
            sign[0::2] = np.where(turned, -1.0, 1.0)
        PHt = sign * P[:, a] - P[:, b]
        S = sign[:, None] * PHt[a] - PHt[b] + JOINED**2 * np.eye(len(a))
        gain = np.linalg.solve(S, PHt.T).T
        mean -= gain @ apart
        mean[2] = wrap_angle(float(mean[2]))
        # Joseph's form, so that the small variance of the difference is not rounding
        P -= gain @ PHt.T
        PHt = sign * P[:, a] - P[:, b]
        P -= PHt @ gain.T
        P += JOINED**2 * gain @ gain.T
        P[:] = symmetric(P)
        self.remove(merged)

    def finish(self) -> Finished:
        """The last map; a filter does not revise its path."""
        return Finished(None, self.landmarks())

"""EKF-SLAM: landmarks behind pose and errors, added with their full cross-covariance, removable and parkable."""

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
"""m, of a wall also rad; standard deviation of the difference of two landmarks that are one."""


class EkfSlam(SlamState):
    """Extended Kalman filter over the pose and all landmarks (Probabilistic Robotics, section 10.2).

    For its buffers, and for landmarks that are parked, see `ekf.parkable`.
    """

    def expect(self, observations: FrameObservations) -> Expectation:
        """What the filter expects of every active landmark. Valid until the next `predict` or `update`."""
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

        It is first linearized at the prediction, or at the pose `at` (3,) if that is known to be better. A filter
        forms its innovations whether they are asked for or not.
        Raises ValueError for a decision that names a landmark which is not in the map, or parked.
        """
        paired = np.flatnonzero(decisions >= 0)
        try:
            offset = np.array([self._offset[int(n)] for n in decisions[paired]], np.int64)
        except KeyError as unknown:
            if self._parked.holds(unknown.args[0]):
                raise ValueError(f"landmark {unknown} is parked: restore it first") from None
            raise ValueError(f"no landmark has number {unknown}") from None
        keep, stats, white = self._correct(observations, paired, offset, np.zeros((len(paired), 2)), threshold, at)
        used, whitened = np.zeros(len(decisions), np.bool_), np.full((len(decisions), 2), np.nan)
        used[paired], whitened[paired] = keep, white
        created = np.full(len(decisions), -1, np.int64)
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
            created[i] = self.created
            self._number = np.append(self._number, self.created)
            self.created += 1
            self.size += 2
        return Updated(used, created, float(stats[0]), int(stats[2]), float(stats[1]), whitened)

    def remove(self, numbers: IntArray) -> None:
        """Marginalize landmarks out, active or parked: their rows and columns go, the rest stays as it is."""
        gone, parked = np.isin(self._number, numbers), np.isin(self.parked, numbers)
        if gone.sum() + parked.sum() != len(set(np.asarray(numbers).tolist())):
            raise ValueError(f"cannot remove {np.asarray(numbers).tolist()}: not all are in the map")
        self._version += 1
        stay = np.concatenate([np.ones(self.base, np.bool_), np.repeat(~gone, 2), np.ones(self._carried, np.bool_)])
        self._select(np.flatnonzero(stay))
        self.size -= 2 * int(gone.sum())
        self._renumber(self._number[~gone])
        if parked.any():
            self._leave(self.parked[parked])

    @property
    def xy(self) -> Array:
        """Means (a, 2) of the active landmarks, in the frame of the state (copies)."""
        return self._mean[self.base : self.size].reshape(-1, 2).copy()

    def position(self, numbers: IntArray) -> tuple[Array, Array]:
        """Means (2n,) and joint covariance (2n, 2n) of active landmarks, in the frame of the state."""
        at = self._at(numbers)
        return self._mean[at], self._P[np.ix_(at, at)]

    def places(self, numbers: IntArray) -> tuple[Array, Array]:
        """The same of each by itself: means (n, 2), and the variance of x plus that of y (n,)."""
        at = self._at(numbers).reshape(-1, 2)
        return self._mean[at], self._P[at, at].sum(axis=1)

    def merge(self, merged: IntArray, kept: IntArray) -> None:
        """Landmarks `merged` (k,) are the same as `kept` (k,), all of them active: both estimates become one.

        An update with the measurement that their difference is zero.
        """
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
        # Joseph's form: what is certain of the difference afterwards must not be rounding
        P -= gain @ PHt.T
        PHt = sign * P[:, a] - P[:, b]
        P -= PHt @ gain.T
        P += JOINED**2 * gain @ gain.T
        P[:] = symmetric(P)
        self.remove(merged)

    def finish(self) -> Finished:
        """The last map; a filter does not revise its path."""
        return Finished(None, self.landmarks())

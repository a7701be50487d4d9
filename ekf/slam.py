"""EKF-SLAM: 3 + 2n states, landmarks added with their full cross-covariance and removable at any time."""

from __future__ import annotations

import numpy as np

from association.expectation import Expectation
from data.inputs import IntArray, Prior, Sightings
from data.result import NEW, Finished, MapState, Updated
from data.sensors import Sensor
from ekf import kernels
from ekf.filter import DEFAULT, Filter, FilterOptions


class EkfSlam(Filter):
    """Extended Kalman filter over the pose and all landmarks (Probabilistic Robotics, section 10.2).

    A landmark number is the order of creation and is never reused; `self._number[i]` is the number in slot i, whose
    coordinates stand at 3 + 2 i of the state.
    """

    def __init__(self, prior: Prior, sensor: Sensor, options: FilterOptions = DEFAULT) -> None:
        """Start at the prior with an empty map."""
        super().__init__(prior, sensor, options, capacity=3 + 2 * 16)
        self._number = np.empty(0, np.int64)
        self._offset: dict[int, int] = {}
        self.created = 0

    def _grow(self, extra: int) -> None:
        """Room for `extra` more landmarks; capacity at least doubles, so growing is rare."""
        need = self.size + 2 * extra
        if need > len(self._mean):
            capacity = max(need, 2 * len(self._mean))
            mean, P = np.zeros(capacity), np.zeros((capacity, capacity))
            mean[: self.size] = self._mean[: self.size]
            P[: self.size, : self.size] = self._P[: self.size, : self.size]
            self._mean, self._P = mean, P

    def expect(self, sightings: Sightings) -> Expectation:
        """What the filter expects of every landmark it holds. Valid until the next `predict` or `update`."""
        at = 3 + 2 * np.arange(len(self._number), dtype=np.int64)
        return self._expect(sightings, self._number, at, np.zeros((len(self._number), 2)))

    def update(self, sightings: Sightings, decisions: IntArray, *, threshold: float = np.inf) -> Updated:
        """One update with all pairings below `threshold`, then new landmarks in order, from the updated pose."""
        paired = np.flatnonzero(decisions >= 0)
        try:
            at = np.array([self._offset[int(n)] for n in decisions[paired]], np.int64)
        except KeyError as unknown:
            raise ValueError(f"no landmark has number {unknown}") from None
        keep, stats = self._correct(sightings, paired, at, np.zeros((len(paired), 2)), threshold)
        used = np.zeros(len(decisions), np.bool_)
        used[paired] = keep
        created = np.full(len(decisions), -1, np.int64)
        fresh = np.flatnonzero(decisions == NEW)
        self._grow(len(fresh))
        for i in fresh:
            kernels.augment(
                self._kind, self._extrinsic, self._mean, self._P, self.size,
                sightings.z[i], sightings.R[i], self.options.augment_variance,
            )  # fmt: skip
            self._offset[self.created] = self.size
            created[i] = self.created
            self._number = np.append(self._number, self.created)
            self.created += 1
            self.size += 2
        return Updated(used, created, float(stats[0]), int(stats[2]), float(stats[1]))

    def remove(self, numbers: IntArray) -> None:
        """Marginalize landmarks out: their rows and columns go, the rest of the covariance stays as it is."""
        gone = np.isin(self._number, numbers)
        if gone.sum() != len(set(np.asarray(numbers).tolist())):
            raise ValueError(f"cannot remove {np.asarray(numbers).tolist()}: not all are in the map")
        self._version += 1
        stay = np.concatenate([[True, True, True], np.repeat(~gone, 2)])
        kept = np.flatnonzero(stay)
        d = len(kept)
        self._mean[:d] = self._mean[kept]
        self._P[:d, :d] = self._P[np.ix_(kept, kept)]
        self.size = d
        self._number = self._number[~gone]
        self._offset = {int(n): 3 + 2 * i for i, n in enumerate(self._number)}

    def finish(self) -> Finished:
        """The last map; a filter does not revise its path."""
        n = len(self._number)
        xy = self._mean[3 : self.size].reshape(n, 2).copy()
        blocks = self._P[3 : self.size, 3 : self.size].reshape(n, 2, n, 2)[np.arange(n), :, np.arange(n), :]
        return Finished(None, MapState(self._number.copy(), xy, blocks.copy()))

"""EKF-SLAM: 3 + 2n states, landmarks added with their full cross-covariance, removable and parkable at any time."""

from __future__ import annotations

import numpy as np

from association.expectation import Expectation
from data.blocks import coordinates, coordinates_from, diagonal_blocks
from data.inputs import IntArray, Prior, Sightings
from data.result import NEW, Finished, MapState, Updated
from data.se2 import Array, wrap_angle
from data.sensors import Sensor
from ekf import kernels
from ekf.filter import DEFAULT, Filter, FilterOptions
from ekf.parking import LONGEST, NOTHING, Carried, begin_epoch, symmetric

JOINED = 1e-4
"""m; standard deviation of the difference of two landmarks that are one."""


class EkfSlam(Filter):
    """Extended Kalman filter over the pose and all landmarks (Probabilistic Robotics, section 10.2).

    A landmark number is the order of creation and is never reused; `self._number[i]` is the number in slot i, whose
    coordinates stand at 3 + 2 i of the state. Numbers ascend with the slots. Parked landmarks have no slot: they stay
    in the map but cost nothing until they are restored, see `ekf.parking`.
    """

    def __init__(self, prior: Prior, sensor: Sensor, options: FilterOptions = DEFAULT) -> None:
        """Start at the prior with an empty map."""
        super().__init__(prior, sensor, options, capacity=3 + 2 * 16)
        self._number = np.empty(0, np.int64)
        self._offset: dict[int, int] = {}
        self._parked = NOTHING
        self.created = 0

    def _grow(self, extra: int) -> None:
        """Room for `extra` more landmarks; capacity at least doubles, so growing is rare."""
        need, old = self._used + 2 * extra, len(self._mean)
        if need > old:
            capacity = max(need, 2 * old)
            mean, P = np.zeros(capacity), np.zeros((capacity, capacity))
            mean[:old], P[:old, :old] = self._mean, self._P
            self._mean, self._P = mean, P
            if len(self._first):
                self._first = np.concatenate([self._first, np.zeros(capacity - old)])

    def _select(self, index: IntArray) -> None:
        """Make the buffers hold their entries `index`, in that order."""
        d = len(index)
        self._mean[:d] = self._mean[index]
        self._P[:d, :d] = self._P[np.ix_(index, index)]
        if len(self._first):
            self._first[:d] = self._first[index]

    def _renumber(self, number: IntArray) -> None:
        """The landmarks of the state, slot by slot."""
        self._number = number
        self._offset = {int(n): 3 + 2 * i for i, n in enumerate(number)}

    def expect(self, sightings: Sightings) -> Expectation:
        """What the filter expects of every active landmark. Valid until the next `predict` or `update`."""
        at = 3 + 2 * np.arange(len(self._number), dtype=np.int64)
        return self._expect(sightings, self._number, at, np.zeros((len(self._number), 2)))

    def update(
        self,
        sightings: Sightings,
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
            if unknown.args[0] in self._parked.rows:
                raise ValueError(f"landmark {unknown} is parked: restore it first") from None
            raise ValueError(f"no landmark has number {unknown}") from None
        keep, stats, white = self._correct(sightings, paired, offset, np.zeros((len(paired), 2)), threshold, at)
        used, whitened = np.zeros(len(decisions), np.bool_), np.full((len(decisions), 2), np.nan)
        used[paired], whitened[paired] = keep, white
        created = np.full(len(decisions), -1, np.int64)
        fresh = np.flatnonzero(decisions == NEW)
        self._grow(len(fresh))
        end = self._used
        for i in fresh:
            distance = float(self.sensor.polar(sightings.z[i : i + 1])[0, 0])
            kernels.augment(
                self._kind, self._extrinsic, self._mean, self._P, end,
                sightings.z[i], sightings.R[i], self.options.augment_variance(distance), self._first,
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
        stay = np.concatenate([[True, True, True], np.repeat(~gone, 2), np.ones(self._carried, np.bool_)])
        self._select(np.flatnonzero(stay))
        self.size -= 2 * int(gone.sum())
        self._renumber(self._number[~gone])
        if parked.any():
            self._parked = self._parked.without(numbers)
            self._tidy()

    def position(self, numbers: IntArray) -> tuple[Array, Array]:
        """Means (2n,) and joint covariance (2n, 2n) of active landmarks."""
        at = self._at(numbers)
        return self._mean[at], self._P[np.ix_(at, at)]

    def _at(self, numbers: IntArray) -> IntArray:
        """Where the coordinates of active landmarks (n,) stand in the state (2n,)."""
        return coordinates_from(np.array([self._offset[n] for n in numbers.tolist()], np.int64))

    def merge(self, merged: IntArray, kept: IntArray) -> None:
        """Landmarks `merged` (k,) are the same as `kept` (k,), all of them active: both estimates become one.

        An update with the measurement that their difference is zero.
        """
        self._version += 1
        e, a, b = self._used, self._at(merged), self._at(kept)
        P, mean = self._P[:e, :e], self._mean[:e]
        PHt = P[:, a] - P[:, b]
        S = PHt[a] - PHt[b] + JOINED**2 * np.eye(len(a))
        gain = np.linalg.solve(S, PHt.T).T
        mean -= gain @ (mean[a] - mean[b])
        mean[2] = wrap_angle(float(mean[2]))
        # Joseph's form: what is certain of the difference afterwards must not be rounding
        P -= gain @ PHt.T
        PHt = P[:, a] - P[:, b]
        P -= PHt @ gain.T
        P += JOINED**2 * gain @ gain.T
        P[:] = symmetric(P)
        self.remove(merged)

    @property
    def parked(self) -> IntArray:
        """Numbers (b,) of the parked landmarks, ascending."""
        return np.fromiter(self._parked.rows, np.int64)

    def parked_xy(self) -> Array:
        """Present means (b, 2) of the parked landmarks, ordered as `parked`."""
        return self._parked.xy(self._mean[self.size : self._used])

    def park(self, numbers: IntArray) -> None:
        """Take active landmarks out of the state; nothing is lost, and `restore` brings them back.

        Raises ValueError for a landmark that is parked already or not in the map, in the invariant filter, whose
        correction moves every landmark, and with first estimates, which a parked landmark would lose.
        """
        if self.options.invariant:
            raise ValueError("the invariant filter moves all landmarks together; none can be parked")
        if self.options.first_estimates:
            raise ValueError("a parked landmark would lose its first estimate; none can be parked")
        away = np.unique(np.asarray(numbers, np.int64))
        for n in away.tolist():
            if n in self._parked.rows:
                raise ValueError(f"cannot park landmark {n}: it is parked already")
            if n not in self._offset:
                raise ValueError(f"cannot park landmark {n}: no landmark has this number")
        if not len(away):
            return
        self._version += 1
        out = np.isin(self._number, away)
        moved = 3 + coordinates(np.flatnonzero(out))
        self._select(np.concatenate([np.delete(np.arange(self._used), moved), moved]))
        self.size -= len(moved)
        self._carried += len(moved)
        self._parked = self._parked.parking(away)
        self._renumber(self._number[~out])
        self._tidy()

    def restore(self, numbers: IntArray) -> None:
        """Take parked landmarks back into the state. Raises ValueError for a landmark that is not parked."""
        back = np.unique(np.asarray(numbers, np.int64))
        for n in back.tolist():
            if n not in self._parked.rows:
                raise ValueError(f"cannot restore landmark {n}: it is not parked")
        if not len(back):
            return
        self._version += 1
        self._grow(2 * len(back))
        x, P, d, e, n = self._mean, self._P, self.size, self._used, 2 * len(back)
        # appended: the landmarks as they are now, whose cross-covariance is needed with all of A and y, and their e
        p = self._parked.now(Carried(x[d:e], P[d:e, :e], P[d:e, d:e]), self._parked.index(back))
        x[e : e + n], x[e + n : e + 2 * n] = p.mean, 0.0
        P[e : e + n, :e], P[:e, e : e + n], P[e : e + n, e : e + n] = p.cross, p.cross.T, p.P
        P[e + n : e + 2 * n, : e + 2 * n], P[: e + 2 * n, e + n : e + 2 * n] = 0.0, 0.0
        P[e + n : e + 2 * n, e : e + n], P[e : e + n, e + n : e + 2 * n] = np.eye(n), np.eye(n)
        number = np.concatenate([self._number, back])
        order = np.argsort(number)
        slots = np.concatenate([np.arange(3, d), np.arange(e, e + n)]).reshape(-1, 2)[order].ravel()
        self._select(np.concatenate([np.arange(3), slots, np.arange(d, e), np.arange(e + n, e + 2 * n)]))
        self.size += n
        self._carried += n
        self._parked = self._parked.restoring(back)
        self._renumber(number[order])
        self._tidy()

    def _tidy(self) -> None:
        """Begin an epoch if what is carried has grown too long."""
        d, e, number = self.size, self._used, self.parked
        if self._carried <= min(LONGEST * d, 2 * len(number)):
            return
        B = self._parked.now(Carried(self._mean[d:e], self._P[d:e, :d], self._P[d:e, d:e]), self._parked.index())
        self._parked, y = begin_epoch(number, B)
        self._carried = len(y.mean)
        e = self._used
        self._mean[d:e], self._P[d:e, d:e] = y.mean, y.P
        self._P[d:e, :d], self._P[:d, d:e] = y.cross, y.cross.T

    def reset(self, mean: Array, covariance: Array) -> None:
        """The map goes with the pose: asking for another one is an error."""
        raise ValueError("the map was made from the poses before; only a localizer can be set to another pose")

    def landmarks(self) -> MapState:
        """The map as it is now, active and parked landmarks."""
        n, d, e = len(self._number), self.size, self._used
        xy = self._mean[3:d].reshape(n, 2)
        blocks = diagonal_blocks(self._P[3:d, 3:d])
        number = np.concatenate([self._number, self.parked])
        order = np.argsort(number)
        xy = np.concatenate([xy, self.parked_xy()])[order]
        blocks = np.concatenate([blocks, self._parked.blocks(self._P[d:e, d:e])])[order]
        return MapState(number[order], xy, blocks)

    def finish(self) -> Finished:
        """The last map; a filter does not revise its path."""
        return Finished(None, self.landmarks())

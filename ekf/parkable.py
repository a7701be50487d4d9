"""The state of EKF-SLAM: landmarks in slots, some of them parked (see `ekf.parking`)."""

from __future__ import annotations

import numpy as np

from data.blocks import coordinates, coordinates_from
from data.inputs import FrameObservations, IntArray, Prior, Systematic
from data.result import MapState
from data.se2 import Array
from data.sensors import Sensor
from ekf import systematic
from ekf.filter import DEFAULT, Filter, FilterOptions
from ekf.nearby import EMPTY, MARGIN, may_be_observed, parked_bounds
from ekf.parking import LONGEST, Parked


class SlamState(Filter):
    """Buffers of pose, systematic errors, active landmarks, y and recent landmarks, in this order.

    A landmark number is the order of creation and is never reused; landmark `self._number[i]` is at offset base + 2 i.
    Numbers ascend with the slots. Parked landmarks have no slot and no cost until they are restored.
    """

    def __init__(
        self, prior: Prior, sensor: Sensor, options: FilterOptions = DEFAULT, *, systematic: Systematic | None = None
    ) -> None:
        """Start at the prior with an empty map; `systematic`: errors to estimate."""
        super().__init__(prior, sensor, options, systematic, landmarks=16)
        self._number = np.empty(0, np.int64)
        self._offset: dict[int, int] = {}
        self._parked, self._bounds = Parked(), EMPTY
        self.created = 0

    def _shrink(self) -> None:
        """Reduce buffers that are far too large, as once most of a map is parked."""
        if len(self._mean) > 4 * self._used:
            room = 2 * self._used
            self._mean, self._P = self._mean[:room].copy(), self._P[:room, :room].copy()

    def _select(self, index: IntArray) -> None:
        """Keep the buffer entries `index`, in that order."""
        d = len(index)
        self._mean[:d] = self._mean[index]
        self._P[:d, :d] = self._P[np.ix_(index, index)]
        if len(self._first):
            self._first[:d] = self._first[index]

    def _renumber(self, number: IntArray) -> None:
        """Set the landmark numbers of the slots."""
        self._number = number
        self._offset = {int(n): self.base + 2 * i for i, n in enumerate(number)}

    @property
    def _recent(self) -> int:
        """Offset of the landmarks parked since the epoch began."""
        return self.size + self._parked.k

    @property
    def active(self) -> IntArray:
        """Numbers (a,) of the active landmarks, ascending."""
        return self._number

    @property
    def parked(self) -> IntArray:
        """Numbers (b,) of the parked landmarks, ascending."""
        return self._parked.numbers

    @property
    def carried(self) -> int:
        """Number of states carried besides the active ones."""
        return self._carried

    def parked_xy(self) -> Array:
        """Present means (b, 2) of the parked landmarks, ordered as `parked`."""
        p, d, r = self._parked, self.size, self._recent
        number = np.concatenate([np.flatnonzero(p.based), p.recent])
        xy = np.concatenate([p.xy(self._mean[d:r]), self._mean[r : self._used][: 2 * len(p.recent)].reshape(-1, 2)])
        return self._frame.points_out(xy[np.argsort(number)], self._mean[3 : self.base])[0]

    def parked_within(self, observations: FrameObservations, within: float) -> IntArray:
        """Parked landmarks (r,) that may be within a squared Mahalanobis distance of some observation."""
        parked, d, r = self._parked, self.size, self._recent
        if not len(observations.z) or not np.isfinite(within):
            return parked.numbers if len(observations.z) else np.empty(0, np.int64)
        count = len(parked.recent)
        e = self._expect(observations, parked.recent, r + 2 * np.arange(count), np.zeros((count, 2)))
        found = parked.recent[(e.individual_distances() <= within * MARGIN).any(axis=0)]
        if not parked.based.any():
            return found
        used = np.concatenate([np.arange(3), np.arange(d, r)])
        x, P = self._mean[used], self._P[np.ix_(used, used)]
        near = may_be_observed(parked, self._bounds, self.sensor, x, P, observations, within)
        return np.concatenate([found, np.flatnonzero(near)])

    def park(self, numbers: IntArray, *, begin_epoch: bool = False) -> None:
        """Move active landmarks out of the state without loss; `restore` is the inverse.

        A new epoch begins when the carried part has grown too long, or with `begin_epoch`.

        Raises ValueError for a landmark that is parked already or not in the map, in the invariant filter, which moves
        every landmark, and with first estimates, which a parked landmark would lose.
        """
        if self.options.invariant:
            raise ValueError("the invariant filter moves all landmarks together; none can be parked")
        if self.options.first_estimates:
            raise ValueError("a parked landmark would lose its first estimate; none can be parked")
        away = np.unique(np.asarray(numbers, np.int64))
        for n in away.tolist():
            if n not in self._offset:
                why = "it is parked already" if self._parked.holds(n) else "no landmark has this number"
                raise ValueError(f"cannot park landmark {n}: {why}")
        if not len(away):
            return
        self._version += 1
        out = np.isin(self._number, away)
        moved = self.base + coordinates(np.flatnonzero(out))
        self._select(np.concatenate([np.delete(np.arange(self._used), moved), moved]))
        self.size -= len(moved)
        self._carried += len(moved)
        self._parked.recent = np.concatenate([self._parked.recent, away])
        self._parked.changed()
        self._renumber(self._number[~out])
        self._begin_epoch_if_due(begin_epoch)

    def restore(self, numbers: IntArray) -> None:
        """Return parked landmarks to the state. Raises ValueError for a landmark that is not parked."""
        back = np.unique(np.asarray(numbers, np.int64))
        for n in back.tolist():
            if not self._parked.holds(n):
                raise ValueError(f"cannot restore landmark {n}: it is not parked")
        if not len(back):
            return
        self._version += 1
        parked, d, r, e = self._parked, self.size, self._recent, self._used
        again = np.isin(parked.recent, back)
        place = r + coordinates(np.arange(len(again))).reshape(-1, 2)
        number = np.concatenate([self._number, parked.recent[again]])
        slots = [np.arange(self.base, d).reshape(-1, 2), place[again]]
        grown = np.empty(0, np.int64)
        old = back[~np.isin(back, parked.recent)]
        if len(old):
            n = 2 * len(old)
            self._grow(2 * len(old))
            x, P = self._mean, self._P
            mean, D_p, own, small = parked.restoring(old, x[d:r], P[d:r, d:r])
            # append the present landmarks and the new end of y
            cross = D_p @ P[d:r, :e]
            cross[:, d:r] += D_p
            x[e : e + n], x[e + n : e + 2 * n] = mean, 0.0
            P[e : e + n, :e], P[:e, e : e + n], P[e : e + n, e : e + n] = cross, cross.T, own
            P[e + n : e + 2 * n, : e + 2 * n], P[: e + 2 * n, e + n : e + 2 * n] = 0.0, 0.0
            P[e : e + n, e + n : e + 2 * n], P[e + n : e + 2 * n, e : e + n] = small, small.T
            number = np.concatenate([number, old])
            slots.append(np.arange(e, e + n).reshape(-1, 2))
            grown = np.arange(e + n, e + 2 * n)
        parked.recent = parked.recent[~again]
        parked.changed()
        order = np.argsort(number)
        rows = np.concatenate(slots)[order].ravel()
        self._select(np.concatenate([np.arange(self.base), rows, np.arange(d, r), grown, place[~again].ravel()]))
        self.size = self.base + len(rows)
        self._carried += len(grown) - 2 * int(again.sum())
        self._renumber(number[order])
        self._begin_epoch_if_due()

    def _marginalize_parked(self, removed: IntArray) -> None:
        """Marginalize parked landmarks out."""
        parked = self._parked
        out = np.isin(parked.recent, removed)
        if out.any():
            place = self._recent + coordinates(np.flatnonzero(out))
            self._select(np.delete(np.arange(self._used), place))
            self._carried -= len(place)
            parked.recent = parked.recent[~out]
        parked.leave(removed[~np.isin(removed, parked.recent) & np.isin(removed, np.flatnonzero(parked.based))])
        self._begin_epoch_if_due()

    def _begin_epoch_if_due(self, begin_epoch: bool = False) -> None:
        """Begin an epoch if asked to, or if the carried part has grown too long."""
        if begin_epoch or self._carried > min(LONGEST * self.size, 2 * self._parked.count):
            self._begin_epoch()

    def _begin_epoch(self) -> None:
        """Update all parked landmarks, which makes the carried part as short as possible."""
        parked, d, r, e = self._parked, self.size, self._recent, self._used
        x, P = self._mean, self._P
        self._version += 1
        parked.update(self.created, x[d:r], P[d:r, d:r], (x[r:e], P[r:e, d:r], P[r:e, r:e]))
        at = coordinates(parked.recent)
        C = np.zeros((len(parked.mean), d))
        if parked.k:
            np.matmul(parked.D, P[d:r, :d], out=C)
        C[at] = P[r:e, :d]
        short = 2 * parked.count <= d
        self._carried = 2 * parked.count if short else d
        self._grow(0)
        x, P = self._mean, self._P
        e = self._used
        if short:
            all_of_them = coordinates(parked.numbers)
            x[d:e], P[d:e, d:e] = parked.empty()
            self._bounds = EMPTY
            P[d:e, :d] = C[all_of_them]
            P[:d, d:e] = P[d:e, :d].T
        else:
            L = parked.begin(C, P[:d, :d])
            self._bounds = parked_bounds(parked, C, P[:3, :3])
            x[d:e], P[d:e, d:e] = 0.0, 0.0
            P[:d, d:e], P[d:e, :d] = L, L.T
        self._shrink()

    def _at(self, numbers: IntArray) -> IntArray:
        """Offsets of the coordinates of active landmarks (n,) in the state (2n,)."""
        return coordinates_from(np.array([self._offset[n] for n in numbers.tolist()], np.int64))

    def landmarks(self) -> MapState:
        """The present map, active and parked landmarks."""
        d, r, b = self.size, self._recent, slice(3, self.base)
        based = coordinates(np.flatnonzero(self._parked.based))
        number, xy, blocks = self._parked.now(self._mean[d:r], self._P[d:r, d:r])
        here = np.concatenate([np.arange(self.base, d), r + np.arange(2 * len(self._parked.recent))]).reshape(-1, 2)
        number = np.concatenate([self._number, self._parked.recent, number])
        xy = np.concatenate([self._mean[here], xy])
        blocks = np.concatenate([self._P[here[:, :, None], here[:, None, :]], blocks])
        cross = np.concatenate([self._P[here.ravel(), b], self._parked.D[based] @ self._P[d:r, b]])
        order = np.argsort(number)
        found = MapState(number[order], xy[order], blocks[order])
        cross = cross.reshape(len(number), 2, self.base - 3)[order]
        return systematic.landmarks(found, cross, self._mean[b], self._P[b, b], self._frame)

"""Appearance as evidence: how unlike an observation is to a landmark in what it looks like.

A descriptor is one more measured number, independent of place and of the other pairings. Each landmark has a mean and a
variance, those of the Kalman filter of a constant: N(m, v) before, N(m + v/s (z - m), v (1 - v/s)) after z, with
s = v + sigma^2. The squared distance of a pair grows by (z - m)^2 / s, and gates get one degree of freedom more.

A class is read wrongly with probability e, as each other class alike (the confusion matrix has 1 - e on its diagonal
and e / (C - 1) beside it). Each landmark has the posterior of its class, uniform at first. The squared distance grows
by -2 ln of the probability of what was read over that of the likeliest reading, which is zero or positive. Gates keep
their probability: the squared distance of right pairings is then chi-square plus the cost of the misread ones.

Both terms add up over the pairings of a frame, as no landmark is paired twice there.
"""

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from data.appearance import UNREAD, Appearance
from data.inputs import IntArray, LandmarkMap
from data.se2 import Array, BoolArray

UNKNOWN = 1.0  # squared distance where one of both has no descriptor: its mean, so that a sum over pairings has its own


class Evidence(NamedTuple):
    """What the appearance of a right pairing adds to its squared distance: chi-square of `dims` degrees of freedom, and
    `cost` with probability `error`, that of a misread class.
    """

    dims: int = 0
    error: float = 0.0
    cost: float = 0.0


class Unlike(NamedTuple):
    """By observation (m) and candidate (n): terms of the squared distance and of the logarithm of its determinant."""

    distance: Array
    log_determinant: Array
    right: Evidence

    def only(self, which: IntArray) -> "Unlike":
        """The same of some candidates."""
        return self._replace(distance=self.distance[:, which], log_determinant=self.log_determinant[:, which])

    def of(self, rows: IntArray) -> "Unlike":
        """The same of some observations."""
        return self._replace(distance=self.distance[rows], log_determinant=self.log_determinant[rows])


class Looks:
    """What landmarks look like, by number, as learned from their pairings or known from a map."""

    def __init__(self) -> None:
        self._row: dict[int, int] = {}
        self._mean, self._variance = np.empty(0), np.empty(0)
        self._noise = np.empty((0, 2))  # sigma and error of the newest reading
        self._log = np.empty((0, 0))  # log-likelihood of each class given all readings
        self._names: tuple[str, ...] = ()

    @classmethod
    def of_map(cls, known: LandmarkMap | None) -> "Looks":
        """As a map states them; nothing is known without one."""
        found = cls()
        if known is not None and known.appearance is not None:
            found.see(known.id, known.appearance)
        return found

    def unlike(self, numbers: IntArray, seen: Appearance) -> Unlike:
        """How unlike observations (m,) are to landmarks (n,), which may be unknown ones."""
        m, n = len(seen), len(numbers)
        self._room(seen.names)
        mean, variance, log = self._of(numbers)
        distance, log_det = np.zeros((m, n)), np.zeros((m, n))
        if seen.measures:
            s = variance[None] + seen.sigma[:, None] ** 2
            there = np.isfinite(s) & np.isfinite(seen.descriptor)[:, None] & np.isfinite(mean)[None]
            s = np.where(there, s, 1.0)
            off = np.where(there, seen.descriptor[:, None] - mean[None], 0.0)
            distance += np.where(there, off * off / s, UNKNOWN)
            log_det += np.where(there, np.log(s), 0.0)
        for i, read in self._read(log, seen):  # over the likeliest
            distance[i] += -2.0 * np.log(read[:, seen.category[i]] / read.max(axis=1))
        return Unlike(distance, log_det, evidence(seen))

    def _read(self, log: Array, seen: Appearance) -> Iterator[tuple[int, Array]]:
        """Each observation with a class, and the probability (n, C) that each class is read of each landmark."""
        count = log.shape[1]
        if count < 2 or not len(log):
            return
        likely = np.exp(log - log.max(axis=1, keepdims=True))
        likely /= likely.sum(axis=1, keepdims=True)
        for i in np.flatnonzero(seen.category >= 0).tolist():
            other = seen.error[i] / (count - 1)
            yield i, (1.0 - seen.error[i]) * likely + other * (1.0 - likely)

    def log_ratio(self, numbers: IntArray, seen: Appearance) -> Array:
        """Logarithm of the likelihood (m, n) of each observation's appearance if it is of each landmark, over that if
        it is of something else, which looks like any of them.
        """
        self._room(seen.names)
        mean, variance, log = self._of(numbers)
        found = np.zeros((len(seen), len(numbers)))
        known = self._mean[np.isfinite(self._variance)]
        if seen.measures and len(known) > 1:
            noise = seen.sigma[:, None] ** 2
            ours, any_ = variance[None] + noise, known.var() + noise
            off, stray = seen.descriptor[:, None] - mean[None], seen.descriptor[:, None] - known.mean()
            there = np.isfinite(ours) & np.isfinite(off)
            ratio = 0.5 * (np.log(any_) - np.log(ours) + stray * stray / any_ - off * off / ours)
            found += np.where(there, ratio, 0.0)
        for i, read in self._read(log, seen):  # over a class read at random
            found[i] += np.log(read[:, seen.category[i]] * log.shape[1])
        return found

    def see(self, numbers: IntArray, seen: Appearance) -> None:
        """Observations (m,) were paired with landmarks (m,), negative for none, or initialized them."""
        self._room(seen.names)
        for i in np.flatnonzero(numbers >= 0).tolist():
            row = self._row_of(int(numbers[i]))
            z, noise = seen.descriptor[i], seen.sigma[i] ** 2
            if np.isfinite(z):
                self._measured(row, float(z), float(noise))
                self._noise[row, 0] = seen.sigma[i]
            c = int(seen.category[i])
            if c >= 0 and self._log.shape[1] > 1:
                self._noise[row, 1] = seen.error[i]
                other = seen.error[i] / (self._log.shape[1] - 1)
                with np.errstate(divide="ignore"):  # a known class excludes all others
                    read = np.log(np.where(np.arange(self._log.shape[1]) == c, 1.0 - seen.error[i], other))
                self._log[row] += read
                self._log[row] -= self._log[row].max()

    def _measured(self, row: int, z: float, noise: float) -> None:
        v = self._variance[row]
        if not np.isfinite(v):
            self._mean[row], self._variance[row] = z, noise
        elif v > 0.0:  # else it is known exactly
            gain = v / (v + noise)
            self._mean[row] += gain * (z - self._mean[row])
            self._variance[row] = v * (1.0 - gain)

    def merge(self, pairs: Sequence[tuple[int, int]]) -> None:
        """Landmarks (away, kept) are one: its readings are those of both."""
        for old, new in pairs:
            here = self._row.pop(old, None)
            if here is None:
                continue
            row = self._row_of(new)
            if np.isfinite(self._variance[here]):
                self._measured(row, float(self._mean[here]), float(self._variance[here]))
            self._log[row] += self._log[here]

    def forget(self, numbers: IntArray) -> None:
        """Landmarks (r,) left the map."""
        for n in numbers.tolist():
            self._row.pop(n, None)

    def estimate(self, numbers: IntArray) -> tuple[Array, Array]:
        """Mean (n,) and variance (n,) of landmarks' descriptors, NaN and infinite where unknown."""
        return self._of(numbers)[:2]

    def differ(self, numbers: IntArray, others: IntArray, limit: float) -> BoolArray:
        """Which of landmarks (m,) and others (n,) are not one: the squared distance of a typical reading of one to the
        other is over `limit`, both ways.

        By the noise of a reading and not of the means, since errors that persist make these too sure.
        """
        looks = self.typical(numbers), self.typical(others)
        if looks[0] is None or looks[1] is None:
            return np.zeros((len(numbers), len(others)), np.bool_)
        there, back = self.unlike(others, looks[0]).distance, self.unlike(numbers, looks[1]).distance
        return np.asarray(np.minimum(there, back.T) > limit)

    def typical(self, numbers: IntArray) -> Appearance | None:
        """A reading of each landmark (n,) without an error: its mean with the noise of one; None: nothing is known."""
        rows = np.array([self._row.get(n, -1) for n in numbers.tolist()], np.int64)
        if not len(self._mean) or not (rows >= 0).any():
            return None
        mean, _, log = self._of(numbers)
        sigma, error = np.where(rows >= 0, self._noise[rows, 0], 1.0), np.where(rows >= 0, self._noise[rows, 1], 0.5)
        read = np.full(len(rows), UNREAD, np.int64)
        if log.shape[1]:
            clear = np.sort(log, axis=1)
            read = np.where(clear[:, -1] > (clear[:, -2] if log.shape[1] > 1 else -np.inf), log.argmax(axis=1), UNREAD)
        return Appearance(mean, sigma, read, error, self._names)

    def _of(self, numbers: IntArray) -> tuple[Array, Array, Array]:
        rows = np.array([self._row.get(n, -1) for n in numbers.tolist()], np.int64)
        there = rows >= 0
        mean, variance = np.full(len(rows), np.nan), np.full(len(rows), np.inf)
        log = np.zeros((len(rows), self._log.shape[1]))
        for values, held in ((mean, self._mean), (variance, self._variance), (log, self._log)):
            values[there] = held[rows[there]]
        return mean, variance, log

    def _room(self, names: tuple[str, ...]) -> None:
        """Columns for so many classes; nothing is known of new ones."""
        more = len(names) - self._log.shape[1]
        if more > 0:
            self._names = names
            self._log = np.concatenate([self._log, np.zeros((len(self._log), more))], axis=1)

    def _row_of(self, number: int) -> int:
        row = self._row.get(number)
        if row is None:
            row = self._row[number] = len(self._mean)
            self._mean, self._variance = np.append(self._mean, np.nan), np.append(self._variance, np.inf)
            self._noise = np.concatenate([self._noise, [[1.0, 0.5]]])
            self._log = np.concatenate([self._log, np.zeros((1, self._log.shape[1]))])
        return row


def evidence(seen: Appearance | None) -> Evidence:
    """Of right pairings of observations (m,) with landmarks that are known well."""
    if seen is None:
        return Evidence()
    count, read, dims = len(seen.names), seen.category >= 0, int(seen.measures)
    if count < 2 or not read.any():
        return Evidence(dims)
    error = float(seen.error[read].mean())
    cost = 2.0 * math.log((1.0 - error) * (count - 1) / error)
    # rounded, since thresholds are kept by these numbers
    return Evidence(dims, round(error * float(read.mean()), 6), max(round(cost, 6), 0.0))

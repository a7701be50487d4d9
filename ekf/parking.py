"""Parking: landmarks leave the active state of EKF-SLAM and return, without approximation.

Source: Guivant & Nebot 2001, "Optimization of the simultaneous localization and map-building algorithm for real-time
implementation" (compressed EKF); docs/notes/large-logs.md derives what is used here. Behind its active state A, whose
covariance at the epoch's begin is P_A0A0 = L L', the filter carries y = L^-1 A0, like a landmark, with mean 0, P_yA0 =
L' and P_yy = 0 in the beginning (P_yy itself need not be a covariance). Parked landmarks B follow from it:

    x_B = m + D y,    P_BA = D P_yA,    P_BB = P + D P_yy D',    D = P_BA0 L'^-1

A landmark may move within an epoch:

    parked p:    its entries move from A to the end of the buffers, behind y (a recent landmark), and back to A if it is
                 restored before the epoch ends;
    restored p:  x_p, P_pA, P_pp from the equations and P_py = D_p (P_yy + I). A0 now includes p as it was at the epoch:
                 L grows by [D_p, l], l l' = P_pp0 - D_p D_p', y by two entries with mean 0, P_yp = l' and otherwise 0,
                 and D by the columns (P_Bp0 - D D_p') l'^-1.

y grows by two entries with each landmark restored; when it has grown too long, B is updated and an epoch begins. Where
B is shorter than A, all of it is kept as recent. So a step never costs more than without parking.

Large symmetric matrices are lower triangles in blocks of rows: half the memory, changed in place by BLAS-3.
"""

import numpy as np
import scipy

from data.blocks import coordinates
from data.inputs import IntArray
from data.se2 import Array

ROWS = 256  # rows of a block. Measured with 8000 rows and products of rank 300: 128 and 512 are within 5 %


class Triangle:
    """A symmetric matrix that grows by rows of zeros; each block of rows includes its whole diagonal block."""

    def __init__(self) -> None:
        self.size = 0  # rows in use
        self._block: list[Array] = []

    def grow(self, size: int) -> None:
        """Extend to at least `size` rows, new ones of zeros."""
        while len(self._block) * ROWS < size:
            self._block.append(np.zeros((ROWS, (len(self._block) + 1) * ROWS)))
        self.size = max(self.size, size)

    def columns(self, index: IntArray) -> Array:
        """Columns (size, k) at `index` (k,)."""
        found = np.empty((len(self._block) * ROWS, len(index)))
        home = index // ROWS
        for b, block in enumerate(self._block):
            begin, end = b * ROWS, (b + 1) * ROWS
            left = np.flatnonzero(home <= b)
            found[begin:end, left] = block[:, index[left]]
            own = np.flatnonzero(home == b)
            if len(own):
                found[:begin, own] = block[index[own] - begin, :begin].T
        return found[: self.size]

    def put(self, index: IntArray, columns: Array) -> None:
        """Set columns (size, k) at `index` (k,), and the rows that mirror them."""
        home = index // ROWS
        for b, block in enumerate(self._block):
            begin, end = b * ROWS, min((b + 1) * ROWS, self.size)
            left = np.flatnonzero(home <= b)
            block[: end - begin, index[left]] = columns[begin:end, left]
            own = np.flatnonzero(home == b)
            if len(own):
                block[index[own] - begin, :end] = columns[:end, own].T

    def square(self, index: IntArray) -> Array:
        """The entries (k, k) at `index` (k,), which ascends."""
        found = np.empty((len(index), len(index)))
        home = index // ROWS
        for b in np.unique(home).tolist():
            rows, left = np.flatnonzero(home == b), np.flatnonzero(home <= b)
            part = self._block[b][np.ix_(index[rows] - b * ROWS, index[left])]
            found[np.ix_(rows, left)] = part
            found[np.ix_(left, rows)] = part.T
        return found

    def add_product(self, left: Array, right: Array) -> None:
        """Add left @ right.T, of factors (size, c) with a symmetric product."""
        for b, block in enumerate(self._block):
            begin, end = b * ROWS, min((b + 1) * ROWS, self.size)
            block[: end - begin, :end] += left[begin:end] @ right[:end].T

    def blocks(self) -> Array:
        """The 2 x 2 blocks (size / 2, 2, 2) of the diagonal, symmetric."""
        found = np.empty((self.size // 2, 2, 2))
        for b, block in enumerate(self._block):
            begin, end = b * ROWS, min((b + 1) * ROWS, self.size)
            row = np.arange(0, end - begin, 2)
            for i in range(2):
                for j in range(2):
                    found[begin // 2 : end // 2, i, j] = block[row + i, begin + row + j]
        return np.asarray(0.5 * (found + found.transpose(0, 2, 1)))


LONGEST = 3  # largest length of y and recent landmarks, relative to A; 2 and 5 take as long


def symmetric(P: Array) -> Array:
    """P (d, d) without the asymmetry of rounding."""
    return np.asarray(0.5 * (P + P.T))


def root(P: Array) -> Array:
    """A regular lower triangle L with L L' = P, or slightly more than a semidefinite P."""
    diagonal = np.diag(P)
    scale, share = np.where(diagonal > 0.0, diagonal, 1.0), 1e-15
    while share < 1.0:
        try:
            return np.asarray(np.linalg.cholesky(P + share * np.diag(scale)), np.float64)
        except np.linalg.LinAlgError:
            share *= 10.0
    return np.diag(np.sqrt(scale))


def whitened(C: Array, L: Array) -> Array:
    """C L'^-1 of a cross-covariance C (r, d) and a root L (d, d)."""
    return np.ascontiguousarray(scipy.linalg.solve_triangular(L, C.T, lower=True).T, np.float64)


class Parked:
    """The parked landmarks in terms of the carried y; landmark n has rows 2n and 2n + 1. Rows of D for landmarks that
    are not parked, or recent, are zero; their mean and P are undefined.
    """

    def __init__(self) -> None:
        self.based = np.empty(0, np.bool_)  # (n,) by landmark number, whether it is parked and in these rows
        self.recent = np.empty(0, np.int64)  # (r,) parked since the epoch began, in the order of the buffers
        self.k = 0  # length of y
        self.mean, self.P = np.zeros(0), Triangle()  # (2n,) m and (2n, 2n) m^2 at the epoch
        self.own = np.empty((0, 2, 2))  # (n, 2, 2) m^2 at the epoch
        self._D = np.zeros((0, 0))

    @property
    def D(self) -> Array:
        """(2n, k), a view."""
        return self._D[: len(self.mean), : self.k]

    @property
    def count(self) -> int:
        """Number of parked landmarks."""
        return len(self.numbers)

    @property
    def numbers(self) -> IntArray:
        """Numbers (b,) of the parked landmarks, ascending."""
        return np.sort(np.concatenate([np.flatnonzero(self.based), self.recent]))

    def holds(self, number: int) -> bool:
        """Whether a landmark is parked."""
        return bool((number < len(self.based) and self.based[number]) or (self.recent == number).any())

    def restoring(self, numbers: IntArray, y: Array, P_yy: Array) -> tuple[Array, Array, Array, Array]:
        """Restore landmarks (r,) of these rows, with which y grows by 2r, given present mean (k,) and covariance of y.
        Returns their mean (2r,), D_p (2r, k), covariance (2r, 2r) and l (2r, 2r).
        """
        at = coordinates(numbers)
        D_p, P_pp = self.D[at], symmetric(self.P.square(at))
        mean, own = self.mean[at] + D_p @ y, symmetric(P_pp + D_p @ P_yy @ D_p.T)
        small = root(P_pp - D_p @ D_p.T)
        self.leave(numbers)
        column = whitened(self.P.columns(at) - self.D @ D_p.T, small)
        column[~np.repeat(self.based, 2)] = 0.0
        n = len(at)
        self._room(len(self.mean), self.k + n)
        self._D[: len(self.mean), self.k : self.k + n] = column
        self.k += n
        return mean, D_p, own, small

    def leave(self, numbers: IntArray) -> None:
        """Remove landmarks of these rows."""
        self.based[numbers] = False
        self.D[coordinates(numbers)] = 0.0

    def update(self, created: int, y: Array, P_yy: Array, recent: tuple[Array, Array, Array]) -> None:
        """Update all means and covariances by y (k,) and P_yy (k, k); y is undefined afterwards (`begin`). `recent`:
        mean (2r,), cross-covariance with y (2r, k) and covariance (2r, 2r) of the recent landmarks.
        """
        self._room(2 * created, self.k)
        D, at = self.D, coordinates(self.recent)
        self.mean += D @ y
        self.P.add_product(D @ P_yy, D)
        if len(at):
            cross = D @ recent[1].T
            cross[at] = recent[2]
            self.mean[at] = recent[0]
            self.P.put(at, cross)
        self.own = self.P.blocks()

    def begin(self, C: Array, P_AA: Array) -> Array:
        """Begin an epoch with all parked landmarks in these rows, given P_BA (2n, d), zero elsewhere; L (d, d)."""
        self.based[self.recent] = True
        self.recent = self.recent[:0]
        L = root(P_AA)
        self.k = 0
        self._room(len(self.mean), len(L))
        self.k = len(L)
        self.D[:] = whitened(C, L)
        return L

    def empty(self) -> tuple[Array, Array]:
        """Make all landmarks recent, by ascending number, without y: mean (2b,) and covariance (2b, 2b)."""
        self.recent = self.numbers
        at = coordinates(self.recent)
        self.based[:] = False
        self.k = 0
        return self.mean[at], symmetric(self.P.square(at))

    def _room(self, rows: int, columns: int) -> None:
        """At least this many rows, new ones of zeros, and room for this many columns of D."""
        have, k, old = self._D.shape, self.k, len(self.mean)
        if rows > have[0] or columns > have[1]:
            larger = np.zeros((max(rows, 2 * have[0]) if rows > have[0] else have[0], columns + columns // 2))
            larger[:old, :k] = self._D[:old, :k]
            self._D = larger
        if rows > old:
            self.mean = np.concatenate([self.mean, np.zeros(rows - old)])
            self.based = np.concatenate([self.based, np.zeros((rows - old) // 2, np.bool_)])
            self.P.grow(rows)

    def now(self, y: Array, P_yy: Array) -> tuple[IntArray, Array, Array, Array]:
        """Numbers (b,), present means (b, 2), covariances (b, 2, 2) and D (b, 2, k) of the landmarks in these rows."""
        numbers = np.flatnonzero(self.based)
        D = self.D.reshape(len(self.based), 2, self.k)[numbers]
        blocks = self.own[numbers] + D @ P_yy @ D.transpose(0, 2, 1)
        return numbers, self.xy(y), 0.5 * (blocks + blocks.transpose(0, 2, 1)), D

    def xy(self, y: Array) -> Array:
        """Present means (b, 2) of the landmarks in these rows, by ascending number."""
        return np.asarray((self.mean + self.D @ y).reshape(-1, 2)[self.based])

"""Parking: landmarks leave the active state of EKF-SLAM and return, without approximation.

Source: Guivant & Nebot 2001, "Optimization of the simultaneous localization and map-building algorithm for real-time
implementation" (compressed EKF). A is the active part (pose and active landmarks), B the parked landmarks. While no
measurement involves B, the evolution of B follows from that of A. With A0 the active part at an epoch, C = P_BA0, and
F, H, S, K, nu of the steps since then:

    P_AB = Phi C'                P_BB = P_BB0 - C Psi C'                   x_B = x_B0 + C theta
    predict:  Phi <- F Phi       new landmark: Phi <- [Phi; Gx Phi]
    update:   Psi += Phi' H' S^-1 H Phi,   theta += Phi' H' S^-1 nu,   Phi <- (I - K H) Phi

These are the Kalman recursions for a vector without measurements of its own, with mean 0, cross-covariance I with A0
and covariance 0 at the start. Psi is ill-conditioned, and C Psi C' a small difference of large terms. So the filter
carries y = L' of that vector, with P_A0A0 = L L' and D = C L'^-1, behind its active state, like a landmark:

    x_B = m + D y,    P_BA = D P_yA,    P_BB = P + D P_yy D'

y begins with mean 0, P_yA0 = L', P_yy = 0: it is L^-1 A0, whose covariance is P_yy + I. (P_yy itself need not be a
covariance.) A landmark may move within an epoch:

    parked p:    its entries move from A to the end of the buffers, behind y (a recent landmark), and back to A if it is
                 restored before the epoch ends;
    restored p:  x_p, P_pA, P_pp from the equations and P_py = D_p (P_yy + I). A0 now includes p as it was at the epoch:
                 L grows by [D_p, l], l l' = P_pp0 - D_p D_p', y by two entries with mean 0, P_yp = l' and otherwise 0,
                 and D by the columns (P_Bp0 - D D_p') l'^-1.

y grows by two entries with each landmark restored; when it has grown too long, B is updated and an epoch begins. Where
B is shorter than A, all of it is kept as recent. So a step never costs more than without parking.

Large symmetric matrices are lower triangles in blocks of rows: half the memory, changed in place by BLAS-3.

Parked landmarks that an observation could be paired with are found without restoring any. All tests are bounds, so no
landmark is missed. A landmark's position l and the pose x0 at the beginning of the epoch (t0) are constant, so

    the covariance of l, and of l - x0, can only have become smaller, and
    the estimate of l - x0 has moved by at most |y| times its standard deviation at t0

(a constant s = m + D y with |D|^2 at most its variance at t0). An observation z of l within a
squared distance g has |range(z) - range(l)| <= sqrt(g S) with S the variance of the expected range and of the noise
(Cauchy-Schwarz). Bounding boxes exclude distant blocks of landmarks. Of the others, mean and cross-covariance with the
pose are formed, and the squared distance with P_ll of t0, which is too small if anything. Walls are never excluded by
their position.
"""

from __future__ import annotations

import math
from functools import cached_property
from typing import NamedTuple

import numpy as np

from association.candidates import gate_radius
from data.blocks import coordinates
from data.compiled import njit
from data.inputs import FrameObservations, IntArray
from data.se2 import Array, BoolArray
from data.sensors import LINE, Sensor, measure, residual

BLOCK = 64  # landmarks in a bounding box, by number: successive landmarks are near each other
MARGIN = 1.0 + 1e-6  # factor on squared distances, so that rounding excludes no landmark


class ParkedBounds(NamedTuple):
    """Parked landmarks of an epoch, their positions relative to x0."""

    own: Array  # (n, 2, 2) covariance
    sigma: Array  # (n,) m
    boxes: Array  # (n / 64, 5) smallest and largest x, then y [m], largest sigma [m]; NaN where none is parked


EMPTY = ParkedBounds(np.empty((0, 2, 2)), np.empty(0), np.empty((0, 5)))  # no landmark is parked


def parked_bounds(parked: Parked, C: Array, P_xx: Array) -> ParkedBounds:
    """Bounds at the beginning of an epoch; C (2n, 3) and P_xx (3, 3) are the covariances with and of the pose."""
    own = parked.P.blocks()
    trace = np.trace(own, axis1=1, axis2=2) + P_xx[0, 0] + P_xx[1, 1] - 2.0 * (C[0::2, 0] + C[1::2, 1])
    sigma = np.sqrt(np.maximum(trace, 0.0))
    n = len(parked.based)
    boxes = np.full((-(-n // BLOCK), 5), np.nan)
    xy = parked.mean.reshape(-1, 2)
    for b in range(len(boxes)):
        here = b * BLOCK + np.flatnonzero(parked.based[b * BLOCK : (b + 1) * BLOCK])
        if len(here):
            boxes[b] = *np.stack([xy[here].min(0), xy[here].max(0)], 1).ravel(), sigma[here].max()
    return ParkedBounds(own, sigma, boxes)


def may_be_observed(
    parked: Parked,
    around: ParkedBounds,
    sensor: Sensor,
    x: Array,
    P: Array,
    observations: FrameObservations,
    within: float,
) -> BoolArray:
    """Which landmarks (n,) of these rows may be within a squared distance of some observation. `around`: bounds at the
    beginning of the epoch; x (3 + k,), P (3 + k, 3 + k): present mean and covariance of pose and y.
    """
    k, robot = parked.k, parked.robot[:2]
    y, P_yy = x[3:], P[3:, 3:]
    gate = math.sqrt(within * MARGIN)
    # covariance of x - x0, and the position relative to the estimate of x0 at that time
    step = robot @ (P_yy[:3, :3] + np.eye(3)) @ robot.T - 2.0 * P[:2, 3:6] @ robot.T + P[:2, :2]
    centre = x[:2] - robot @ y[:3]
    since = np.diag([step[0, 0], step[1, 1], P[2, 2]])
    reach = gate_radius(sensor, np.maximum(since, 0.0), observations, within * MARGIN)
    found = np.zeros(len(parked.based), np.bool_)
    seen = FrameObservations(np.array(observations.z, float), np.array(observations.R, float))
    near = Query(centre, reach, gate + float(np.linalg.norm(y[:k])), within * MARGIN)
    held = parked.mean, parked.D, parked.based
    _search(sensor.kind, sensor.extrinsic, x, P, held, around, near, seen, found)
    return found


class Query(NamedTuple):
    """A search without landmarks farther from `centre` (2,) than `reach` [m] plus `sigmas` standard deviations."""

    centre: Array
    reach: float
    sigmas: float
    within: float


@njit
def _search(
    kind: int,
    extrinsic: Array,
    x: Array,
    P: Array,
    held: tuple[Array, Array, BoolArray],
    around: ParkedBounds,
    near: Query,
    seen: FrameObservations,
    found: BoolArray,
) -> None:
    """See `may_be_observed`; `held` = means, D and which are based, as of `Parked`."""
    mean, D, based = held
    own, sigma, boxes = around
    centre, reach, sigmas, within = near
    z, R = seen
    k = D.shape[1]
    z_hat, Hx, Hl = np.empty(2), np.empty((2, 3)), np.empty((2, 2))
    place, cross = np.empty(2), np.empty((2, 3))
    for b in range(len(boxes)):
        away = np.hypot(
            max(boxes[b, 0] - centre[0], 0.0, centre[0] - boxes[b, 1]),
            max(boxes[b, 2] - centre[1], 0.0, centre[1] - boxes[b, 3]),
        )
        if not away <= reach + sigmas * boxes[b, 4]:
            continue
        for n in range(b * BLOCK, min((b + 1) * BLOCK, len(based))):
            if not based[n]:
                continue
            away = math.hypot(mean[2 * n] - centre[0], mean[2 * n + 1] - centre[1])
            if away > reach + sigmas * sigma[n]:
                continue
            for q in range(2):
                place[q] = mean[2 * n + q]
                cross[q] = 0.0
                for j in range(k):
                    weight = D[2 * n + q, j]
                    place[q] += weight * x[3 + j]
                    for i in range(3):
                        cross[q, i] += weight * P[3 + j, i]
            measure(kind, extrinsic, x, place[0], place[1], z_hat, Hx, Hl)
            mixed = Hx @ cross.T @ Hl.T
            HPHt = Hx @ np.ascontiguousarray(P[:3, :3]) @ Hx.T + mixed + mixed.T + Hl @ own[n] @ Hl.T
            for i in range(len(z)):
                nx, ny = residual(kind, z[i, 0], z[i, 1], z_hat)
                # the noise of a wall's observation has the sign of its own normal
                side = -1.0 if kind == LINE and math.cos(z[i, 1] - z_hat[1]) < 0.0 else 1.0
                a, c = HPHt[0, 0] + R[i, 0, 0], HPHt[1, 1] + R[i, 1, 1]
                off = 0.5 * (HPHt[0, 1] + HPHt[1, 0] + side * (R[i, 0, 1] + R[i, 1, 0]))
                det = a * c - off * off
                if not det > 0.0 or c * nx**2 - 2.0 * off * nx * ny + a * ny**2 <= within * det:
                    found[n] = True
                    break


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
        mean: Array = 0.5 * (found + found.transpose(0, 2, 1))
        return mean


LONGEST = 3  # largest length of y and recent landmarks, relative to A; 2 and 5 take as long


STRIP = 16  # columns solved one by one; BLAS subtracts the ones before them


def symmetric(P: Array) -> Array:
    """P (d, d) without the asymmetry of rounding."""
    even: Array = 0.5 * (P + P.T)
    return even


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
    """C L'^-1 of a cross-covariance C (r, d) and a root L (d, d); D L' = C to a rounding, however small L is."""
    D = np.array(C, float, order="C")
    for begin in range(0, len(L), STRIP):
        strip = slice(begin, begin + STRIP)
        D[:, strip] -= D[:, :begin] @ L[strip, :begin].T
        _forward(D, L, begin, min(begin + STRIP, len(L)))
    return D


@njit
def _forward(D: Array, L: Array, begin: int, end: int) -> None:
    """Solve the rows of D for their columns from `begin` before `end` by forward substitution, in place."""
    for r in range(len(D)):
        for j in range(begin, end):
            total = D[r, j]
            for q in range(begin, j):
                total -= D[r, q] * L[j, q]
            D[r, j] = total / L[j, j]


class Parked:
    """The parked landmarks in terms of the carried y; landmark n has rows 2n and 2n + 1.

    Rows of D for landmarks that are not parked, or recent, are zero; their mean and P are undefined.
    """

    def __init__(self) -> None:
        self.based = np.empty(0, np.bool_)  # (n,) by landmark number, whether it is parked and in these rows
        self.recent = np.empty(0, np.int64)  # (r,) parked since the epoch began, in the order of the buffers
        self.k, self.epochs = 0, 0  # length of y, number of epochs begun
        self.mean, self.P = np.zeros(0), Triangle()  # (2n,) m and (2n, 2n) m^2 at the epoch
        self.robot = np.zeros((3, 3))  # root of the pose's covariance at the epoch
        self._D = np.zeros((0, 0))

    @property
    def D(self) -> Array:
        """(2n, k), a view."""
        return self._D[: len(self.mean), : self.k]

    @property
    def count(self) -> int:
        """Number of parked landmarks."""
        return len(self.numbers)

    @cached_property
    def numbers(self) -> IntArray:
        """Numbers (b,) of the parked landmarks, ascending; `changed` clears the cache."""
        return np.sort(np.concatenate([np.flatnonzero(self.based), self.recent]))

    def changed(self) -> None:
        """Clear the cache of `numbers`."""
        self.__dict__.pop("numbers", None)

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
        self.changed()

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

    def begin(self, C: Array, P_AA: Array) -> Array:
        """Begin an epoch with all parked landmarks in these rows, given P_BA (2n, d), zero elsewhere; L (d, d)."""
        self.based[self.recent] = True
        self.recent = self.recent[:0]
        L = root(P_AA)
        self.k = 0
        self._room(len(self.mean), len(L))
        self.k = len(L)
        self.D[:] = whitened(C, L)
        self.robot = L[:3, :3].copy()
        self.epochs += 1
        return L

    def empty(self) -> tuple[Array, Array]:
        """Make all landmarks recent, by ascending number, without y: mean (2b,) and covariance (2b, 2b)."""
        self.recent = self.numbers
        at = coordinates(self.recent)
        self.based[:] = False
        self.k = 0
        self.epochs += 1
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

    def now(self, y: Array, P_yy: Array) -> tuple[IntArray, Array, Array]:
        """Numbers (b,), present means (b, 2) and covariances (b, 2, 2) of the landmarks in these rows."""
        numbers = np.flatnonzero(self.based)
        at = coordinates(numbers)
        D = self.D[at].reshape(len(numbers), 2, self.k)
        blocks = self.P.blocks()[numbers] + np.matmul(D @ P_yy, D.transpose(0, 2, 1))
        return numbers, (self.mean[at] + self.D[at] @ y).reshape(-1, 2), 0.5 * (blocks + blocks.transpose(0, 2, 1))

    def xy(self, y: Array) -> Array:
        """Present means (b, 2) of the landmarks in these rows, by ascending number."""
        at = coordinates(np.flatnonzero(self.based))
        now: Array = (self.mean[at] + self.D[at] @ y).reshape(-1, 2)
        return now

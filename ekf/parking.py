"""Parking: landmarks leave the active state of EKF-SLAM and come back, without any approximation.

Source: Guivant & Nebot 2001, "Optimization of the simultaneous localization and map-building algorithm for real-time
implementation" (compressed EKF). A is the active part (pose and active landmarks), B the parked landmarks. As long as
no measurement involves B, all that happens to B follows from what happens to A. With A0 the active part at an epoch,
C = P_BA0, and F, H, S, K, nu of the steps since then:

    P_AB = Phi C'                P_BB = P_BB0 - C Psi C'                   x_B = x_B0 + C theta
    predict:  Phi <- F Phi       new landmark: Phi <- [Phi; Gx Phi]
    update:   Psi += Phi' H' S^-1 H Phi,   theta += Phi' H' S^-1 nu,   Phi <- (I - K H) Phi

These are the Kalman filter's own recursions for a vector y that no measurement involves and that starts with mean 0,
P_yA = I and P_yy = 0: ever after, P_yA = Phi', P_yy = -Psi and y = theta. So y stands behind the active state in the
filter's buffers, the compiled steps carry it along as they carry any landmark, and

    x_B = m + C y,    P_BA = C P_yA,    P_BB = P + C P_yy C'

(P_yy is no covariance, but no step asks it to be.) In this form no epoch need end for a landmark to move:

    parked p:    its entries move from A to the end of y, its row of C is I there, its m and P are 0;
    restored p:  x_p, P_pA, P_pp from the equations, P_py = C_p P_yy; the others keep their P_Bp = P of base by a
                 new part e of y with mean 0, P_ep = I and otherwise 0, and the columns P_Bp in C.

Only y grows by that, by two entries each time; when it has grown too long, B is brought up to date and an epoch begins.
Where B is shorter than A, y is then B itself with C = I. As y is never longer than B, parking never makes the steps
cost more than keeping the landmarks would.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from data.blocks import coordinates
from data.inputs import IntArray
from data.se2 import Array

LONGEST = 3
"""y may grow to this many times the length of A: longer steps against rarer epochs. Measured, and flat around here."""


class Carried(NamedTuple):
    """A vector (c,) beside others (d,): its mean, cross-covariance (c, d) with them and covariance (c, c)."""

    mean: Array
    cross: Array
    P: Array


def symmetric(P: Array) -> Array:
    """P (d, d) without the asymmetry of rounding."""
    even: Array = 0.5 * (P + P.T)
    return even


def root(P: Array) -> Array:
    """A lower triangle L with L L' = P, or where P is semidefinite a little more than P; L is regular in any case."""
    diagonal = np.diag(P)
    scale, share = np.where(diagonal > 0.0, diagonal, 1.0), 1e-15
    while True:
        try:
            L: Array = np.linalg.cholesky(P + share * np.diag(scale))
            return L
        except np.linalg.LinAlgError:
            share *= 10.0
        if not share < 1e3:
            return np.diag(np.sqrt(scale))


@dataclass(frozen=True, eq=False)
class Parked:
    """Parked landmarks, one per pair of rows, in terms of the carried y: x_B = mean + C y, P_BB = P + C P_yy C'.

    Attributes:
        number: (b,) landmark numbers, -1 where the landmark is no longer parked.
        mean: (2b,) m.
        P: (2a, 2a) m^2, a <= b; zero for the later rows.
        C: (2b, c).
    """

    number: IntArray
    mean: Array
    P: Array
    C: Array

    @cached_property
    def rows(self) -> dict[int, int]:
        """Row pair of each parked landmark, by ascending number."""
        order = np.argsort(self.number)
        order = order[self.number[order] >= 0]
        return dict(zip(self.number[order].tolist(), order.tolist(), strict=True))

    def index(self, numbers: IntArray | None = None) -> IntArray:
        """Rows (2n,) of landmarks; None: of all, by ascending number."""
        chosen = self.rows.values() if numbers is None else [self.rows[n] for n in numbers.tolist()]
        return coordinates(np.fromiter(chosen, np.int64))

    def now(self, y: Carried, rows: IntArray) -> Carried:
        """Present mean (r,), cross-covariance (r, d) with A, and covariance (r, r) of some rows."""
        C = self.C[rows]
        P = C @ y.P @ C.T
        based = np.flatnonzero(rows < len(self.P))
        P[np.ix_(based, based)] += self.P[np.ix_(rows[based], rows[based])]
        return Carried(self.mean[rows] + C @ y.mean, C @ y.cross, symmetric(P))

    def xy(self, y: Array) -> Array:
        """Present means (n, 2), by ascending number, given the mean of y."""
        rows = self.index()
        now: Array = (self.mean[rows] + self.C[rows] @ y).reshape(-1, 2)
        return now

    def blocks(self, P_yy: Array) -> Array:
        """Present covariance (n, 2, 2) of each landmark, by ascending number."""
        rows = self.index().reshape(-1, 2)
        C = self.C[rows]
        blocks: Array = C @ P_yy @ C.transpose(0, 2, 1)
        based = rows[:, 0] < len(self.P)
        blocks[based] += self.P[rows[based][:, :, None], rows[based][:, None, :]]
        return 0.5 * (blocks + blocks.transpose(0, 2, 1))

    def parking(self, numbers: IntArray) -> Parked:
        """Also these (n,), whose coordinates have been moved to the end of y."""
        r, c = self.C.shape
        n = 2 * len(numbers)
        C = np.zeros((r + n, c + n))
        C[:r, :c], C[r:, c:] = self.C, np.eye(n)
        return Parked(np.concatenate([self.number, numbers]), np.concatenate([self.mean, np.zeros(n)]), self.P, C)

    def restoring(self, numbers: IntArray) -> Parked:
        """Without these (n,), which have been put into the state, y longer by the parts e of each."""
        rows = self.index(numbers)
        column = np.zeros((len(self.C), len(rows)))
        based = rows < len(self.P)
        column[: len(self.P), based] = self.P[:, rows[based]]
        return replace(self.without(numbers), C=np.concatenate([self.C, column], axis=1))

    def without(self, numbers: IntArray) -> Parked:
        """These marginalized out; y keeps its meaning for the others."""
        return replace(self, number=np.where(np.isin(self.number, numbers), -1, self.number))


NOTHING = Parked(np.empty(0, np.int64), np.zeros(0), np.zeros((0, 0)), np.zeros((0, 0)))
"""No landmark is parked, and there is no y."""


def begin_epoch(number: IntArray, B: Carried) -> tuple[Parked, Carried]:
    """Landmarks (b,) with mean, P_BA (2b, d) and P_BB, and the y they begin with."""
    n, d = B.cross.shape
    if n <= d:
        return Parked(number, np.zeros(n), np.zeros((0, 0)), np.eye(n)), B
    return Parked(number, B.mean, B.P, B.cross), Carried(np.zeros(d), np.eye(d), np.zeros((d, d)))

"""Parking: landmarks leave the active state of EKF-SLAM and come back, without any approximation.

Source: Guivant & Nebot 2001, "Optimization of the simultaneous localization and map-building algorithm for real-time
implementation" (compressed EKF). A is the active part (pose and active landmarks), B the parked landmarks. As long as
no measurement involves B, all that happens to B follows from what happens to A. With A0 the active part at the last
parking or restoring (an epoch), C = P_BA0, and F, H, S, nu of the steps since then:

    P_AB = Phi C'                P_BB = P_BB0 - C Psi C'                   x_B = x_B0 + C theta
    predict:  Phi <- F Phi       new landmark: Phi <- [Phi; Gx Phi]
    update:   Psi += Phi' H' S^-1 H Phi,   theta += Phi' H' S^-1 nu,   Phi <- (I - K H) Phi

These are the Kalman filter's own recursions for a vector y that no measurement involves and that starts with mean 0,
cross-covariance P_yA = I and P_yy = 0: then P_yA = Phi', P_yy = -Psi and y = theta ever after. So y stands behind the
active state in the filter's buffers, the compiled steps carry it along as they carry any landmark, and

    x_B = x + C y,    P_BA = C P_yA,    P_BB = P + C P_yy C'

(P_yy is not a covariance, but no step asks it to be.) Where B is shorter than A, y is B itself with C = I, so that
parking never costs more than keeping the landmarks.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from data.inputs import IntArray
from data.se2 import Array


class Carried(NamedTuple):
    """The vector y (c,) behind the active state (d,): its mean, P_yA (c, d) and P_yy (c, c)."""

    mean: Array
    cross: Array
    P: Array


@dataclass(frozen=True, eq=False)
class Parked:
    """Parked landmarks as they were when the epoch began; with the carried y they give what they are now.

    Attributes:
        number: (b,) landmark numbers, ascending; the coordinates below are in this order.
        mean: (2b,) m, the part of the mean that y does not give.
        P: (2b, 2b) m^2, the part of the covariance that y does not give.
        C: (2b, c) how the landmarks follow y.
    """

    number: IntArray
    mean: Array
    P: Array
    C: Array

    def mean_now(self, y: Array) -> Array:
        """Means (2b,), given the mean of y."""
        now: Array = self.mean + self.C @ y
        return now

    def now(self, y: Carried) -> tuple[Array, Array, Array]:
        """Mean (2b,), P_BA (2b, d) and P_BB (2b, 2b), symmetric to the bit."""
        P_BB = self.P + self.C @ y.P @ self.C.T
        return self.mean_now(y.mean), self.C @ y.cross, 0.5 * (P_BB + P_BB.T)

    def blocks_now(self, P_yy: Array) -> Array:
        """Covariance (b, 2, 2) of each landmark, without forming that of all."""
        b = len(self.number)
        own = self.P.reshape(b, 2, b, 2)[np.arange(b), :, np.arange(b), :]
        shape = (b, 2, len(P_yy))
        left, right = (self.C @ P_yy).reshape(shape), self.C.reshape(shape)
        blocks: Array = own + left @ right.transpose(0, 2, 1)
        return 0.5 * (blocks + blocks.transpose(0, 2, 1))

    def without(self, numbers: IntArray) -> Parked:
        """Landmarks marginalized out; y keeps its meaning for the others."""
        stay = ~np.isin(self.number, numbers)
        rows = np.repeat(stay, 2)
        return replace(
            self, number=self.number[stay], mean=self.mean[rows], P=self.P[np.ix_(rows, rows)], C=self.C[rows]
        )


NOTHING = Parked(np.empty(0, np.int64), np.zeros(0), np.zeros((0, 0)), np.zeros((0, 0)))
"""No landmark is parked, and there is no y."""


def begin_epoch(number: IntArray, mean: Array, P_BA: Array, P_BB: Array) -> tuple[Parked, Carried]:
    """Park landmarks `number` (b,) with mean (2b,), P_BA (2b, d) and P_BB (2b, 2b); returns them and the y to carry."""
    n, d = P_BA.shape
    if n <= d:
        return Parked(number, np.zeros(n), np.zeros((n, n)), np.eye(n)), Carried(mean, P_BA, P_BB)
    return Parked(number, mean, P_BB, P_BA), Carried(np.zeros(d), np.eye(d), np.zeros((d, d)))

"""What the tutorials' programs do otherwise than the algorithms they teach, so that their numbers can be had.

Nothing here is for any other use: both are faults.
"""

from __future__ import annotations

import numpy as np

from association.decide import Decided
from association.expectation import Expectation
from association.likelihood import ALPHA, RATIO
from data.inputs import Increment, IntArray, Sightings
from data.motion.velocity import carried
from data.result import DISCARD, NEW
from data.se2 import Array, BoolArray, wrap_angle
from ekf.localizer import EkfLocalizer
from eval.replay.frontend import FrontEnd

FARTHEST = 10.0
"""Squared distance that the ratio test's running minimum begins with."""


class GainFromBefore(EkfLocalizer):
    """EKF localization whose gain takes the covariance from before the prediction: K = P- H' S^-1.

    S is formed from the predicted covariance, as it should be, and (I - K H) P applied without symmetry.
    """

    def predict(self, increment: Increment) -> None:
        """Move by an increment, and remember the covariance from before."""
        self._version += 1
        self._before = self._P[:3, :3].copy()
        wx, wy, F, B = carried(self._mean[2], increment.mean)
        self._P[:3, :3] = F @ self._P[:3, :3] @ F.T + B @ increment.covariance @ B.T
        self._mean[:2] += wx, wy
        self._mean[2] = wrap_angle(float(self._mean[2] + increment.mean[2]))

    def _correct(
        self,
        sightings: Sightings,
        rows: IntArray,
        at: IntArray,
        known: Array,
        threshold: float,
        pose: Array | None = None,
    ) -> tuple[BoolArray, Array, Array]:
        self._version += 1
        stats, white = np.zeros(3), np.full((len(rows), 2), np.nan)
        for i, row in enumerate(rows.tolist()):
            z_hat, Hx, _ = (a[0] for a in self.sensor.linearize(self._mean[:3], known[i : i + 1]))
            nu = self.sensor.residual(sightings.z[row], z_hat)
            S = Hx @ self._P[:3, :3] @ Hx.T + sightings.R[row]
            K = self._before @ Hx.T @ np.linalg.inv(S)
            white[i] = np.linalg.solve(np.linalg.cholesky(0.5 * (S + S.T)), nu)
            nis = float(white[i] @ white[i])
            stats += nis, -0.5 * (nis + np.linalg.slogdet(2.0 * np.pi * S)[1]), 2.0
            self._mean[:3] += K @ nu
            self._mean[2] = wrap_angle(float(self._mean[2]))
            self._P[:3, :3] = (np.eye(3) - K @ Hx) @ self._P[:3, :3]
        return np.ones(len(rows), np.bool_), stats, white


class RunningMinimum(FrontEnd):
    """The ratio test whose second best is the running minimum's predecessor, not the second best of all candidates.

    It depends on the order of the map: a second best that comes after the best is never seen.
    """

    def decide(self, expectation: Expectation, method: str | None = None) -> Decided:
        """Decisions with the running minimum, or for comparison by another method."""
        return super().decide(expectation, method) if method is not None else Decided(running(expectation), True)


def running(expectation: Expectation) -> IntArray:
    """Decisions (m,): the landmarks in the order of their creation, then "new" at `ALPHA`."""
    e = expectation.by_age()
    d2 = np.column_stack([e.individual_distances(), np.full(len(e.z), ALPHA)])
    number = np.append(e.number, NEW)
    decisions = np.full(len(d2), DISCARD, np.int64)
    for i, row in enumerate(d2.tolist()):
        best, second, winner = FARTHEST, FARTHEST, DISCARD
        for squared, candidate in zip(row, number.tolist(), strict=True):
            if squared < best:
                best, second, winner = squared, best, candidate
        if second > RATIO * best:
            decisions[i] = winner
    return decisions

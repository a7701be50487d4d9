"""EKF-SLAM that knows that odometry errs in system: turning rate and scales are estimated along with the map.

Uneven wheels and a steering that is off centre turn a robot a little with every metre, and not as far as it thinks with
every turn (Borenstein and Feng, "Measurement and correction of systematic odometry errors in mobile robots", IEEE
Transactions on Robotics and Automation 12, 1996). Taken for white noise this is inexplicable after some hundred metres,
whatever its variance; as five more states it is gone by then.
"""

from __future__ import annotations

import numpy as np

from data.inputs import Increment, IntArray, Prior
from data.se2 import Array, world_from_body
from data.sensors import Sensor
from ekf.filter import DEFAULT, FilterOptions
from ekf.slam import EkfSlam

SIGMA = np.array([1e-3, 2e-3, 0.05, 0.05, 0.02])
"""rad/m, rad/m, 1, 1, 1. Of the curvature that comes and goes, of a steady one, of the scales of left turns, right
turns and distances, before anything is known."""
LENGTH = 50.0
"""m. The curvature that comes and goes is forgotten to 1/e over this distance."""
WALK = np.array([0.0, 1e-5, 3e-4, 3e-4, 1e-4])
"""Per square root of a metre: how much the others wander."""


def systematic(increment: Array) -> Array:
    """Jacobian (3, 5) of an increment (3,) to the systematic errors; half of a turn happens before the step."""
    x, y, turn = increment
    distance = float(np.hypot(x, y)) * (1.0 if x >= 0.0 else -1.0)
    A = np.zeros((3, 5))
    A[2, :4] = distance, distance, max(turn, 0.0), min(turn, 0.0)
    A[0], A[1] = -0.5 * y * A[2], 0.5 * x * A[2]
    A[:2, 4] = x, y
    return A


class CalibratingSlam(EkfSlam):
    """`EkfSlam` whose motion is corrected by systematic errors (5,), carried along behind the landmarks.

    The order is that of `SIGMA`. They stand where parked landmarks are carried, so that none can be parked.
    """

    def __init__(self, prior: Prior, sensor: Sensor, options: FilterOptions = DEFAULT) -> None:
        """Start at the prior with an empty map and odometry that is right by all that is known."""
        super().__init__(prior, sensor, options)
        self._carried = len(SIGMA)
        tail = np.arange(self.size, self._used)
        self._P[tail, tail] = SIGMA**2

    @property
    def errors(self) -> tuple[Array, Array]:
        """Systematic errors (5,) and their covariance (5, 5), copies."""
        tail = slice(self.size, self._used)
        return self._mean[tail].copy(), self._P[tail, tail].copy()

    def park(self, numbers: IntArray, *, begin_epoch: bool = False) -> None:
        """The errors are carried in the place of what parking carries: asking for it is an error."""
        raise ValueError("the filter carries the odometry's errors where parked landmarks are; none can be parked")

    def predict(self, increment: Increment) -> None:
        """Move by an increment and what is known of its error."""
        d, e = self.size, self._used
        A = systematic(increment.mean)
        D = world_from_body(float(self._mean[2])) @ A
        super().predict(Increment(increment.mean + A @ self._mean[d:e], increment.covariance))
        P, distance = self._P, float(np.hypot(increment.mean[0], increment.mean[1]))
        P[:3, :e] += D @ P[d:e, :e]
        P[:e, :3] += P[:e, d:e] @ D.T
        fading = np.exp(-distance / LENGTH)
        self._mean[d] *= fading
        P[d, :e] *= fading
        P[:e, d] *= fading
        fresh = distance * WALK**2
        fresh[0] = SIGMA[0] ** 2 * (1.0 - fading**2)
        P[np.arange(d, e), np.arange(d, e)] += fresh

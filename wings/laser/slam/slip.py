"""How far wheels may slip between two scans, per metre and per second, and what a match that says so has to gain.

Odometry's error has two modes: its noise, and rare slips (or a robot that backs while its odometry says forward). Their
mixture is replaced by the likelier mode (E. Olson, P. Agarwal, "Inference on networks of mixtures for robust robot
mapping", IJRR 32, 2013, max-mixtures).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from data.se2 import Array

TURNED_WAY = 0.25  # m per rad: the way of a wheel in a turn
PER_METRE = np.array([1.0, 1.0, 0.5])
"""m, m, rad per metre of the wheels: backing instead of forward is two standard deviations."""
PER_RADIAN = np.array([0.0, 0.0, 0.5])  # and per radian of their turn
PER_SECOND = np.array([0.3, 0.3, 0.5])  # pushed, or sliding, with wheels at rest
LONGEST = 2.0  # s: in a longer time between two scans nothing more is expected
LEAST = np.array([0.02, 0.02, 0.02])  # m, m, rad
RARE = 15.0
"""Log odds of noise against a slip, before the data. It is the fit of a tenth of the points, which a moving door or
people can have."""
AGAIN, STEADY = 3.0, 0.2
"""Log odds of noise against a slip that goes on, and its standard deviation as a share of a slip's."""


class Travel(NamedTuple):
    """What the wheels report between two scans: distance [m], turn [rad], both summed, and the time [s]."""

    distance: float = 0.0
    turn: float = 0.0
    seconds: float = 0.0

    def plus(self, motion: Array, seconds: float) -> Travel:
        """With one more motion (3,)."""
        distance, turn = math.hypot(motion[0], motion[1]), abs(float(motion[2]))
        return Travel(self.distance + distance, self.turn + turn, self.seconds + seconds)

    @property
    def way(self) -> float:
        """Of a wheel [m]."""
        return self.distance + TURNED_WAY * self.turn


def slip_deviation(travel: Travel) -> Array:
    """Standard deviation (3,) [m, m, rad] of odometry's error if the wheels slip."""
    seconds = min(travel.seconds, LONGEST)
    return LEAST + PER_METRE * travel.distance + PER_RADIAN * travel.turn + PER_SECOND * seconds


def repeated(motion: Array, then: Travel, now: Travel) -> Array | None:
    """The last motion (3,) at the same rate: per metre of the wheels, or per second where they stand still."""
    if then.way > 0.0 and now.way > 0.0:
        return motion * (now.way / then.way)
    if then.seconds > 0.0 and now.seconds > 0.0:
        return motion * (now.seconds / then.seconds)
    return None


def least_penalty(chi2: float, error: Array, slip: Array, going_on: Array | None) -> float:
    """Negative log likelihood, up to a constant, of a pose: by the noise of odometry, or as a slip.

    `chi2`, `error` (3,): against odometry; `slip` (3,): standard deviation of a slip; `going_on` (3,): error against
    the last motion at the same rate where that slipped already, else None.
    """
    penalty = min(0.5 * chi2, RARE + 0.5 * float(((error / slip) ** 2).sum()))
    if going_on is not None:
        penalty = min(penalty, AGAIN + 0.5 * float(((going_on / (STEADY * slip)) ** 2).sum()))
    return penalty

"""The smallest eigenvalue that an increment's covariance has: information forms need its inverse."""

from __future__ import annotations

import numpy as np

from data.se2 import Array


def floor_covariances(covariance: Array, floor: float) -> tuple[Array, int]:
    """Add floor * I to every increment covariance (N, 3, 3), row 0 aside, whose smallest eigenvalue is below `floor`.

    Singular increments (a robot at rest, one odometry sample) are harmless in a filter and fatal in an information
    form; doing it here once keeps filter and smoother on the same numbers. A floored covariance comes back as it is,
    so a log written and read again stays the same bit for bit. Returns the covariances and the count.
    """
    result = np.array(covariance, float)
    if floor <= 0.0 or len(result) < 2:
        return result, 0
    smallest, _, largest = np.linalg.eigvalsh(result).T
    # the slack is what adding the floor and taking the eigenvalues may lose to rounding
    low = smallest < floor * (1.0 - 1e-6) - 1e-15 * largest
    low[0] = False
    # a matrix can be indefinite by rounding: that is made up for, or the floor would not be reached
    lift = floor + np.maximum(-smallest[low], 0.0)
    result[low] += lift[:, None, None] * np.eye(3)
    return result, int(low.sum())

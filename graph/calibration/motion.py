"""The increments of a run as factors, and whose drift each has."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from data.errors import DataError
from data.inputs import Increment
from data.se2 import Array
from graph.calibration.increments import increment_factor
from graph.calibration.variables import Errors
from graph.factors import SINGULAR, Factor, root_information


class Motion:
    """All increments so far, in the order of frames from 1 on.

    Attributes:
        knot: of the drift, the newest one.
        oldest: first frame in the graph: increments up to it are no factors any more.
        now: (q,) the constants as known now, in prior sigmas: all factors are linearized there.
    """

    def __init__(self, errors: Errors) -> None:
        """None."""
        self._errors = errors
        self.knot = 0
        self.now = np.zeros(len(errors.constant))
        self._mean, self._covariance = [np.zeros(3)], [np.zeros((3, 3))]
        self._knots = list[int]()
        self.oldest = 0
        self._first_knot = 0

    @property
    def raw(self) -> tuple[Array, Array]:
        """Increments (N, 3) and covariances (N, 3, 3) as odometry stated them."""
        return np.array(self._mean), np.array(self._covariance)

    def extend(self, first: int, increments: Sequence[Increment], knots: Sequence[int]) -> tuple[list[Factor], float]:
        """Factors of increments (n) into frames `first`, ....

        `knots` (n,): whose drift each has. Also returned: the smallest pivot of the covariances. Raises DataError for a
        singular one.
        """
        mean, covariance = (np.array(rows) for rows in zip(*increments, strict=True))
        roots, pivot = root_information(covariance)
        bad = np.flatnonzero(~(pivot > SINGULAR))
        if len(bad):
            raise DataError(
                f"increment into frame {first + bad[0]}: its covariance is singular (variance {pivot[bad[0]]:.3g} in "
                "some direction); a smoother needs a covariance_floor of 1e-10 or so"
            )
        self._mean += list(mean)
        self._covariance += list(covariance)
        self._knots += knots
        found: list[Factor] = [
            increment_factor(self._errors, first + i, increments[i], roots[i], knots[i], self.now)
            for i in range(len(mean))
        ]
        return found, float(pivot.min())

    def knot_of(self, frame: int) -> int:
        """Whose drift the increment into a frame of the graph has (0 of frame 0)."""
        return self._knots[max(frame - 1 - self.oldest, 0)] if self._knots else self.knot

    def forget(self, oldest: int) -> range:
        """Frame `oldest` is the first one in the graph now; knots that no increment in it has any more."""
        gone, first = oldest - self.oldest, self._first_knot
        del self._knots[:gone]
        self.oldest = oldest
        self._first_knot = self._knots[0] if self._knots else self.knot
        return range(first, self._first_knot)

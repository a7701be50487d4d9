"""What every smoother answers to the verbs that are a filter's own."""

from __future__ import annotations

import numpy as np

from data.inputs import IntArray
from data.se2 import Array


class Smoother:
    """No state that every frame updates as a whole, so that nothing need be parked; and no pose without a past.

    Attributes:
        smooths: True: it revises its path as more is seen.
        fixed_linearization: False: `update` may be told where to linearize.
        size: 0 states.
        parked: numbers of the parked landmarks: none.
    """

    smooths = True
    fixed_linearization = False
    size = 0
    parked: IntArray = np.empty(0, np.int64)

    def stamp(self, time: float) -> None:
        """The present frame's time, which makes no difference to a smoother that keeps all poses."""

    def parked_xy(self) -> Array:
        """No landmark is parked: (0, 2)."""
        return np.empty((0, 2))

    def park(self, numbers: IntArray) -> None:
        """A landmark costs a graph nothing while it is not seen: asking for it is an error."""
        raise ValueError("a smoother parks no landmark")

    def restore(self, numbers: IntArray) -> None:
        """No landmark is parked: asking for it is an error."""
        raise ValueError(f"cannot restore {np.asarray(numbers).tolist()}: a smoother parks no landmark")

    def reset(self, mean: Array, covariance: Array) -> None:
        """The newest pose follows from the past: asking for another one is an error."""
        raise ValueError("a smoother's pose follows from its past; begin another one at the new pose")

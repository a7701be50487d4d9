"""Step-by-step estimators: the verbs that all of them have, and a fresh one by name."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from association.expectation import Expectation
from data.errors import UsageError
from data.inputs import Increment, IntArray, Sightings
from data.result import Finished, PoseEstimate, Updated
from data.se2 import Array
from ekf.filter import DEFAULT, FilterOptions
from ekf.localizer import EkfLocalizer
from ekf.slam import EkfSlam
from eval.replay.given import Given
from eval.replay.settings import Setup
from graph.fixed_lag import FixedLagSmoother
from graph.incremental import Isam2Smoother

FILTERS = {
    "ekf": DEFAULT,
    "ekf-iterated": FilterOptions(iterations=10),
    "ekf-fej": FilterOptions(first_estimates=True),
    "ekf-invariant": FilterOptions(invariant=True),
}
"""Filters by name: one filter, whose correction is applied in different ways."""


class Estimator(Protocol):
    """The verbs every step-by-step estimator has; any association method works with any of them."""

    def predict(self, increment: Increment) -> None:
        """Move by an increment."""
        ...

    def stamp(self, time: float) -> None:
        """The present frame's time [s]: only what keeps poses for a span of time needs to know."""
        ...

    def expect(self, sightings: Sightings) -> Expectation:
        """What it expects to see."""
        ...

    def update(
        self, sightings: Sightings, decisions: IntArray, *, threshold: float = np.inf, at: Array | None = None
    ) -> Updated:
        """Use the pairings, found new landmarks; `at` (3,): where to linearize first, if not at the prediction."""
        ...

    def remove(self, numbers: IntArray) -> None:
        """Drop landmarks."""
        ...

    def join(self, away: IntArray, kept: IntArray) -> None:
        """Landmarks `away` are the same as `kept`, and go."""
        ...

    def lose(self, covariance: Array) -> None:
        """Believe the last motion so much less, by a covariance (3, 3) that is the same in all directions."""
        ...

    def estimate(self) -> PoseEstimate:
        """The newest pose."""
        ...

    def finish(self) -> Finished:
        """The end of the run."""
        ...


def make_estimator(
    name: str, given: Given, options: FilterOptions | None = None, *, lag: float = Setup.lag
) -> Estimator:
    """A fresh step-by-step estimator: with a map it localizes, without it does SLAM. `given` may be whole `Inputs`.

    `options` stand in for those that go with the name of a filter; `lag` [s] is that of `fixed-lag`, which counts
    frames as long as no frame is stamped with its time.
    """
    if name in FILTERS:
        options = options or FILTERS[name]
        if given.map is not None:
            return EkfLocalizer(given.prior, given.sensor, given.map, options)
        return EkfSlam(given.prior, given.sensor, options)
    if name == "isam2":
        return Isam2Smoother(given.prior, given.sensor, given.map)
    if name == "fixed-lag":
        return FixedLagSmoother(given.prior, given.sensor, given.map, lag=lag)
    raise UsageError(f"{name!r} does not work step by step; {', '.join(FILTERS)}, isam2 and fixed-lag do")

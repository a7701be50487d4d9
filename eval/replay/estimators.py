"""Step-by-step estimators: the verbs that all of them have, and a fresh one by name."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from association.decide import HINDSIGHT
from association.expectation import Expectation
from data.errors import UsageError
from data.inputs import Increment, IntArray, Sightings
from data.result import Finished, MapState, PoseEstimate, Updated
from data.se2 import Array
from ekf import walls
from ekf.filter import DEFAULT, FilterOptions
from ekf.localizer import EkfLocalizer
from ekf.slam import EkfSlam
from eval.replay.external.make import estimator as foreign_estimator
from eval.replay.external.spec import is_foreign
from eval.replay.settings import STEPPING, Given, Setup
from graph.fixed_lag import FixedLagSmoother
from graph.incremental import Isam2Smoother

OPTIONS = {
    "ekf": DEFAULT,
    "ekf-iterated": FilterOptions(iterations=10),
    "ekf-fej": FilterOptions(first_estimates=True),
    "ekf-invariant": FilterOptions(invariant=True),
}
"""Filters by name: one filter, whose correction is applied in different ways."""


class Estimator(Protocol):
    """The verbs every step-by-step estimator has; any association method works with any of them.

    What one of them cannot do is either of no consequence to it (`stamp`, `amend`), or asking for it is a ValueError
    (`park`, `reset`).
    """

    @property
    def smooths(self) -> bool:
        """Whether it revises its past: a smoother does, a filter does not."""
        ...

    @property
    def fixed_linearization(self) -> bool:
        """Whether it linearizes where it does and nowhere else: then `update` takes no `at`."""
        ...

    @property
    def size(self) -> int:
        """Length of the state that every frame updates, 0 if there is none."""
        ...

    @property
    def errors(self) -> tuple[Array, Array] | None:
        """Systematic errors (p,) as they are known now and their covariance (p, p); None: none are estimated."""
        ...

    @property
    def parked(self) -> IntArray:
        """Numbers (b,) of landmarks that are in the map but not in the state, ascending."""
        ...

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
        self,
        sightings: Sightings,
        decisions: IntArray,
        *,
        threshold: float = np.inf,
        at: Array | None = None,
        innovations: bool = False,
    ) -> Updated:
        """Use the pairings below `threshold`, initialize new landmarks.

        `at` (3,): where to linearize first, if not at the prediction; `innovations`: form them even if they cost extra.
        """
        ...

    def remove(self, numbers: IntArray) -> None:
        """Drop landmarks."""
        ...

    def merge(self, merged: IntArray, kept: IntArray) -> None:
        """Landmarks `merged` are the same as `kept`, and go."""
        ...

    def park(self, numbers: IntArray) -> None:
        """Landmarks leave the state, and stay in the map."""
        ...

    def restore(self, numbers: IntArray) -> None:
        """Parked landmarks come back into the state."""
        ...

    def parked_xy(self) -> Array:
        """Positions (b, 2) of the parked landmarks, ordered as `parked`."""
        ...

    def inflate(self, covariance: Array) -> None:
        """Believe the last motion so much less, by a covariance (3, 3) that is the same in all directions."""
        ...

    def reset(self, mean: Array, covariance: Array) -> None:
        """Localization: be at another pose (3,) with covariance (3, 3), whatever was believed before."""
        ...

    def amend(self, frames: IntArray, sightings: Sightings, decisions: IntArray) -> None:
        """What frames (m,) up to now saw (m) was for other landmarks (m,) than decided before, negative: for none.

        In SLAM this is asked once, of all that was seen, after the last frame and before `finish`.
        """
        ...

    def estimate(self) -> PoseEstimate:
        """The newest pose."""
        ...

    def landmarks(self) -> MapState:
        """The map as it is now; a given one without covariance."""
        ...

    def finish(self) -> Finished:
        """The end of the run."""
        ...


def make_estimator(
    name: str, given: Given, options: FilterOptions | None = None, *, lag: float = Setup.lag
) -> Estimator:
    """A fresh step-by-step estimator: with a map it localizes, without it does SLAM. `given` may be whole `Inputs`.

    `name`: of ours, or the settled text of a foreign one (`eval.replay.external`).
    `options` stand in for those that go with the name of a filter; `lag` [s] is that of `fixed-lag`, which counts
    frames as long as no frame is stamped with its time.
    """
    if is_foreign(name):
        return foreign_estimator(name, given, options)
    if name in OPTIONS:
        options = options or OPTIONS[name]
        if given.map is not None:
            return EkfLocalizer(given.prior, given.sensor, given.map, options, systematic=given.systematic)
        return EkfSlam(given.prior, given.sensor, options, systematic=given.systematic)
    if name == "isam2":
        return Isam2Smoother(given.prior, given.sensor, given.map, systematic=given.systematic)
    if name == "fixed-lag":
        return FixedLagSmoother(given.prior, given.sensor, given.map, lag=lag, systematic=given.systematic)
    raise UsageError(f"{name!r} does not work step by step; {', '.join(STEPPING[:-1])} and {STEPPING[-1]} do")


FOR_WALLS = "jcbb"
"""The way of association of walls without labels, where nobody says otherwise."""
NO_HINDSIGHT_OF_WALLS = f"{HINDSIGHT} knows landmarks as points, walls can be paired by {FOR_WALLS}"


def lack_with_walls(
    name: str, task: str, association: str, given: Given, options: FilterOptions | None = None
) -> str | None:
    """Why an estimator with a way of association cannot do with walls, if the sensor sees them; None if it can.

    `options` stand in for those that go with the name of a filter.
    """
    if given.sensor.sees_points:
        return None
    if association == HINDSIGHT:
        return NO_HINDSIGHT_OF_WALLS
    own = options or OPTIONS.get(name)
    return None if own is None else walls.lack(own, given.systematic, slam=task == "slam")

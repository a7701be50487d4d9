"""Step-by-step estimators: the verbs that all of them have, those that some have, and a fresh one by name."""

from __future__ import annotations

from typing import Any, NamedTuple, Protocol, TypeVar, runtime_checkable

import numpy as np

from association.expectation import Expectation
from data.errors import UsageError
from data.inputs import FrameObservations, Increment, IntArray
from data.result import Finished, MapState, PoseEstimate, Updated
from data.se2 import Array
from ekf import walls
from ekf.filter import DEFAULT, FilterOptions
from ekf.localizer import EkfLocalizer
from ekf.slam import EkfSlam
from eval.replay.external.adapter import Adapter
from eval.replay.external.guard import call
from eval.replay.external.make import CannotError
from eval.replay.external.make import estimator as foreign_estimator
from eval.replay.external.spec import is_foreign
from eval.replay.settings import HINDSIGHT, STEPPING, Given, Setup
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
    """What every step-by-step estimator has; any association method works with any of them.

    What only some can do are capabilities (`Capabilities`): a front end asks for them once, before the first frame.
    """

    @property
    def smooths(self) -> bool:
        """Whether it revises its past: a smoother does, a filter does not."""
        ...

    def predict(self, increment: Increment) -> None:
        """Move by an increment."""
        ...

    def expect(self, observations: FrameObservations) -> Expectation:
        """What it expects to see."""
        ...

    def update(
        self,
        observations: FrameObservations,
        decisions: IntArray,
        *,
        threshold: float = np.inf,
        at: Array | None = None,
        innovations: bool = False,
    ) -> Updated:
        """Use the pairings below `threshold`, initialize new landmarks.

        `at` (3,): where to linearize first, if not at the prediction, for those that can; `innovations`: form them even
        if they cost extra.
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


@runtime_checkable
class Timed(Protocol):
    """It needs to know what time it is, since it keeps poses for a span of time."""

    def stamp(self, time: float) -> None:
        """The present frame's time [s]."""
        ...


@runtime_checkable
class Stateful(Protocol):
    """It has a state that every frame updates as a whole."""

    @property
    def size(self) -> int:
        """Length of the state."""
        ...


@runtime_checkable
class Calibrating(Protocol):
    """It may estimate systematic errors along."""

    @property
    def errors(self) -> tuple[Array, Array] | None:
        """The errors (p,) as they are known now and their covariance (p, p); None: none are estimated."""
        ...


@runtime_checkable
class Parkable(Protocol):
    """Its landmarks can leave the state, stay in the map and come back."""

    @property
    def parked(self) -> IntArray:
        """Numbers (b,) of landmarks that are in the map but not in the state, ascending."""
        ...

    def parked_xy(self) -> Array:
        """Positions (b, 2) of the parked landmarks, ordered as `parked`."""
        ...

    def park(self, numbers: IntArray) -> None:
        """Landmarks leave the state, and stay in the map."""
        ...

    def restore(self, numbers: IntArray) -> None:
        """Parked landmarks come back into the state."""
        ...


@runtime_checkable
class Removable(Protocol):
    """SLAM: its landmarks can leave the map."""

    def remove(self, numbers: IntArray) -> None:
        """Drop landmarks."""
        ...


@runtime_checkable
class Revisable(Removable, Protocol):
    """SLAM: its landmarks can turn out to be the same."""

    def merge(self, merged: IntArray, kept: IntArray) -> None:
        """Landmarks `merged` are the same as `kept`, and go."""
        ...


@runtime_checkable
class Amendable(Protocol):
    """A smoother whose pairings can be decided otherwise later."""

    def amend(self, frames: IntArray, observations: FrameObservations, decisions: IntArray) -> None:
        """What frames (m,) up to now saw (m) was for other landmarks (m,) than decided before, negative: for none.

        In SLAM this is asked once, of all that was seen, after the last frame and before `finish`.
        """
        ...


@runtime_checkable
class Inflatable(Protocol):
    """It can believe a motion less than it was told to."""

    def inflate(self, covariance: Array) -> None:
        """Believe the last motion so much less, by a covariance (3, 3) that is the same in all directions."""
        ...


@runtime_checkable
class Resettable(Protocol):
    """Localization: it can be set to another pose."""

    def reset(self, mean: Array, covariance: Array) -> None:
        """Be at another pose (3,) with covariance (3, 3), whatever was believed before."""
        ...


class Capabilities(NamedTuple):
    """An estimator once more, as each of the capabilities that it has; None for those it lacks."""

    timed: Timed | None
    stateful: Stateful | None
    calibrating: Calibrating | None
    parkable: Parkable | None
    removable: Removable | None
    revisable: Revisable | None
    amendable: Amendable | None
    inflatable: Inflatable | None
    resettable: Resettable | None


CAPABILITIES: tuple[Any, ...] = (
    Timed,
    Stateful,
    Calibrating,
    Parkable,
    Removable,
    Revisable,
    Amendable,
    Inflatable,
    Resettable,
)
"""In the order of the fields of `Capabilities`."""


def capabilities(estimator: Estimator) -> Capabilities:
    """What an estimator can do beside the core; of a foreign one, what it has verbs of its own for."""
    if isinstance(estimator, Adapter):  # to ask may run its code
        has = [call(f"{estimator.name}()", isinstance, estimator.inner, each) for each in CAPABILITIES]
    else:
        has = [isinstance(estimator, each) for each in CAPABILITIES]
    either: list[Any] = [estimator if yes else None for yes in has]
    return Capabilities(*either)


C = TypeVar("C")


def needed(capability: C | None, verbs: str, why: str) -> C:
    """A capability that a run cannot do without. Raises CannotError where it is lacking."""
    if capability is None:
        raise CannotError(f"the estimator has no {verbs}, which {why} needs")
    return capability


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

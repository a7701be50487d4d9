"""A foreign estimator with all the verbs of ours: what it need not write is supplied, what it returns is checked."""

from __future__ import annotations

import inspect
import math
from typing import Any

import numpy as np

from association.expectation import Expectation
from data.inputs import Increment, IntArray, LandmarkMap, Sightings
from data.result import NEW, Finished, MapState, PoseEstimate, Updated
from data.se2 import Array
from eval.replay.foreign.guard import ForeignError, array, call
from eval.replay.foreign.returned import expectation_of, finished_of, map_of, pose_of, updated_of

NONE = np.empty(0, np.int64)
NONE.setflags(write=False)
KEYWORDS = ("threshold", "at", "innovations")
"""What `update` may take besides observations and decisions."""


class Adapter:
    """Somebody else's estimator among ours; see `eval.replay.estimators.Estimator` for the verbs.

    Attributes:
        name: in tables.
        inner: theirs.
        smooths: whether it revises its past.
        lacks_covariance: whether it ever gave a pose without one.
    """

    def __init__(self, name: str, inner: Any, known: LandmarkMap | None, frames: int | None = None) -> None:
        """Around `inner`; `known` is the map of localization."""
        self.name, self.inner, self._known = name, inner, known
        self.smooths = bool(getattr(inner, "smooths", False))
        self.fixed_linearization = bool(getattr(inner, "fixed_linearization", "at" not in _taken(inner)))
        self.lacks_covariance = False
        self._created, self._takes = 0, _taken(inner)

    def has(self, verb: str) -> bool:
        """Whether it has a verb of its own."""
        return callable(getattr(self.inner, verb, None))

    @property
    def size(self) -> int:
        """Length of its state, 0 if it does not say."""
        return int(getattr(self.inner, "size", 0))

    @property
    def errors(self) -> None:
        """It is not asked to estimate systematic errors."""
        return None

    @property
    def parked(self) -> IntArray:
        """Numbers (b,) of the parked landmarks; none where it cannot park."""
        return np.asarray(getattr(self.inner, "parked", NONE), np.int64)

    def predict(self, increment: Increment) -> None:
        """Move by an increment."""
        self._call("predict", increment)

    def stamp(self, time: float) -> None:
        """The present frame's time [s], if it wants to know."""
        if self.has("stamp"):
            self._call("stamp", time)

    def expect(self, sightings: Sightings) -> Expectation:
        """What it expects to see."""
        return expectation_of(f"{self.name}.expect", self._call("expect", sightings), sightings)

    def update(
        self,
        sightings: Sightings,
        decisions: IntArray,
        *,
        threshold: float = math.inf,
        at: Array | None = None,
        innovations: bool = False,
    ) -> Updated:
        """Use the pairings; of the keywords it gets those that it takes."""
        given = {"threshold": threshold, "at": at, "innovations": innovations}
        done = self._call("update", sightings, decisions.copy(), **{k: given[k] for k in self._takes})
        new = (decisions == NEW) if self._known is None else np.zeros(len(decisions), np.bool_)
        found = updated_of(f"{self.name}.update", done, decisions, new, self._created)
        self._created += int((found.created >= 0).sum())
        return found

    def remove(self, numbers: IntArray) -> None:
        """Drop landmarks."""
        self._call("remove", numbers.copy())

    def merge(self, merged: IntArray, kept: IntArray) -> None:
        """Landmarks `merged` are the same as `kept`."""
        self._call("merge", merged.copy(), kept.copy())

    def park(self, numbers: IntArray) -> None:
        """Landmarks leave the state."""
        self._call("park", numbers.copy())

    def restore(self, numbers: IntArray) -> None:
        """They come back."""
        self._call("restore", numbers.copy())

    def parked_xy(self) -> Array:
        """Positions (b, 2) of the parked landmarks."""
        if not len(self.parked):
            return np.empty((0, 2))
        who = f"{self.name}.parked_xy"
        found: Array = array(who, self._call("parked_xy"), (len(self.parked), 2), "what it returned")
        return found

    def inflate(self, covariance: Array) -> None:
        """Believe the last motion less; of no consequence where it cannot."""
        if self.has("inflate"):
            self._call("inflate", covariance.copy())

    def reset(self, mean: Array, covariance: Array) -> None:
        """Be at another pose."""
        self._call("reset", mean.copy(), covariance.copy())

    def amend(self, frames: IntArray, sightings: Sightings, decisions: IntArray) -> None:
        """What frames saw was for other landmarks; of no consequence where it does not revise its past."""
        if self.has("amend"):
            self._call("amend", frames.copy(), sightings, decisions.copy())

    def estimate(self) -> PoseEstimate:
        """The newest pose; NaN for the covariance where it gives none."""
        found = pose_of(f"{self.name}.estimate", self._call("estimate"))
        self.lacks_covariance |= not np.isfinite(found.covariance).all()
        return found

    def landmarks(self) -> MapState:
        """The map as it is now: the given one in localization, none where it does not say."""
        if self.has("landmarks"):
            return map_of(f"{self.name}.landmarks", self._call("landmarks"))
        if self._known is not None:
            return MapState(self._known.id, self._known.xy, np.zeros((len(self._known.id), 2, 2)))
        return MapState(NONE, np.empty((0, 2)), np.empty((0, 2, 2)))

    def finish(self) -> Finished:
        """The end: its own, or the last map."""
        if self.has("finish"):
            return finished_of(f"{self.name}.finish", self._call("finish"))
        return Finished(None, self.landmarks() if self._known is None else None)

    def notes(self) -> list[str]:
        """What a reader of its results should know."""
        said = []
        if self.lacks_covariance:
            said.append(f"{self.name} gives no covariance: there is no NEES, no share inside 3 sigma and no ellipse")
        if self._known is None and not self.has("landmarks"):
            said.append(f"{self.name} has no `landmarks`: nothing is known of its map")
        return said

    def _call(self, verb: str, *arguments: Any, **named: Any) -> Any:
        function = getattr(self.inner, verb, None)
        if function is None:
            raise ForeignError(f"{self.name} has no `{verb}`, which is needed here")
        return call(f"{self.name}.{verb}", function, *arguments, **named)


def _taken(inner: Any) -> tuple[str, ...]:
    """The keywords that its `update` takes."""
    try:
        parameters = inspect.signature(inner.update).parameters.values()
    except (AttributeError, TypeError, ValueError):
        return ()
    if any(p.kind is p.VAR_KEYWORD for p in parameters):
        return KEYWORDS
    return tuple(k for k in KEYWORDS if any(p.name == k for p in parameters))

"""A front end for SLAM in hindsight: how an estimator lives with landmarks that are taken back or turn out to be one.

`HindsightMapper` decides; a filter drops or joins landmarks in its state, a smoother takes their factors out of the
graph and puts those of joined ones in again.
"""

from __future__ import annotations

import numpy as np

from association.decide import HINDSIGHT
from data.errors import UsageError
from data.inputs import Frame, IntArray
from data.result import Event, Updated
from ekf.filter import Filter, FilterOptions
from eval.replay.frontend import FrontEnd, Watch
from eval.replay.given import Given
from eval.replay.hindsight.mapper import HindsightMapper
from eval.replay.map_management import Upkeep
from eval.replay.settings import Setup

EVERYTHING = float(np.finfo(float).max)
"""A gate that lets all pass, but for which a smoother forms its innovations."""


class MappingFrontEnd(FrontEnd):
    """The verbs of a frame, decisions by `HindsightMapper`; the log has no map.

    Attributes:
        mapper: what decides; its `events` are the revisions.
    """

    def __init__(
        self, estimator: str, association: str, given: Given, setup: Setup, options: FilterOptions | None = None
    ) -> None:
        """Before the first frame. Raises UsageError with one update per observation."""
        if options is not None and options.each:
            raise UsageError(f"{HINDSIGHT} judges the observations of a frame together; they cannot be used one by one")
        super().__init__(estimator, association, given, setup, options)
        self.mapper = HindsightMapper(given, setup)
        if self.upkeep is None:
            self.upkeep = Upkeep(setup)
        if not isinstance(self.estimator, Filter):
            self._threshold = EVERYTHING
        self._stays = isinstance(self.estimator, Filter) and self.estimator.options.first_estimates
        """It linearizes nowhere else."""

    def move(self, frame: Frame) -> None:
        """The next frame comes."""
        super().move(frame)
        self.mapper.move(frame)

    def associate(self, frame: Frame, watch: Watch | None = None) -> tuple[IntArray, Updated]:
        """Decide about this frame's observations and use them; returns decisions (m,) and what was done."""
        expectation = self.expect(frame.sightings) if watch is not None else None
        decisions, complete, at, astray = self.mapper.decide(frame)
        if astray is not None:
            self.estimator.lose(astray)
        self.incomplete += not complete
        if watch is not None:
            watch.decided(self, frame, expectation, decisions)
        return decisions, self.update(frame, decisions, None if self._stays else at)

    def tidy(self) -> None:
        """The end of a frame: landmarks leave the map in hindsight, and by the rules of the setup."""
        found = self.mapper.revise()
        self._retract(found.retracted)
        if len(found.joined):
            if (slam := self._filter) is not None:
                self.wake(np.intersect1d(slam.parked, np.concatenate([found.joined, found.kept])))
            self.estimator.join(found.joined, found.kept)
            self._gone(found.joined)
        super().tidy()

    def leave(self, numbers: IntArray) -> None:
        """Landmarks (r,) leave the map by the rules of the setup; nothing more is decided about them."""
        super().leave(numbers)
        self.mapper.leave(numbers)

    def close(self) -> None:
        """The end of the log: what did not become certain is taken back."""
        self._retract(self.mapper.close())

    def _retract(self, numbers: IntArray) -> None:
        if len(numbers):
            self.estimator.remove(numbers)
            self._gone(numbers)

    def _gone(self, numbers: IntArray) -> None:
        assert self.upkeep is not None  # hindsight always has one
        self.upkeep.retract(numbers)

    def events(self) -> tuple[Event, ...]:
        """Decisions that were revised."""
        return tuple(self.mapper.events)

    def notes(self) -> list[str]:
        """What a reader of the results should know."""
        return [*super().notes(), *self.mapper.notes()]

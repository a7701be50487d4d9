"""Front end for SLAM in hindsight: how an estimator handles retracted and merged landmarks.

`HindsightMapper` decides. A filter drops or merges landmarks in its state; a smoother removes their factors and
re-attaches those of merged ones.
"""

from __future__ import annotations

import numpy as np

from association.appearance import evidence
from association.truncated import Acceptance, of_places
from data.errors import UsageError
from data.inputs import Frame, IntArray
from data.notice import Notice
from data.result import Event
from ekf.filter import FilterOptions
from eval.replay.estimators import needed
from eval.replay.frontend import FrontEnd, Pairing
from eval.replay.hindsight.mapper import HindsightMapper
from eval.replay.settings import HINDSIGHT, Given, Setup


class MappingFrontEnd(FrontEnd):
    """Front end with decisions by `HindsightMapper`; the log has no map."""

    revises_map = True
    asks_for_innovations = True

    def __init__(
        self, estimator: str, association: str, given: Given, setup: Setup, options: FilterOptions | None = None
    ) -> None:
        """Check options and estimator.

        Raises UsageError: with one update per observation. Raises CannotError: landmarks of the estimator's map cannot
        be removed and merged.
        """
        if options is not None and options.each:
            raise UsageError(f"{HINDSIGHT} judges the observations of a frame together; they cannot be used one by one")
        super().__init__(estimator, association, given, setup, options)
        self._map = needed(self.can.revisable, "`remove` and `merge`", f"--association {HINDSIGHT}")
        self.mapper = HindsightMapper(given, setup)  # decides; its `events` are the revisions

    @property
    def passed(self) -> Acceptance:
        """Each pairing is tested given the others; the outer gate rejects next to nothing."""
        return Acceptance(conditional=of_places(self.setup.gate, 2, right=self._right))

    def move(self, frame: Frame) -> None:
        """Take the next frame."""
        super().move(frame)
        self.mapper.move(frame)

    def use_poses(self, frame: Frame) -> None:
        """Update with the frame's fixes and closures, in the mapper's own filter too."""
        super().use_poses(frame)
        self.mapper.use_poses(frame)

    def associate(self, frame: Frame) -> Pairing:
        """Decide about this frame's observations; the mapper has its own expectation."""
        decisions, complete, at, kidnapped, S = self.mapper.decide(frame)
        self._right = evidence(frame.appearance)
        self.incomplete += not complete
        if kidnapped is not None and self.can.inflatable is not None:
            self.can.inflatable.inflate(kidnapped)
        return Pairing(decisions, at=at, S=S)

    def tidy(self) -> None:
        """Retract and merge landmarks in hindsight, and remove those that the setup rules out."""
        found = self.mapper.revise()
        self._retract(found.retracted)
        if len(found.merged):
            if self.parking is not None:
                self.parking.restore(np.concatenate([found.merged, found.kept]))
            self._map.merge(found.merged, found.kept)
            self._gone(found.merged)
        super().tidy()

    def leave(self, numbers: IntArray) -> None:
        """Remove landmarks (r,) by the rules of the setup; nothing more is decided about them."""
        super().leave(numbers)
        self.mapper.leave(numbers)

    def close(self) -> None:
        """Re-associate all observations and retract transient landmarks."""
        end = self.mapper.close()
        self._retract(end.retracted)
        self.left, self.gated_final = end.left, end.gated
        if end.settled is not None and self.can.amendable is not None:
            self.can.amendable.amend(*end.settled)

    def _retract(self, numbers: IntArray) -> None:
        if len(numbers):
            self._map.remove(numbers)
            self._gone(numbers)

    def _gone(self, numbers: IntArray) -> None:
        assert self.map_management is not None  # the map is revised
        self.map_management.remove(numbers)

    def events(self) -> tuple[Event, ...]:
        """Revised decisions."""
        return tuple(self.mapper.events)

    def notes(self) -> list[Notice]:
        """Messages about the run."""
        return [*super().notes(), *self.mapper.notes()]

"""One estimator with one way of association, frame by frame: what a replay and the step-through command share."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Protocol

import numpy as np

from association.candidates import Drift, in_view, may_be_in_view
from association.decide import Decided, decide
from association.expectation import Expectation, gate_threshold
from association.jcbb import BUDGET
from association.known import pair_by_label
from data.inputs import Frame, IntArray, Sightings
from data.result import DISCARD, Event, MapState, Updated
from data.se2 import Array
from ekf.filter import Filter, FilterOptions
from ekf.slam import EkfSlam
from eval.replay.estimators import FILTERS, make_estimator
from eval.replay.given import Beginning, Given
from eval.replay.map_management import Upkeep
from eval.replay.settings import Setup
from graph.incremental import Isam2Smoother


class Watch(Protocol):
    """Somebody who looks on while a log is replayed, frame by frame, and changes nothing."""

    def moved(self, front: FrontEnd) -> None:
        """A frame begins; its observations were not looked at yet."""
        ...

    def decided(self, front: FrontEnd, frame: Frame, expectation: Expectation | None, decisions: IntArray) -> None:
        """The observations of (a part of) the frame were decided about, not used yet; `known` needs no expectation."""
        ...

    def updated(self, front: FrontEnd, decisions: IntArray, created: IntArray) -> None:
        """A frame is over; decisions and founded landmarks (M,) are those of the whole log so far."""
        ...


class FrontEnd:
    """The verbs of a frame, in this order: move, (look at the expectation, decide,) update.

    `k` is the frame; `association` is `known` (labels that come with the frames decide) or a method's name.
    """

    def __init__(
        self, estimator: str, association: str, given: Given, setup: Setup, options: FilterOptions | None = None
    ) -> None:
        """Before the first frame."""
        self.given, self.setup, self.association = Beginning(given.prior, given.sensor, given.map), setup, association
        self.estimator = make_estimator(estimator, given, options, lag=setup.lag)
        self.slam = given.map is None
        kept = setup if self._filter is not None else replace(setup, forget_after=None, deactivate_after=None)
        self.upkeep = Upkeep(kept) if self.slam and kept.upkeep else None
        self.k = -1
        self.incomplete, self.reactivated = 0, 0
        self._drift = Drift()
        self.largest = 0
        gated = association == "known" and (setup.gate_smoothers or estimator in FILTERS)
        self._threshold = gate_threshold(setup.gate_known) if gated else math.inf
        self._held: dict[int, int] = {}
        self._label_of: dict[int, int] = {}

    @property
    def _filter(self) -> EkfSlam | None:
        return self.estimator if isinstance(self.estimator, EkfSlam) else None

    def move(self, frame: Frame) -> None:
        """The next frame comes; the first one has no motion."""
        self.k = frame.number
        if frame.increment is not None:
            self.estimator.predict(frame.increment)
            self._drift.move(frame.increment)
        self.estimator.stamp(frame.time)
        if self.upkeep is not None:
            self.upkeep.begin(frame.number, frame.time)

    def expect(self, sightings: Sightings) -> Expectation:
        """What the estimator expects of its candidates: parked landmarks that may be in view are taken back first."""
        slam, sensor = self._filter, self.given.sensor
        pose, covariance = self.estimator.estimate()
        if slam is not None and self.upkeep is not None and len(slam.parked):
            bounds = self._drift.sigmas(slam.parked, covariance)
            self.wake(slam.parked[may_be_in_view(sensor, pose, slam.parked_xy(), *bounds)])
        e = self.estimator.expect(sightings)
        if self.setup.in_view and isinstance(self.estimator, Filter):
            e = e.only(np.flatnonzero(in_view(sensor, e.z_hat, e.HPHt)))
        return e

    def wake(self, numbers: IntArray) -> None:
        """Parked landmarks come back into the filter's state."""
        slam = self._filter
        if slam is not None and self.upkeep is not None and len(numbers):
            slam.restore(numbers)
            self.upkeep.wake(numbers)
            self.reactivated += len(numbers)

    def decide(self, expectation: Expectation, method: str | None = None) -> Decided:
        """Decisions by the method of this run, or for comparison by another one."""
        s = self.setup
        return decide(method or self.association, expectation, s.gate, s.new_gate, known_map=not self.slam)

    def pair_known(self, frame: Frame) -> IntArray:
        """Decisions by label for observations of this frame. Raises ValueError where labels were not granted."""
        if frame.label is None:
            raise ValueError("known association was not granted to these inputs")
        if self.given.map is not None:
            return np.where(np.isin(frame.label, self.given.map.id), frame.label, DISCARD)
        return pair_by_label(frame.label, self._held)

    def associate(self, frame: Frame, watch: Watch | None = None) -> tuple[IntArray, Updated]:
        """Decide about (a part of) this frame's observations, use them; returns decisions (m,) and what was done."""
        expectation = None
        if self.association == "known":
            decisions = self.pair_known(frame)
        else:
            expectation = self.expect(frame.sightings)
            decisions, complete = self.decide(expectation)
            self.incomplete += not complete
        if watch is not None:
            watch.decided(self, frame, expectation, decisions)
        # an estimator that forms no innovations of its own: before the update, as an expectation ends with it
        own = None
        if expectation is not None and not isinstance(self.estimator, Filter):
            own = _statistics(expectation, decisions)
        done = self.update(frame, decisions)
        if own is not None:
            done = done._replace(nis=own[0], dof=own[1], log_likelihood=own[2])
        return decisions, done

    def update(self, frame: Frame, decisions: IntArray, at: Array | None = None) -> Updated:
        """Use the decisions (m,) about the frame's observations; `at` (3,): where the frame was placed, if it was."""
        slam, sightings = self._filter, frame.sightings
        if slam is not None and len(slam.parked):
            self.wake(np.intersect1d(decisions, slam.parked))
        done = self.estimator.update(sightings, decisions, threshold=self._threshold, at=at)
        if self.slam:
            founded = np.flatnonzero(done.created >= 0)
            if self.association == "known" and frame.label is not None:
                for i in founded:
                    label, number = int(frame.label[i]), int(done.created[i])
                    self._held[label], self._label_of[number] = number, label
            if self.upkeep is not None:
                numbers = np.where(done.used, decisions, done.created)
                seen = np.flatnonzero(numbers >= 0)
                self.upkeep.see(numbers[seen])
                if slam is not None and self.setup.deactivate_after is not None:
                    taken = Sightings(sightings.z[seen], sightings.R[seen])
                    self._drift.see(self.given.sensor, taken, numbers[seen], slam.estimate().covariance)
        return done

    def tidy(self) -> None:
        """The end of a frame: landmarks leave the map by the rules of the setup."""
        slam = self._filter
        if slam is not None:
            self.largest = max(self.largest, slam.size)
        if self.upkeep is None:
            return
        leaving = self.upkeep.leaving()
        gone = np.concatenate([leaving.retracted, leaving.forgotten])
        if len(gone):
            self.leave(gone)
            for n in gone.tolist():
                self._held.pop(self._label_of.pop(n, -1), None)
        if slam is not None and len(leaving.parked):
            slam.park(leaving.parked)

    def leave(self, numbers: IntArray) -> None:
        """Landmarks (r,) leave the map by the rules of the setup."""
        self.estimator.remove(numbers)

    def close(self) -> None:
        """The end of the log."""

    def events(self) -> tuple[Event, ...]:
        """Decisions that were revised: none, where they are made frame by frame."""
        return ()

    def landmarks(self) -> MapState:
        """The map as it is now, parked landmarks included; a given one has no covariance."""
        if self.given.map is not None:
            known = self.given.map
            return MapState(known.id, known.xy, np.zeros((len(known.id), 2, 2)))
        if isinstance(self.estimator, Isam2Smoother):
            return self.estimator.landmarks()
        state = self.estimator.finish().map
        assert state is not None  # a SLAM filter always has a map
        return state

    @property
    def size(self) -> int:
        """Length of a filter's (active) state; 0 for a smoother."""
        return self.estimator.size if isinstance(self.estimator, Filter) else 0

    def notes(self) -> list[str]:
        """What a reader of the results should know."""
        told, s = [], self.setup
        if self.incomplete:
            told.append(
                f"{self.association} ran out of its {BUDGET} nodes in {self.incomplete} frames; "
                "the best pairings found until then were used"
            )
        if self.slam and self._filter is None and (s.forget_after is not None or s.deactivate_after is not None):
            told.append("landmarks are forgotten or parked in the filter's state only, not in the graph")
        if s.deactivate_after is not None and self._filter is not None:
            told.append(
                f"landmarks unseen for {s.deactivate_after:g} were parked: at most {self.largest} states were active, "
                f"and landmarks were taken back {self.reactivated} times"
            )
        if self.upkeep is not None and self.upkeep.removed:
            told.append(f"{len(self.upkeep.removed)} landmarks were removed from the map")
        return told


def _statistics(e: Expectation, decisions: IntArray) -> tuple[float, int, float]:
    """NIS, degrees of freedom and log-likelihood of a frame's pairings."""
    rows = np.flatnonzero(decisions >= 0)
    order = np.argsort(e.number)
    return e.innovation_statistics(rows, order[np.searchsorted(e.number, decisions[rows], sorter=order)])

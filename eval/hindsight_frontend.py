"""A front end for localization in hindsight: how an estimator lives with decisions that may be revised.

A filter is set to the bank's mixture wherever there is more than one hypothesis. A smoother, which cannot take a
pairing in a known map back, gets what is all but certain; if it turns out to be elsewhere than the bank is sure of, it
is begun anew there.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from association.decide import Decided
from association.expectation import Expectation
from data.inputs import Increment, Inputs, IntArray, Prior, Sightings
from data.result import DISCARD, Event, Finished, PoseEstimate, Trajectory, Updated
from data.se2 import Array
from ekf.filter import Filter, FilterOptions
from ekf.localizer import EkfLocalizer
from eval.frontend import Estimator, FrontEnd, make_estimator
from eval.hindsight_localizer import MAYBE, HindsightLocalizer
from eval.setup import Setup
from eval.watch import Watch

CERTAIN = 0.9
"""A smoother gets a decision that at least this share of the hypotheses agree on, by weight."""


class Stretches:
    """A smoother that can be begun anew: the verbs of an estimator, its final path put together from the stretches."""

    def __init__(self, begin: Callable[[Prior, int], Estimator], prior: Prior) -> None:
        """`begin(prior, frame)` makes the smoother of the log from a frame on."""
        self._begin, self._now = begin, begin(prior, 0)
        self._first, self._frame = 0, 0
        self._done: list[Finished] = []

    def predict(self, increment: Increment) -> None:
        """Move by an increment."""
        self._frame += 1
        self._now.predict(increment)

    def expect(self, sightings: Sightings) -> Expectation:
        """What the present smoother expects to see."""
        return self._now.expect(sightings)

    def update(
        self, sightings: Sightings, decisions: IntArray, *, threshold: float = math.inf, at: Array | None = None
    ) -> Updated:
        """Use the pairings."""
        return self._now.update(sightings, decisions, threshold=threshold, at=at)

    def remove(self, numbers: IntArray) -> None:
        """A known map does not change: asking for it is an error."""
        self._now.remove(numbers)

    def join(self, away: IntArray, kept: IntArray) -> None:
        """No two landmarks of a known map are one: asking for it is an error."""
        self._now.join(away, kept)

    def estimate(self) -> PoseEstimate:
        """The newest pose."""
        return self._now.estimate()

    def reset(self, mean: Array, covariance: Array) -> None:
        """From this frame on a new smoother, whose prior is the pose (3,) and covariance (3, 3)."""
        if self._frame > self._first:
            ended = self._now.finish()
            assert ended.final is not None  # smoothers have one
            kept = self._frame - self._first
            path = Trajectory(ended.final.pose[:kept], ended.final.covariance[:kept])
            self._done.append(ended._replace(final=path))
        self._first = self._frame
        self._now = self._begin(Prior(mean, covariance), self._frame)

    def finish(self) -> Finished:
        """The stretches one after the other; costs and degrees of freedom add up."""
        parts = [*self._done, self._now.finish()]
        paths = [p.final for p in parts if p.final is not None]
        totals = [p.total_nis for p in parts if p.total_nis is not None]
        final = Trajectory(np.concatenate([p.pose for p in paths]), np.concatenate([p.covariance for p in paths]))
        total = (sum(t[0] for t in totals), sum(t[1] for t in totals)) if len(totals) == len(parts) else None
        return Finished(final, None, total)


class LocalizingFrontEnd(FrontEnd):
    """The verbs of a frame, decisions by `HindsightLocalizer`; the log has a known map.

    Attributes:
        localizer: what decides; its `events` are the revisions.
    """

    def __init__(
        self, estimator: str, association: str, inputs: Inputs, setup: Setup, options: FilterOptions | None = None
    ) -> None:
        """Before the first frame. Raises UsageError without a map."""
        self.localizer = HindsightLocalizer(inputs)
        super().__init__(estimator, association, inputs, setup, options)
        self._decided = np.empty(0, np.int64)
        self._was_single = True
        self._filtering = isinstance(self.estimator, Filter)
        if not self._filtering:

            def begin(prior: Prior, frame: int) -> Estimator:
                rest = replace(inputs, prior=prior, time=inputs.time[frame:])
                return make_estimator(estimator, rest, options, lag=setup.lag)

            self.estimator = Stretches(begin, inputs.prior)

    def move(self) -> None:
        """The next frame."""
        super().move()
        self.localizer.move(self.inputs.increment(self.k) if self.k > 0 else None)

    def decide(self, expectation: Expectation, method: str | None = None) -> Decided:
        """Decisions by the hypotheses, or for comparison by a method; a smoother gets only what it may expect."""
        if method is not None:
            return super().decide(expectation, method)
        return Decided(np.where(np.isin(self._decided, expectation.number), self._decided, DISCARD), True)

    def associate(self, rows: slice, watch: Watch | None = None) -> tuple[IntArray, Updated]:
        """Decide about observations of this frame and use them; returns decisions (m,) and what was done."""
        localizer, times = self.localizer, len(self.localizer.found)
        self._decided = localizer.decide(rows, MAYBE if self._filtering else CERTAIN)
        if len(localizer.found) > times:
            if watch is not None:
                watch.decided(self, rows, None, self._decided)
            self._reset()
            nothing = np.full(len(self._decided), -1, np.int64)
            done = Updated(self._decided >= 0, nothing, math.nan, 0, math.nan)
            self._was_single = True
            return self._decided, done
        decisions, done = super().associate(rows, watch)
        several = not (localizer.single and self._was_single)
        self._was_single = localizer.single
        if (several and self._filtering) or localizer.elsewhere(self.estimator.estimate()):
            self._reset()
        return decisions, done

    def _reset(self) -> None:
        """The estimator is where the hypotheses are."""
        assert isinstance(self.estimator, EkfLocalizer | Stretches)
        self.estimator.reset(*self.localizer.pose())

    def close(self) -> None:
        """The end of the log."""
        self.localizer.close()

    def events(self) -> tuple[Event, ...]:
        """Decisions that were revised."""
        return tuple(self.localizer.events)

    def notes(self) -> list[str]:
        """What a reader of the results should know."""
        return [*super().notes(), *self.localizer.notes()]

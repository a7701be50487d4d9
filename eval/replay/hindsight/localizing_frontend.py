"""A front end for localization in hindsight: how an estimator lives with decisions that may be revised.

A filter is set to the bank's mixture wherever there is more than one hypothesis. A smoother gets what most of them
decide, by weight: a decision that has to wait is handed over when later frames have settled it, and one that they
contradict is replaced. If it turns out to be elsewhere than the bank is sure of all the same, it is begun anew there.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from association.decide import Decided
from association.evidence import constants
from association.expectation import Expectation
from data.inputs import Increment, Inputs, IntArray, Prior, Sightings
from data.result import DISCARD, Event, Finished, PoseEstimate, Trajectory, Updated
from data.se2 import Array
from ekf.filter import Filter, FilterOptions
from ekf.localizer import EkfLocalizer
from eval.replay.estimators import Estimator, make_estimator
from eval.replay.frontend import FrontEnd, Watch
from eval.replay.hindsight.localizer import HindsightLocalizer
from eval.replay.settings import Setup
from graph.incremental import Isam2Smoother


class Stretches:
    """A smoother that can be begun anew: the verbs of an estimator, its final path put together from the stretches."""

    def __init__(self, begin: Callable[[Prior, int], Estimator], prior: Prior) -> None:
        """`begin(prior, frame)` makes the smoother of the log from a frame on."""
        self._begin, self._now = begin, begin(prior, 0)
        self._first, self._frame = 0, 0
        self._given = 0
        """First frame whose sightings are the present smoother's: those of the one it began in are in its prior."""
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

    def amend(self, frames: IntArray, sightings: Sightings, decisions: IntArray) -> None:
        """Take what frames (m,) saw for other landmarks than before; what stretches before this one saw stays."""
        assert isinstance(self._now, Isam2Smoother)
        keep = np.flatnonzero(frames >= self._given)
        if len(keep):
            seen = Sightings(sightings.z[keep], sightings.R[keep])
            self._now.amend(frames[keep] - self._first, seen, decisions[keep])

    def remove(self, numbers: IntArray) -> None:
        """A known map does not change: asking for it is an error."""
        self._now.remove(numbers)

    def join(self, away: IntArray, kept: IntArray) -> None:
        """No two landmarks of a known map are one: asking for it is an error."""
        self._now.join(away, kept)

    def lose(self, covariance: Array) -> None:
        """Believe the last motion so much less."""
        self._now.lose(covariance)

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
        self._first, self._given = self._frame, self._frame + 1
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
        # of a smoother: what it takes each observation for, and the first one that not all hypotheses agree about
        self._given_as, self._open = np.full(len(inputs.observations.frame), DISCARD, np.int64), 0
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
        self._decided = localizer.decide(rows)
        if len(localizer.found) > times:
            if watch is not None:
                watch.decided(self, rows, None, self._decided)
            self._reset()
            nothing = np.full(len(self._decided), -1, np.int64)
            done = Updated(self._decided >= 0, nothing, math.nan, 0, math.nan)
            self._was_single = True
            return self._decided, done
        self._hand_over(rows.start, rows.stop, constants.MAYBE)
        decisions, done = super().associate(rows, watch)
        self._given_as[rows] = np.where(done.used, decisions, DISCARD)
        several = not (localizer.single and self._was_single)
        self._was_single = localizer.single
        if (several and self._filtering) or localizer.elsewhere(self.estimator.estimate()):
            self._reset()
        return decisions, done

    def _hand_over(self, stop: int, seen: int, share: float) -> None:
        """Decisions about rows before `stop` that `share` of the hypotheses agree on by now, with `seen` rows seen."""
        if self._filtering or stop <= self._open:
            return
        o, rows = self.inputs.observations, np.arange(self._open, stop)
        number, sure = (a[: len(rows)] for a in self.localizer.bank.opinion(seen - self._open))
        changed = (sure >= share) & (number != self._given_as[rows])
        if changed.any():
            self._given_as[rows[changed]] = number[changed]
            whole = np.flatnonzero(np.isin(o.frame, o.frame[rows[changed]]))
            assert isinstance(self.estimator, Stretches)
            self.estimator.amend(o.frame[whole], Sightings(o.z[whole], o.R[whole]), self._given_as[whole])
        undecided = np.flatnonzero(sure < 1.0)
        self._open = int(rows[undecided[0]]) if len(undecided) else stop

    def _reset(self) -> None:
        """The estimator is where the hypotheses are."""
        assert isinstance(self.estimator, EkfLocalizer | Stretches)
        self.estimator.reset(*self.localizer.pose())

    def close(self) -> None:
        """The end of the log: what is not settled is as the leading hypothesis has it."""
        self.localizer.close()
        self._hand_over(len(self._given_as), len(self._given_as), 0.0)

    def events(self) -> tuple[Event, ...]:
        """Decisions that were revised."""
        return tuple(self.localizer.events)

    def notes(self) -> list[str]:
        """What a reader of the results should know."""
        return [*super().notes(), *self.localizer.notes()]

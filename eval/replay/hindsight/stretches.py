"""A smoother that can be begun anew in the middle of a log, as a filter can be reset."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from association.expectation import Expectation
from data.inputs import Increment, IntArray, Prior, Sightings
from data.result import Finished, MapState, PoseEstimate, Systematics, Trajectory, Updated
from data.se2 import Array
from eval.replay.estimators import Estimator


class Stretches:
    """A smoother that can be begun anew: the verbs of an estimator, its final path put together from the stretches."""

    smooths = True
    fixed_linearization = False
    size = 0

    def __init__(self, begin: Callable[[Prior], Estimator], prior: Prior) -> None:
        """`begin(prior)` makes the smoother of the log from the present frame on."""
        self._begin, self._now = begin, begin(prior)
        self._first, self._frame, self._time = 0, 0, 0.0
        self._given = 0
        """First frame whose sightings are the present smoother's: those of the one it began in are in its prior."""
        self._done: list[Finished] = []

    def predict(self, increment: Increment) -> None:
        """Move by an increment."""
        self._frame += 1
        self._now.predict(increment)

    def stamp(self, time: float) -> None:
        """The present frame's time [s]."""
        self._time = time
        self._now.stamp(time)

    def expect(self, sightings: Sightings) -> Expectation:
        """What the present smoother expects to see."""
        return self._now.expect(sightings)

    def update(
        self,
        sightings: Sightings,
        decisions: IntArray,
        *,
        threshold: float = math.inf,
        at: Array | None = None,
        innovations: bool = False,
    ) -> Updated:
        """Use the pairings."""
        return self._now.update(sightings, decisions, threshold=threshold, at=at, innovations=innovations)

    def amend(self, frames: IntArray, sightings: Sightings, decisions: IntArray) -> None:
        """Take what frames (m,) saw for other landmarks than before; what stretches before this one saw stays."""
        keep = np.flatnonzero(frames >= self._given)
        if len(keep):
            seen = Sightings(sightings.z[keep], sightings.R[keep])
            self._now.amend(frames[keep] - self._first, seen, decisions[keep])

    def remove(self, numbers: IntArray) -> None:
        """A known map does not change: asking for it is an error."""
        self._now.remove(numbers)

    def merge(self, merged: IntArray, kept: IntArray) -> None:
        """No two landmarks of a known map are one: asking for it is an error."""
        self._now.merge(merged, kept)

    @property
    def errors(self) -> tuple[Array, Array] | None:
        """Systematic errors as the present smoother knows them."""
        return self._now.errors

    @property
    def parked(self) -> IntArray:
        """No landmark is parked: (0,)."""
        return self._now.parked

    def parked_xy(self) -> Array:
        """No landmark is parked: (0, 2)."""
        return self._now.parked_xy()

    def park(self, numbers: IntArray) -> None:
        """A known map does not change: asking for it is an error."""
        self._now.park(numbers)

    def restore(self, numbers: IntArray) -> None:
        """No landmark is parked: asking for it is an error."""
        self._now.restore(numbers)

    def inflate(self, covariance: Array) -> None:
        """Believe the last motion so much less."""
        self._now.inflate(covariance)

    def estimate(self) -> PoseEstimate:
        """The newest pose."""
        return self._now.estimate()

    def landmarks(self) -> MapState:
        """The given map."""
        return self._now.landmarks()

    def reset(self, mean: Array, covariance: Array) -> None:
        """From this frame on a new smoother, whose prior is the pose (3,) and covariance (3, 3)."""
        if self._frame > self._first:
            ended = self._now.finish()
            assert ended.final is not None  # smoothers have one
            kept = self._frame - self._first
            path = Trajectory(ended.final.pose[:kept], ended.final.covariance[:kept])
            errors = ended.systematic
            if errors is not None:
                errors = errors._replace(mean=errors.mean[:kept], sigma=errors.sigma[:kept])
            self._done.append(ended._replace(final=path, systematic=errors))
        self._first, self._given = self._frame, self._frame + 1
        self._now = self._begin(Prior(mean, covariance))
        self._now.stamp(self._time)

    def finish(self) -> Finished:
        """The stretches one after the other; costs and degrees of freedom add up."""
        parts = [*self._done, self._now.finish()]
        paths = [p.final for p in parts if p.final is not None]
        totals = [p.total_nis for p in parts if p.total_nis is not None]
        errors = [p.systematic for p in parts if p.systematic is not None]
        final = Trajectory(np.concatenate([p.pose for p in paths]), np.concatenate([p.covariance for p in paths]))
        total = (sum(t[0] for t in totals), sum(t[1] for t in totals)) if len(totals) == len(parts) else None
        found = None
        if errors:
            mean, sigma = (np.concatenate(rows) for rows in zip(*(e[1:] for e in errors), strict=True))
            found = Systematics(errors[0].names, mean, sigma)
        return Finished(final, None, total, systematic=found)

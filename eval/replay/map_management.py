"""Which landmarks leave the map, and when: map maintenance, forgetting and parking.

Landmarks are parked where a person asks for it, those unseen for a time (`Parking`), or in a large map without being
asked, as it is faster and nothing else changes (`AutomaticParking`). They come back into a filter's state when they may
be seen again, or when something is paired with them; a bound on each one's uncertainty says when that may be, so that
what is parked costs nothing in the meantime.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from association.candidates import Drift, may_be_in_view
from association.decide import horizon
from data.inputs import FrameObservations, Increment, IntArray
from data.notice import Code, Notice, Severity, notice
from data.sensors import Sensor
from ekf.epochs import LEAST, MOVED, PRODUCT, READING, STEP
from ekf.slam import EkfSlam
from eval.replay.estimators import Capabilities, Estimator, needed
from eval.replay.external.spec import is_foreign
from eval.replay.settings import HINDSIGHT, Setup

MAINTENANCE_FRAMES = 2
"""A landmark seen only once is removed when its observation is more frames ago than this."""


class Leaving(NamedTuple):
    """Landmark numbers: `retracted` as if never seen, `forgotten` from now on, `parked` until seen again."""

    retracted: IntArray
    forgotten: IntArray
    parked: IntArray


class MapManagement:
    """When each landmark was seen, and what follows from it: `begin` a frame, `see`, `leaving`.

    Attributes:
        removed: frame after which a landmark was no longer in the map.
        retracted: landmarks that were removed as if never seen.
    """

    def __init__(self, setup: Setup) -> None:
        """Nothing seen."""
        self.setup = setup
        self.removed: dict[int, int] = {}
        self.retracted: set[int] = set()
        self._frame, self._now = 0, 0.0
        # by landmark: frame of its first observation, their number, time of the last one, time since which it is
        # active (seen or restored last)
        self._first, self._times = np.empty(0, np.int64), np.empty(0, np.int64)
        self._last, self._active = np.empty(0), np.empty(0)
        self._parked, self._gone = np.empty(0, np.bool_), np.empty(0, np.bool_)

    def begin(self, frame: int, time: float) -> None:
        """The next frame, at a time in the unit of the setup's spans."""
        self._frame, self._now = frame, time

    def see(self, numbers: IntArray) -> None:
        """Landmarks paired or initialized in this frame; numbers come in order of creation."""
        more = int(numbers.max(initial=-1)) + 1 - len(self._first)
        if more > 0:
            self._first = np.concatenate([self._first, np.full(more, self._frame)])
            self._times = np.concatenate([self._times, np.zeros(more, np.int64)])
            self._last = np.concatenate([self._last, np.full(more, self._now)])
            self._active = np.concatenate([self._active, np.full(more, self._now)])
            self._parked = np.concatenate([self._parked, np.zeros(more, np.bool_)])
            self._gone = np.concatenate([self._gone, np.zeros(more, np.bool_)])
        np.add.at(self._times, numbers, 1)
        self._last[numbers] = self._active[numbers] = self._now

    def restored(self, numbers: IntArray) -> None:
        """Parked landmarks came back; the time until they are parked again starts anew."""
        self._parked[numbers] = False
        self._active[numbers] = self._now

    def leaving(self) -> Leaving:
        """What leaves after this frame; afterwards it counts as gone."""
        s, now, nobody = self.setup, self._now, np.empty(0, np.int64)
        retracted = forgotten = parked = nobody
        if s.maintain:
            old = self._frame - self._first > MAINTENANCE_FRAMES
            retracted = np.flatnonzero(~self._gone & (self._times == 1) & old)
            self.remove(retracted)
            self.retracted.update(retracted.tolist())
        if s.forget_after is not None:
            forgotten = np.flatnonzero(~self._gone & (now - self._last > s.forget_after))
            self.remove(forgotten)
        if s.deactivate_after is not None:
            parked = np.flatnonzero(~self._gone & ~self._parked & (now - self._active > s.deactivate_after))
            self._parked[parked] = True
        return Leaving(retracted, forgotten, parked)

    def remove(self, numbers: IntArray) -> None:
        """Landmarks (r,) that leave the map after this frame, by these rules or for another reason."""
        self._gone[numbers] = True
        self.removed.update((n, self._frame) for n in numbers.tolist())

    def removal_frames(self, count: int) -> IntArray:
        """Frame (count,) after which each landmark was no longer in the map; -1: it stayed."""
        frames = np.full(count, -1, np.int64)
        for n, frame in self.removed.items():
            frames[n] = frame
        return frames


KEPT = 10
"""Frames. A landmark that was paired or taken back so recently stays. Flat: 5 and 20 take as long."""


class Parking:
    """Parks landmarks of an estimator and restores them.

    Attributes:
        largest: how many states the estimator had at most.
        restored: how many landmarks came back, counted each time.
    """

    def __init__(
        self,
        estimator: Estimator,
        can: Capabilities,
        management: MapManagement,
        sensor: Sensor,
        within: float = math.inf,
    ) -> None:
        """Nothing parked. No method looks at landmarks beyond the squared distance `within` of every reading.

        Raises CannotError for an estimator that cannot park.
        """
        self.estimator, self._state = estimator, can.stateful
        self.parkable = needed(can.parkable, "`park`, `restore`, `parked_xy` and `parked`", "--deactivate-after")
        self.management, self.sensor, self.within = management, sensor, within
        self._slam = estimator if isinstance(estimator, EkfSlam) else None
        self.largest, self.restored = 0, 0
        self._drift = Drift()

    def move(self, increment: Increment) -> None:
        """The robot moved."""
        self._drift.move(increment)

    @property
    def state_size(self) -> int:
        """Length of the state; what is parked does not count."""
        return 0 if self._state is None else self._state.size

    def offer(self, observations: FrameObservations) -> None:
        """Restore what may be in view, of walls what some reading might be of, before anything is expected."""
        parked = self.parkable.parked
        if len(parked) and not self.sensor.sees_points:  # where a wall is tells little of whether it is in view
            self._restore(parked if self._slam is None else self._slam.parked_within(observations, self.within))
        elif len(parked):
            pose, covariance = self.estimator.estimate()
            bounds = self._drift.sigmas(parked, covariance)
            self._restore(parked[may_be_in_view(self.sensor, pose, self.parkable.parked_xy(), *bounds)])

    def restore(self, numbers: IntArray) -> None:
        """Restore those of some landmarks (n,) that are parked; decisions that are no landmark are left alone."""
        if len(parked := self.parkable.parked):
            self._restore(np.intersect1d(numbers, parked))

    def _restore(self, numbers: IntArray) -> None:
        if len(numbers):
            self.parkable.restore(numbers)
            self.management.restored(numbers)
            self.restored += len(numbers)

    def see(self, observations: FrameObservations, numbers: IntArray) -> None:
        """Landmarks (m,) were seen."""
        self._drift.see(self.sensor, observations, numbers, self.estimator.estimate().covariance)

    def measure(self) -> None:
        """How large the state is now."""
        self.largest = max(self.largest, self.state_size)

    def park(self, numbers: IntArray) -> None:
        """Landmarks (n,) leave the state."""
        if len(numbers):
            self.parkable.park(numbers)

    def notes(self) -> list[Notice]:
        """What a reader of the results should know."""
        after = self.management.setup.deactivate_after
        return [notice(Code.PARKED, Severity.INFO, after=after, largest=self.largest, restored=self.restored)]


class AutomaticParking:
    """Parks what is of no use in the next frames, as long as that is faster; decisions and estimates do not change.

    When to park is weighed as in `ekf.epochs`, but without knowing what comes: whenever the steps since the last time
    have cost so much more than those of a state without the superfluous landmarks as parking these costs.
    """

    def __init__(self, slam: EkfSlam, within: float) -> None:
        """Nothing parked. No method looks at landmarks beyond the squared distance `within` of every reading."""
        self.slam, self.within = slam, within
        self._frame, self._pairings, self._excess = 0, 0, 0.0
        self._last = np.empty(0, np.int64)
        """By landmark: the last frame in which it was paired, initialized or taken back."""

    @property
    def state_size(self) -> int:
        """Length of the state, what is parked included: it is a part of the same state."""
        return self.slam.size + 2 * len(self.slam.parked)

    def move(self, increment: Increment) -> None:
        """The robot moved."""
        self._frame += 1

    def offer(self, observations: FrameObservations) -> None:
        """Restore what some reading might be of, before anything is expected."""
        if len(self.slam.parked):
            self._restore(self.slam.parked_within(observations, self.within))

    def restore(self, numbers: IntArray) -> None:
        """Restore those of some landmarks (n,) that are parked; decisions that are no landmark are left alone."""
        if len(parked := self.slam.parked):
            self._restore(np.intersect1d(numbers, parked))

    def _restore(self, numbers: IntArray) -> None:
        if len(numbers):
            self.slam.restore(numbers)
            self._last[numbers] = self._frame

    def see(self, observations: FrameObservations, numbers: IntArray) -> None:
        """Landmarks (m,) were seen."""
        self._pairings += len(numbers)
        more = self.slam.created - len(self._last)
        if more > 0:
            self._last = np.concatenate([self._last, np.full(more, self._frame)])
        self._last[numbers] = self._frame

    def measure(self) -> None:
        """What the steps of this frame have cost in excess."""
        slam, pairings, self._pairings = self.slam, self._pairings, 0
        if slam.created < LEAST:
            return
        used = slam.size + slam.carried
        active = slam.active
        idle = active[self._last[active] < self._frame - KEPT]
        needed = 2 * (slam.size - 2 * len(idle))
        self._excess += (STEP + READING * pairings) * max(used**2 - needed**2, 0)
        parked = 2 * len(slam.parked)
        cost = PRODUCT * parked**2 * slam.carried + MOVED * (parked + 2 * len(idle)) * len(idle)
        if len(idle) and self._excess > cost:
            slam.park(idle, begin_epoch=True)
            self._excess = 0.0

    def park(self, numbers: IntArray) -> None:
        """Nothing has to be parked but for the time it takes."""

    def notes(self) -> list[Notice]:
        """Nothing: a reader of the results need not know."""
        return []


def automatic_parking(estimator: Estimator, association: str, setup: Setup) -> AutomaticParking | None:
    """For an estimator whose large map may be parked without changing anything, None for others.

    These are others: smoothers and localizers; the invariant filter and the one with first estimates, which cannot
    park; the iterated one, which ends by how far all landmarks moved; methods of association without a gate, for
    which every landmark is a candidate.
    """
    if not isinstance(estimator, EkfSlam):
        return None
    options = estimator.options
    if options.invariant or options.first_estimates or options.iterations > 1:
        return None
    if is_foreign(association):  # nobody knows how far it looks
        return None
    within = horizon(association, setup.gate, setup.new_gate)
    if association in ("known", HINDSIGHT):  # decided without a look at this estimator, but somebody may ask for one
        within = horizon("jcbb", setup.gate, setup.new_gate)
    elif not np.isfinite(within):
        return None
    return AutomaticParking(estimator, within)

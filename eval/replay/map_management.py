"""Which landmarks leave the map, and when: map maintenance, forgetting and parking.

Landmarks unseen for a time are parked on request (`Parking`); a large map is parked automatically where that is faster
and changes nothing (`AutomaticParking`). They return into a filter's state when they may be seen again or are paired. A
bound on each one's uncertainty gives the time, so parked landmarks cost nothing meanwhile.
"""

from collections.abc import Callable
from typing import Any, NamedTuple, cast

import numpy as np

from association.candidates import UncertaintyBounds, may_be_in_view
from association.decide import horizon
from data.inputs import FrameObservations, Increment, IntArray
from data.notice import Code, Notice, notice
from data.se2 import Array
from data.sensors import Sensor
from ekf.slam import EkfSlam
from ekf.whole_run import LEAST, MOVED, PAIRING, PRODUCT, STEP
from eval.replay.estimators import Able, Estimator, needed
from eval.replay.external.adapter import ForeignError, call, load, text_of, whole
from eval.replay.external.spec import is_foreign
from eval.replay.settings import HINDSIGHT, Setup

MAINTENANCE_FRAMES = 2  # a landmark seen once is removed after more frames than this


class Leaving(NamedTuple):
    """Landmark numbers: `retracted` as if never seen, `forgotten` from now on, `parked` until seen again."""

    retracted: IntArray
    forgotten: IntArray
    parked: IntArray


SEEN = [("first", int), ("times", int), ("last", float), ("active", float), ("parked", bool), ("removed", bool)]
"""Of a landmark: frame of its first observation, number of observations, time of the last one, time since which it is
active (seen or restored last), and whether it was parked and removed."""


class Landmarks(NamedTuple):
    """What a rule of the user's gets of the map: landmark numbers (L,), the frames (L,) of their first observation, how
    often they were seen (L,), and the time (L,) of their last observation [s; frames in a log without stamps].
    """

    number: IntArray
    first: IntArray
    times: IntArray
    last: Array


class MapManagement:
    """When each landmark was seen, and the consequences: `begin` a frame, `see`, `leaving`."""

    def __init__(self, setup: Setup) -> None:
        self.setup = setup
        self.removed: dict[int, int] = {}  # frame after which a landmark was no longer in the map
        self.retracted: set[int] = set()  # landmarks that were removed as if never seen
        self._frame, self._now, self._of = 0, 0.0, np.empty(0, SEEN)
        self._rule = load(text_of(setup.maintain_by, "maintenance")) if setup.maintain_by else None

    def begin(self, frame: int, time: float) -> None:
        """Begin a frame at a time in the unit of the setup's spans."""
        self._frame, self._now = frame, time

    def see(self, numbers: IntArray) -> None:
        """Note landmarks paired or initialized in this frame; numbers are in order of creation."""
        more = int(numbers.max(initial=-1)) + 1 - len(self._of)
        if more > 0:
            new = np.array((self._frame, 0, self._now, self._now, False, False), SEEN)
            self._of = np.concatenate([self._of, np.repeat(new, more)])
        np.add.at(self._of["times"], numbers, 1)
        self._of["last"][numbers] = self._of["active"][numbers] = self._now

    def restored(self, numbers: IntArray) -> None:
        """Note restored landmarks; their time until parking starts again."""
        self._of["parked"][numbers] = False
        self._of["active"][numbers] = self._now

    def leaving(self) -> Leaving:
        """The landmarks that leave after this frame."""
        s, now, of = self.setup, self._now, self._of
        retracted = forgotten = parked = np.empty(0, np.int64)
        if s.maintain:
            old = self._frame - of["first"] > MAINTENANCE_FRAMES
            retracted = np.flatnonzero(~of["removed"] & (of["times"] == 1) & old)
        if self._rule is not None:
            retracted = np.union1d(retracted, self._ruled(self._rule.name, self._rule.thing))
        if s.retracts:
            self.remove(retracted)
            self.retracted.update(retracted.tolist())
        if s.forget_after is not None:
            forgotten = np.flatnonzero(~of["removed"] & (now - of["last"] > s.forget_after))
            self.remove(forgotten)
        if s.deactivate_after is not None:
            parked = np.flatnonzero(~of["removed"] & ~of["parked"] & (now - of["active"] > s.deactivate_after))
            of["parked"][parked] = True
        return Leaving(retracted, forgotten, parked)

    def _ruled(self, name: str, rule: Callable[..., Any]) -> IntArray:
        """Landmarks that leave by a rule of the user's. Raises ForeignError for one that is not in the map."""
        there = np.flatnonzero(~self._of["removed"])
        own = self._of[there]
        found = np.asarray(call(name, rule, self._frame, Landmarks(there, own["first"], own["times"], own["last"])))
        leave: IntArray = whole(name, found, found.size, "what it returned")
        if len(strange := np.setdiff1d(leave, there)):
            raise ForeignError(f"{name}: landmark {strange[0]} is not in the map")
        return leave

    def remove(self, numbers: IntArray) -> None:
        """Landmarks (r,) leave the map after this frame, by these rules or for another reason."""
        self._of["removed"][numbers] = True
        self.removed.update((n, self._frame) for n in numbers.tolist())

    def removal_frames(self, count: int) -> IntArray:
        """Frame (count,) after which each landmark was no longer in the map; -1: it stayed."""
        return np.array([self.removed.get(n, -1) for n in range(count)], np.int64)


class Parking:
    """Parks landmarks of an estimator and restores them."""

    def __init__(
        self, estimator: Estimator, can: dict[str, Able], management: MapManagement, sensor: Sensor, within: float
    ) -> None:
        """`within`: squared distance beyond which no method considers landmarks. CannotError: it cannot park."""
        self.estimator, self._state = estimator, can.get("size")
        self.parkable = needed(can.get("park"), "`park`, `restore`, `parked_xy` and `parked`", "--deactivate-after")
        self.management, self.sensor, self.within = management, sensor, within
        self._slam = estimator if isinstance(estimator, EkfSlam) else None
        self.largest, self.restored = 0, 0  # largest number of states so far, and number of restorations
        self._drift = UncertaintyBounds()

    def move(self, increment: Increment) -> None:
        """The robot moved."""
        self._drift.move(increment)

    @property
    def state_size(self) -> int:
        """Length of the state without parked landmarks."""
        return 0 if self._state is None else self._state.size

    def offer(self, observations: FrameObservations) -> None:
        """Restore landmarks that may be in view (walls: that an observation may be of), before the expectation."""
        parked = self.parkable.parked
        if len(parked) and not self.sensor.sees_points:  # the position of a wall hardly says whether it is in view
            self._restore(parked if self._slam is None else self._slam.parked_within(observations, self.within))
        elif len(parked):
            pose, covariance = self.estimator.estimate()
            bounds = self._drift.sigmas(parked, covariance)
            self._restore(parked[may_be_in_view(self.sensor, pose, self.parkable.parked_xy(), *bounds)])

    def restore(self, numbers: IntArray) -> None:
        """Restore the parked ones of landmarks (n,); other decisions are ignored."""
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
        """Update the largest state."""
        self.largest = max(self.largest, self.state_size)

    def park(self, numbers: IntArray) -> None:
        """Move landmarks (n,) out of the state."""
        if len(numbers):
            self.parkable.park(numbers)

    def notes(self) -> list[Notice]:
        """A message about parked landmarks."""
        after = self.management.setup.deactivate_after
        return [notice(Code.PARKED, after=after, largest=self.largest, restored=self.restored)]


KEPT = 10  # frames; a landmark paired or restored within these stays (5 and 20 take as long)


class AutomaticParking(Parking):
    """Parks landmarks that the next frames do not need, while that is faster; decisions and estimates do not change.

    Costs are those of `ekf.whole_run`. Landmarks are parked when the steps since the last time have cost more without
    it than parking does.
    """

    def __init__(self, slam: EkfSlam, within: float) -> None:
        """No method considers landmarks beyond the squared distance `within` of every observation."""
        self.parkable, self.slam = cast(Able, slam), slam
        self.within = within
        self._frame, self._pairings, self._excess = 0, 0, 0.0
        self._last = np.empty(0, np.int64)
        """By landmark: the last frame in which it was paired, initialized or taken back."""

    @property
    def state_size(self) -> int:
        """Length of the state, parked landmarks included: they belong to the same state."""
        return self.slam.size + 2 * len(self.slam.parked)

    def move(self, increment: Increment) -> None:
        """Count a frame."""
        self._frame += 1

    def offer(self, observations: FrameObservations) -> None:
        """Restore landmarks that an observation may be of, before the expectation."""
        if len(self.slam.parked):
            self._restore(self.slam.parked_within(observations, self.within))

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
        """Add the excess cost of this frame."""
        slam, pairings, self._pairings = self.slam, self._pairings, 0
        if slam.created < LEAST:
            return
        active = slam.active
        idle = active[self._last[active] < self._frame - KEPT]
        needed = 2 * (slam.size - 2 * len(idle))
        self._excess += (STEP + PAIRING * pairings) * max((slam.size + slam.carried) ** 2 - needed**2, 0)
        parked = 2 * len(slam.parked)
        cost = PRODUCT * parked**2 * slam.carried + MOVED * (parked + 2 * len(idle)) * len(idle)
        if len(idle) and self._excess > cost:
            slam.park(idle)
            self._excess = 0.0

    def park(self, numbers: IntArray) -> None:
        """Do nothing: only computing time demands parking."""

    def notes(self) -> list[Notice]:
        """No messages."""
        return []


def automatic_parking(
    estimator: Estimator, association: str, setup: Setup, looks: tuple[int, int] = (0, 0)
) -> AutomaticParking | None:
    """For an estimator whose large map may be parked without changing anything, else None; `looks`: as of `horizon`.

    Excluded are smoothers and localizers; the invariant filter and first estimates, which cannot park; the iterated
    filter, which stops by the motion of all landmarks; methods without a gate, which consider every landmark.
    """
    if not isinstance(estimator, EkfSlam):
        return None
    options = estimator.options
    if options.invariant or options.first_estimates or options.iterations > 1:
        return None
    if is_foreign(association):  # its reach is unknown
        return None
    # decided without this estimator, but an observer may ask for an expectation
    method = "jcbb" if association in ("known", HINDSIGHT) else association
    within, apart = horizon(method, setup.gate, setup.new_gate, looks=looks), method != association
    return AutomaticParking(estimator, within) if apart or np.isfinite(within) else None

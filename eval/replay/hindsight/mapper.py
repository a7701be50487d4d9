"""SLAM without labels, decisions in hindsight: a filter that decides, and the window over which it decides again.

The filter estimates the odometry's systematic errors along with the map (`ekf.calibrating`), because decisions need to
know how far it may have drifted; every estimator gets the decisions, none gets the filter's estimate. See
`eval.replay.hindsight.localizing_frontend` for how an estimator lives with what is decided.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from association.candidates import in_view
from association.decide import Decided
from association.evidence.gates import scaled, widest
from association.evidence.pairings import jcbb_hindsight, settled
from association.expectation import Expectation, gate_threshold
from data.inputs import Frame, IntArray, LandmarkMap
from data.result import DISCARD, Event
from data.se2 import Array, BoolArray
from data.sensors import RANGE_BEARING
from ekf.calibrating import CalibratingSlam
from eval.replay.given import Given
from eval.replay.hindsight.duplicates import LONELY, constellation, single
from eval.replay.hindsight.gates import LearnedGates
from eval.replay.hindsight.kidnapping import Whereabouts, unknown
from eval.replay.hindsight.ledger import Hindsight
from eval.replay.hindsight.placement import Placing
from eval.replay.settings import Setup

SPAN = 2.0
"""In ranges of the sensor: what was seen on a way as short as this is the window."""
AGE = 6.0
"""In ranges: what was first seen longer ago than this is old."""
CROWDED = 0.5
"""Landmarks that one expects inside a gate by chance: with more, a frame alone cannot tell which is which."""
TOGETHER = 4
"""Pairings of one frame that tell each other which is which."""
SEEN = 2
"""Sightings that a landmark needs to be recognized."""
KNOWN = 0.1
"""In ranges: with a smaller standard deviation the robot is not lost any more."""
EVERY = 5
"""Frames with sightings between two looks at the window, where nothing new is founded."""


class Mapped(NamedTuple):
    """Decisions (m,), whether the search for them was complete, and where (3,) the frame was placed, if it was.

    astray: where the robot turned out to have been moved unseen, what is to be added (3, 3) to its motion's covariance.
    """

    decisions: IntArray
    complete: bool
    at: Array | None
    astray: Array | None


class Revision(NamedTuple):
    """What a frame takes back: landmarks as if never seen (r,); those (j,) that are one with others, `kept` (j,)."""

    retracted: IntArray
    joined: IntArray
    kept: IntArray


class HindsightMapper:
    """What decides about the observations of a log without a map: `move`, `decide`, `revise`; at the end `close`.

    Landmark numbers are in the order of creation, as in every estimator that gets the decisions.

    Attributes:
        filter: what decides.
        hindsight: the evidence for its landmarks.
        gates: the noise that there is, by which it decides.
        whereabouts: whether the robot has been moved unseen.
        joined: (frame, away, kept) of every landmark that turned out to be another one.
    """

    def __init__(self, given: Given, setup: Setup) -> None:
        """Before the first frame."""
        self.sensor, self.setup = given.sensor, setup
        self.filter = CalibratingSlam(given.prior, given.sensor)
        self.hindsight = Hindsight(given.sensor)
        self.placing = Placing(given.sensor, setup, self.hindsight.rates)
        self.whereabouts = Whereabouts(given.sensor)
        self.joined: list[tuple[int, int, int]] = []
        self.gates = LearnedGates(given.sensor)
        self._parted, self._epoch = -math.inf, 0
        """Way and next landmark where the robot last could not tell which is which."""
        self._again: list[tuple[int, int]] = []
        """Landmarks founded while lost, and which they are."""
        self._founder: dict[int, int] = {}
        self._k, self._way, self._reach = -1, 0.0, 0.0
        self._first: dict[int, float] = {}
        self._last: dict[int, float] = {}
        self._times: dict[int, int] = {}
        self._beside: dict[int, set[int]] = {}
        """Landmarks that were seen in one frame with each: they cannot be the same."""
        self._waited, self._founded = 0, False

    def move(self, frame: Frame) -> None:
        """The next frame comes; the first one has no motion."""
        self._k, increment = frame.number, frame.increment
        if increment is not None:
            self.filter.predict(increment)
            self.placing.move(increment)
            self.whereabouts.move(increment)
            self._way += math.hypot(*increment.mean[:2])
            self.gates.move(increment)

    @property
    def _range(self) -> float:
        """The sensor's range, or the farthest that was seen."""
        return min(self.sensor.max_range, self._reach)

    def decide(self, frame: Frame) -> Mapped:
        """Decisions about observations of this frame, used by the filter, too."""
        seen, sensor = frame.sightings, self.sensor
        e = self.filter.expect(seen)
        e = e.only(np.flatnonzero(in_view(sensor, e.z_hat, e.HPHt)))
        placed = self.placing.find(e, self.filter.estimate().mean)
        if placed is None:
            decisions, complete = self._choose(e)
            self.gates.learn(e, decisions)
            self.hindsight.judge(e, decisions)
        else:
            decisions, complete = placed.decisions, True
            self.hindsight.judge(placed.expectation, decisions, placed.believed)
        at: Array | None = None if placed is None else placed.pose
        astray: Array | None = None
        if placed is None:
            at, astray, decisions = self._astray(e, decisions, frame)
        done = self.filter.update(seen, decisions, at=at)
        pose = self.filter.estimate().mean
        self.hindsight.see(frame.first, seen.z, done, pose)
        self.placing.see(pose, bool(done.used.any()))
        self._note(np.where(done.created >= 0, done.created, decisions), bool((done.created >= 0).any()))
        self._founder.update({frame.first + int(i): int(done.created[i]) for i in np.flatnonzero(done.created >= 0)})
        self._reach = max(self._reach, float(sensor.polar(seen.z)[:, 0].max(initial=0.0)))
        return Mapped(decisions, complete, at, astray)

    def _choose(self, e: Expectation) -> Decided:
        """Joint compatibility; a pairing among several likely ones counts only if the frame as a whole makes it."""
        gate, new_gate = self.setup.gate, self.setup.new_gate
        real = scaled(e, self.gates.scales)
        found = Decided(*jcbb_hindsight(real, gate, new_gate))
        if not len(e.number) or not len(e.z):
            return found
        crowded = self._crowded(e)
        if (found.decisions >= 0).sum() < TOGETHER and crowded.any():
            if self._way - self._parted > SPAN * self._range:
                self._parted, self._epoch = self._way, self.filter.created
            # of what was founded since, nothing is founded again
            few = np.flatnonzero(~crowded | (e.number >= self._epoch))
            again = Decided(*jcbb_hindsight(real.only(few), gate, new_gate))
            return Decided(self._put_off(e.only(few), again.decisions), again.complete)
        return Decided(self._put_off(e, found.decisions), found.complete)

    def _put_off(self, e: Expectation, decisions: IntArray) -> IntArray:
        """Decisions (m,) with `DISCARD` for what the stated noise allows to be a landmark, until several agree."""
        stated = settled(e, decisions, self.setup.new_gate)
        return self.gates.judge(e, decisions, stated, self.filter.estimate().mean, self._range)

    def _astray(self, e: Expectation, decisions: IntArray, frame: Frame) -> tuple[Array | None, Array | None, IntArray]:
        """Where the frame is after all, by its surroundings; what was unknown about its motion; its decisions."""
        w, astray = self.whereabouts, None
        sure = self.hindsight.certain()
        paired = int(np.isin(decisions, sure).sum())
        if w.watch(self._k, len(decisions), self.filter.created, paired, self.hindsight.surprise()):
            astray = unknown(self.filter.mean[3:].reshape(-1, 2), self._range)
            self.filter.lose(astray)
            self._parted, self._epoch = self._way, self.filter.created
        if w.lost and np.trace(self.filter.estimate().covariance[:2, :2]) < (KNOWN * self._range) ** 2:
            w.recover(self._k)  # a constellation told
        if not w.lost:
            return None, astray, decisions
        xy = self.filter.position(sure)[0].reshape(-1, 2)
        seen, rows = frame.sightings, np.arange(frame.first, frame.first + len(decisions))
        found = w.search(self._k, seen, rows, LandmarkMap(sure, xy))
        if found is None:
            e = self.filter.expect(seen)
            known = np.flatnonzero(~self._crowded(e) | (e.number >= self._epoch))
            return None, astray, jcbb_hindsight(e.only(known), self.setup.gate, self.setup.new_gate)[0]
        place, of = found
        self._again = [(self._founder[row], n) for row, n in of.items() if row in self._founder]
        return place.pose, astray, np.array([of.get(row, DISCARD) for row in rows.tolist()], np.int64)

    def _crowded(self, e: Expectation) -> BoolArray:
        """Candidates (n,) into whose gate so many landmarks fall by chance that a single observation tells nothing."""
        sensor = self.sensor
        area = np.sqrt(np.linalg.det(e.HPHt)) * (sensor.polar(e.z_hat)[:, 0] if sensor.kind == RANGE_BEARING else 1.0)
        crowded: BoolArray = self._crowd() * math.pi * gate_threshold(self.setup.gate or 0.99) * area > CROWDED
        return crowded

    def _crowd(self) -> float:
        """Landmarks per square metre around the robot."""
        mean = self.filter.mean
        near = np.hypot(*(mean[3:].reshape(-1, 2) - mean[:2]).T) < self._range
        return max(1, int(near.sum())) / (math.pi * self._range**2) if self._range > 0.0 else 0.0

    def _note(self, number: IntArray, founded: bool) -> None:
        here = [n for n in number.tolist() if n >= 0]
        for n in here:
            self._first.setdefault(n, self._way)
            self._last[n] = self._way
            self._times[n] = self._times.get(n, 0) + 1
            self._beside.setdefault(n, set()).update(set(here) - {n})
        self._founded |= founded
        self._waited += 1

    def revise(self) -> Revision:
        """The end of a frame: what is taken back, from the filter already."""
        gone = self.hindsight.contradicted(self._k)
        self._drop(gone)
        again, self._again = dict(self._again), []
        pairs = [(a, b) for a, b in again.items() if a in self._first and b in self._first and b < a]
        if not pairs and (self._founded or self._waited >= EVERY):
            self._founded, self._waited = False, 0
            pairs = self._recognize()
        away, kept = np.array(pairs, np.int64).reshape(-1, 2).T
        if len(away):
            self.filter.join(away, kept)
            self.hindsight.join(self._k, pairs)
            for a, b in pairs:
                self._join(a, b)
        return Revision(gone, away, kept)

    def _recognize(self) -> list[tuple[int, int]]:
        """Landmarks of the window that were founded before: (away, kept)."""
        span, age = SPAN * self._range, AGE * self._range
        known = [n for n in self._first if self._times[n] >= SEEN]
        window = [n for n in known if self._way - self._last[n] <= span]
        young = [n for n in window if self._way - self._first[n] <= age]
        aged = [n for n in known if self._way - self._first[n] > age]
        if not young:
            return []
        f, crowd, scale = self.filter, self._crowd(), widest(self.gates.scales)
        young.sort(key=lambda n: self._last[n])
        anew = [n for n in young if n >= self._epoch]
        pairs = [] if set(aged) & set(window) else constellation(f, self._beside, young, aged, crowd, scale)
        pairs = pairs or constellation(f, self._beside, anew, [n for n in known if n < self._epoch], crowd, scale)
        if pairs:
            self._parted = -math.inf
            return pairs
        return single(f, self._beside, window, aged, LONELY / crowd, scale) or single(
            f, self._beside, window, known, 0.2 * LONELY / crowd, scale
        )

    def _join(self, away: int, kept: int) -> None:
        self.joined.append((self._k, away, kept))
        self._first.pop(away)
        self._last[kept] = max(self._last[kept], self._last.pop(away))
        self._times[kept] += self._times.pop(away)
        for n in self._beside.pop(away):
            self._beside[n].discard(away)
            if n != kept:
                self._beside[n].add(kept)
                self._beside[kept].add(n)

    def _drop(self, numbers: IntArray) -> None:
        if len(numbers):
            self.filter.remove(numbers)
        for n in numbers.tolist():
            for q in self._beside.pop(n):
                self._beside[q].discard(n)
            del self._first[n], self._last[n], self._times[n]

    def leave(self, numbers: IntArray) -> None:
        """Landmarks (r,) left the estimator's map for another reason: they leave this one, too."""
        self.hindsight.leave(numbers)
        self._drop(numbers)

    def close(self) -> IntArray:
        """The end of the log: landmarks (r,) that did not become certain are taken back."""
        gone = self.hindsight.uncertain(self._k)
        self._drop(gone)
        return gone

    @property
    def events(self) -> list[Event]:
        """The revisions, in order."""
        return self.hindsight.events

    def notes(self) -> list[str]:
        """What a reader of the results should know."""
        told = [*self.hindsight.notes(), *self.placing.notes()]
        w = self.whereabouts
        if w.alarms:
            told.append(
                f"the robot was moved unseen {len(w.alarms)} times (first in frame {w.alarms[0]}), and"
                f" {len(w.found)} times its place in the map was found again"
            )
        if self.joined:
            first = self.joined[0][0]
            told.append(f"{len(self.joined)} landmarks turned out to be ones founded before (first in frame {first})")
        return told

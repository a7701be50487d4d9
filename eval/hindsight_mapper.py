"""SLAM without labels, decisions in hindsight: a filter that decides, and the window over which it decides again.

The filter estimates the odometry's systematic errors along with the map (`ekf.calibrating`), because decisions need to
know how far it may have drifted; every estimator gets the decisions, none gets the filter's estimate. See
`eval.hindsight_frontend` for how an estimator lives with what is decided.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from association.candidates import in_view
from association.constellation import Landmarks, recognize, squared_distances
from association.decide import Decided
from association.expectation import Expectation, gate_threshold
from association.hindsight import jcbb_hindsight, settled
from association.learned_gates import scaled, widest
from data.inputs import Increment, Inputs, IntArray, Sightings
from data.result import Event
from data.se2 import Array, BoolArray
from data.sensors import RANGE_BEARING
from ekf.calibrating import CalibratingSlam
from eval.hindsight import Hindsight
from eval.learned_gates import LearnedGates
from eval.placing import Placing
from eval.setup import Setup

SPAN = 2.0
"""In ranges of the sensor: what was seen on a way as short as this is the window."""
AGE = 6.0
"""In ranges: what was first seen longer ago than this is old."""
CROWDED = 0.5
"""Landmarks that one expects inside a gate by chance: with more, a frame alone cannot tell which is which."""
LONELY = 0.1
"""With fewer, a single pair of landmarks may be recognized."""
TOGETHER = 4
"""Pairings of one frame that tell each other which is which."""
SEEN = 2
"""Sightings that a landmark needs to be recognized."""
MOST = 16
"""Landmarks of a constellation, those seen last."""
EVERY = 5
"""Frames with sightings between two looks at the window, where nothing new is founded."""


class Mapped(NamedTuple):
    """Decisions (m,), whether the search for them was complete, and where (3,) the frame was placed, if it was."""

    decisions: IntArray
    complete: bool
    at: Array | None


class Revision(NamedTuple):
    """What a frame takes back: landmarks as if never seen (r,); those (j,) that are one with others, `kept` (j,)."""

    retracted: IntArray
    joined: IntArray
    kept: IntArray


class _Compared(NamedTuple):
    """New and old landmarks with what is between them; `beside` (m, n): they cannot be the same."""

    new: Landmarks
    old: Landmarks
    cross: Array
    d2: Array
    det: Array
    beside: BoolArray


class HindsightMapper:
    """What decides about the observations of a log without a map: `move`, `decide`, `revise`; at the end `close`.

    Landmark numbers are in the order of creation, as in every estimator that gets the decisions.

    Attributes:
        filter: what decides.
        hindsight: the evidence for its landmarks.
        gates: the noise that there is, by which it decides.
        joined: (frame, away, kept) of every landmark that turned out to be another one.
    """

    def __init__(self, inputs: Inputs, setup: Setup) -> None:
        """Before the first frame."""
        self.inputs, self.setup = inputs, setup
        self.filter = CalibratingSlam(inputs.prior, inputs.sensor)
        self.hindsight = Hindsight(inputs.sensor)
        self.placing = Placing(inputs.sensor, setup, self.hindsight.rates)
        self.joined: list[tuple[int, int, int]] = []
        self.gates = LearnedGates(inputs.sensor)
        self._parted, self._epoch = -math.inf, 0
        """Way and next landmark where the robot last could not tell which is which."""
        self._k, self._way, self._reach = -1, 0.0, 0.0
        self._first: dict[int, float] = {}
        self._last: dict[int, float] = {}
        self._times: dict[int, int] = {}
        self._beside: dict[int, set[int]] = {}
        """Landmarks that were seen in one frame with each: they cannot be the same."""
        self._waited, self._founded = 0, False

    def move(self, increment: Increment | None) -> None:
        """The next frame; the first one has no motion."""
        self._k += 1
        if increment is not None:
            self.filter.predict(increment)
            self.placing.move(increment)
            self._way += math.hypot(*increment.mean[:2])
            self.gates.move(increment)

    @property
    def _range(self) -> float:
        """The sensor's range, or the farthest that was seen."""
        return min(self.inputs.sensor.max_range, self._reach)

    def decide(self, rows: slice) -> Mapped:
        """Decisions about observations of this frame, used by the filter, too."""
        o, sensor = self.inputs.observations, self.inputs.sensor
        seen = Sightings(o.z[rows], o.R[rows])
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
        at = None if placed is None else placed.pose
        done = self.filter.update(seen, decisions, at=at)
        pose = self.filter.estimate().mean
        self.hindsight.see(rows.start, seen.z, done, pose)
        self.placing.see(pose, bool(done.used.any()))
        self._note(np.where(done.created >= 0, done.created, decisions), bool((done.created >= 0).any()))
        self._reach = max(self._reach, float(sensor.polar(seen.z)[:, 0].max(initial=0.0)))
        return Mapped(decisions, complete, at)

    def _choose(self, e: Expectation) -> Decided:
        """Joint compatibility; a pairing among several likely ones counts only if the frame as a whole makes it."""
        gate, new_gate, sensor = self.setup.gate, self.setup.new_gate, self.inputs.sensor
        real = scaled(e, self.gates.scales)
        found = Decided(*jcbb_hindsight(real, gate, new_gate))
        if not len(e.number) or not len(e.z):
            return found
        area = np.sqrt(np.linalg.det(e.HPHt)) * (sensor.polar(e.z_hat)[:, 0] if sensor.kind == RANGE_BEARING else 1.0)
        crowded = self._crowd() * math.pi * gate_threshold(gate or 0.99) * area > CROWDED
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
        pairs: list[tuple[int, int]] = []
        if self._founded or self._waited >= EVERY:
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
        anew = [n for n in young if n >= self._epoch]
        pairs = [] if set(aged) & set(window) else self._fit(young, [n for n in aged if n not in set(window)])
        pairs = pairs or self._fit(anew, [n for n in known if n < self._epoch])
        if pairs:
            self._parted = -math.inf
            return pairs
        pair = self._single(window, aged, LONELY) or self._single(window, known, 0.2 * LONELY)
        return [] if pair is None else [pair]

    def _fit(self, young: list[int], old: list[int]) -> list[tuple[int, int]]:
        """Young landmarks that are old ones by their constellation: (away, kept)."""
        if not young or not old:
            return []
        young = sorted(young, key=lambda n: self._last[n])[-MOST:]
        c = self._compare(young, old)
        turn = 3.0 * math.sqrt(self.filter.estimate().covariance[2, 2]) + 0.1
        allowed = (c.d2 < gate_threshold(0.999)) & ~c.beside
        found = recognize(c.new, c.old, c.cross, allowed, self._crowd(), turn, widest(self.gates.scales))
        return [(young[i], old[j]) for i, j in found]

    def _compare(self, young: list[int], old: list[int]) -> _Compared:
        mean, P = self.filter.position(np.array(young + old))
        m = 2 * len(young)
        new, there = Landmarks(mean[:m].reshape(-1, 2), P[:m, :m]), Landmarks(mean[m:].reshape(-1, 2), P[m:, m:])
        d2, det = squared_distances(new, there, P[:m, m:])
        beside = np.array([np.isin(old, [*self._beside[a], a]) for a in young])
        return _Compared(new, there, P[:m, m:], d2, det, beside)

    def _single(self, window: list[int], others: list[int], lonely: float) -> tuple[int, int] | None:
        """Two landmarks that stand where one does, and no other near: (away, kept)."""
        young, old = sorted(window), sorted(others)
        if not young or not old:
            return None
        between = self._compare(young, old)
        may = (between.d2 < gate_threshold(0.99)) & ~between.beside
        every = np.union1d(np.array(young)[may.any(axis=1)], np.array(old)[may.any(axis=0)])
        if not len(every):
            return None
        c = self._compare(every.tolist(), every.tolist())
        d2 = np.where(c.beside, np.inf, c.d2)
        near, scale = d2 < gate_threshold(0.99), widest(self.gates.scales)
        area = scale * math.pi * gate_threshold(0.99) * np.sqrt(np.maximum(c.det, 0.0))
        alone = near & (d2 < scale * gate_threshold(0.99)) & (self._crowd() * area < lonely)
        # a third one nearby leaves open which of both it is, unless all three may be one
        together = near | np.eye(len(every), dtype=np.bool_)
        apart = together.astype(np.int64) @ (~together).astype(np.int64)
        alone &= apart + apart.T == 0
        alone &= (every[:, None] > every[None]) & np.isin(every, young)[:, None] & np.isin(every, old)[None]
        found = every[np.argwhere(alone)].tolist()
        return tuple(found[0]) if found else None

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
        if self.joined:
            first = self.joined[0][0]
            told.append(f"{len(self.joined)} landmarks turned out to be ones founded before (first in frame {first})")
        return told

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
from association.constellation import Landmarks, density, recognize, squared_distances
from association.decide import Decided
from association.expectation import Expectation, gate_threshold
from association.hindsight import jcbb_hindsight
from data.inputs import Increment, Inputs, IntArray, Sightings
from data.result import Event
from ekf.calibrating import CalibratingSlam
from eval.hindsight import Hindsight
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
EVERY = 5
"""Frames with sightings between two looks at the window, where nothing new is founded."""


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
        joined: (frame, away, kept) of every landmark that turned out to be another one.
    """

    def __init__(self, inputs: Inputs, setup: Setup) -> None:
        """Before the first frame."""
        self.inputs, self.setup = inputs, setup
        self.filter = CalibratingSlam(inputs.prior, inputs.sensor)
        self.hindsight = Hindsight(inputs.sensor)
        self.joined: list[tuple[int, int, int]] = []
        self._k, self._way, self._reach = -1, 0.0, 0.0
        self._first: dict[int, float] = {}
        self._last: dict[int, float] = {}
        self._times: dict[int, int] = {}
        self._beside: dict[int, set[int]] = {}
        """Landmarks that were seen in one frame with each: they cannot be the same."""
        self._waited, self._founded = 0, False
        self._counted = 0, 0.0
        """Landmarks, and how many there are per square metre."""

    def move(self, increment: Increment | None) -> None:
        """The next frame; the first one has no motion."""
        self._k += 1
        if increment is not None:
            self.filter.predict(increment)
            self._way += math.hypot(*increment.mean[:2])

    @property
    def _range(self) -> float:
        """The sensor's range, or the farthest that was seen."""
        return min(self.inputs.sensor.max_range, self._reach)

    def decide(self, rows: slice) -> Decided:
        """Decisions (m,) about observations of this frame, used by the filter, too."""
        o, sensor = self.inputs.observations, self.inputs.sensor
        seen = Sightings(o.z[rows], o.R[rows])
        e = self.filter.expect(seen)
        e = e.only(np.flatnonzero(in_view(sensor, e.z_hat, e.HPHt)))
        decisions, complete = self._choose(e)
        self.hindsight.judge(e, decisions)
        done = self.filter.update(seen, decisions)
        self.hindsight.see(rows.start, seen.z, done, self.filter.estimate().mean)
        self._note(np.where(done.created >= 0, done.created, decisions), bool((done.created >= 0).any()))
        self._reach = max(self._reach, float(sensor.polar(seen.z)[:, 0].max(initial=0.0)))
        return Decided(decisions, complete)

    def _choose(self, e: Expectation) -> Decided:
        """Joint compatibility; a pairing among several likely ones counts only if the frame as a whole makes it."""
        gate, new_gate = self.setup.gate, self.setup.new_gate
        found = Decided(*jcbb_hindsight(e, gate, new_gate))
        if not len(e.number) or not len(e.z):
            return found
        crowded = self._crowd() * math.pi * gate_threshold(gate or 0.99) * np.sqrt(np.linalg.det(e.HPHt)) > CROWDED
        if not np.isin(found.decisions, e.number[crowded]).any() or (found.decisions >= 0).sum() >= TOGETHER:
            return found
        return Decided(*jcbb_hindsight(e.only(np.flatnonzero(~crowded)), gate, new_gate))

    def _crowd(self) -> float:
        """Landmarks per square metre, looked at again when there are a tenth more."""
        n = len(self._first)
        if not 0.9 * self._counted[0] <= n <= 1.1 * self._counted[0]:
            self._counted = n, density(self.filter.mean[3:].reshape(-1, 2))
        return self._counted[1]

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
        """Landmarks of the window that are old ones: (away, kept)."""
        span, age = SPAN * self._range, AGE * self._range
        known = [n for n in self._first if self._times[n] >= SEEN]
        window = {n for n in known if self._way - self._last[n] <= span}
        young = [n for n in known if n in window and self._way - self._first[n] <= age]
        old = [n for n in known if self._way - self._first[n] > age]
        anchored = any(n in window for n in old)
        if not anchored:
            old = [n for n in old if n not in window]
        if not young or not old:
            return []
        mean, P = self.filter.position(np.array(young + old))
        m = 2 * len(young)
        new = Landmarks(mean[:m].reshape(-1, 2), P[:m, :m])
        there, cross = Landmarks(mean[m:].reshape(-1, 2), P[m:, m:]), P[:m, m:]
        d2, det = squared_distances(new, there, cross)
        apart = np.array([np.isin(old, list(self._beside[a])) for a in young])
        crowd = self._crowd()
        if anchored:
            near = (d2 < gate_threshold(0.99)) & ~apart
            lonely = crowd * math.pi * gate_threshold(0.99) * np.sqrt(det) < LONELY
            alone = near & lonely & (near.sum(axis=0) == 1)[None] & (near.sum(axis=1) == 1)[:, None]
            found = [(int(i), int(j)) for i, j in np.argwhere(alone)[:1]]
        else:
            turn = 3.0 * math.sqrt(self.filter.estimate().covariance[2, 2]) + 0.1
            found = recognize(new, there, cross, (d2 < gate_threshold(0.999)) & ~apart, crowd, turn)
        return [(young[i], old[j]) for i, j in found]

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
        told = self.hindsight.notes()
        if self.joined:
            first = self.joined[0][0]
            told.append(f"{len(self.joined)} landmarks turned out to be ones founded before (first in frame {first})")
        return told

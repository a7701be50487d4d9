"""SLAM in hindsight: evidence for every landmark, and what is taken back when later frames contradict it.

The poor man's multi-hypothesis tracking: one hypothesis is kept, and what it decided is decided again where the
evidence turns against it. The work of a frame is bounded by the landmarks in view.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from association.evidence import constants
from association.evidence.landmarks import (
    FOUNDED,
    Evidence,
    Judgement,
    Visibility,
    certain,
    detection_rate,
    missing,
    overlooked,
    sighted,
    verdict,
)
from association.evidence.pairings import Alone, alone, pairs_of
from association.expectation import Expectation
from data.inputs import IntArray
from data.result import DISCARD, NEW, Event, Updated
from data.se2 import Array
from data.sensors import Sensor

JOINED = "the same landmark as one founded before"


class Judged(NamedTuple):
    """What a frame's expectation says about its pairings, to be taken before the update, which it does not survive.

    rows (k,) of the paired observations, the landmarks' numbers (k,), their innovations given each other; the landmarks
    (n,) that should have been seen and were not.
    """

    rows: IntArray
    number: IntArray
    alone: Alone
    missing: IntArray


class Hindsight:
    """Evidence for the landmarks of one run, and the decisions that were taken back.

    Attributes:
        events: the revisions, in order.
    """

    def __init__(self, sensor: Sensor) -> None:
        """Before the first frame."""
        self.sensor = sensor
        self.events: list[Event] = []
        self._evidence: dict[int, Evidence] = {}
        self._sightings: dict[int, list[tuple[int, int]]] = {}
        """Of each landmark in the map: the observations that are taken for it, and the decision about each."""
        self._place: dict[int, tuple[float, float]] = {}
        """Where each landmark in the map was looked for last."""
        self._reach = 0.0
        """m; the farthest that was seen."""
        self._touched: set[int] = set()
        nobody = np.empty(0, np.int64)
        self._judged = Judged(nobody, nobody, Alone(np.empty((0, 2)), np.empty((0, 2, 2))), nobody)
        self._visibility = Visibility()

    def judge(self, e: Expectation, decisions: IntArray, believed: Expectation | None = None) -> None:
        """Note what the expectation of a frame says about the decisions (m,) made from it; `see` takes it in.

        `believed`: what is expected once the pairings are believed, where the prediction alone tells too little.
        """
        rows, chosen = pairs_of(e, decisions)
        absent = missing(believed or e, decisions, self.sensor)
        self._judged = Judged(rows, e.number[chosen], alone(e, rows, chosen), (believed or e).number[absent])

    def see(self, first_row: int, z: Array, done: Updated, pose: Array) -> None:
        """Take in what was judged, and done with the observations z (m, 2), rows `first_row`... of the log.

        `pose` (3,) is where they were made, after the update.
        """
        judged = self._judged
        self._reach = max(self._reach, float(self.sensor.polar(z)[:, 0].max(initial=0.0)))
        for n in judged.missing.tolist():
            if self._look(n, pose, seen=False):
                self._evidence[n] = overlooked(self._evidence[n])
                self._touched.add(n)
        _, _, Gz = self.sensor.inverse(pose, z)
        for q, (i, n) in enumerate(zip(judged.rows.tolist(), judged.number.tolist(), strict=True)):
            told = None
            if len(judged.rows) > constants.JUDGED_BY:
                told = Judgement(judged.alone.innovation[q], judged.alone.information[q], Gz[i])
            self._evidence[n] = sighted(self._evidence[n], told, self._look(n, pose, seen=True))
            self._sightings[n].append((first_row + i, n))
            self._touched.add(n)
        for i in np.flatnonzero(done.created >= 0).tolist():
            n = int(done.created[i])
            self._evidence[n], self._sightings[n] = FOUNDED, [(first_row + i, NEW)]
            self._place[n] = float(pose[0]), float(pose[1])

    def _look(self, number: int, pose: Array, *, seen: bool) -> bool:
        """Whether a landmark in view is looked at from another place than last time.

        Together, certain ones tell how often a landmark in view is seen.
        """
        x, y = self._place[number]
        if math.hypot(pose[0] - x, pose[1] - y) < constants.SAME_PLACE * min(self.sensor.max_range, self._reach):
            return False
        self._place[number] = float(pose[0]), float(pose[1])
        e = self._evidence[number]
        if certain(e, self._visibility):
            self._visibility = self._visibility.counting(e.row > 0, seen)
        return True

    def contradicted(self, frame: int) -> IntArray:
        """Landmarks (r,) that the evidence of this frame speaks against; all decisions for them are taken back."""
        found = {n: verdict(self._evidence[n], self._visibility) for n in sorted(self._touched)}
        self._touched.clear()
        return self._retract(frame, {n: why for n, why in found.items() if why})

    def uncertain(self, frame: int) -> IntArray:
        """Landmarks (r,) that were never seen often enough to be certain; at the end of a run they are taken back."""
        few = [n for n, e in sorted(self._evidence.items()) if not certain(e, self._visibility)]
        return self._retract(frame, dict.fromkeys(few, "uncertain"))

    def join(self, frame: int, pairs: list[tuple[int, int]]) -> None:
        """Landmarks are one with others, (away, kept): what was decided for the first is decided for the second."""
        for away, kept in pairs:
            rows = self._sightings.pop(away)
            self.events += [Event(frame, row, old, kept, JOINED) for row, old in rows]
            self._sightings[kept] += [(row, kept) for row, _ in rows]
            gone, stays = self._evidence.pop(away), self._evidence[kept]
            self._place[kept] = self._place.pop(away)
            # where it stood was judged against another estimate: its shifts say nothing about this one
            self._evidence[kept] = stays._replace(
                seen=stays.seen + gone.seen, looks=stays.looks + gone.looks, missed=stays.missed + gone.missed, row=0
            )

    def surprise(self) -> float:
        """Log-likelihood ratio of being elsewhere against being here, of certain landmarks the judged frame missed."""
        v, total = self._visibility, 0.0
        if sum(v) < constants.ENOUGH_LOOKS:
            return 0.0
        for n in self._judged.missing.tolist():
            e = self._evidence[n]
            if certain(e, v):
                rate = min(v.rate, detection_rate(e.looks, e.missed - e.row))
                here = v.row(e.row + 1, rate) / v.row(e.row, rate)
                total += max(0.0, math.log((1.0 - constants.ELSEWHERE_SHARE * rate) / here))
        return total

    def certain(self) -> IntArray:
        """Numbers (n,) of the landmarks that are certain, ascending."""
        return np.array([n for n, e in sorted(self._evidence.items()) if certain(e, self._visibility)], np.int64)

    def rates(self, numbers: IntArray) -> Array:
        """With which rate (n,) landmarks of the map are seen where they are in view: the common one once certain."""
        v, every = self._visibility, [self._evidence[n] for n in numbers.tolist()]
        return np.array([v.rate if certain(e, v) else detection_rate(e.looks, e.missed) for e in every])

    def leave(self, numbers: IntArray) -> None:
        """Landmarks left the map for another reason: nothing more is decided about them."""
        for n in numbers.tolist():
            del self._evidence[n], self._sightings[n], self._place[n]

    def _retract(self, frame: int, gone: dict[int, str]) -> IntArray:
        for n, why in gone.items():
            self.events += [Event(frame, row, old, DISCARD, why) for row, old in self._sightings.pop(n)]
            del self._evidence[n], self._place[n]
        return np.array(list(gone), np.int64)

    def notes(self) -> list[str]:
        """What a reader of the results should know."""
        if not self.events:
            return []
        undone = sum(e.old >= 0 for e in self.events)
        return [f"{undone} pairings were undone in hindsight, {sum(e.new >= 0 for e in self.events)} made instead"]

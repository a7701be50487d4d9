"""The ledger of SLAM in hindsight: a record for each landmark, and what is taken back when later frames contradict it.

The poor man's multi-hypothesis tracking: one hypothesis is kept, and what it decided is decided again where the
evidence turns against it. The work of a frame is bounded by the landmarks in view. Here, and nowhere else, landmarks
are initialized, seen, merged and dropped.
"""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np

from association.candidates import holding
from association.conditional import Alone, alone
from association.expectation import Expectation
from data.inputs import Frame, IntArray
from data.notice import Code, Notice, Severity, notice
from data.result import DISCARD, NEW, Event, Updated
from data.se2 import Array
from data.sensors import Sensor
from eval.replay.hindsight import constants
from eval.replay.hindsight.final_association import Reassociation, beginnings
from eval.replay.hindsight.record import (
    Epoch,
    Judged,
    Judgement,
    Record,
    Visibility,
    certain,
    detection_rate,
    lasting,
    missing,
    overlooked,
    sighted,
    verdict,
)

MERGED = "the same landmark as one initialized before"
REASSOCIATED = "paired anew on the smoothed path"
UNREAD = "none of its readings is left"


class Ledger:
    """The landmarks of one run, and the decisions about them that were taken back.

    Attributes:
        records: of the landmarks in the map, by their numbers, in the order in which they were initialized.
        created: how many were initialized so far; the number of the next one.
        frame: the newest one.
        frames: how many had observations.
        travelled: m, until the newest frame.
        epoch: see there.
        events: the revisions, in order.
        merged: (frame, away, kept) of every landmark that turned out to be another one.
    """

    def __init__(self, sensor: Sensor) -> None:
        """Before the first frame."""
        self.sensor = sensor
        self.records: dict[int, Record] = {}
        self.created, self.frame, self.frames, self.travelled = 0, -1, 0, 0.0
        self.epoch = Epoch()
        self.events: list[Event] = []
        self.merged: list[tuple[int, int, int]] = []
        self._read = replace(sensor, max_range=0.0, min_angle=0.0, max_angle=0.0)
        """The sensor with the part of its view in which something was read."""
        self._touched: set[int] = set()
        nobody = np.empty(0, np.int64)
        self._judged = Judged(nobody, nobody, Alone(np.empty((0, 2)), np.empty((0, 2, 2))), nobody, nobody)
        self._visibility = Visibility()
        self._former: list[bytes] = []
        """Looks at the landmarks that were retracted."""

    def move(self, frame: Frame) -> None:
        """The next frame comes."""
        self.frame = frame.number
        if frame.increment is not None:
            self.travelled += math.hypot(*frame.increment.mean[:2])

    @property
    def range(self) -> float:
        """The sensor's range [m], or the farthest that was seen."""
        return min(self.sensor.max_range, self._read.max_range)

    def judge(self, e: Expectation, decisions: IntArray, believed: Expectation | None = None) -> None:
        """Note what the expectation of a frame says about the decisions (m,) made from it; `see` takes it in.

        `believed`: what is expected once the pairings are believed, where the prediction alone tells too little.
        """
        rows, chosen = e.paired(decisions)
        expected = believed or e
        absent, in_read = (expected.number[missing(expected, decisions, s)] for s in (self.sensor, self._read))
        self._judged = Judged(rows, e.number[chosen], alone(e, rows, chosen), absent, in_read)

    def see(self, frame: Frame, decisions: IntArray, done: Updated, pose: Array) -> None:
        """Take in what was judged, and done with the decisions (m,); `pose` (3,) is where the frame was seen from."""
        judged, z = self._judged, frame.observations.z
        self.frames += 1
        self._read = holding(self._read, self.sensor.polar(z))
        for n in judged.missing.tolist():
            if self._look(n, pose, seen=False):
                self.records[n].evidence = overlooked(self.records[n].evidence)
                self._touched.add(n)
        _, _, Gz = self.sensor.inverse(pose, z)
        for q, (i, n) in enumerate(zip(judged.rows.tolist(), judged.number.tolist(), strict=True)):
            judgement = None
            # a reading at zero range has no direction: it says nothing about where the landmark went
            if len(judged.rows) > constants.JUDGED_BY and np.linalg.det(Gz[i]) != 0.0:
                judgement = Judgement(judged.alone.innovation[q], judged.alone.information[q], Gz[i])
            record, elsewhere = self.records[n], self._look(n, pose, seen=True)
            record.evidence = sighted(record.evidence, judgement, elsewhere)
            record.observations.append((frame.first + i, n))
            self._touched.add(n)
        for i in np.flatnonzero(done.created >= 0).tolist():
            self._initialize(int(done.created[i]), frame.first + i, pose)
        together = [n for n in np.where(done.created >= 0, done.created, decisions).tolist() if n >= 0]
        for n in together:
            record = self.records[n]
            record.last, record.times = self.travelled, record.times + 1
            record.covisible.update(set(together) - {n})

    def _initialize(self, number: int, row: int, pose: Array) -> None:
        place = float(pose[0]), float(pose[1])
        self.records[number] = Record([(row, NEW)], place, self.travelled, self.travelled)
        self.created = number + 1

    def _look(self, number: int, pose: Array, *, seen: bool) -> bool:
        """Whether a landmark in view is looked at from another place than last time.

        Together, certain ones tell how often a landmark in view is seen.
        """
        record = self.records[number]
        x, y = record.looked_from
        if math.hypot(pose[0] - x, pose[1] - y) < constants.SAME_PLACE * self.range:
            if seen and not record.opportunities:
                record.opportunities.append(True)
            return False
        record.looked_from = float(pose[0]), float(pose[1])
        if seen or number in self._judged.in_read:
            record.opportunities.append(seen)
        if certain(record.evidence, self._visibility):
            self._visibility = self._visibility.counting(record.evidence.row > 0, seen)
        return True

    def gated_elsewhere(self, number: int, inside: bool) -> bool:
        """Whether a landmark's gate was not judged so from here before: from one place it is one case."""
        gated = self.records[number].gated
        if self.travelled - gated.get(inside, -math.inf) < constants.SAME_PLACE * self.range:
            return False
        gated[inside] = self.travelled
        return True

    def begin_epoch(self) -> None:
        """From here on the robot cannot tell which landmark is which."""
        self.epoch = Epoch(self.travelled, self.created)

    def end_epoch(self) -> None:
        """It can tell again; the next doubt begins a new epoch."""
        self.epoch = self.epoch._replace(begun=-math.inf)

    def contradicted(self) -> IntArray:
        """Landmarks (r,) that the evidence of this frame speaks against; all decisions for them are taken back."""
        found = {n: verdict(self.records[n].evidence, self._visibility) for n in sorted(self._touched)}
        self._touched.clear()
        return self._retract({n: why for n, why in found.items() if why})

    def reassociate(self, found: Reassociation) -> IntArray:
        """Take all readings (M,) of the log for landmarks of the map; those of which none is left (r,) are taken back.

        The reading that names a landmark is its first one, and what was taken for it before is discarded.
        """
        first = beginnings(found)
        gone = self._retract({n: UNREAD for n in self.records if n not in first})
        former = {row: (n, decision) for n, r in self.records.items() for row, decision in r.observations}
        for record in self.records.values():
            record.observations.clear()
        for row, n in enumerate(found.number.tolist()):
            before, new = former.get(row, (-1, DISCARD)), DISCARD
            if n >= 0 and row >= first[n]:
                new = NEW if row == first[n] else n
                self.records[n].observations.append((row, new))
            if before == (n, new) or before[1] == new == DISCARD:
                continue
            steps = [before[1], *([n] if new == NEW and before[1] != n else []), new]
            self.events += [Event(self.frame, row, old, then, REASSOCIATED) for old, then in pairwise(steps)]
        return gone

    def uncertain(self) -> IntArray:
        """Landmarks (r,) that may have been there for a while only; at the end of a run they are taken back."""
        every = self.records.values()
        observations = np.array([r.evidence.seen for r in every], np.int64)
        keep = lasting([r.opportunities for r in every], self._former, observations)
        return self._retract(dict.fromkeys(np.array(list(self.records))[~keep].tolist(), "uncertain"))

    def _retract(self, gone: dict[int, str]) -> IntArray:
        for n, why in gone.items():
            self.events += [Event(self.frame, row, old, DISCARD, why) for row, old in self.records[n].observations]
        self._former += [bytes(self.records[n].opportunities) for n in gone]
        self.drop(numbers := np.array(list(gone), np.int64))
        return numbers

    def drop(self, numbers: IntArray) -> None:
        """Landmarks leave the map: nothing more is decided about them."""
        for n in numbers.tolist():
            for other in self.records.pop(n).covisible:
                self.records[other].covisible.discard(n)

    def merge(self, pairs: list[tuple[int, int]]) -> None:
        """Landmarks are one with others, (away, kept): what was decided for the first is decided for the second."""
        for away, kept in pairs:
            gone, stays = self.records.pop(away), self.records[kept]
            self.events += [Event(self.frame, row, old, kept, MERGED) for row, old in gone.observations]
            self.merged.append((self.frame, away, kept))
            stays.observations += [(row, kept) for row, _ in gone.observations]
            stays.looked_from = gone.looked_from
            stays.last, stays.times = max(stays.last, gone.last), stays.times + gone.times
            e, more = stays.evidence, gone.evidence
            # where it stood was judged against another estimate: its shifts say nothing about this one
            stays.evidence = e._replace(
                seen=e.seen + more.seen,
                opportunities=e.opportunities + more.opportunities,
                missed=e.missed + more.missed,
                row=0,
            )
            # what was missed where the other one was seen was seen
            stays.opportunities = bytearray(bytes(stays.opportunities).rstrip(b"\0") + b"\1" + gone.opportunities)
            for n in gone.covisible:
                self.records[n].covisible.discard(away)
                if n != kept:
                    self.records[n].covisible.add(kept)
                    stays.covisible.add(n)

    def surprise(self) -> float:
        """Log-likelihood ratio of being elsewhere against being here, of certain landmarks the judged frame missed."""
        v, total = self._visibility, 0.0
        if sum(v) < constants.ENOUGH_OPPORTUNITIES:
            return 0.0
        for n in self._judged.missing.tolist():
            e = self.records[n].evidence
            if certain(e, v):
                rate = min(v.rate, detection_rate(e.opportunities, e.missed - e.row))
                here = v.row(e.row + 1, rate) / v.row(e.row, rate)
                total += max(0.0, math.log((1.0 - constants.ELSEWHERE_SHARE * rate) / here))
        return total

    def replaced(self, decisions: IntArray) -> tuple[int, int]:
        """Certain landmarks that the judged frame paired, by decisions (m,); certain ones missed, something newer read.

        Newer is what was initialized, in this frame or before, after the missed one had been seen last.
        """
        v, numbers = self._visibility, set(decisions.tolist())
        paired = [self.records[n] for n in numbers if n in self.records]
        newest = self.travelled if NEW in numbers else max((r.first for r in paired), default=-math.inf)
        missed = [self.records[n] for n in self._judged.missing.tolist() if n not in numbers]
        return (
            sum(certain(r.evidence, v) for r in paired),
            sum(r.last < newest and certain(r.evidence, v) for r in missed),
        )

    def certain(self) -> IntArray:
        """Numbers (n,) of the landmarks that are certain, ascending."""
        return np.array([n for n, r in self.records.items() if certain(r.evidence, self._visibility)], np.int64)

    def rates(self, numbers: IntArray) -> Array:
        """With which rate (n,) landmarks of the map are seen where they are in view: the common one once certain."""
        v, every = self._visibility, [self.records[n].evidence for n in numbers.tolist()]
        return np.array([v.rate if certain(e, v) else detection_rate(e.opportunities, e.missed) for e in every])

    def notes(self) -> list[Notice]:
        """What a reader of the results should know."""
        events = [e for e in self.events if e.why != REASSOCIATED]
        anew = len({e.observation for e in self.events if e.why == REASSOCIATED})
        undone, again = sum(e.old >= 0 for e in events), sum(e.new >= 0 for e in events)
        revised = [notice(Code.REVISED, Severity.INFO, undone=undone, again=again)] if events else []
        return revised + ([notice(Code.REASSOCIATED_AT_END, Severity.INFO, decisions=anew)] if anew else [])

    def merge_notes(self) -> list[Notice]:
        """The same of landmarks that were merged."""
        if not self.merged:
            return []
        return [notice(Code.MERGED, Severity.INFO, landmarks=len(self.merged), first=self.merged[0][0])]

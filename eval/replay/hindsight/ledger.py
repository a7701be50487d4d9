"""Step 5, the ledger of SLAM in hindsight: a record for each landmark, and revisions when later frames contradict it.

One hypothesis is kept, and its decisions are revised where the evidence turns against them. Work per frame is bounded
by the landmarks in view. Only the ledger initializes, merges and drops landmarks.

Evidence for a landmark: detections, missed detections, and whether it stood still. An observation gives the landmark's
innovation given its frame's other pairings (`association.conditional`). For a static landmark these are independent,
with chi-square squares and weighted mean zero in the world. A moving landmark drags its estimate along, so its
innovations point in the direction of motion.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from association.appearance import Looks
from association.candidates import holding, narrower
from association.conditional import ConditionalInnovations, conditional_innovations
from association.expectation import Expectation, gate_threshold
from data.inputs import Frame, IntArray
from data.notice import Code, Notice, notice
from data.result import DISCARD, NEW, Event, Updated
from data.se2 import Array
from data.sensors import Sensor
from eval.replay.hindsight import constants
from eval.replay.hindsight.final_association import Reassociation, beginnings
from eval.replay.hindsight.opportunities import DETECTED, FAMILIAR, MISSED, Detections, beside, cell, missing, remaining

Symmetric = tuple[float, float, float]  # entries xx, xy and yy of a matrix


class Evidence(NamedTuple):
    """Evidence for and against one landmark."""

    seen: int  # observations, `opportunities` of them from different places
    opportunities: int
    missed: int  # missed detections from different places, `row` of them since the last observation
    row: int
    judged: int  # observations judged by others of their frame
    squares: float  # sum of their squared innovations
    pull: tuple[float, float]  # weighted sum of their innovations in the world
    information: Symmetric  # sum of their information


INITIALIZED = Evidence(1, 1, 0, 0, 0, 0.0, (0.0, 0.0), (0.0, 0.0, 0.0))  # of a landmark that was initialized just now


class Judgement(NamedTuple):
    """Innovation (2,) of an observation given others of its frame, its information (2, 2); G (2, 2): to the world."""

    innovation: Sequence[float]
    information: Sequence[Sequence[float]]
    G: Sequence[Sequence[float]]


def add_observation(e: Evidence, judged: Judgement | None, elsewhere: bool) -> Evidence:
    """Add an observation and what the others of its frame say of it; `elsewhere`: from another place than the last."""
    seen, opportunities = e.seen + 1, e.opportunities + elsewhere
    ((g, h), (i, j)) = ((0.0, 0.0), (0.0, 0.0)) if judged is None else judged.G
    det = g * j - h * i
    if judged is None or det == 0.0:  # at zero range nothing has a direction
        return Evidence(seen, opportunities, e.missed, 0, *e[4:])
    (x, y), ((a, b), (_, c)) = judged.innovation, judged.information
    g, h, i, j = j / det, -h / det, -i / det, g / det  # to the innovation
    u, v = a * x + b * y, b * x + c * y
    p, q, r, s = a * g + b * i, a * h + b * j, b * g + c * i, b * h + c * j
    (px, py), (xx, xy, yy) = e.pull, e.information
    pull = px + g * u + i * v, py + h * u + j * v
    information = xx + g * p + i * r, xy + g * q + i * s, yy + h * q + j * s
    return Evidence(seen, opportunities, e.missed, 0, e.judged + 1, e.squares + x * u + y * v, pull, information)


def add_miss(e: Evidence) -> Evidence:
    """Add a missed detection."""
    return e._replace(missed=e.missed + 1, row=e.row + 1)


class Visibility(NamedTuple):
    """Counts over confirmed landmarks in view: detected, missed, after either. Misses come in rows."""

    seen_seen: int = 0
    seen_missed: int = 0
    missed_seen: int = 0
    missed_missed: int = 0

    def counting(self, before_missed: bool, seen: bool) -> "Visibility":
        """Add one detection opportunity."""
        counts = list(self)
        counts[2 * before_missed + (not seen)] += 1
        return Visibility(*counts)

    def without(self, row: int) -> "Visibility":
        """Leave out an unfinished row of misses: a landmark must not testify for itself."""
        if not row:
            return self
        missed = max(0, self.missed_missed - (row - 1))
        return self._replace(seen_missed=max(0, self.seen_missed - 1), missed_missed=missed)

    @property
    def rate(self) -> float:
        """Detection probability of a landmark in view."""
        return detection_rate(self.seen_seen + self.missed_seen, self.seen_missed + self.missed_missed)

    def row(self, length: int, rate: float) -> float:
        """Probability (Markov chain) that an existing landmark of this detection probability is missed `length` times
        in a row. Before enough rows are known, misses count as independent.
        """
        if not length:
            return 1.0
        prior, missed = constants.INDEPENDENT_MISSES, self.missed_missed
        again = (missed + prior * (1.0 - rate)) / (missed + self.missed_seen + prior)
        return (1.0 - rate) * max(again, 1.0 - rate) ** (length - 1)


def detection_rate(seen: int, missed: int) -> float:
    """Mean of the beta distribution of a rate, from a uniform prior."""
    return (seen + 1) / (seen + missed + 2)


def confirmed(e: Evidence, v: Visibility) -> bool:
    """Whether a landmark has as many observations as `CONFIRMED` detection opportunities would give; at least two."""
    return e.seen >= max(constants.CONFIRMED_AT_LEAST, constants.CONFIRMED * v.rate)


def verdict(e: Evidence, v: Visibility) -> str:
    """Why a landmark is to be retracted, `moved` or `missed`; or empty. A confirmed landmark has its own detection
    probability, if that is lower, and needs more evidence against it.
    """
    if e.judged:
        (x, y), (xx, xy, yy) = e.pull, e.information
        drift = (yy * x * x - 2.0 * xy * x * y + xx * y * y) / (xx * yy - xy * xy)
        if drift > gate_threshold(constants.MOVED) or e.squares > gate_threshold(constants.RESTLESS, 2 * e.judged):
            return "moved"
    if not e.row:
        return ""
    if confirmed(e, v):
        v = v.without(e.row)
        own = min(v.rate, detection_rate(e.opportunities, e.missed - e.row))
        return "missed" if v.row(e.row, own) < constants.UNLIKELY**constants.UNLIKELY_POWER else ""
    return "missed" if v.row(e.row, v.rate) < constants.UNLIKELY else ""


@dataclass
class Record:
    """One landmark of the map, except its position."""

    observations: list[tuple[int, int]]  # (observation, decision) of all assigned to it; the first one initialized it
    place: tuple[float, float]  # (x, y) [m] of the robot at its last detection opportunity
    first: float  # distances travelled [m] at its first and its last observation
    last: float
    times: int = 0  # observations, by the decisions that were used
    evidence: Evidence = INITIALIZED
    covisible: set[int] = field(default_factory=set)  # landmarks seen in one frame with it: they cannot be the same
    # distance travelled [m] at the last judgement of its gate, by result
    gated: dict[bool, float] = field(default_factory=dict)
    opportunities: bytearray = field(default_factory=bytearray)  # after the first observation; see `opportunities.py`
    familiar: set[int] = field(default_factory=set)  # viewpoint cells in or beside which it was detected
    viewpoint: int | None = None  # the last one of these cells


class Judged(NamedTuple):
    """Judgement of a frame's pairings by its expectation, before the update changes the state.

    rows (k,) of the paired observations, the landmarks' numbers (k,), their innovations given each other; missed
    landmarks (n) and the cells of the viewpoints from which they were missed, None: another one may occlude it.
    """

    rows: IntArray
    number: IntArray
    alone: ConditionalInnovations
    missing: list[int]
    viewpoint: list[int | None]


class Epoch(NamedTuple):
    """Since when landmarks are ambiguous to the robot: distance travelled [m], number of the next landmark."""

    begun: float = -math.inf
    first: int = 0


MERGED = "the same landmark as one initialized before"
REASSOCIATED = "paired anew on the smoothed path"
UNREAD = "none of its readings is left"
COUNTS = ("seen", "opportunities", "missed")


class Ended(NamedTuple):
    """Landmarks (r,) retracted as transient; (l,) that left the map before; last observations of folded ones."""

    transient: IntArray
    left: IntArray
    folded: list[int]


class Ledger:
    """The landmarks of one run, and the decisions about them that were revised."""

    def __init__(self, sensor: Sensor) -> None:
        self.sensor = sensor
        self.records: dict[int, Record] = {}  # of the landmarks in the map, by number, in order of initialization
        # number of the next landmark, newest frame, number of frames with observations, distance travelled [m]
        self.created, self.frame, self.frames, self.travelled = 0, -1, 0, 0.0
        self.epoch = Epoch()
        self.looks = Looks()  # what the landmarks look like
        self.events: list[Event] = []  # the revisions, in order
        self.merged: list[tuple[int, int, int]] = []  # (frame, away, kept) of every merged landmark
        self._read = replace(sensor, max_range=0.0, min_angle=0.0, max_angle=0.0)  # the view that held observations
        self._touched: set[int] = set()
        nothing = np.empty(0, np.int64)
        self._judged = Judged(nothing, nothing, ConditionalInnovations(np.empty((0, 2)), np.empty((0, 2, 2))), [], [])
        self._visibility = Visibility()

    def move(self, frame: Frame) -> None:
        """The next frame comes."""
        self.frame = frame.number
        if frame.increment is not None:
            self.travelled += math.hypot(*frame.increment.mean[:2])

    @property
    def view(self) -> Sensor:
        """The stated field of view, where observations were made."""
        return narrower(self.sensor, self._read)

    @property
    def range(self) -> float:
        """The sensor's range [m], or the largest observed one."""
        return min(self.sensor.max_range, self._read.max_range)

    def judge(self, e: Expectation, decisions: IntArray, pose: Array, believed: Expectation | None = None) -> None:
        """Judge the decisions (m,) of a frame by its expectation from a pose (3,), for `see`. `believed`: expectation
        given these pairings, where the prediction alone is too uncertain.
        """
        rows, chosen = e.paired(decisions)
        expected = believed or e
        absent, seen = missing(expected, decisions, self.sensor)
        polar, hidden, heading = seen.polar[absent].tolist(), seen.behind[absent].tolist(), float(pose[2])
        at = [None if hid else cell(r, heading + b) for (r, b), hid in zip(polar, hidden, strict=True)]
        alone = conditional_innovations(e, rows, chosen)
        self._judged = Judged(rows, e.number[chosen], alone, expected.number[absent].tolist(), at)

    def see(self, frame: Frame, decisions: IntArray, done: Updated, pose: Array) -> None:
        """Take in the judgement of a frame and its decisions (m,); `pose` (3,) is where it was taken."""
        judged, z = self._judged, frame.observations.z
        self.frames += 1
        polar = self.sensor.polar(z)
        self._read = holding(self._read, polar)
        x, y, heading = pose.tolist()
        place, cells = (x, y), [cell(r, heading + b) for r, b in polar.tolist()]
        for n, at in zip(judged.missing, judged.viewpoint, strict=True):
            if at is not None and self._opportunity(n, place, at, detected=False):
                self.records[n].evidence = add_miss(self.records[n].evidence)
                self._touched.add(n)
        G = self.sensor.inverse(pose, z[judged.rows])[2]
        enough = len(judged.rows) > constants.JUDGED_BY
        columns = (each.tolist() for each in (judged.rows, judged.number, *judged.alone, G))
        for i, n, *said in zip(*columns, strict=True):
            record, elsewhere = self.records[n], self._opportunity(n, place, cells[i], detected=True)
            record.evidence = add_observation(record.evidence, Judgement(*said) if enough else None, elsewhere)
            record.observations.append((frame.first + i, n))
            self._touched.add(n)
        for i in np.flatnonzero(done.created >= 0).tolist():
            self.created = int(done.created[i]) + 1
            record = Record([(frame.first + i, NEW)], place, self.travelled, self.travelled)
            record.familiar.update(beside(cells[i]))
            self.records[self.created - 1] = record
        number = np.where(done.created >= 0, done.created, decisions)
        if frame.appearance is not None:
            self.looks.see(number, frame.appearance)
        together = [n for n in number.tolist() if n >= 0]
        for n in together:
            record = self.records[n]
            record.last, record.times = self.travelled, record.times + 1
            record.covisible.update(together)
            record.covisible.remove(n)

    def _opportunity(self, number: int, place: tuple[float, float], at: int, *, detected: bool) -> bool:
        """Whether this opportunity, at cell `at`, is from another `place` than the last and tells something."""
        record = self.records[number]
        familiar, (x, y) = at in record.familiar, record.place
        elsewhere = math.hypot(place[0] - x, place[1] - y) >= constants.SAME_PLACE * self.range
        if elsewhere or (detected and not record.opportunities):
            record.opportunities.append((DETECTED if detected else MISSED) + (FAMILIAR if familiar else 0))
        if detected and at != record.viewpoint:
            record.viewpoint = at
            record.familiar.update(beside(at))
        if not elsewhere:
            return False
        record.place = place
        if not (familiar or detected):
            return False
        if confirmed(record.evidence, self._visibility):
            self._visibility = self._visibility.counting(record.evidence.row > 0, detected)
        return True

    def gated_elsewhere(self, number: int, inside: bool) -> bool:
        """Whether a landmark's gate was not judged this way near here: from one place it is one case."""
        gated = self.records[number].gated
        if self.travelled - gated.get(inside, -math.inf) < constants.SAME_PLACE * self.range:
            return False
        gated[inside] = self.travelled
        return True

    def contradicted(self) -> IntArray:
        """Retract landmarks (r,) that the evidence of this frame contradicts."""
        found = {n: verdict(self.records[n].evidence, self._visibility) for n in sorted(self._touched)}
        self._touched.clear()
        return self._retract({n: why for n, why in found.items() if why})

    def reassociate(self, found: Reassociation) -> IntArray:
        """Assign all observations (M,) of the log to landmarks of the map; retract landmarks (r,) without any. The
        observation that names a landmark initializes it, whatever was observed before; it need not be the first one.
        """
        first = beginnings(found)
        leaving = self._retract({n: UNREAD for n in self.records if n not in first})
        former = {row: (n, decision) for n, r in self.records.items() for row, decision in r.observations}
        for record in self.records.values():
            record.observations.clear()
        for row, n in enumerate(found.number.tolist()):
            before, new = former.get(row, (-1, DISCARD)), DISCARD
            if n >= 0:
                new = NEW if row == first[n] else n
                self.records[n].observations.append((row, new))
            if before == (n, new) or before[1] == new == DISCARD:
                continue
            steps = [before[1], *([n] if new == NEW and before[1] != n else []), new]
            self.events += [Event(self.frame, row, old, then, REASSOCIATED) for old, then in pairwise(steps)]
        return leaving

    def close(self, recounted: dict[int, Detections]) -> Ended:
        """Retract transient landmarks, at the end of a run, by what is `recounted` or recorded."""
        every = list(self.records.items())
        observations = np.array([len(r.observations) for _, r in every], np.int64)
        rows = [[row for row, _ in r.observations] for _, r in every]
        spans = np.array([[min(of), max(of)] for of in rows], np.int64).reshape(-1, 2)
        found = remaining([recounted.get(n, Detections(r.opportunities)) for n, r in every], observations, spans)
        numbers = np.array([n for n, _ in every], np.int64)
        left = numbers[found.left]
        folded = [self.records[n].observations[-1][0] for n in left.tolist()] if found.folded else []
        transient = self._retract(dict.fromkeys(numbers[~(found.stays | found.few)].tolist(), "uncertain"))
        return Ended(transient, left[:0] if found.folded else left, folded)

    def _retract(self, leaving: dict[int, str]) -> IntArray:
        for n, why in leaving.items():
            self.events += [Event(self.frame, row, old, DISCARD, why) for row, old in self.records[n].observations]
        self.drop(numbers := np.array(list(leaving), np.int64))
        return numbers

    def drop(self, numbers: IntArray) -> None:
        """Remove landmarks from the map without revisions."""
        self.looks.forget(numbers)
        for n in numbers.tolist():
            for other in self.records.pop(n).covisible:
                self.records[other].covisible.discard(n)

    def merge(self, pairs: list[tuple[int, int]]) -> None:
        """Merge landmarks (away, kept): decisions for the first become decisions for the second."""
        self.looks.merge(pairs)
        for away, kept in pairs:
            old, into = self.records.pop(away), self.records[kept]
            self.events += [Event(self.frame, row, decision, kept, MERGED) for row, decision in old.observations]
            self.merged.append((self.frame, away, kept))
            into.observations += [(row, kept) for row, _ in old.observations]
            into.place = old.place
            into.last, into.times = max(into.last, old.last), into.times + old.times
            # where it stood was judged against another estimate, so only the counts are added
            counts = {name: getattr(into.evidence, name) + getattr(old.evidence, name) for name in COUNTS}
            into.evidence = into.evidence._replace(**counts, row=0)
            # misses of one at places where the other one was detected were detections
            seen = bytearray(bytes(into.opportunities).rstrip(bytes([MISSED, MISSED + FAMILIAR])))
            into.opportunities = seen + bytes([DETECTED + FAMILIAR]) + old.opportunities
            into.familiar |= old.familiar
            for n in old.covisible:
                self.records[n].covisible.discard(away)
                if n != kept:
                    self.records[n].covisible.add(kept)
                    into.covisible.add(n)

    def surprise(self) -> float:
        """Log-likelihood ratio of being elsewhere, from confirmed landmarks that the judged frame missed."""
        v, total = self._visibility, 0.0
        if sum(v) < constants.ENOUGH_OPPORTUNITIES:
            return 0.0
        for n, at in zip(self._judged.missing, self._judged.viewpoint, strict=True):
            e = self.records[n].evidence
            if at in self.records[n].familiar and confirmed(e, v):
                rate = min(v.rate, detection_rate(e.opportunities, e.missed - e.row))
                here = v.row(e.row + 1, rate) / v.row(e.row, rate)
                total += max(0.0, math.log((1.0 - constants.ELSEWHERE_SHARE * rate) / here))
        return total

    def replaced(self, decisions: IntArray) -> tuple[int, int]:
        """Numbers of confirmed landmarks that the judged frame paired by decisions (m,), and that it missed and
        replaced.

        A missed landmark is replaced if this frame observed a landmark initialized after the missed one was last seen.
        """
        v, numbers = self._visibility, set(decisions.tolist())
        paired = [self.records[n] for n in numbers if n in self.records]
        newest = self.travelled if NEW in numbers else max((r.first for r in paired), default=-math.inf)
        missed = [self.records[n] for n in self._judged.missing if n not in numbers]
        replaced = sum(r.last < newest and confirmed(r.evidence, v) for r in missed)
        return sum(confirmed(r.evidence, v) for r in paired), replaced

    def paired(self, decisions: IntArray) -> int:
        """Number of decisions (m,) for confirmed landmarks."""
        v, records = self._visibility, self.records
        return sum(confirmed(records[n].evidence, v) for n in decisions.tolist() if n in records)

    def confirmed(self) -> IntArray:
        """Numbers (n,) of the confirmed landmarks, ascending."""
        return np.array([n for n, r in self.records.items() if confirmed(r.evidence, self._visibility)], np.int64)

    def rates(self, numbers: IntArray) -> Array:
        """Detection probability (n,) of landmarks, pooled once confirmed."""
        v, every = self._visibility, [self.records[n].evidence for n in numbers.tolist()]
        return np.array([v.rate if confirmed(e, v) else detection_rate(e.opportunities, e.missed) for e in every])

    def notes(self) -> list[Notice]:
        """Messages about revised decisions."""
        events = [e for e in self.events if e.why != REASSOCIATED]
        reassociated = len({e.observation for e in self.events if e.why == REASSOCIATED})
        undone, again = sum(e.old >= 0 for e in events), sum(e.new >= 0 for e in events)
        revised = [notice(Code.REVISED, undone=undone, again=again)] if events else []
        return revised + ([notice(Code.REASSOCIATED_AT_END, decisions=reassociated)] if reassociated else [])

    def merge_notes(self) -> list[Notice]:
        """Messages about merged landmarks."""
        return [notice(Code.MERGED, landmarks=len(self.merged), first=self.merged[0][0])] if self.merged else []

"""Step 6, SLAM's monitors: detect a kidnapped robot and relocalize it in its own map; tell whether a map is plausible.

A robot that pairs nothing where confirmed landmarks should be in view was kidnapped; exploration misses nothing. After
the alarm the motion counts as unknown, and the scan since then is searched in the map without a prior.

A robot lost while mapping observes known surroundings as new: it misses confirmed landmarks and observes newer ones in
their place. Exploration misses no old landmarks; a bad sensor misses many, but also observes old ones. So two kinds
count: confirmed landmarks that are paired, and those missed where something newer was observed. One frame is one piece
of evidence, because its errors have one cause; frames from one place are one, too. A second test at the end: most
landmarks of a bent map are retracted. Both tests (`Lost`) only report; they decide nothing.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from association.conditional import jcbb_conditional
from data.inputs import Frame, Increment, IntArray, LandmarkMap
from data.notice import Code, Notice, notice
from data.result import DISCARD
from data.se2 import Array
from eval.replay.hindsight import constants
from eval.replay.hindsight.gates import clear, dense
from eval.replay.hindsight.ledger import Ledger
from eval.replay.hindsight.relocalize import EMPTY, extended, moved, relocalize
from eval.replay.hindsight.two_models import TwoModels
from eval.replay.settings import Setup


class Relocated(NamedTuple):
    """Decisions (m,) of a frame; pose (3,) found by relocalization, or None; see `Mapped.kidnapped`, or None."""

    decisions: IntArray
    at: Array | None
    kidnapped: Array | None


class Kidnapping:
    """The cumulative sum of the evidence, and the scan since the alarm."""

    def __init__(self, ledger: Ledger, setup: Setup) -> None:
        self.ledger, self.setup = ledger, setup
        self.lost = False  # since an alarm, until the place is found or landmarks of the map are paired again
        self.alarms: list[int] = []  # frames of alarms and of recoveries
        self.found: list[int] = []
        self._score, self._scan = 0.0, EMPTY
        self._before = 0  # number of the first landmark initialized since the trouble began
        self._same: list[tuple[int, int]] = []
        """Landmarks that were initialized since, and those of the map that they are."""

    def move(self, increment: Increment) -> None:
        """The robot moved."""
        if self.lost:
            self._scan = moved(self._scan, increment)

    def decide(self, filters: TwoModels, frame: Frame, decisions: IntArray) -> Relocated:
        """Final decisions about a frame whose decisions (m,) the ledger has judged; the filter is inflated if it is
        lost.
        """
        ledger, slam, kidnapped = self.ledger, filters.believed, None
        if self._alarm(len(decisions), ledger.paired(decisions)):
            kidnapped = unknown = anywhere(slam.xy, ledger.range)
            filters.each(lambda each: each.inflate(unknown))
            ledger.epoch = ledger.new_epoch()
        if self.lost and np.trace(slam.estimate().covariance[:2, :2]) < (constants.FOUND_AGAIN * ledger.range) ** 2:
            self._recover()  # by a constellation
        if not self.lost:
            return Relocated(decisions, None, kidnapped)
        known = slam.landmarks()
        held = np.isin(known.number, ledger.confirmed())
        found = self._search(frame, LandmarkMap(known.number[held], known.xy[held]))
        if found is not None:
            return Relocated(*found, kidnapped)
        e, seen = slam.expect(frame.observations), frame.appearance
        if seen is not None:
            e = e.with_appearance(ledger.looks.unlike(e.number, seen))
        few = e.only(clear(e, dense(e, slam, ledger, self.setup), ledger.epoch))
        return Relocated(jcbb_conditional(few, self.setup.gate, self.setup.new_gate)[0], None, kidnapped)

    def _alarm(self, seen: int, paired: int) -> bool:
        """Whether this frame raises the alarm; `seen`: observations, `paired`: with confirmed landmarks.

        Missed detections count by their log-likelihood ratio, if several observations show that the sensor works.
        """
        if self._score == 0.0 and not self.lost:
            self._before = self.ledger.created
        missed = self.ledger.surprise() if seen >= constants.ALARM_OBSERVATIONS else 0.0
        self._score = max(0.0, self._score + missed - constants.PAIRING_TRUST * paired)
        if self.lost or self._score < constants.ALARM:
            return False
        self.lost, self._score, self._scan = True, 0.0, EMPTY
        self.alarms.append(self.ledger.frame)
        return True

    def _search(self, frame: Frame, known: LandmarkMap) -> tuple[IntArray, Array] | None:
        """Decisions (m,) and pose (3,) of the frame if the scan has one place in the map.

        Landmarks initialized since the trouble began are excluded: the scan would find itself.
        """
        old = known.id < self._before
        rows = np.arange(frame.first, frame.first + len(frame.observations.z))
        self._scan = extended(self._scan, self.ledger.sensor, frame.observations, rows)
        place = relocalize(self._scan, LandmarkMap(known.id[old], known.xy[old]))
        if place is None:
            return None
        self._recover()
        pairs = zip(place.pairings.tolist(), self._scan.rows, strict=True)
        number_of = {row: number for number, points in pairs if number >= 0 for row in points}
        initialized = {r.observations[0][0]: n for n, r in self.ledger.records.items()}
        self._same = [(initialized[row], n) for row, n in number_of.items() if row in initialized]
        return np.array([number_of.get(row, DISCARD) for row in rows.tolist()], np.int64), place.pose

    def _recover(self) -> None:
        self.lost, self._score = False, 0.0
        self.found.append(self.ledger.frame)

    def duplicates(self) -> list[tuple[int, int]]:
        """Landmarks initialized while lost that equal others of the map: (away, kept)."""
        records, same = self.ledger.records, dict(self._same)
        self._same = []
        return [(away, kept) for away, kept in same.items() if away in records and kept in records and kept < away]

    def notes(self) -> list[Notice]:
        """A message about alarms."""
        if not self.alarms:
            return []
        times, first = len(self.alarms), self.alarms[0]
        return [notice(Code.MOVED_UNSEEN, times=times, first=first, found=len(self.found))]


def anywhere(xy: Array, reach: float) -> Array:
    """Covariance (3, 3) of a motion to anywhere in a map (n, 2) or within the sensor's reach of it."""
    size = float(np.hypot(*np.ptp(xy, axis=0))) if len(xy) else 0.0
    return np.diag([(size + reach) ** 2, (size + reach) ** 2, math.pi**2])


class Suspicion(NamedTuple):
    """State of the test while mapping. score: see the module; since: frame after the last one with score 0."""

    score: float = 0.0
    since: int = 0
    alarm: int | None = None  # frame since which the robot has been lost, from the first alarm, None: no alarm
    over: int | None = None  # frame where the score returned to 0, None: not yet


def suspect(before: Suspicion, frame: int, paired: int, replaced: int) -> Suspicion:
    """After a frame from another place with this many paired and replaced confirmed landmarks."""
    if not paired + replaced:
        return before
    here, lost = constants.PAIRED_HEALTHY, constants.PAIRED_LOST
    ratio = paired * math.log(lost / here) + replaced * math.log((1.0 - lost) / (1.0 - here))
    after = before._replace(score=max(0.0, before.score + ratio / (paired + replaced)))
    if after.score == 0.0:
        over = frame if after.alarm is not None and after.over is None else after.over
        return after._replace(since=frame + 1, over=over)
    if after.score >= constants.PAIRED_ALARM:
        return after._replace(alarm=after.since if after.alarm is None else after.alarm, over=None)
    return after


class Lost:
    """Tests every frame that the ledger has judged."""

    def __init__(self, ledger: Ledger) -> None:
        self.ledger, self.suspicion = ledger, Suspicion()
        self._place = (math.inf, math.inf)
        self.often, self.retracted = 0, 0  # number of often observed landmarks, and of those retracted at the end

    def see(self, frame: Frame, decisions: IntArray, pose: Array) -> None:
        """Add a frame with its decisions (m,), before the update; `pose` (3,) is the predicted one."""
        x, y = self._place
        if math.hypot(pose[0] - x, pose[1] - y) < constants.SAME_PLACE * self.ledger.range:
            return
        paired, replaced = self.ledger.replaced(decisions)
        if paired + replaced:
            self._place = float(pose[0]), float(pose[1])
        self.suspicion = suspect(self.suspicion, frame.number, paired, replaced)

    def end(self, often: Sequence[int], retracted: IntArray) -> None:
        """The end of the log: often observed landmarks (n,) and retracted ones (r,)."""
        self.often, self.retracted = len(often), int(np.isin(often, retracted).sum())

    def notes(self) -> list[Notice]:
        """Messages about a restarted or bent map."""
        s, found = self.suspicion, []
        if s.alarm is not None:
            found.append(notice(Code.MAP_RESTARTED, frame=s.alarm, over=s.over))
        if self.often >= constants.RETRACTED_FEWEST and self.retracted > constants.RETRACTED_SHARE * self.often:
            found.append(notice(Code.RETRACTED, gone=self.retracted, often=self.often))
        return found

"""Localization without labels, decisions in hindsight: hypotheses, a monitor, and relocalization of the lost.

A bank of pose hypotheses decides about the observations of a log with a known map; see
`eval.replay.hindsight.localizing_frontend` for how an estimator lives with what it decides.
"""

from __future__ import annotations

import math

import numpy as np

from association.expectation import gate_threshold
from data.errors import UsageError
from data.inputs import Frame, IntArray
from data.notice import Code, Notice, Severity, notice
from data.result import DISCARD, Event, PoseEstimate
from data.se2 import pose_error
from ekf.filter import FilterOptions
from eval.replay.hindsight import constants
from eval.replay.hindsight.hypotheses import Choice, Hypotheses
from eval.replay.hindsight.lost import Monitor, healthy, recovered, watch
from eval.replay.hindsight.relocalize import EMPTY, Place, Scan, extended, moved, relocalize
from eval.replay.settings import Given


class HindsightLocalizer:
    """What decides about the observations of a log with a known map, frame by frame: `move`, `decide`; then `pose`.

    Attributes:
        alarms: frames in which the monitor first said that the robot is lost.
        found: frames in which it was found again by its surroundings alone.
        online: decisions as they were made, one for each observation so far.
        events: what was decided anew, in order.
    """

    def __init__(self, given: Given, monitor: Monitor | None = None) -> None:
        """Before the first frame. Raises UsageError without a map."""
        if given.map is None:
            raise UsageError("hypotheses of the pose alone need a known map")
        self.sensor, self.map = given.sensor, given.map
        self.bank = Hypotheses(
            given.prior, given.sensor, given.map, FilterOptions(iterations=constants.HYPOTHESIS_ITERATIONS)
        )
        self.monitor = monitor or Monitor()
        self.health = healthy(self.monitor)
        self._scans = (EMPTY, EMPTY)
        """What was seen since each of the monitor's sums left zero: before that it may have been somewhere else."""
        self.alarms: list[int] = []
        self.found: list[int] = []
        self.online: list[int] = []
        self.events: list[Event] = []
        self._now: list[int] = []
        """Decisions as they look now."""
        self._anew = 0
        """Rows before this one are settled: a scan's place began a new past."""
        self._k, self._first = -1, 0
        """The frame, and its first row."""

    def move(self, frame: Frame) -> None:
        """The next frame comes; the first one has no motion."""
        self._k, self._first, increment = frame.number, frame.first, frame.increment
        if increment is not None:
            self.bank.predict(increment)
            self._scans = (moved(self._scans[0], increment), moved(self._scans[1], increment))

    def decide(self, frame: Frame) -> IntArray:
        """Decisions (m,) about observations of this frame: landmark id, or `DISCARD` where they are to wait."""
        past = self.bank.members[0].past
        standing = self.bank.observe(frame.observations, frame.first)
        self._revise(past, self.bank.members[0].past)
        before, paired = self.health, int((standing.decisions >= 0).sum())
        self.health = watch(self.monitor, before, len(standing.decisions), paired, standing.nis, standing.dof)
        decisions = np.where(standing.sure >= constants.DECISION_WEIGHT, standing.decisions, DISCARD)
        sums = self.health.unpaired, self.health.misfit
        self._scans = (self._since(sums[0], self._scans[0], frame), self._since(sums[1], self._scans[1], frame))
        if self.health.lost:
            if not before.lost:
                self.alarms.append(self._k)
            alone = self._since(math.inf, EMPTY, frame)
            tried = [scan for s, scan in zip(sums, self._scans, strict=True) if s >= self.monitor.threshold]
            for scan in [*tried, alone]:
                place = relocalize(scan, self.map)
                if place is not None:
                    decisions = self._go_to(place, scan)[-len(decisions) :]
                    break
        self.online += decisions.tolist()
        self._now += decisions.tolist()
        return decisions

    def _since(self, score: float, scan: Scan, frame: Frame) -> Scan:
        """The scan with this frame's observations, or none while the score is zero."""
        if score <= 0.0:
            return EMPTY
        seen = frame.observations
        return extended(scan, self.sensor, seen, np.arange(frame.first, frame.first + len(seen.z)))

    def _go_to(self, place: Place, scan: Scan) -> IntArray:
        """Go on from where the scan was taken; decisions about its observations, oldest first."""
        by_row = {
            row: number if number >= 0 else DISCARD
            for number, rows in zip(place.pairings.tolist(), scan.rows, strict=True)
            for row in rows
        }
        for row in sorted(by_row):
            self._change(row, by_row[row], "its place was found without a prior")
        self._anew = max(by_row) + 1
        self.bank.restart(place.pose, place.covariance)
        self.health, self._scans = recovered(self.health), (EMPTY, EMPTY)
        self.found.append(self._k)
        return np.array([by_row[row] for row in sorted(by_row)], np.int64)

    def _revise(self, old: Choice | None, new: Choice | None) -> None:
        """The leader's past replaces that of the leader before, as far back as they differ."""
        while new is not None and (old is None or new.row > old.row):
            new = new.before
        while new is not None and old is not None and new is not old and new.row >= self._anew:
            if new.number != old.number:
                self._change(new.row, new.number, "another hypothesis leads")
            new, old = new.before, old.before

    def _change(self, row: int, number: int, why: str) -> None:
        if row < self._first and number != (before := self._now[row]):
            self.events.append(Event(self._k, row, before, number, why))
            self._now[row] = number

    def close(self) -> None:
        """The end of the log: decisions that were put off become those of the leading hypothesis."""
        last = self.bank.decisions(len(self.online))
        for row in np.flatnonzero(last != np.array(self._now, np.int64)).tolist():
            if row >= self._anew or self._now[row] == DISCARD != last[row]:
                self._change(row, int(last[row]), "put off until the end")

    @property
    def single(self) -> bool:
        """Whether there is one hypothesis only."""
        return len(self.bank.members) == 1

    def pose(self) -> PoseEstimate:
        """The pose by all hypotheses together."""
        return self.bank.estimate()

    def elsewhere(self, estimate: PoseEstimate) -> bool:
        """Whether the bank has one opinion of the pose, and an estimator another one."""
        if not self.single:
            return False
        mean, P = self.bank.estimate()
        error = pose_error(estimate.mean, mean)
        # an exact prior has no inverse; a micrometre away is nowhere else
        both = P + estimate.covariance + constants.EXACT_VARIANCE * np.eye(3)
        return float(error @ np.linalg.solve(both, error)) > gate_threshold(constants.OTHER_PLACE, 3)

    def notes(self) -> list[Notice]:
        """What a reader of the results should know."""
        anew = len({e.observation for e in self.events})
        notes = [notice(Code.REVISED_POSES, Severity.INFO, decisions=anew)]
        if self.alarms:
            times, first = len(self.alarms), self.alarms[0]
            notes.append(notice(Code.FOUND_AGAIN, Severity.INFO, times=times, first=first, found=len(self.found)))
        return notes

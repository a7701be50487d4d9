"""Localization without labels: pose hypotheses, a monitor, and relocalization of the lost robot.

See `eval.replay.hindsight.localizing_frontend` for how an estimator uses the decisions.
"""

from __future__ import annotations

import math

import numpy as np

from association.expectation import gate_threshold
from data.errors import UsageError
from data.inputs import Frame, IntArray
from data.notice import Code, Notice, notice
from data.result import DISCARD, Event, PoseEstimate
from data.se2 import pose_error
from ekf.filter import FilterOptions
from eval.replay.hindsight import constants
from eval.replay.hindsight.hypotheses import Choice, Hypotheses
from eval.replay.hindsight.lost import Health, recovered, watch
from eval.replay.hindsight.relocalize import EMPTY, Place, Scan, extended, moved, relocalize
from eval.replay.poses import PoseMeasurements
from eval.replay.settings import Given


class HindsightLocalizer:
    """Decides about the observations of a log with a known map, frame by frame: `move`, `decide`; then `pose`.

    Fixes and closures (`use_poses`, after `move`) weigh the hypotheses.
    """

    def __init__(self, given: Given, gate_poses: float | None = None) -> None:
        """Start at the prior; `gate_poses`: of fixes and closures. Raises UsageError without a map."""
        if given.map is None:
            raise UsageError("hypotheses of the pose alone need a known map")
        self.sensor, self.map = given.sensor, given.map
        self.bank = Hypotheses(
            given.prior, given.sensor, given.map, FilterOptions(iterations=constants.HYPOTHESIS_ITERATIONS)
        )
        self.poses = PoseMeasurements(given, self.bank, self.bank, gate_poses)
        self.health = Health()
        self._scans = (EMPTY, EMPTY)  # observations since each cumulative sum left zero
        self.alarms: list[int] = []  # frames in which the monitor detected a lost robot
        self.found: list[int] = []  # frames in which it was relocalized
        self.online: list[int] = []  # decisions as they were made, one for each observation so far
        self.events: list[Event] = []  # revised decisions, in order
        self._now: list[int] = []  # decisions after revisions
        self._restarted = 0  # rows before this one are settled: relocalization began a new past
        self._k, self._first = -1, 0  # the frame, and its first row

    def move(self, frame: Frame) -> None:
        """Take the motion of the next frame."""
        self._k, self._first, increment = frame.number, frame.first, frame.increment
        if increment is not None:
            self.bank.predict(increment)
            self._scans = (moved(self._scans[0], increment), moved(self._scans[1], increment))

    def use_poses(self, frame: Frame) -> None:
        """Update with the frame's fixes and closures."""
        past = self.bank.members[0].past
        self.poses.use(frame)
        self._revise(past, self.bank.members[0].past)

    def decide(self, frame: Frame) -> IntArray:
        """Decisions (m,) about observations of this frame: landmark id, or `DISCARD` where they are postponed."""
        past = self.bank.members[0].past
        standing = self.bank.observe(frame.observations, frame.first, frame.appearance)
        self._revise(past, self.bank.members[0].past)
        before, paired = self.health, int((standing.decisions >= 0).sum())
        self.health = watch(before, len(standing.decisions), paired, standing.nis, standing.dof)
        decisions = np.where(standing.sure >= constants.DECISION_WEIGHT, standing.decisions, DISCARD)
        sums = self.health.unpaired, self.health.misfit
        self._scans = (self._since(sums[0], self._scans[0], frame), self._since(sums[1], self._scans[1], frame))
        if self.health.lost:
            if not before.lost:
                self.alarms.append(self._k)
            alone = self._since(math.inf, EMPTY, frame)
            tried = [scan for s, scan in zip(sums, self._scans, strict=True) if s >= constants.ALARM]
            for scan in [*tried, alone]:
                place = relocalize(scan, self.map)
                if place is not None:
                    decisions = self._go_to(place, scan)[-len(decisions) :]
                    break
        self.online += decisions.tolist()
        self._now += decisions.tolist()
        return decisions

    def _since(self, score: float, scan: Scan, frame: Frame) -> Scan:
        """The scan with this frame's observations; empty while the score is zero."""
        if score <= 0.0:
            return EMPTY
        seen = frame.observations
        return extended(scan, self.sensor, seen, np.arange(frame.first, frame.first + len(seen.z)))

    def _go_to(self, place: Place, scan: Scan) -> IntArray:
        """Restart where the scan was taken; returns decisions about its observations, oldest first."""
        by_row = {
            row: number if number >= 0 else DISCARD
            for number, rows in zip(place.pairings.tolist(), scan.rows, strict=True)
            for row in rows
        }
        for row in sorted(by_row):
            self._change(row, by_row[row], "its place was found without a prior")
        self._restarted = max(by_row) + 1
        self.bank.restart(place.pose, place.covariance)
        self.health, self._scans = recovered(self.health), (EMPTY, EMPTY)
        self.found.append(self._k)
        return np.array([by_row[row] for row in sorted(by_row)], np.int64)

    def _revise(self, old: Choice | None, new: Choice | None) -> None:
        """Replace the past of the previous leader by that of the new one, back to where they differ."""
        while new is not None and (old is None or new.row > old.row):
            new = new.before
        while new is not None and old is not None and new is not old and new.row >= self._restarted:
            if new.number != old.number:
                self._change(new.row, new.number, "another hypothesis leads")
            new, old = new.before, old.before

    def _change(self, row: int, number: int, why: str) -> None:
        if row < self._first and number != (before := self._now[row]):
            self.events.append(Event(self._k, row, before, number, why))
            self._now[row] = number

    def close(self) -> None:
        """Postponed decisions become those of the leading hypothesis."""
        last = self.bank.decisions(len(self.online))
        for row in np.flatnonzero(last != np.array(self._now, np.int64)).tolist():
            if row >= self._restarted or self._now[row] == DISCARD != last[row]:
                self._change(row, int(last[row]), "put off until the end")

    @property
    def single(self) -> bool:
        """Whether there is only one hypothesis."""
        return len(self.bank.members) == 1

    def pose(self) -> PoseEstimate:
        """The pose of the whole mixture."""
        return self.bank.estimate()

    def elsewhere(self, estimate: PoseEstimate) -> bool:
        """Whether there is one hypothesis, and an estimator contradicts its pose."""
        if not self.single:
            return False
        mean, P = self.bank.estimate()
        error = pose_error(estimate.mean, mean)
        # an exact prior has no inverse; a micrometre is no other place
        both = P + estimate.covariance + constants.EXACT_VARIANCE * np.eye(3)
        return float(error @ np.linalg.solve(both, error)) > gate_threshold(constants.MOTION_GATE, 3)

    def notes(self) -> list[Notice]:
        """Messages about revisions and alarms."""
        revised = len({e.observation for e in self.events})
        notes = [notice(Code.REVISED_POSES, decisions=revised)]
        if self.alarms:
            times, first = len(self.alarms), self.alarms[0]
            notes.append(notice(Code.FOUND_AGAIN, times=times, first=first, found=len(self.found)))
        return notes

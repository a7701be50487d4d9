"""Fixes and closures of a log: handed to one estimator frame by frame, and the record of what became of them."""

from __future__ import annotations

from data.inputs import Frame
from data.notice import Code, Notice, notice
from data.pose_measurements import Closures, Fixes, PoseUpdated, not_used
from eval.replay.estimators import Closable, Fixable
from eval.replay.settings import Given


class PoseMeasurements:
    """The fixes and closures of a log for one estimator, before its first frame; those it has no method for are not
    used.
    """

    def __init__(self, given: Given, fixable: Fixable | None, closable: Closable | None, gate: float | None) -> None:
        """The estimator as `fixable` and `closable`; `gate`: of each, a chi-square probability, None: all are used."""
        self.gate = gate
        self._fixes, self._closures = given.fixes, given.closures
        self._fixable, self._closable = fixable, closable
        # what became of the present frame's; None: it has none, or they were not used
        self.fixed: PoseUpdated | None = None
        self.closed: PoseUpdated | None = None
        if self._closures is not None and self._closable is not None:
            self._closable.keep(self._closures.last_use())

    def use(self, frame: Frame) -> None:
        """Update with those of a frame, fixes first."""
        self.fixed = self.closed = None
        if frame.fixes is not None and self._fixes is not None and self._fixable is not None:
            self.fixed = self._fixable.fix(frame.fixes, self._fixes.sources, self.gate)
        if frame.closures is not None and self._closable is not None:
            self.closed = self._closable.close_loops(frame.closures, self.gate)

    def notes(self) -> list[Notice]:
        """A message about those that were not used."""
        fixes = 0 if self._fixes is None or self._fixable is not None else len(self._fixes)
        closures = 0 if self._closures is None or self._closable is not None else len(self._closures)
        return [notice(Code.POSES_UNUSED, fixes=fixes, closures=closures)] if fixes or closures else []


class PoseRecords:
    """What became of a log's fixes and closures, by row; those not reached stay blank."""

    def __init__(self, fixes: Fixes | None, closures: Closures | None) -> None:
        self.fixes = not_used([] if fixes is None else fixes.dof)
        self.closures = not_used([3] * (0 if closures is None else len(closures)))
        self._fixed = self._closed = False  # whether any were handed on
        self._gate: float | None = None

    def enter(self, frame: Frame, poses: PoseMeasurements) -> None:
        """Those of a frame."""
        self._gate = poses.gate
        if frame.fixes is not None and poses.fixed is not None:
            self._fixed = True
            self.fixes.enter(frame.fixes.rows, poses.fixed)
        if frame.closures is not None and poses.closed is not None:
            self._closed = True
            self.closures.enter(frame.closures.row, poses.closed)

    def innovations(self) -> tuple[PoseUpdated | None, PoseUpdated | None]:
        """Of fixes and of closures; None: they were not used."""
        fixes, closures = (done._replace(gate=self._gate) for done in (self.fixes, self.closures))
        return fixes if self._fixed else None, closures if self._closed else None

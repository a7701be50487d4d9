"""Fixes and closures of a log: handed to one estimator frame by frame, and the record of what became of them."""

from __future__ import annotations

import numpy as np

from data.inputs import Frame
from data.notice import Code, Notice, notice
from data.pose_measurements import MEASURED, Closures, Fixes, FixKind, FrameClosures, PoseInnovations, PoseUpdated
from data.se2 import BoolArray
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


class PoseRecord:
    """Fixes, or closures, by row: which were used, and their innovations; those not reached stay blank."""

    def __init__(self, dof: list[int]) -> None:
        """`dof` of each."""
        n = len(dof)
        self._used, self._nis = np.zeros(n, np.bool_), np.full(n, np.nan)
        self._dof, self._white, self._given = np.array(dof, np.int64), np.full((n, 3), np.nan), False
        self._S = np.full((n, 3, 3), np.nan)

    def enter(self, rows: slice, done: PoseUpdated) -> None:
        """The result of an update with those of these rows."""
        self._given = True
        self._used[rows], self._nis[rows], self._white[rows] = done.used, done.nis, done.white
        self._S[rows] = done.S

    @property
    def rejected(self) -> BoolArray:
        """Those (f,) that were not used."""
        return ~self._used

    def innovations(self, gate: float | None) -> PoseInnovations | None:
        """Of all; None: they were not used."""
        found = PoseInnovations(self._used, self._nis, self._dof, self._white, gate, self._S)
        return found if self._given else None


class PoseRecords:
    """The records of a log's fixes and closures."""

    def __init__(self, fixes: Fixes | None, closures: Closures | None) -> None:
        kinds = [] if fixes is None else fixes.kind.tolist()
        self._gate: float | None = None
        self.fixes = PoseRecord([len(MEASURED[FixKind(kind)]) for kind in kinds])
        self.closures = PoseRecord([3] * (0 if closures is None else len(closures)))

    def enter(self, frame: Frame, poses: PoseMeasurements) -> None:
        """Those of a frame."""
        self._gate = poses.gate
        if frame.fixes is not None and poses.fixed is not None:
            first = frame.fixes.first
            self.fixes.enter(slice(first, first + len(frame.fixes.kind)), poses.fixed)
        if frame.closures is not None and poses.closed is not None:
            self.closures.enter(_rows(frame.closures), poses.closed)

    def innovations(self) -> tuple[PoseInnovations | None, PoseInnovations | None]:
        """Of fixes and of closures."""
        return self.fixes.innovations(self._gate), self.closures.innovations(self._gate)


def _rows(closures: FrameClosures) -> slice:
    return slice(int(closures.row[0]), int(closures.row[-1]) + 1)

"""Fixes and closures of a log: handed to one estimator frame by frame, and the record of what became of them."""

from data.inputs import Frame
from data.notice import Code, Notice, notice
from data.pose_measurements import Closures, Fixes, PoseUpdated, not_used
from eval.replay.estimators import Closable, Fixable
from eval.replay.settings import Given


class PoseMeasurements:
    """The fixes and closures of a log, behind their gate, for one estimator and for those that decide beside it. Those
    that an estimator has no method for are not used.
    """

    def __init__(self, given: Given, fixable: Fixable | None, closable: Closable | None, gate: float | None) -> None:
        """The estimator as `fixable` and `closable`; `gate`: of each, a chi-square probability, None: all are used."""
        self.gate = gate
        self._fixes, self._closures = given.fixes, given.closures
        self._fixable, self._closable = fixable, closable
        self.fixed: PoseUpdated | None = None  # what became of the present frame's; None: it has none, or none was used
        self.closed: PoseUpdated | None = None
        keep_frames(given, closable)

    def use(self, frame: Frame) -> None:
        """Update the estimator with a frame's fixes, then with its closures."""
        self.fixed, self.closed = self.of(frame, self._fixable, self._closable)

    def of(
        self, frame: Frame, fixable: Fixable | None, closable: Closable | None
    ) -> tuple[PoseUpdated | None, PoseUpdated | None]:
        """Update any estimator with a frame's fixes and closures, and return what became of both."""
        fixed = closed = None
        if frame.fixes is not None and self._fixes is not None and fixable is not None:
            fixed = fixable.fix(frame.fixes, self._fixes.sources, self.gate)
        if frame.closures is not None and closable is not None:
            closed = closable.close_loops(frame.closures, self.gate)
        return fixed, closed

    def notes(self) -> list[Notice]:
        """A notice where the estimator cannot use fixes or closures."""
        fixes = 0 if self._fixes is None or self._fixable is not None else len(self._fixes)
        closures = 0 if self._closures is None or self._closable is not None else len(self._closures)
        return [notice(Code.POSES_UNUSED, fixes=fixes, closures=closures)] if fixes or closures else []


def keep_frames(given: Given, closable: Closable | None) -> None:
    """Tell an estimator before the first frame which frames closures will name."""
    if given.closures is not None and closable is not None:
        closable.keep(given.closures.last_use())


class PoseRecords:
    """What became of a log's fixes and closures, by row; those not reached stay blank."""

    def __init__(self, fixes: Fixes | None, closures: Closures | None) -> None:
        self.fixes = not_used([] if fixes is None else fixes.dof)
        self.closures = not_used([3] * (0 if closures is None else len(closures)))
        self._fixed = self._closed = False  # whether any were handed on

    def enter(self, frame: Frame, fixed: PoseUpdated | None, closed: PoseUpdated | None) -> None:
        """Those of a frame."""
        if frame.fixes is not None and fixed is not None:
            self._fixed = True
            self.fixes.enter(frame.fixes.row, fixed)
        if frame.closures is not None and closed is not None:
            self._closed = True
            self.closures.enter(frame.closures.row, closed)

    def innovations(self, gate: float | None) -> tuple[PoseUpdated | None, PoseUpdated | None]:
        """Of fixes and of closures, behind this gate; None: they were not used."""
        fixes, closures = (done._replace(gate=gate) for done in (self.fixes, self.closures))
        return fixes if self._fixed else None, closures if self._closed else None

"""Collects a run frame by frame; observers of a replay."""

import math
from collections.abc import Callable

import numpy as np

from data import result
from data.inputs import Frame, Inputs, IntArray, Systematic
from data.pose_measurements import Closures, Fixes
from eval.replay.external.spec import name_of
from eval.replay.frontend import FrontEnd, Pairing, PoseRecords
from eval.replay.settings import BATCH, INCREMENTAL


class Recorder:
    """Decisions, innovations and estimates of every frame; frames that were not reached stay blank."""

    def __init__(
        self, frames: int, observations: int, systematic: Systematic | None = None, fixes: Fixes | None = None,
        closures: Closures | None = None,
    ) -> None:  # fmt: skip
        """Blank, for numbers of frames and observations; `systematic`: errors that are estimated."""
        n, m = frames, observations
        self.poses = PoseRecords(fixes, closures)
        self._pose, self._covariance = np.full((n, 3), np.nan), np.full((n, 3, 3), np.nan)
        self._nis, self._dof, self._likelihood = np.full(n, np.nan), np.zeros(n, np.int64), np.full(n, np.nan)
        self._moments = 0.0, 0.0
        self._size, self._white = np.zeros(n, np.int64), np.full((m, 2), np.nan)
        self._frame = np.full(m, -1, np.int64)
        p = 0 if systematic is None else len(systematic.names)
        self._systematic, self._errors, self._known = systematic, np.full((n, p), np.nan), False
        self._errors_sigma = self._errors.copy()
        # as they were made, unused pairings discarded; landmarks that observations initialized
        self.decisions, self.created = np.full(m, result.DISCARD, np.int64), np.full(m, -1, np.int64)

    def update(self, frame: Frame, decisions: IntArray, done: result.Updated) -> None:
        """Record decisions about (a part of) a frame and the update with them."""
        k, rows = frame.number, slice(frame.first, frame.first + len(decisions))
        self._frame[rows], self.created[rows], self.decisions[rows] = k, done.created, decisions
        self.decisions[rows][(decisions >= 0) > done.used] = result.DISCARD
        if done.white is not None:
            self._white[rows] = done.white
        self._enter(k, done.nis, done.dof, done.log_likelihood, done.moments)

    def _enter(self, k: int, nis: float, dof: int, log_likelihood: float, moments: tuple[float, float] | None) -> None:
        if math.isfinite(nis):
            formed = math.isfinite(self._nis[k])
            self._nis[k] = self._nis[k] + nis if formed else nis
            self._likelihood[k] = self._likelihood[k] + log_likelihood if formed else log_likelihood
            self._dof[k] += dof
            (mean, variance), (more, wider) = self._moments, (dof, 2.0 * dof) if moments is None else moments
            self._moments = mean + more, variance + wider

    def begin(self, front: FrontEnd) -> None:
        """Record landmarks that began in this frame by observations of several: the first one initialized them."""
        for begun in front.begun:
            self.created[begun.rows[0]] = begun.number
            self.decisions[begun.rows] = begun.number
            self.decisions[begun.rows[0]] = result.NEW
            self._enter(front.k, begun.nis, begun.dof, begun.log_likelihood, None)

    def estimate(self, front: FrontEnd) -> None:
        """Record the estimate at the end of a frame."""
        self._pose[front.k], self._covariance[front.k] = front.estimator.estimate()
        self._size[front.k] = front.state_size
        errors = None if "errors" not in front.can else front.can["errors"].errors
        if errors is not None:
            self._known = True
            self._errors[front.k], self._errors_sigma[front.k] = errors[0], np.sqrt(np.maximum(np.diag(errors[1]), 0.0))

    def run(
        self, name: str, task: str, front: FrontEnd, finished: result.Finished, failure: result.Failure | None,
        seconds: float,
    ) -> result.Run:  # fmt: skip
        """The run, after the last frame or where the estimator failed."""
        final, removed = self.decisions, None
        if front.map_management is not None:
            removed = front.map_management.removal_frames(int(self.created.max(initial=-1)) + 1)
            number = np.where(self.created >= 0, self.created, self.decisions)
            final = np.where(np.isin(number, sorted(front.map_management.retracted)), result.DISCARD, self.decisions)
        events = front.events()
        created, begun = front.initialized(final, self.created)
        final = result.revised(final, events)
        state = None
        if finished.map is not None:
            first = result.surviving(final, created) if begun is None else begun
            state = result.map_estimate(finished.map, self._frame, final, first)
        fixes, closures = self.poses.innovations(front.poses.gate)
        innovations = None
        if np.isfinite(self._nis).any():
            innovations = result.Innovations(self._nis, self._dof, self._likelihood, self._white)
        errors, dof = None, int(self._dof.sum())
        if self._systematic is not None and self._known:
            errors = result.Systematics(self._systematic.names, self._errors, self._errors_sigma)
        gated = (float(self._moments[0]) / dof, float(self._moments[1]) / dof) if dof else result.CHI_SQUARE
        total, size = finished.total_nis, None
        if not front.estimator.smooths:
            size = self._size
            if innovations is not None and failure is None:
                total = float(np.nansum(self._nis)), dof
        return result.Run(
            name, front.association, task, result.Trajectory(self._pose, self._covariance), finished.final, state,
            self.decisions, final, created, innovations, total, size, seconds, failure, tuple(front.notes()),
            removed, events, gated, finished.iterations, finished.last_step_sigma,
            errors_online=errors, errors_final=finished.systematic, begun=begun,
            gated_final=front.gated_final, left=front.left, fixes=fixes, closures=closures,
            fixes_final=finished.fixes, closures_final=finished.closures,
        )  # fmt: skip


class Observer:
    """Observes a replay frame by frame and changes nothing; this one is the null observer."""

    def moved(self, front: FrontEnd) -> None:
        """A frame begins; its observations are not processed yet."""

    def decided(self, front: FrontEnd, frame: Frame, pairing: Pairing) -> None:
        """The observations of (a part of) the frame are decided about, but not used yet."""

    def updated(self, front: FrontEnd, decisions: IntArray, created: IntArray) -> None:
        """A frame is over; decisions and initialized landmarks (M,) are those of the whole log so far."""


class ObserverError(BaseException):
    """What an observer raised: no failure of the estimator, so no guard of it may catch this."""

    def __init__(self, of: Exception) -> None:
        super().__init__(str(of))
        self.of = of


def observe(stage: Callable[..., None], *seen: object) -> None:
    """A stage of an observer: what it raises is told apart from what the estimator raises."""
    try:
        stage(*seen)
    except Exception as fault:
        raise ObserverError(fault) from fault


class Writing(Observer):
    """An observer with a result, which stays with the run as `Run.watched`."""

    seconds = 0.0  # time spent observing, not part of the estimator's

    def left(self) -> object:
        """The result, after the last frame."""
        raise NotImplementedError


def missing_run(name: str, association: str, task: str, inputs: Inputs, failure: result.Failure) -> result.Run:
    """A failed run without results: blank trajectories of the phases that this estimator has, and no decisions."""
    n, given = len(inputs), "none" if name == "dead-reckoning" else name_of(association)
    nowhere = result.Trajectory(np.full((n, 3), np.nan), np.full((n, 3, 3), np.nan))
    online, final = (nowhere if has else None for has in (name not in BATCH, name in (*BATCH, *INCREMENTAL)))
    nothing = np.full(len(inputs.observations.frame), result.DISCARD, np.int64)
    created = np.full(len(nothing), -1, np.int64)
    return result.Run(name_of(name), given, task, online, final, None, nothing, nothing, created, failure=failure)

"""Localization without labels, in hindsight: pose hypotheses, a monitor, and relocalization of the lost robot.

An estimator uses decisions that may be revised. A filter is reset to the mixture of the hypotheses whenever there are
several. A smoother gets the decisions of the majority by weight; postponed decisions are handed over later, and
contradicted ones are replaced. A smoother that still ends up elsewhere is restarted there (`Stretches`).

A kidnapped robot leaves observations unpaired or pairs them badly. For both, every frame adds the log-likelihood ratio
of "lost" against "healthy" to a cumulative sum, which never falls below zero (Page, Biometrika 41, 1954). The trouble
began where the sum last left zero.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from association.decide import Decided
from association.expectation import Expectation, gate_threshold
from association.truncated import Acceptance
from data.errors import UsageError
from data.inputs import Frame, FrameObservations, Increment, IntArray, Prior
from data.notice import Code, Notice, notice
from data.pose_measurements import Closures, Fixes, FixSource, PoseUpdated, not_used
from data.result import DISCARD, Event, Finished, MapState, PoseEstimate, Systematics, Trajectory, Updated
from data.se2 import Array, BoolArray, pose_error
from ekf.filter import FilterOptions
from eval.replay.estimators import Estimator, capabilities, make_estimator, needed
from eval.replay.external.adapter import OwnInnovations
from eval.replay.external.spec import is_foreign
from eval.replay.frontend import FrontEnd, Pairing, keep_frames
from eval.replay.hindsight import constants, hypotheses
from eval.replay.hindsight.hypotheses import Choice, Hypotheses
from eval.replay.hindsight.relocalize import EMPTY, Place, Scan, extended, moved, relocalize
from eval.replay.settings import HINDSIGHT, Given, Setup


@dataclass(frozen=True)
class Health:
    """State of the test after a frame."""

    unpaired: float = 0.0  # cumulative sums, 0 while nothing indicates a lost robot
    misfit: float = 0.0
    # expected in a healthy frame: share of paired observations, ...
    share: float = field(default_factory=lambda: constants.HEALTH_START[0])
    strays: float = 0.0  # ... number of unpaired ones, ...
    scale: float = field(default_factory=lambda: constants.HEALTH_START[1])  # ... NIS per degree of freedom
    learned: float = field(default_factory=lambda: constants.HEALTH_WEIGHT)  # weight of what was learned [observations]
    lost: bool = False  # one of the sums has reached the threshold


def watch(before: Health, offered: int, paired: int, nis: float, dof: int) -> Health:
    """The state after a frame with `paired` of `offered` observations paired, and the NIS of these with its dof.

    Expectations are learned from all frames except those of a lost robot. The expected NIS is at least its chi-square
    mean, so that conservative noise does not speed up the test.
    """
    if offered == 0:
        return before
    unpaired = before.unpaired + _against_strays(before, offered, offered - paired)
    r = constants.LOST_SCALE  # one instant full of misfits is one piece of evidence: its errors are not independent
    fit = 0.5 * (nis / max(before.scale, 1.0) * (1.0 - 1.0 / r) - dof * math.log(r))
    misfit = before.misfit + min(fit, constants.MISFIT_MOST * constants.ALARM)
    unpaired, misfit = max(0.0, unpaired), max(0.0, misfit)
    after = replace(before, unpaired=unpaired, misfit=misfit)
    if max(unpaired, misfit) >= constants.ALARM:
        return replace(after, lost=True)
    weight = min(before.learned + offered, constants.NOISE_MEMORY)
    gain, scale = offered / weight, before.scale
    if dof > 0:
        scale += 0.5 * dof / weight * (nis / dof - scale)
    share = before.share + gain * (paired / offered - before.share)
    strays = before.strays + gain * (offered - paired - before.strays)
    return replace(after, lost=False, share=share, strays=strays, scale=scale, learned=weight)


def _against_strays(before: Health, offered: int, left: int) -> float:
    """Log-likelihood ratio of "lost" for `left` of the `offered` observations unpaired, the smaller of two models'."""
    share = min(max(before.share, constants.HEALTH_SHARE_LEAST), constants.HEALTH_SHARE_MOST)
    binomial = (offered - left) * math.log(constants.LOST_SHARE)
    binomial += left * math.log((1.0 - constants.LOST_SHARE * share) / (1.0 - share))
    usual = max(before.strays, constants.HEALTH_STRAYS_LEAST * offered)
    more = max(usual, (1.0 - constants.LOST_SHARE * share) * offered)
    return min(binomial, left * math.log(more / usual) - (more - usual))


def recovered(before: Health) -> Health:
    """The state after the pose was found again: sums are zero, expectations stay."""
    return replace(before, unpaired=0.0, misfit=0.0, lost=False)


class Stretches:
    """A smoother that can be restarted; its final path is joined from the stretches."""

    smooths = True

    def __init__(self, begin: Callable[[Prior], Estimator], prior: Prior) -> None:
        """Start with `begin(prior)`, which makes the smoother of the log from the present frame on."""
        self._begin, self._now = begin, begin(prior)
        self._can = capabilities(self._now)
        self._first, self._frame, self._time = 0, 0, 0.0
        self._given = 0  # first frame whose observations the present smoother has: its first frame's are in its prior
        self._done: list[tuple[Finished, int]] = []  # ended ones, each with its number of frames
        self._last_use: dict[int, int] = {}

    def predict(self, increment: Increment) -> None:
        """Move by an increment."""
        self._frame += 1
        self._now.predict(increment)

    def stamp(self, time: float) -> None:
        """The present frame's time [s]."""
        self._time = time
        if "stamp" in self._can:
            self._can["stamp"].stamp(time)

    def expect(self, observations: FrameObservations) -> Expectation:
        """The expectation of the present smoother."""
        return self._now.expect(observations)

    def update(self, observations: FrameObservations, decisions: IntArray, **options: Any) -> Updated:
        """Use the pairings."""
        return self._now.update(observations, decisions, **options)

    def keep(self, last_use: dict[int, int]) -> None:
        """The frames that later closures name; a later smoother keeps those that it has."""
        self._last_use = last_use
        if "close_loops" in self._can:
            first = self._first
            mine = {frame - first: last - first for frame, last in last_use.items() if frame >= first}
            self._can["close_loops"].keep(mine)

    def fix(self, fixes: Fixes, sources: tuple[FixSource, ...], gate: float | None) -> PoseUpdated:
        """Update with absolute measurements of the pose."""
        return not_used(fixes.dof) if "fix" not in self._can else self._can["fix"].fix(fixes, sources, gate)

    def close_loops(self, closures: Closures, gate: float | None) -> PoseUpdated:
        """Update with relative poses; not used: those of a frame of an earlier stretch."""
        done = not_used([3] * len(closures.row))
        mine = np.minimum(closures.frame1, closures.frame2) >= self._first
        if "close_loops" not in self._can or not mine.any():
            return done
        part = closures.only(mine)
        moved = replace(part, frame1=part.frame1 - self._first, frame2=part.frame2 - self._first)
        done.enter(mine, self._can["close_loops"].close_loops(moved, gate))
        return done

    def amend(self, frames: IntArray, observations: FrameObservations, decisions: IntArray) -> None:
        """Change the landmarks of what frames (m,) saw; earlier stretches stay as they are."""
        keep = np.flatnonzero(frames >= self._given)
        if len(keep) and "amend" in self._can:
            seen = FrameObservations(observations.z[keep], observations.R[keep])
            self._can["amend"].amend(frames[keep] - self._first, seen, decisions[keep])

    @property
    def errors(self) -> tuple[Array, Array] | None:
        """Systematic errors of the present smoother."""
        return None if "errors" not in self._can else self._can["errors"].errors

    def estimate(self) -> PoseEstimate:
        """The newest pose."""
        return self._now.estimate()

    def landmarks(self) -> MapState:
        """The given map."""
        return self._now.landmarks()

    def reset(self, mean: Array, covariance: Array) -> None:
        """Begin a new smoother at this frame, with pose (3,) and covariance (3, 3) as its prior."""
        if self._frame > self._first:
            self._done.append((self._now.finish(), self._frame - self._first))
        self._first, self._given = self._frame, self._frame + 1
        self._now = self._begin(Prior(mean, covariance))
        self._can = capabilities(self._now)
        self.keep(self._last_use)
        self.stamp(self._time)

    def finish(self) -> Finished:
        """Join the stretches; costs and degrees of freedom add up."""
        parts = [*self._done, (self._now.finish(), self._frame + 1 - self._first)]
        totals = [p.total_nis for p, _ in parts if p.total_nis is not None]
        paths = [(p.final.pose[:n], p.final.covariance[:n]) for p, n in parts if p.final is not None]  # all have
        errors = [(e.mean[:n], e.sigma[:n]) for p, n in parts if (e := p.systematic) is not None]
        final = Trajectory(*map(np.concatenate, zip(*paths, strict=True)))
        total = (sum(t[0] for t in totals), sum(t[1] for t in totals)) if len(totals) == len(parts) else None
        found, last = None, parts[-1][0].systematic
        if last is not None:
            found = Systematics(last.names, *map(np.concatenate, zip(*errors, strict=True)))
        return Finished(final, None, total, systematic=found)


class Handed(NamedTuple):
    """The newest w observations of a smoother: frame (w,), z (w, 2), R (w, 2, 2), its pairing (w,)."""

    frame: IntArray
    z: Array
    R: Array
    number: IntArray

    def of(self, rows: IntArray | BoolArray) -> "Handed":
        """A selection of rows."""
        return Handed(self.frame[rows], self.z[rows], self.R[rows], self.number[rows])


NOTHING = Handed(np.empty(0, np.int64), np.empty((0, 2)), np.empty((0, 2, 2)), np.empty(0, np.int64))


class LocalizingFrontEnd(FrontEnd):
    """Decides by pose hypotheses, for any estimator with a known map. Fixes and closures weigh the hypotheses."""

    def __init__(
        self, estimator: str, association: str, given: Given, setup: Setup, options: FilterOptions | None = None
    ) -> None:
        """Check map and estimator. Raises UsageError: without a map; CannotError: the estimator has no `reset`."""
        if given.map is None:
            raise UsageError("hypotheses of the pose alone need a known map")
        super().__init__(estimator, association, given, setup, options)
        iterated = FilterOptions(iterations=constants.HYPOTHESIS_ITERATIONS)
        self.bank = Hypotheses(given.prior, given.sensor, given.map, iterated)
        keep_frames(given, self.bank)
        self.health = Health()
        self._scans = (EMPTY, EMPTY)  # observations since each cumulative sum left zero
        self.alarms: list[int] = []  # frames in which the monitor detected a lost robot
        self.found: list[int] = []  # frames in which it was relocalized
        self.online: list[int] = []  # decisions as they were made, one for each observation so far
        self._now: list[int] = []  # decisions after revisions
        self._revised: list[Event] = []  # revised decisions, in order
        self._restarted = 0  # rows before this one are settled: relocalization began a new past
        self._first = 0  # first row of the frame
        self._decided = np.empty(0, np.int64)
        self._was_single, self._found_again = True, False
        self._handed, self._held_until = NOTHING, 0
        """Of a smoother: all of the frames from that on in which not all hypotheses agree, up to this observation."""
        self._open, self._seen = 0, 0  # the first observation that they do not agree about, and how many there were
        if self.estimator.smooths:

            def begin(prior: Prior) -> Estimator:
                return make_estimator(estimator, self.given._replace(prior=prior), options, lag=setup.lag)

            self.use(Stretches(begin, given.prior))
            if is_foreign(estimator):
                self.own = OwnInnovations(self.estimator.expect, self.given.sensor)
        self._pose = needed(self.can.get("reset"), "`reset`", f"--association {HINDSIGHT}")

    @property
    def passed(self) -> Acceptance:
        """The wide gate of the hypotheses."""
        return Acceptance(gate_threshold(hypotheses.GATE))

    def move(self, frame: Frame) -> None:
        """Predict the next frame, by all hypotheses."""
        super().move(frame)
        self._first = frame.first
        if frame.increment is not None:
            self.bank.predict(frame.increment)
            self._scans = (moved(self._scans[0], frame.increment), moved(self._scans[1], frame.increment))

    def use_poses(self, frame: Frame) -> None:
        """Update with the frame's fixes and closures, in the hypotheses too. After a reset a filter no longer knows the
        frames before; it is reset again where only the hypotheses can use a closure.
        """
        super().use_poses(frame)
        past = self.bank.members[0].past
        own, (_, theirs) = self.poses.closed, self.poses.of(frame, self.bank, self.bank)
        self._revise(past)
        if own is None or theirs is None or self.estimator.smooths:
            return
        lacking = np.isnan(own.nis) & np.isfinite(theirs.nis)
        if lacking.any():
            self._pose.reset(*self.bank.estimate())
            own.enter(lacking, theirs.of(lacking))

    def associate(self, frame: Frame) -> Pairing:
        """Decide about (a part of) this frame's observations; after a relocalization the estimator has no say."""
        times = len(self.found)
        self._decided = self._decide(frame)
        self._seen = frame.first + len(self._decided)
        self._found_again = len(self.found) > times
        if self._found_again:
            return Pairing(self._decided)
        self._hand_over(frame.first, constants.DECISION_WEIGHT)
        return super().associate(frame)

    def decide(self, expectation: Expectation, method: str | None = None) -> Decided:
        """Decisions by the hypotheses, or by another method; a smoother gets only candidates that it expects."""
        if method is not None:
            return super().decide(expectation, method)
        return Decided(np.where(np.isin(self._decided, expectation.number), self._decided, DISCARD), True)

    def _decide(self, frame: Frame) -> IntArray:
        """Decisions (m,) about observations of this frame: landmark id, or `DISCARD` where they are postponed."""
        past = self.bank.members[0].past
        standing = self.bank.observe(frame.observations, frame.first, frame.appearance)
        self._revise(past)
        before, paired = self.health, int((standing.decisions >= 0).sum())
        self.health = watch(before, len(standing.decisions), paired, standing.nis, standing.dof)
        decisions = np.where(standing.sure >= constants.DECISION_WEIGHT, standing.decisions, DISCARD)
        sums = self.health.unpaired, self.health.misfit
        self._scans = (self._since(sums[0], self._scans[0], frame), self._since(sums[1], self._scans[1], frame))
        if self.health.lost:
            if not before.lost:
                self.alarms.append(self.k)
            alone = self._since(math.inf, EMPTY, frame)
            for scan in [*[scan for s, scan in zip(sums, self._scans, strict=True) if s >= constants.ALARM], alone]:
                place = relocalize(scan, self.bank.map)
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
        pairs = zip(place.pairings.tolist(), scan.rows, strict=True)
        by_row = {row: number if number >= 0 else DISCARD for number, rows in pairs for row in rows}
        for row in sorted(by_row):
            self._change(row, by_row[row], "its place was found without a prior")
        self._restarted = max(by_row) + 1
        self.bank.restart(place.pose, place.covariance)
        self.health, self._scans = recovered(self.health), (EMPTY, EMPTY)
        self.found.append(self.k)
        return np.array([by_row[row] for row in sorted(by_row)], np.int64)

    def _revise(self, old: Choice | None) -> None:
        """Replace the past of the previous leader by that of the present one, back to where they differ."""
        new = self.bank.members[0].past
        while new is not None and (old is None or new.row > old.row):
            new = new.before
        while new is not None and old is not None and new is not old and new.row >= self._restarted:
            if new.number != old.number:
                self._change(new.row, new.number, "another hypothesis leads")
            new, old = new.before, old.before

    def _change(self, row: int, number: int, why: str) -> None:
        if row < self._first and number != (before := self._now[row]):
            self._revised.append(Event(self.k, row, before, number, why))
            self._now[row] = number

    def update(self, frame: Frame, pairing: Pairing) -> Updated:
        """Use the decisions; after a relocalization, only reset the pose."""
        if self._found_again:
            self._was_single = True
            self._pose.reset(*self.bank.estimate())
            nothing = np.full(len(pairing.decisions), -1, np.int64)
            self._hold(frame, np.full(len(pairing.decisions), DISCARD, np.int64))
            return Updated(pairing.decisions >= 0, nothing, math.nan, 0, math.nan)
        done = super().update(frame, pairing)
        self._hold(frame, np.where(done.used, pairing.decisions, DISCARD))
        single = len(self.bank.members) == 1
        several, self._was_single = not (single and self._was_single), single
        if (several and not self.estimator.smooths) or self._elsewhere():
            self._pose.reset(*self.bank.estimate())
        return done

    def _hand_over(self, stop: int, share: float) -> None:
        """Hand over decisions before row `stop` that a weight of at least `share` of the hypotheses agree on."""
        if not self.estimator.smooths or stop <= self._open:
            return
        count, held = stop - self._open, self._handed
        number, sure = (a[:count] for a in self.bank.opinion(self._seen - self._open))
        first = self._open - (self._held_until - len(held.frame))
        rows = np.arange(first, first + count)
        changed = (sure >= share) & (number != held.number[rows])
        if changed.any():
            held.number[rows[changed]] = number[changed]
            whole = held.of(np.isin(held.frame, held.frame[rows[changed]]))
            if "amend" in self.can:
                self.can["amend"].amend(whole.frame, FrameObservations(whole.z, whole.R), whole.number)
        undecided = np.flatnonzero(sure < 1.0)
        self._open = self._open + int(undecided[0]) if len(undecided) else stop
        oldest = held.frame[rows[undecided[0]]] if len(undecided) else self.k
        self._handed = held.of(held.frame >= oldest)

    def _hold(self, frame: Frame, number: IntArray) -> None:
        """Remember the landmarks of a frame's observations in a smoother."""
        if self.estimator.smooths:
            new = np.full(len(number), frame.number), *frame.observations, number
            self._handed = Handed(*(np.concatenate(both) for both in zip(self._handed, new, strict=True)))
            self._held_until = self._seen

    def _elsewhere(self) -> bool:
        """Whether there is one hypothesis, and the estimator contradicts its pose."""
        if len(self.bank.members) > 1:
            return False
        (mean, P), (own, covariance) = self.bank.estimate(), self.estimator.estimate()
        error = pose_error(own, mean)
        # an exact prior has no inverse; a micrometre is no other place
        both = P + covariance + constants.EXACT_VARIANCE * np.eye(3)
        return float(error @ np.linalg.solve(both, error)) > gate_threshold(constants.MOTION_GATE, 3)

    def close(self) -> None:
        """Postponed and open decisions become those of the leading hypothesis."""
        last = self.bank.decisions(len(self.online))
        for row in np.flatnonzero(last != np.array(self._now, np.int64)).tolist():
            if row >= self._restarted or self._now[row] == DISCARD != last[row]:
                self._change(row, int(last[row]), "put off until the end")
        self._hand_over(self._seen, 0.0)

    def events(self) -> tuple[Event, ...]:
        """Revised decisions."""
        return tuple(self._revised)

    def notes(self) -> list[Notice]:
        """Messages about the run, revisions and alarms."""
        notes = [*super().notes(), notice(Code.REVISED_POSES, decisions=len({e.observation for e in self._revised}))]
        if self.alarms:
            times, first = len(self.alarms), self.alarms[0]
            notes.append(notice(Code.FOUND_AGAIN, times=times, first=first, found=len(self.found)))
        return notes

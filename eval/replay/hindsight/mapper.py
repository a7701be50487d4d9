"""SLAM without labels, decisions in hindsight: the nine steps of `docs/hindsight.md`, in their order.

The deciding filter always estimates systematic errors (`ekf.systematic`), because decisions depend on the possible
drift of the odometry. Every estimator gets the decisions, none gets the filter's estimate. A filter drops or merges
landmarks in its state; a smoother removes their factors and re-attaches those of merged ones.
"""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

import numpy as np

from association.appearance import evidence
from association.candidates import in_view
from association.expectation import Expectation
from association.truncated import Acceptance, of_places
from data.errors import UsageError
from data.inputs import ERRORS, Frame, FrameObservations, Increment, IntArray, Systematic
from data.notice import Code, Notice, notice
from data.result import Event
from data.se2 import Array
from ekf.filter import FilterOptions
from ekf.slam import EkfSlam
from eval.replay.estimators import needed
from eval.replay.frontend import FrontEnd, Pairing
from eval.replay.hindsight import constants
from eval.replay.hindsight.duplicates import Duplicates
from eval.replay.hindsight.gates import LearnedGates, pair, widest
from eval.replay.hindsight.kidnapping import Kidnapping
from eval.replay.hindsight.ledger import Ledger
from eval.replay.hindsight.lost import Lost
from eval.replay.hindsight.noise import AS_STATED, Restated
from eval.replay.hindsight.placement import Memory, Placed, drifted, place, too_uncertain
from eval.replay.hindsight.record import detection_rate
from eval.replay.hindsight.two_models import TwoModels
from eval.replay.hindsight.whole_log import Assumed, Smoothed, WholeLog
from eval.replay.poses import PoseMeasurements, keep_frames
from eval.replay.settings import HINDSIGHT, Given, Setup


class UncertainMotion:
    """Motion since the last pairing with the map, and the poses from which the map was seen."""

    def __init__(self, ledger: Ledger, setup: Setup) -> None:
        self.ledger, self.setup = ledger, setup
        self.placed = 0  # number of frames whose pose was found by geometry
        self._motion = np.zeros((3, 3))
        self._explained = (0, 0)  # observations where the map was in view before: paired, and strays
        self._seen_from: deque[Array] = deque(maxlen=constants.REMEMBERED_FRAMES)

    def move(self, increment: Increment) -> None:
        """The robot moved."""
        self._motion = drifted(self._motion, increment)

    def place(self, e: Expectation, predicted: Array) -> Placed | None:
        """The pose of a frame by geometry; None if the prediction is good enough, or the map does not give a pose."""
        sensor, s = self.ledger.sensor, self.setup
        if e.elsewhere is None or not too_uncertain(e, sensor, self._motion):
            return None
        strays = 1.0 - detection_rate(*self._explained)
        memory = Memory(self._seen_from, self.ledger.rates(e.number), strays)
        found = place(e, sensor, predicted, self._motion, memory, s.gate, s.new_gate)
        if found is not None:
            self.placed += 1
            paired, sudden = self._explained
            self._explained = paired + int((found.decisions >= 0).sum()), sudden + found.sudden
        return found

    def see(self, pose: Array, paired: bool) -> None:
        """Note a used frame and its pose (3,); `paired`: with landmarks of the map."""
        self._seen_from.append(pose)
        if paired or len(self._seen_from) == 1:
            self._motion = np.zeros((3, 3))

    def notes(self) -> list[Notice]:
        """A message about placed frames."""
        mostly = 2 * self.placed > self.ledger.frames
        return [notice(Code.PLACED, frames=self.placed, mostly=mostly)] if self.placed else []


TIGHT = Systematic(("scale", "curvature", "left", "right", "drift"), np.array([0.02, 2e-3, 0.05, 0.05, 1.25e-3]), 50.0)
"""Odometry errors of a calibrated robot, which the filter estimates in addition to those of the run.

The rate of the drift, sigma^2 / length, is 3.1e-8. On Victoria Park 2e-8 to 4.5e-8 leave 122 to 126 false positives;
1e-8 loses a loop, and 6e-8 closes wrong ones."""


def with_tight(run: Systematic | None) -> Systematic:
    """The errors that a run estimates, with its priors, and those of `TIGHT` that it does not.

    With the errors alone that the residuals of Victoria Park name, loops are not closed (twice as many landmarks).
    """
    if run is None:
        return TIGHT
    sigma = dict(zip(TIGHT.names, TIGHT.sigma, strict=True)) | dict(zip(run.names, run.sigma, strict=True))
    names = tuple(name for name in ERRORS if name in sigma)
    return Systematic(names, np.array([sigma[name] for name in names]), run.length)


class Mapped(NamedTuple):
    """Decisions (m,), whether the search was complete, and the pose (3,) of a placed frame.

    kidnapped: covariance (3, 3) to be added to the motion into this frame, if the robot was moved unseen; S: (2k, 2k)
    joint covariance of the innovations of its k pairings, None: not formed.
    """

    decisions: IntArray
    complete: bool
    at: Array | None
    kidnapped: Array | None
    S: Array | None = None


class Revision(NamedTuple):
    """Revisions of a frame: retracted landmarks (r,); merged ones (j,) and those they are merged into, `kept` (j,)."""

    retracted: IntArray
    merged: IntArray
    kept: IntArray


class Closed(NamedTuple):
    """The end of a log.

    retracted: (r,) landmarks that are transient, or have no observation left; left: (l,) those of the map that left
    before; settled: frames (m,), observations and landmarks (m,) of the final decisions, None: they are
    those so far; gated: as of `whole_log.Smoothed`.
    """

    retracted: IntArray
    left: IntArray
    settled: tuple[IntArray, FrameObservations, IntArray] | None
    gated: tuple[float, float] | None


class HindsightMapper:
    """Decides about the observations of a log without a map: `move`, `decide`, `revise`; at the end `close`.

    Landmark numbers are in the order of creation, as in every estimator that gets the decisions.
    """

    def __init__(self, given: Given, setup: Setup) -> None:
        self.setup = setup
        self._systematic = with_tight(given.systematic)
        self.restated = Restated(given.sensor)  # noise of odometry and sensor
        self.filters = TwoModels(given.prior, given.sensor, self._systematic, undecided=given.systematic is None)
        self.ledger = Ledger(given.sensor)  # their landmarks and the revisions
        self.motion = UncertainMotion(self.ledger, setup)  # whether a frame can be predicted
        self.gates = LearnedGates(self.ledger)  # learned variance scales
        self.kidnapping = Kidnapping(self.ledger, setup)  # whether the robot was moved unseen
        self.duplicates = Duplicates(self.ledger)  # landmarks initialized twice
        self.lost = Lost(self.ledger)  # plausibility of the map; decides nothing
        keep_frames(given, self.filters)
        self.whole = WholeLog(given, setup.gate)  # the log, for the final re-association
        self._end: list[Notice] = []  # messages about it

    @property
    def filter(self) -> EkfSlam:
        """The believed filter."""
        return self.filters.believed

    def move(self, frame: Frame) -> None:
        """Step 1, predict; the first frame has no motion."""
        self.whole.move(frame)
        frame = self.restated.see(frame)
        self.ledger.move(frame)
        if frame.increment is not None:
            self.filters.predict(frame.increment)
            self.motion.move(frame.increment)
            self.kidnapping.move(frame.increment)

    def use_poses(self, frame: Frame, poses: PoseMeasurements) -> None:
        """Update with the frame's fixes and closures, after step 1."""
        self.whole.poses.enter(frame, *poses.of(frame, self.filters, self.filters))

    def decide(self, frame: Frame) -> Mapped:
        """Steps 2 to 7: decisions about observations of this frame, also used by the filter."""
        frame = self.restated.restated(frame)
        e = self._expect(frame)
        placed = self.motion.place(e, self.filter.estimate().mean)  # 2
        if placed is None:
            decisions, complete = self._pair(e)  # 3, 4
            self.ledger.judge(e, decisions, self.filter.estimate().mean)  # 5
            decisions, at, kidnapped = self.kidnapping.decide(self.filters, frame, decisions)  # 6
            decided = Mapped(decisions, complete, at, kidnapped)
        else:
            self.ledger.judge(placed.expectation, placed.decisions, placed.pose, placed.believed)  # 5
            decided = Mapped(placed.decisions, True, placed.pose, None)
            e = placed.expectation
        # not after an unknown motion or a search: these pairings passed no gate; nor under larger noise, whose gate
        # cuts off hardly anything of the stated distribution
        stated = self.restated.shares == AS_STATED
        if stated and decided.kidnapped is None and np.isin(decided.decisions[decided.decisions >= 0], e.number).all():
            decided = decided._replace(S=e.joint_innovation(*e.paired(decided.decisions))[1])
        self._update(frame, decided)  # 7
        if decided.kidnapped is not None:
            self.whole.loosen(decided.kidnapped)
        return decided

    def _expect(self, frame: Frame) -> Expectation:
        e = self.filter.expect(frame.observations)
        e = e.only(np.flatnonzero(in_view(self.restated.widened(self.filter.sensor), e.z_hat, e.HPHt)))
        seen = frame.appearance
        return e if seen is None else e.with_appearance(self.ledger.looks.unlike(e.number, seen))

    def _pair(self, e: Expectation) -> tuple[IntArray, bool]:
        """Step 3, pair by the learned noise; step 4, postpone what only the stated noise explains."""
        among, decisions, complete, self.ledger.epoch = pair(e, self.filter, self.ledger, self.gates.scales, self.setup)
        if len(e.number) and len(e.z):
            decisions = self.gates.put_off(among, decisions, self.filter.estimate().mean, self.setup.new_gate)
        self.gates.learn(e, decisions)
        return decisions, complete

    def _update(self, frame: Frame, decided: Mapped) -> None:
        """Step 7, update the filter, initialize landmarks, and record detections."""
        self.lost.see(frame, decided.decisions, self.filter.estimate().mean)
        done = self.filters.update(frame.observations, decided.decisions, at=decided.at)
        pose = self.filter.estimate().mean
        self.ledger.see(frame, decided.decisions, done, pose)
        self.motion.see(pose, bool(done.used.any()))

    def revise(self) -> Revision:
        """Steps 8 and 9, the end of a frame: retract and merge landmarks, in the filter already."""
        self.whole.end_frame(self.filter.estimate().mean)
        retracted = self._remove(self.ledger.contradicted())  # 8
        pairs = self.kidnapping.duplicates() or self.duplicates.find(self.filter, widest(self.gates.scales))  # 9
        merged, kept = np.array(pairs, np.int64).reshape(-1, 2).T
        if len(merged):
            self.filters.merge(merged, kept)
            self.ledger.merge(pairs)
        return Revision(retracted, merged, kept)

    def leave(self, numbers: IntArray) -> None:
        """Remove landmarks (r,) that left the estimator's map for another reason."""
        self.whole.managed = True
        self.ledger.drop(numbers)
        self._remove(numbers)

    def close(self) -> Closed:
        """The end of the log: re-associate all observations, and retract landmarks."""
        often = [n for n, r in self.ledger.records.items() if r.evidence.seen >= constants.CONFIRMED]
        by = Assumed(self.ledger.view, self.restated, self._systematic if self.filters.has_errors else None)
        found = self.whole.reassociate(self.ledger.records, self.filter.landmarks(), by)
        unobserved = np.empty(0, np.int64)
        if isinstance(found, Smoothed):
            other = self.whole.plain(found, self.setup, constants.PLAIN_MOST * self.ledger.created, by)
            if other is not None:
                found = other.smoothed
                self._end.append(notice(Code.PLAIN_LIKELIER, odds=other.odds))
            unobserved = self._remove(self.ledger.reassociate(found.found))
        elif found is not None:
            self._end.append(found)
        smoothed = found if isinstance(found, Smoothed) else None
        last = self.ledger.close({} if smoothed is None else smoothed.opportunities)
        settled = None if smoothed is None else self.whole.settled(self.ledger.records)
        self.lost.end(often, last.transient)
        if folded := [self.whole.frame_of(row) for row in last.folded]:
            gone, every = len(folded), len(folded) + len(self.ledger.records)
            self._end.append(notice(Code.MAP_FOLDED, landmarks=gone, of=every, first=min(folded), last=max(folded)))
        retracted = np.concatenate([unobserved, self._remove(last.transient)])
        return Closed(retracted, last.left, settled, None if smoothed is None else smoothed.gated)

    def _remove(self, numbers: IntArray) -> IntArray:
        if len(numbers):
            self.filters.remove(numbers)
        return numbers

    @property
    def events(self) -> list[Event]:
        """The revisions, in order."""
        return self.ledger.events

    def notes(self) -> list[Notice]:
        """Messages about the run."""
        return [
            *self.restated.notes(), *self.ledger.notes(), *self.motion.notes(), *self.kidnapping.notes(),
            *self.ledger.merge_notes(), *self.lost.notes(), *self._end,
        ]  # fmt: skip


class MappingFrontEnd(FrontEnd):
    """Front end with decisions by `HindsightMapper`; the log has no map."""

    revises_map = True
    asks_for_innovations = True

    def __init__(
        self, estimator: str, association: str, given: Given, setup: Setup, options: FilterOptions | None = None
    ) -> None:
        """Check options and estimator.

        Raises UsageError: with one update per observation. Raises CannotError: landmarks of the estimator's map cannot
        be removed and merged.
        """
        if options is not None and options.each:
            raise UsageError(f"{HINDSIGHT} judges the observations of a frame together; they cannot be used one by one")
        super().__init__(estimator, association, given, setup, options)
        self._map = needed(self.can.revisable, "`remove` and `merge`", f"--association {HINDSIGHT}")
        self.mapper = HindsightMapper(given, setup)  # decides; its `events` are the revisions

    @property
    def passed(self) -> Acceptance:
        """Each pairing is tested given the others; the outer gate rejects next to nothing."""
        return Acceptance(conditional=of_places(self.setup.gate, 2, right=self._right))

    def move(self, frame: Frame) -> None:
        """Take the next frame."""
        super().move(frame)
        self.mapper.move(frame)

    def use_poses(self, frame: Frame) -> None:
        """Update with the frame's fixes and closures, in the mapper's own filter too."""
        super().use_poses(frame)
        self.mapper.use_poses(frame, self.poses)

    def associate(self, frame: Frame) -> Pairing:
        """Decide about this frame's observations; the mapper has its own expectation."""
        decisions, complete, at, kidnapped, S = self.mapper.decide(frame)
        self._right = evidence(frame.appearance)
        self.incomplete += not complete
        if kidnapped is not None and self.can.inflatable is not None:
            self.can.inflatable.inflate(kidnapped)
        return Pairing(decisions, at=at, S=S)

    def tidy(self) -> None:
        """Retract and merge landmarks in hindsight, and remove those that the setup rules out."""
        found = self.mapper.revise()
        self._retract(found.retracted)
        if len(found.merged):
            if self.parking is not None:
                self.parking.restore(np.concatenate([found.merged, found.kept]))
            self._map.merge(found.merged, found.kept)
            self._gone(found.merged)
        super().tidy()

    def leave(self, numbers: IntArray) -> None:
        """Remove landmarks (r,) by the rules of the setup; nothing more is decided about them."""
        super().leave(numbers)
        self.mapper.leave(numbers)

    def close(self) -> None:
        """Re-associate all observations and retract transient landmarks."""
        end = self.mapper.close()
        self._retract(end.retracted)
        self.left, self.gated_final = end.left, end.gated
        if end.settled is not None and self.can.amendable is not None:
            self.can.amendable.amend(*end.settled)

    def _retract(self, numbers: IntArray) -> None:
        if len(numbers):
            self._map.remove(numbers)
            self._gone(numbers)

    def _gone(self, numbers: IntArray) -> None:
        assert self.map_management is not None  # the map is revised
        self.map_management.remove(numbers)

    def events(self) -> tuple[Event, ...]:
        """Revised decisions."""
        return tuple(self.mapper.events)

    def notes(self) -> list[Notice]:
        """Messages about the run."""
        return [*super().notes(), *self.mapper.notes()]

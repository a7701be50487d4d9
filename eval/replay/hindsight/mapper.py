"""SLAM without labels, decisions in hindsight: the nine steps of `docs/hindsight.md`, in their order.

The deciding filter always estimates systematic errors (`ekf.systematic`), because decisions depend on the possible
drift of the odometry. Every estimator gets the decisions, none gets the filter's estimate. A filter drops or merges
landmarks in its state; a smoother removes their factors and re-attaches those of merged ones.
"""

from __future__ import annotations

from collections import deque

import numpy as np

from association.appearance import evidence
from association.candidates import in_view
from association.expectation import Expectation
from association.truncated import Acceptance, of_places
from data.inputs import ERRORS, Frame, Increment, IntArray, Systematic
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
from eval.replay.hindsight.kidnapping import Kidnapping, Lost
from eval.replay.hindsight.ledger import Ledger, detection_rate
from eval.replay.hindsight.noise import AS_STATED, Restated
from eval.replay.hindsight.placement import Memory, Placed, drifted, place, too_uncertain
from eval.replay.hindsight.two_models import TwoModels
from eval.replay.hindsight.whole_log import Assumed, Smoothed, WholeLog
from eval.replay.poses import keep_frames
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


class MappingFrontEnd(FrontEnd):
    """Decides about the observations of a log without a map, by a filter of its own, for any estimator.

    Landmark numbers are in the order of creation, as in every estimator that gets the decisions.
    """

    revises_map = True
    asks_for_innovations = True

    def __init__(
        self, estimator: str, association: str, given: Given, setup: Setup, options: FilterOptions | None = None
    ) -> None:
        """Raises CannotError: landmarks of the estimator's map cannot be removed and merged."""
        super().__init__(estimator, association, given, setup, options)
        self._map = needed(self.can.get("merge"), "`remove` and `merge`", f"--association {HINDSIGHT}")
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

    @property
    def passed(self) -> Acceptance:
        """Each pairing is tested given the others; the outer gate rejects next to nothing."""
        return Acceptance(conditional=of_places(self.setup.gate, 2, right=self._right))

    def move(self, frame: Frame) -> None:
        """Step 1, predict; the first frame has no motion."""
        super().move(frame)
        self.whole.move(frame)
        frame = self.restated.see(frame)
        self.ledger.move(frame)
        if frame.increment is not None:
            self.filters.predict(frame.increment)
            self.motion.move(frame.increment)
            self.kidnapping.move(frame.increment)

    def use_poses(self, frame: Frame) -> None:
        """Update with the frame's fixes and closures, after step 1; the deciding filter, too."""
        super().use_poses(frame)
        self.whole.poses.enter(frame, *self.poses.of(frame, self.filters, self.filters))

    def associate(self, frame: Frame) -> Pairing:
        """Steps 2 to 7: decisions about observations of this frame, also used by the deciding filter."""
        self._right = evidence(frame.appearance)
        frame = self.restated.restated(frame)
        e = self.filter.expect(frame.observations)
        e = e.only(np.flatnonzero(in_view(self.restated.widened(self.filter.sensor), e.z_hat, e.HPHt)))
        if frame.appearance is not None:
            e = e.with_appearance(self.ledger.looks.unlike(e.number, frame.appearance))
        predicted = self.filter.estimate().mean
        placed, kidnapped = self.motion.place(e, predicted), None  # 2
        if placed is None:
            decisions = self._pair(e, predicted)  # 3, 4
            self.ledger.judge(e, decisions, predicted)  # 5
            decisions, at, kidnapped = self.kidnapping.decide(self.filters, frame, decisions)  # 6
        else:
            e, decisions, at = placed.expectation, placed.decisions, placed.pose
            self.ledger.judge(e, decisions, at, placed.believed)  # 5
        S = None
        # not after an unknown motion or a search: these pairings passed no gate; nor under larger noise, whose gate
        # cuts off hardly anything of the stated distribution
        plain = self.restated.shares == AS_STATED and kidnapped is None
        if plain and set(decisions[decisions >= 0].tolist()) <= set(e.number.tolist()):
            S = e.joint_innovation(*e.paired(decisions))[1]
        self._learn(frame, decisions, at)  # 7
        if kidnapped is not None:
            self.whole.loosen(kidnapped)
            if "inflate" in self.can:
                self.can["inflate"].inflate(kidnapped)
        return Pairing(decisions, at=at, S=S)

    def _pair(self, e: Expectation, pose: Array) -> IntArray:
        """Step 3, pair by the learned noise; step 4, postpone what only the stated noise explains."""
        among, found, self.ledger.epoch = pair(e, self.filter, self.ledger, self.gates.scales, self.setup)
        decisions, self.incomplete = found.decisions, self.incomplete + (not found.complete)
        if len(e.number) and len(e.z):
            decisions = self.gates.put_off(among, found, pose, self.setup.new_gate)
        self.gates.learn(e, decisions)
        return decisions

    def _learn(self, frame: Frame, decisions: IntArray, at: Array | None) -> None:
        """Step 7, update the deciding filter, initialize landmarks, and record detections."""
        self.lost.see(frame, decisions, self.filter.estimate().mean)
        done = self.filters.update(frame.observations, decisions, at=at)
        pose = self.filter.estimate().mean
        self.ledger.see(frame, decisions, done, pose)
        self.motion.see(pose, bool(done.used.any()))

    def tidy(self) -> None:
        """Steps 8 and 9, the end of a frame: retract and merge landmarks, and remove those that the setup rules out."""
        self.whole.end_frame(self.filter.estimate().mean)
        self._retract(self.ledger.contradicted())  # 8
        pairs = self.kidnapping.duplicates() or self.duplicates.find(self.filter, widest(self.gates.scales))  # 9
        if pairs:
            merged, kept = np.array(pairs, np.int64).T
            self.filters.each(lambda slam: slam.merge(merged, kept))
            self.ledger.merge(pairs)
            if self.parking is not None:
                self.parking.restore(np.concatenate([merged, kept]))
            self._map.merge(merged, kept)
            self._gone(merged)
        super().tidy()

    def leave(self, numbers: IntArray) -> None:
        """Remove landmarks (r,) by the rules of the setup; nothing more is decided about them."""
        super().leave(numbers)
        self.whole.managed = True
        self.ledger.drop(numbers)
        self.filters.each(lambda slam: slam.remove(numbers))

    def close(self) -> None:
        """The end of the log: re-associate all observations, and retract landmarks without any and transient ones."""
        ledger, whole = self.ledger, self.whole
        often = [n for n, r in ledger.records.items() if r.evidence.seen >= constants.CONFIRMED]
        by = Assumed(ledger.view, self.restated, self._systematic if self.filters.has_errors else None)
        found = whole.reassociate(ledger.records, self.filter.landmarks(), by)
        smoothed = found if isinstance(found, Smoothed) else None
        unobserved = np.empty(0, np.int64)
        if isinstance(found, Notice):
            self._end.append(found)
        if smoothed is not None:
            other = whole.plain(smoothed, self.setup, constants.PLAIN_MOST * ledger.created, by)
            if other is not None:
                smoothed, odds = other
                self._end.append(notice(Code.PLAIN_LIKELIER, odds=odds))
            unobserved = ledger.reassociate(smoothed.found)
            self.gated_final = smoothed.gated
        transient, self.left, last_seen = ledger.close({} if smoothed is None else smoothed.opportunities)
        self.lost.end(often, transient)
        if last_seen:
            folded, gone = whole.settled(ledger.records)[0][last_seen].tolist(), len(last_seen)
            every = gone + len(ledger.records)
            self._end.append(notice(Code.MAP_FOLDED, landmarks=gone, of=every, first=min(folded), last=max(folded)))
        self._retract(np.concatenate([unobserved, transient]))
        if smoothed is not None and "amend" in self.can:
            self.can["amend"].amend(*whole.settled(ledger.records))

    def _retract(self, numbers: IntArray) -> None:
        if len(numbers):
            self.filters.each(lambda slam: slam.remove(numbers))
            self._map.remove(numbers)
            self._gone(numbers)

    def _gone(self, numbers: IntArray) -> None:
        assert self.map_management is not None  # the map is revised
        self.map_management.remove(numbers)

    def events(self) -> tuple[Event, ...]:
        """Revised decisions."""
        return tuple(self.ledger.events)

    def notes(self) -> list[Notice]:
        """Messages about the run."""
        return [
            *super().notes(), *self.restated.notes(), *self.ledger.notes(), *self.motion.notes(),
            *self.kidnapping.notes(), *self.ledger.merge_notes(), *self.lost.notes(), *self._end,
        ]  # fmt: skip

"""SLAM without labels, decisions in hindsight: the nine steps of `docs/hindsight.md`, in their order.

A filter decides that estimates systematic errors along with the map (`ekf.systematic`), whether the estimators do or
not, because decisions need to know how far odometry may have drifted; every estimator gets the decisions, none gets the
filter's estimate.
See `eval.replay.hindsight.mapping_frontend` for how an estimator lives with what is decided.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from association.candidates import in_view
from association.expectation import Expectation
from data.inputs import ERRORS, Frame, FrameObservations, IntArray, Systematic
from data.notice import Notice
from data.result import Event
from data.se2 import Array
from ekf.slam import EkfSlam
from eval.replay.hindsight import constants
from eval.replay.hindsight.duplicates import Duplicates
from eval.replay.hindsight.gates import LearnedGates, pair, widest
from eval.replay.hindsight.kidnapping import Kidnapping
from eval.replay.hindsight.ledger import Ledger
from eval.replay.hindsight.lost import Lost
from eval.replay.hindsight.noise import AS_STATED, Restated
from eval.replay.hindsight.two_models import TwoModels
from eval.replay.hindsight.uncertain_motion import UncertainMotion
from eval.replay.hindsight.whole_log import WholeLog
from eval.replay.settings import Given, Setup

TIGHT = Systematic(("scale", "curvature", "left", "right", "drift"), np.array([0.02, 2e-3, 0.05, 0.05, 1.25e-3]), 50.0)
"""Errors of odometry that the filter estimates beside those of the run: what remains of a robot that was calibrated.

How fast the drift changes, sigma^2 / length, is 3.1e-8 here. On Victoria Park 2e-8 to 4.5e-8 (sigma 1e-3 to 1.5e-3,
length 25 to 100 m) leave 122 to 126 false positives; 1e-8 loses a loop, and 6e-8 closes wrong ones.
"""


def beside_tight(run: Systematic | None) -> Systematic:
    """The errors that a run estimates, with its priors, and beside them those of `TIGHT` that it does not.

    Decisions need to know how far the path may have drifted even where estimates do without: on Victoria Park, with
    the errors alone that its residuals name, loops are not closed (twice as many landmarks).
    """
    if run is None:
        return TIGHT
    sigma = dict(zip(TIGHT.names, TIGHT.sigma, strict=True)) | dict(zip(run.names, run.sigma, strict=True))
    names = tuple(name for name in ERRORS if name in sigma)
    return Systematic(names, np.array([sigma[name] for name in names]), run.length)


class Mapped(NamedTuple):
    """Decisions (m,), whether the search for them was complete, and where (3,) the frame was placed, if it was.

    kidnapped: where the robot turned out to have been moved unseen, what is to be added (3, 3) to the covariance of the
    motion into this frame; S: (2k, 2k) joint covariance of the innovations of its k pairings, None: not formed.
    """

    decisions: IntArray
    complete: bool
    at: Array | None
    kidnapped: Array | None
    S: Array | None = None


class Revision(NamedTuple):
    """What a frame takes back: landmarks as if never seen (r,); those (j,) that are one with others, `kept` (j,)."""

    retracted: IntArray
    merged: IntArray
    kept: IntArray


class HindsightMapper:
    """What decides about the observations of a log without a map: `move`, `decide`, `revise`; at the end `close`.

    Landmark numbers are in the order of creation, as in every estimator that gets the decisions.

    Attributes:
        restated: what odometry and sensor are really like.
        filters: what decides.
        ledger: its landmarks, and what was revised.
        motion: whether a frame can be predicted.
        gates: the noise that there is, by which it decides.
        kidnapping: whether the robot has been moved unseen.
        duplicates: which landmarks were initialized twice.
        lost: whether its own map is to be believed; decides nothing.
        whole: the log, to be looked at once more in the end.
    """

    def __init__(self, given: Given, setup: Setup) -> None:
        """Before the first frame."""
        self.setup = setup
        self._systematic = beside_tight(given.systematic)
        self.restated = Restated(given.sensor)
        self.filters = TwoModels(given.prior, given.sensor, self._systematic, doubted=given.systematic is None)
        self.ledger = Ledger(given.sensor)
        self.motion = UncertainMotion(self.ledger, setup)
        self.gates = LearnedGates(self.ledger)
        self.kidnapping = Kidnapping(self.ledger, setup)
        self.duplicates = Duplicates(self.ledger)
        self.lost = Lost(self.ledger)
        self.whole = WholeLog(given)

    @property
    def filter(self) -> EkfSlam:
        """The one that is believed."""
        return self.filters.believed

    def move(self, frame: Frame) -> None:
        """Step 1, predict: the next frame comes; the first one has no motion."""
        self.whole.move(frame)
        frame = self.restated.see(frame)
        self.ledger.move(frame)
        if frame.increment is not None:
            self.filters.predict(frame.increment)
            self.motion.move(frame.increment)
            self.kidnapping.move(frame.increment)

    def decide(self, frame: Frame) -> Mapped:
        """Steps 2 to 7: decisions about observations of this frame, used by the filter, too."""
        frame = self.restated.restated(frame)
        e = self._expect(frame.observations)
        placed = self.motion.place(e, self.filter.estimate().mean)  # 2
        if placed is None:
            decisions, complete = self._pair(e)  # 3, 4
            self.ledger.judge(e, decisions)  # 5
            decisions, at, kidnapped = self.kidnapping.decide(self.filters, frame, decisions)  # 6
            decided = Mapped(decisions, complete, at, kidnapped)
        else:
            self.ledger.judge(placed.expectation, placed.decisions, placed.believed)  # 5
            decided = Mapped(placed.decisions, True, placed.pose, None)
            e = placed.expectation
        # not where the motion turned out to be unknown, or the search found the place: those pairings passed no gate;
        # and where there is more noise than was stated, they passed one that hardly cuts off any of what was stated
        stated = self.restated.shares == AS_STATED
        if stated and decided.kidnapped is None and np.isin(decided.decisions[decided.decisions >= 0], e.number).all():
            decided = decided._replace(S=e.joint_innovation(*e.paired(decided.decisions))[1])
        self._update(frame, decided)  # 7
        if decided.kidnapped is not None:
            self.whole.loosen(decided.kidnapped)
        return decided

    def _expect(self, observations: FrameObservations) -> Expectation:
        e = self.filter.expect(observations)
        return e.only(np.flatnonzero(in_view(self.restated.widened(self.filter.sensor), e.z_hat, e.HPHt)))

    def _pair(self, e: Expectation) -> tuple[IntArray, bool]:
        """Step 3, pair by the noise that there is; step 4, put off what only the stated noise explains."""
        among, decisions, complete = pair(e, self.filter, self.ledger, self.gates.scales, self.setup)
        if len(e.number) and len(e.z):
            decisions = self.gates.put_off(among, decisions, self.filter.estimate().mean, self.setup.new_gate)
        self.gates.learn(e, decisions)
        return decisions, complete

    def _update(self, frame: Frame, decided: Mapped) -> None:
        """Step 7, update the filter with the decisions, initialize landmarks, and note what was seen."""
        self.lost.look(frame, decided.decisions, self.filter.estimate().mean)
        done = self.filters.update(frame.observations, decided.decisions, at=decided.at)
        pose = self.filter.estimate().mean
        self.ledger.see(frame, decided.decisions, done, pose)
        self.motion.see(pose, bool(done.used.any()))

    def revise(self) -> Revision:
        """Steps 8 and 9, the end of a frame: what is taken back, from the filter already."""
        self.whole.end_frame(self.filter.estimate().mean)
        retracted = self._remove(self.ledger.contradicted())  # 8
        pairs = self.kidnapping.duplicates() or self.duplicates.find(self.filter, widest(self.gates.scales))  # 9
        merged, kept = np.array(pairs, np.int64).reshape(-1, 2).T
        if len(merged):
            self.filters.merge(merged, kept)
            self.ledger.merge(pairs)
        return Revision(retracted, merged, kept)

    def leave(self, numbers: IntArray) -> None:
        """Landmarks (r,) left the estimator's map for another reason: they leave this one, too."""
        self.whole.managed = True
        self.ledger.drop(numbers)
        self._remove(numbers)

    def close(self) -> IntArray:
        """The end of the log: all is paired anew, and landmarks (r,) are taken back.

        Those that may have been there for a while only, and those of which no reading is left.
        """
        often = [n for n, r in self.ledger.records.items() if r.evidence.seen >= constants.CONFIRMED]
        errs = self._systematic if self.filters.errs else None
        anew = self.whole.reassociate(self.ledger.records, self.filter.landmarks(), self.restated, errs)
        unread = self._remove(self.ledger.reassociate(anew)) if anew is not None else np.empty(0, np.int64)
        gone = self.ledger.uncertain()
        if anew is not None:
            self.whole.settle(self.ledger.records)
        self.lost.end(often, gone)
        return np.concatenate([unread, self._remove(gone)])

    def _remove(self, numbers: IntArray) -> IntArray:
        if len(numbers):
            self.filters.remove(numbers)
        return numbers

    @property
    def events(self) -> list[Event]:
        """The revisions, in order."""
        return self.ledger.events

    def notes(self) -> list[Notice]:
        """What a reader of the results should know."""
        return [
            *self.restated.notes(), *self.ledger.notes(), *self.motion.notes(), *self.kidnapping.notes(),
            *self.ledger.merge_notes(), *self.lost.notes(),
            *([self.whole.failed] if self.whole.failed is not None else []),
        ]  # fmt: skip

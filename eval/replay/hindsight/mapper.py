"""SLAM without labels, decisions in hindsight: the nine steps of `docs/notes/hindsight-steps.md`, in their order.

The deciding filter always estimates systematic errors (`ekf.systematic`), because decisions depend on the possible
drift of the odometry. Every estimator gets the decisions, none gets the filter's estimate. A filter drops or merges
landmarks in its state; a smoother removes their factors and re-attaches those of merged ones.

Step 6, SLAM's monitors: detect a kidnapped robot and relocalize it in its own map; tell whether a map is plausible.

A robot that pairs nothing where confirmed landmarks should be in view was kidnapped; exploration misses nothing. After
the alarm the motion counts as unknown, and the scan since then is searched in the map without a prior.

A robot lost while mapping observes known surroundings as new: it misses confirmed landmarks and observes newer ones in
their place. Exploration misses no old landmarks; a bad sensor misses many, but also observes old ones. So two kinds
count: confirmed landmarks that are paired, and those missed where something newer was observed. One frame is one piece
of evidence, because its errors have one cause; frames from one place are one, too. A second test at the end: most
landmarks of a bent map are retracted. Both tests (`Lost`) only report; they decide nothing.
"""

import math
from collections import deque
from collections.abc import Callable, Sequence
from typing import NamedTuple, TypeVar

import numpy as np

from association.appearance import evidence
from association.candidates import in_view
from association.conditional import jcbb_conditional
from association.expectation import Expectation
from association.truncated import Acceptance, of_places
from data.inputs import ERRORS, Frame, FrameObservations, Increment, IntArray, LandmarkMap, Prior, Systematic
from data.notice import Code, Notice, notice
from data.pose_measurements import Closures, Fixes, FixSource, PoseUpdated
from data.result import DISCARD, Event, Updated
from data.se2 import Array
from data.sensors import Sensor
from ekf.filter import FilterOptions
from ekf.slam import EkfSlam
from eval.replay.estimators import needed
from eval.replay.frontend import FrontEnd, Pairing, keep_frames
from eval.replay.hindsight import constants
from eval.replay.hindsight.duplicates import Duplicates
from eval.replay.hindsight.gates import LearnedGates, clear, dense, pair, widest
from eval.replay.hindsight.ledger import Epoch, Ledger, detection_rate
from eval.replay.hindsight.noise import AS_STATED, Restated
from eval.replay.hindsight.placement import Memory, Placed, drifted, place, too_uncertain
from eval.replay.hindsight.relocalize import EMPTY, extended, moved, relocalize
from eval.replay.hindsight.whole_log import Assumed, Smoothed, WholeLog
from eval.replay.settings import HINDSIGHT, Given, Setup

Result = TypeVar("Result")
STRONG = 5.0
"""Log odds of very strong evidence, 150 to 1 (Kass and Raftery, "Bayes factors", Journal of the American Statistical
Association 90, 1995)."""
DECIDED = 14.0
"""Log odds at which the less likely model is dropped; it is the right one in one of exp(DECIDED) logs (Wald's
inequality)."""


class TwoModels:
    """EKF-SLAM under two odometry models, with and without systematic errors; the better predictor counts.

    Whether odometry has systematic errors (`ekf.systematic`) is unknown beforehand. Without the errors in the state, no
    loop is closed where they exist; with them, every gate is wider and wrong loops are closed where they do not. Both
    filters get the same decisions. The likelihood ratio of their innovations is a sequential probability ratio test
    (Wald, "Sequential tests of statistical hypotheses", Annals of Mathematical Statistics 16, 1945).
    """

    def __init__(self, prior: Prior, sensor: Sensor, systematic: Systematic, *, undecided: bool = True) -> None:
        """Start at the prior with empty maps. `undecided`: test whether there are errors; else they are assumed."""
        self._stated, self._erring = EkfSlam(prior, sensor), EkfSlam(prior, sensor, systematic=systematic)
        self._kept = [self._stated, self._erring] if undecided else [self._erring]
        self.log_odds = 0.0  # of systematic errors against odometry as stated, from the innovations so far

    @property
    def believed(self) -> EkfSlam:
        """The filter with systematic errors, unless there is strong evidence against them."""
        return self._erring if self.has_errors else self._stated

    @property
    def has_errors(self) -> bool:
        """Whether systematic odometry errors are assumed."""
        return self.log_odds >= -STRONG

    def each(self, step: Callable[[EkfSlam], Result]) -> Result:
        """Let all filters do a step; returns the result of the believed one."""
        return {each: step(each) for each in self._kept}[self.believed]

    def predict(self, increment: Increment) -> None:
        """Move by an increment."""
        self.each(lambda slam: slam.predict(increment))

    def update(self, observations: FrameObservations, decisions: IntArray, *, at: Array | None = None) -> Updated:
        """See `EkfSlam.update`; returns the result of the filter that was believed before the frame."""
        before, done = self.believed, {each: each.update(observations, decisions, at=at) for each in self._kept}
        if len(done) > 1 and done[before].dof:
            self.log_odds += done[self._erring].log_likelihood - done[self._stated].log_likelihood
            if abs(self.log_odds) > DECIDED:
                self._kept = [self.believed]
        return done[before]

    def keep(self, last_use: dict[int, int]) -> None:
        """See `Filter.keep`."""
        self.each(lambda slam: slam.keep(last_use))

    def fix(self, fixes: Fixes, sources: tuple[FixSource, ...], gate: float | None) -> PoseUpdated:
        """See `Filter.fix`."""
        return self.each(lambda slam: slam.fix(fixes, sources, gate))

    def close_loops(self, closures: Closures, gate: float | None) -> PoseUpdated:
        """See `Filter.close_loops`."""
        return self.each(lambda slam: slam.close_loops(closures, gate))


class Relocated(NamedTuple):
    """Decisions (m,) of a frame; pose (3,) found by relocalization, or None; see `Mapped.kidnapped`, or None."""

    decisions: IntArray
    at: Array | None
    kidnapped: Array | None


class Kidnapping:
    """The cumulative sum of the evidence, and the scan since the alarm."""

    def __init__(self, ledger: Ledger, setup: Setup) -> None:
        self.ledger, self.setup = ledger, setup
        self.lost = False  # since an alarm, until the place is found or landmarks of the map are paired again
        self.alarms: list[int] = []  # frames of alarms and of recoveries
        self.found: list[int] = []
        self._score, self._scan = 0.0, EMPTY
        self._before = 0  # number of the first landmark initialized since the trouble began
        self._same: list[tuple[int, int]] = []
        """Landmarks that were initialized since, and those of the map that they are."""

    def move(self, increment: Increment) -> None:
        """The robot moved."""
        if self.lost:
            self._scan = moved(self._scan, increment)

    def decide(self, filters: TwoModels, frame: Frame, decisions: IntArray) -> Relocated:
        """Final decisions about a frame whose decisions (m,) the ledger has judged; a lost filter is inflated."""
        ledger, slam, kidnapped = self.ledger, filters.believed, None
        if self._alarm(len(decisions), ledger.paired(decisions)):
            kidnapped = unknown = anywhere(slam.xy, ledger.range)
            filters.each(lambda each: each.inflate(unknown))
            ledger.epoch = Epoch(ledger.travelled, ledger.created)
        if self.lost and np.trace(slam.estimate().covariance[:2, :2]) < (constants.FOUND_AGAIN * ledger.range) ** 2:
            self._recover()  # by a constellation
        if not self.lost:
            return Relocated(decisions, None, kidnapped)
        known = slam.landmarks()
        held = np.isin(known.number, ledger.confirmed())
        found = self._search(frame, LandmarkMap(known.number[held], known.xy[held]))
        if found is not None:
            return Relocated(*found, kidnapped)
        e, seen = slam.expect(frame.observations), frame.appearance
        if seen is not None:
            e = e.with_appearance(ledger.looks.unlike(e.number, seen))
        few = e.only(clear(e, dense(e, slam, ledger, self.setup), ledger.epoch))
        return Relocated(jcbb_conditional(few, self.setup.gate, self.setup.new_gate)[0], None, kidnapped)

    def _alarm(self, seen: int, paired: int) -> bool:
        """Whether missed detections, and unpaired ones of the `seen` observations, raise the alarm in this frame."""
        if self._score == 0.0 and not self.lost:
            self._before = self.ledger.created
        missed = self.ledger.surprise() if seen >= constants.ALARM_OBSERVATIONS else 0.0
        self._score = max(0.0, self._score + missed - constants.PAIRING_TRUST * paired)
        if self.lost or self._score < constants.ALARM:
            return False
        self.lost, self._score, self._scan = True, 0.0, EMPTY
        self.alarms.append(self.ledger.frame)
        return True

    def _search(self, frame: Frame, known: LandmarkMap) -> tuple[IntArray, Array] | None:
        """Decisions (m,) and pose (3,) of the frame if the scan has one place among the landmarks from before."""
        old = known.id < self._before
        rows = np.arange(frame.first, frame.first + len(frame.observations.z))
        self._scan = extended(self._scan, self.ledger.sensor, frame.observations, rows)
        place = relocalize(self._scan, LandmarkMap(known.id[old], known.xy[old]))
        if place is None:
            return None
        self._recover()
        pairs = zip(place.pairings.tolist(), self._scan.rows, strict=True)
        number_of = {row: number for number, points in pairs if number >= 0 for row in points}
        initialized = {r.observations[0][0]: n for n, r in self.ledger.records.items()}
        self._same = [(initialized[row], n) for row, n in number_of.items() if row in initialized]
        return np.array([number_of.get(row, DISCARD) for row in rows.tolist()], np.int64), place.pose

    def _recover(self) -> None:
        self.lost, self._score = False, 0.0
        self.found.append(self.ledger.frame)

    def duplicates(self) -> list[tuple[int, int]]:
        """Landmarks initialized while lost that equal others of the map: (away, kept)."""
        records, same = self.ledger.records, dict(self._same)
        self._same = []
        return [(away, kept) for away, kept in same.items() if away in records and kept in records and kept < away]

    def notes(self) -> list[Notice]:
        """A message about alarms."""
        if not self.alarms:
            return []
        times, first = len(self.alarms), self.alarms[0]
        return [notice(Code.MOVED_UNSEEN, times=times, first=first, found=len(self.found))]


def anywhere(xy: Array, reach: float) -> Array:
    """Covariance (3, 3) of a motion to anywhere in a map (n, 2) or within the sensor's reach of it."""
    size = float(np.hypot(*np.ptp(xy, axis=0))) if len(xy) else 0.0
    return np.diag([(size + reach) ** 2, (size + reach) ** 2, math.pi**2])


class Suspicion(NamedTuple):
    """State of the test while mapping. score: see the module; since: frame after the last one with score 0."""

    score: float = 0.0
    since: int = 0
    alarm: int | None = None  # frame since which the robot has been lost, from the first alarm, None: no alarm
    over: int | None = None  # frame where the score returned to 0, None: not yet


def suspect(before: Suspicion, frame: int, paired: int, replaced: int) -> Suspicion:
    """After a frame from another place with this many paired and replaced confirmed landmarks."""
    if not paired + replaced:
        return before
    here, lost = constants.PAIRED_HEALTHY, constants.PAIRED_LOST
    ratio = paired * math.log(lost / here) + replaced * math.log((1.0 - lost) / (1.0 - here))
    after = before._replace(score=max(0.0, before.score + ratio / (paired + replaced)))
    if after.score == 0.0:
        over = frame if after.alarm is not None and after.over is None else after.over
        return after._replace(since=frame + 1, over=over)
    if after.score >= constants.PAIRED_ALARM:
        return after._replace(alarm=after.since if after.alarm is None else after.alarm, over=None)
    return after


class Lost:
    """Tests every frame that the ledger has judged."""

    def __init__(self, ledger: Ledger) -> None:
        self.ledger, self.suspicion = ledger, Suspicion()
        self._place = (math.inf, math.inf)
        self.often, self.retracted = 0, 0  # number of often observed landmarks, and of those retracted at the end

    def see(self, frame: Frame, decisions: IntArray, pose: Array) -> None:
        """Add a frame with its decisions (m,), before the update; `pose` (3,) is the predicted one."""
        x, y = self._place
        if math.hypot(pose[0] - x, pose[1] - y) < constants.SAME_PLACE * self.ledger.range:
            return
        paired, replaced = self.ledger.replaced(decisions)
        if paired + replaced:
            self._place = float(pose[0]), float(pose[1])
        self.suspicion = suspect(self.suspicion, frame.number, paired, replaced)

    def end(self, often: Sequence[int], retracted: IntArray) -> None:
        """The end of the log: often observed landmarks (n,) and retracted ones (r,)."""
        self.often, self.retracted = len(often), int(np.isin(often, retracted).sum())

    def notes(self) -> list[Notice]:
        """Messages about a restarted or bent map."""
        s, found = self.suspicion, []
        if s.alarm is not None:
            found.append(notice(Code.MAP_RESTARTED, frame=s.alarm, over=s.over))
        if self.often >= constants.RETRACTED_FEWEST and self.retracted > constants.RETRACTED_SHARE * self.often:
            found.append(notice(Code.RETRACTED, gone=self.retracted, often=self.often))
        return found


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
        memory = Memory(self._seen_from, self.ledger.rates(e.number), 1.0 - detection_rate(*self._explained))
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
    """The errors that a run estimates, with its priors, and those of `TIGHT` that it does not. With the errors alone
    that the residuals of Victoria Park name, loops are not closed (twice as many landmarks).
    """
    if run is None:
        return TIGHT
    sigma = dict(zip(TIGHT.names, TIGHT.sigma, strict=True)) | dict(zip(run.names, run.sigma, strict=True))
    names = tuple(name for name in ERRORS if name in sigma)
    return Systematic(names, np.array([sigma[name] for name in names]), run.length)


class MappingFrontEnd(FrontEnd):
    """Decides about the observations of a log without a map, by a filter of its own, for any estimator. Landmark
    numbers are in the order of creation, as in every estimator that gets the decisions.
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
        self.whole.forgets = self.setup.forget_after is not None and not self.estimator.smooths
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
        transient, self.left, last_seen = ledger.close({} if smoothed is None else smoothed.detections)
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

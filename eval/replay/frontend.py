"""One estimator with one association method, its fixes and closures, frame by frame: replay, live, step-through."""

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from association.appearance import Evidence, Looks, evidence
from association.candidates import Faces, aligned_with_observations, in_view
from association.decide import Decided, decide, horizon, pair_by_label
from association.expectation import Expectation, gate_threshold
from association.jcbb import BUDGET
from association.triangulate import triangulate
from association.truncated import Acceptance, acceptance, accepted_moments, truncated_square
from data.appearance import Appearance
from data.inputs import Frame, FrameObservations, IntArray, LandmarkMap
from data.notice import Code, Notice, notice
from data.pose_measurements import Closures, Fixes, PoseUpdated, not_used
from data.result import DISCARD, NEW, Event, Finished, MapState, Updated, surviving
from data.se2 import Array
from data.sensors import Sensor
from ekf.filter import Filter, FilterOptions
from ekf.localizer import EkfLocalizer
from eval.replay.estimators import Able, Closable, Estimator, Fixable, capabilities, make_estimator, needed
from eval.replay.external.adapter import Adapter, Method, OwnInnovations, load, locked
from eval.replay.external.spec import is_foreign, name_of
from eval.replay.map_management import MapManagement, Parking, automatic_parking
from eval.replay.settings import HINDSIGHT, MHT, Beginning, Given, Setup

MOST = 16
"""Observations of a landmark that wait; of more, every second one is left out, so that they span the way since the
first. They cost the filter a pose each."""


class Waiting(NamedTuple):
    """One observation: its frame, row of the log, numbers (2,), covariance (2, 2) and sensor."""

    frame: int
    row: int
    z: Array
    R: Array
    sensor: Sensor


class Begun(NamedTuple):
    """A landmark that began: its label and number, the rows (m,) of its observations, and the statistics of `nis`."""

    label: int
    number: int
    rows: IntArray
    nis: float
    dof: int
    log_likelihood: float


class WaitingLandmarks:
    """By label, the observations of landmarks that are not in the map yet."""

    def __init__(self) -> None:
        self._of: dict[int, list[Waiting]] = {}
        self._fresh = set[int]()

    def add(self, frame: Frame, rows: IntArray, sensor: Sensor, estimator: Able) -> None:
        """Observations `rows` (m,) of (a part of) a frame, whose labels are not in the map."""
        assert frame.label is not None
        for i in rows.tolist():
            label = int(frame.label[i])
            seen = Waiting(frame.number, frame.first + i, frame.observations.z[i], frame.observations.R[i], sensor)
            waiting = self._of.setdefault(label, [])
            waiting.append(seen)
            if len(waiting) > MOST:
                self._of[label] = waiting[::-2][::-1]
                self._release(waiting[-2::-2], estimator)
            self._fresh.add(label)
            estimator.hold(frame.number)

    def begin(self, estimator: Able) -> list[Begun]:
        """Initialize the landmarks of the present frame whose places are now determined."""
        begun = []
        for label in sorted(self._fresh):
            waiting = self._of[label]
            sensors = [w.sensor for w in waiting]
            if sum(len(s.measures) for s in sensors) < 3:
                continue
            frames = np.array([w.frame for w in waiting])
            seen = FrameObservations(np.array([w.z for w in waiting]), np.array([w.R for w in waiting]))
            place = triangulate(sensors, *estimator.held(frames), *seen)
            if place is not None:
                number, nis, dof, likelihood = estimator.initialize(frames, sensors, seen, place.xy)
                begun.append(Begun(label, number, np.array([w.row for w in waiting]), nis, dof, likelihood))
                del self._of[label]
                self._release(waiting, estimator)
        self._fresh.clear()
        return begun

    def _release(self, waiting: list[Waiting], estimator: Able) -> None:
        """Keep the poses of these observations no longer, unless others need them."""
        for frame in {w.frame for w in waiting} - {w.frame for other in self._of.values() for w in other}:
            estimator.release(frame)


class KnownAssociation:
    """Decisions by label; in SLAM a label names the landmark that it initialized, while that is in the map."""

    def __init__(self, known: LandmarkMap | None) -> None:
        """`known` is the map of localization."""
        self.map = known
        self._number_of: dict[int, int] = {}
        self._label_of: dict[int, int] = {}

    def decide(self, frame: Frame) -> IntArray:
        """Decisions (m,) about a frame's observations. Raises ValueError where labels were not granted."""
        if frame.label is None:
            raise ValueError("known association was not granted to these inputs")
        if self.map is not None:
            return np.where(self.map.rows(frame.label) >= 0, frame.label, DISCARD)
        return pair_by_label(frame.label, self._number_of)

    def initialized(self, frame: Frame, created: IntArray) -> None:
        """Note landmarks (m,) that the frame's observations initialized, -1 for none."""
        assert frame.label is not None  # or `decide` raised
        for i in (created >= 0).nonzero()[0].tolist():
            self.begun(int(frame.label[i]), int(created[i]))

    def begun(self, label: int, number: int) -> None:
        """A landmark began by an observation with this label, or by several."""
        self._number_of[label], self._label_of[number] = number, label

    def removed(self, numbers: IntArray) -> None:
        """Forget landmarks (r,): their labels may initialize others."""
        for n in numbers.tolist():
            self._number_of.pop(self._label_of.pop(n, -1), None)


class Pairing(NamedTuple):
    """Decisions (m,) about (a part of) a frame, and the expectation they were made from, if any."""

    decisions: IntArray
    expectation: Expectation | None = None
    at: Array | None = None  # pose (3,) of a placed frame, where the estimator may linearize first
    S: Array | None = None  # (2k, 2k) joint covariance of the innovations of its k gated pairings; None: not formed


class FrontEnd:
    """Steps of a frame, in this order: move, use_poses, associate, update, tidy; after the last one close."""

    revises_map = False  # whether landmarks leave the map for other reasons than map management's
    asks_for_innovations = False  # whether the estimator must form its innovations
    gated_final: tuple[float, float] | None = None  # see `Run`, as `left`
    left: IntArray | None = None

    def __init__(
        self, estimator: str, association: str, given: Given, setup: Setup, options: FilterOptions | None = None
    ) -> None:
        """Make the estimator. Raises CannotError: the estimator lacks a capability that the setup needs."""
        self.given = Beginning(*(getattr(given, name) for name in Beginning._fields))
        self.setup = setup
        self.sensor = given.sensor  # that of the observations at hand
        self.association = name_of(association)  # `known` (labels decide) or a method's name
        self._method = Method(load(association)) if is_foreign(association) else association
        self.use(make_estimator(estimator, given, options, lag=setup.lag))
        self.slam = given.map is None
        self.k, self.incomplete = -1, 0  # frame; frames in which the search ran out of its budget
        within = math.inf  # labels and hindsight use no distance, and the reach of a foreign method is unknown
        if association not in ("known", HINDSIGHT, MHT) and not is_foreign(association):
            within = horizon(association, setup.gate, setup.new_gate, known_map=not self.slam, looks=given.looks)
        if isinstance(self.estimator, EkfLocalizer):
            self.estimator.within = within
        # a graph need not park, and leaving it is no forgetting: the landmark was never seen
        kept = replace(setup, forget_after=None, deactivate_after=None) if self.estimator.smooths else setup
        self.map_management: MapManagement | None = None
        self.parking: Parking | None = None
        if self.slam and (kept.manages_map or self.revises_map):
            self.map_management = MapManagement(kept)  # which landmarks leave the map; None where all stay
            if kept.deactivate_after is not None and given.closures is None:
                self.parking = Parking(self.estimator, self.can, self.map_management, given.sensor, within)
            if kept.retracts or kept.forget_after is not None:
                needed(self.can.get("remove"), "`remove`", "--maintain" if kept.retracts else "--forget-after")
        partial = self.slam and not all(s.locates for s in given.sensors or (given.sensor,))
        self.waiting = WaitingLandmarks() if partial else None  # landmarks that are not located yet
        self.begun: list[Begun] = []  # those that began in this frame
        if self.parking is None and given.closures is None and not partial:
            self.parking = automatic_parking(self.estimator, association, setup, given.looks)
        self.faces = Faces(given.sensor) if self.slam and not given.sensor.sees_points else None
        self.known = KnownAssociation(given.map) if association == "known" else None
        gated = self.known is not None and (setup.gate_smoothers or not self.estimator.smooths)
        self._label_gate = setup.label_gate if gated else None
        self._threshold = gate_threshold(self._label_gate, len(self.sensor.measures))
        self.looks, self._right = Looks.of_map(given.map), Evidence()  # of landmarks; of a frame's right pairings
        self._kind: dict[int, str] = {}  # of landmarks that are not for every sensor, by number
        if given.map is not None and given.map.kind is not None:
            self._kind = dict(zip(given.map.id.tolist(), given.map.kind, strict=True))

    def use(self, estimator: Estimator) -> None:
        """Give the decisions to this estimator, before its first frame."""
        self.estimator, self.can = estimator, capabilities(estimator)  # gets the decisions; its capabilities
        self.foreign = estimator if isinstance(estimator, Adapter) else None  # if it is foreign
        self.poses = PoseMeasurements(
            self.given, self.can.get("fix"), self.can.get("close_loops"), self.setup.gate_poses
        )
        self.own: OwnInnovations | None = None  # its innovations
        if self.foreign is not None:
            self.own = OwnInnovations(self.foreign.expect if self.foreign.has("expect") else None, self.given.sensor)

    def move(self, frame: Frame) -> None:
        """Predict the next frame; the first one has no motion."""
        self.k = frame.number
        if frame.increment is not None:
            self.estimator.predict(frame.increment)
            if self.parking is not None:
                self.parking.move(frame.increment)
        if "stamp" in self.can:
            self.can["stamp"].stamp(frame.time)
        if self.map_management is not None:
            self.map_management.begin(frame.number, frame.time)

    def look(self, frame: Frame) -> None:
        """Use the sensor of (a part of) a frame; `Frame.by_sensor`."""
        if frame.sensor is None or self.sensor is (sensor := self.given.sensors[int(frame.sensor[0])]):
            return
        needed(self.can.get("look"), "`look`", "a log with several sensors").look(sensor)
        self.sensor = sensor
        self._threshold = gate_threshold(self._label_gate, len(sensor.measures))

    def use_poses(self, frame: Frame) -> None:
        """Update with the frame's fixes and closures."""
        self.poses.use(frame)

    def associate(self, frame: Frame) -> Pairing:
        """Decide about (a part of) this frame's observations."""
        if self.known is not None:
            decisions = self.known.decide(frame)
            if self.waiting is not None and not self.sensor.locates:
                self.waiting.add(frame, np.flatnonzero(decisions == NEW), self.sensor, self._delaying)
                decisions = np.where(decisions == NEW, DISCARD, decisions)
            return Pairing(decisions)
        expectation = self.expect(frame.observations, frame.appearance)
        decisions, complete = self.decide(expectation)
        self.incomplete += not complete
        return Pairing(decisions, expectation, S=expectation.joint_innovation(*expectation.paired(decisions))[1])

    @property
    def passed(self) -> Acceptance:
        """The gates that a used pairing has passed."""
        if self.known is not None:
            return Acceptance(self._threshold)
        return acceptance(self.association, self.setup.gate, len(self.sensor.measures), self._right)

    def expect(self, observations: FrameObservations, appearance: Appearance | None = None) -> Expectation:
        """The expectation of candidates beside the appearance; parked landmarks in view are restored first."""
        if self.parking is not None:
            self.parking.offer(observations)
        self._right = evidence(appearance)
        e = aligned_with_observations(self.estimator.expect(observations), self.sensor)
        if self.sensor.sees and self._kind:
            kinds = [self._kind.get(n, self.sensor.sees) for n in e.number.tolist()]
            e = e.only(np.flatnonzero(np.array(kinds, object) == self.sensor.sees))
        if self.faces is not None and len(e.number):
            e = e.only(np.flatnonzero(self.faces.visible(*self.estimator.estimate(), e.number, e.z_hat)))
        if self.setup.in_view:
            e = e.only(np.flatnonzero(in_view(self.sensor, e.z_hat, e.HPHt)))
        return e if appearance is None else e.with_appearance(self.looks.unlike(e.number, appearance))

    def decide(self, expectation: Expectation, method: str | None = None) -> Decided:
        """Decisions by the method of this run, or by another one for comparison."""
        s = self.setup
        chosen = self._method if method is None else method
        offered = expectation if isinstance(chosen, str) else locked(expectation)
        return decide(chosen, offered, s.gate, s.new_gate, known_map=not self.slam)

    def update(self, frame: Frame, pairing: Pairing) -> Updated:
        """Use the decisions: one update with all pairings, then new landmarks from the updated pose."""
        if self.parking is not None:
            self.parking.restore(pairing.decisions)
        # a smoother forms no innovations unless asked to, and a foreign estimator's are not believed; the expectation
        # has them, until the update
        formed = None
        if self.own is not None:
            self.own.before(frame.observations, pairing.decisions, pairing.expectation, pairing.at)
        elif pairing.expectation is not None and self.estimator.smooths:
            formed = pairing.expectation.innovation_statistics(*pairing.expectation.paired(pairing.decisions))
        done = self.estimator.update(
            frame.observations, pairing.decisions, threshold=self._threshold, at=pairing.at,
            innovations=self.asks_for_innovations,
        )  # fmt: skip
        if self.known is not None and self.slam:
            self.known.initialized(frame, done.created)
        if self.slam and self.sensor.sees:
            self._kind |= dict.fromkeys(done.created[done.created >= 0].tolist(), self.sensor.sees)
        if any(of is not None for of in (frame.appearance, self.faces, self.map_management, self.parking)):
            self._see(frame, np.where(done.used, pairing.decisions, done.created))
        if self.own is not None:
            done = self.own.after(done)
        elif formed is not None:
            done = done._replace(nis=formed[0], dof=formed[1], log_likelihood=formed[2])
        moments = self._moments(pairing.S, done.dof)
        return done if moments is None else done._replace(moments=moments)

    def _see(self, frame: Frame, numbers: IntArray) -> None:
        """Tell all that follow landmarks which ones the frame observed, by observation (m,), negative for none."""
        seen = np.flatnonzero(numbers >= 0)
        if frame.appearance is not None:
            self.looks.see(numbers, frame.appearance)
        if self.faces is not None:
            self.faces.see(self.estimator.estimate().mean, numbers[seen], frame.observations.z[seen])
        if self.map_management is not None:
            self.map_management.see(numbers[seen])
        if self.parking is not None:
            self.parking.see(FrameObservations(frame.observations.z[seen], frame.observations.R[seen]), numbers[seen])

    def _moments(self, S: Array | None, dof: int) -> tuple[float, float] | None:
        """Expected mean and variance of a frame's NIS; None where innovations are chi-square, or it is not known."""
        if self.passed.everything:
            return None
        if self.known is not None:  # each pairing by itself
            dims = len(self.sensor.measures)
            mean, variance = truncated_square(self._threshold, dims)
            return mean * dof / dims, variance * dof / dims
        measures = self.sensor.measures
        whole = S is not None and len(S) // 2 * len(measures) == dof
        return accepted_moments(S, self.passed, self.k, measures) if S is not None and whole else None

    @property
    def _delaying(self) -> Able:
        return needed(self.can.get("initialize"), "`initialize`", "SLAM with bearings or ranges alone")

    def tidy(self) -> None:
        """The end of a frame: waiting landmarks begin, and others leave by the rules of the setup."""
        if self.waiting is not None:
            self.begun = self.waiting.begin(self._delaying)
            assert self.known is not None  # or these sensors were refused
            for each in self.begun:
                self.known.begun(each.label, each.number)
        if self.parking is not None:
            self.parking.measure()
        if self.map_management is None:
            return
        leaving = self.map_management.leaving()
        removed = np.concatenate([leaving.retracted, leaving.forgotten])
        if len(removed):
            self.leave(removed)
            if self.known is not None:
                self.known.removed(removed)
        if self.parking is not None:
            self.parking.park(leaving.parked)

    def leave(self, numbers: IntArray) -> None:
        """Remove landmarks (r,) by the rules of the setup."""
        assert "remove" in self.can  # or these rules were refused
        self.can["remove"].remove(numbers)

    def close(self) -> None:
        """End the log."""

    def finish(self) -> Finished:
        """The end of the estimator's run, after `close`."""
        return self.estimator.finish()

    def initialized(self, final: IntArray, created: IntArray) -> tuple[IntArray, IntArray | None]:
        """Landmarks (M,) that observations initialized, -1 for none: at any time, and by the final decisions (M,).

        A landmark begins with the observation that changes from a pairing into `NEW`. None: there is no such revision.
        """
        events = self.events()
        if all(e.new != NEW for e in events):
            return created, None
        found = surviving(final, created)
        for e in events:
            found[e.observation] = e.old if e.new == NEW else -1
        return created, found

    @property
    def state_size(self) -> int:
        """Length of the state with the poses of earlier frames that are kept in it, 0 if there is none."""
        if self.parking is not None:
            return self.parking.state_size
        if isinstance(self.estimator, Filter):
            return self.estimator.size + self.estimator.kept
        return 0 if "size" not in self.can else self.can["size"].size

    def events(self) -> tuple[Event, ...]:
        """Revised decisions; none if decided frame by frame."""
        return ()

    def landmarks(self) -> MapState:
        """The current map, parked landmarks included; a given one has no covariance."""
        return self.estimator.landmarks()

    def as_decided(self, numbers: IntArray) -> IntArray:
        """Numbers (n,) by which decisions name these landmarks (n,) of the estimator."""
        return numbers

    def notes(self) -> list[Notice]:
        """Messages about the run."""
        notes, s = [], self.setup
        notes += [] if self.foreign is None else self.foreign.notes()
        notes += [] if self.own is None else self.own.notes()
        notes += self.poses.notes()
        if self.slam and not self.estimator.smooths and s.deactivate_after is not None and self.parking is None:
            notes.append(notice(Code.NOT_PARKED))
        if self.incomplete:
            notes.append(notice(Code.OUT_OF_NODES, method=self.association, nodes=BUDGET, frames=self.incomplete))
        if self.slam and self.estimator.smooths and (s.forget_after is not None or s.deactivate_after is not None):
            notes.append(notice(Code.FILTER_ONLY))
        if self.parking is not None:
            notes += self.parking.notes()
        if self.map_management is not None and self.map_management.removed:
            notes.append(notice(Code.REMOVED, landmarks=len(self.map_management.removed)))
        return notes


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

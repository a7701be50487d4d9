"""The association problem of one frame: the decisions of each method on the same expectation, and the truth."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from association.expectation import Expectation, SingularInnovationError
from data.inputs import CLUTTER, Frame, IntArray
from data.log import Log
from data.result import DISCARD, NEW
from data.sensors import Sensor
from data.truth import UNKNOWN_ID
from eval.referee.confusion import OUTCOMES, Confusion, confuse
from eval.replay.frontend import FrontEnd, Pairing
from eval.replay.recorder import Observer
from eval.replay.run import step_by_step
from eval.replay.settings import Setup

COMPARED = ("nn", "singles", "ml", "jcbb")  # methods shown side by side
RIGHT = ("tp", "tn")


class TruthRow(NamedTuple):
    """The referee's judgement of one frame's m observations."""

    ground_truth: IntArray  # (m,) number of the right landmark, negative for none
    outcome: IntArray  # (m,) index into `OUTCOMES`

    @property
    def correct(self) -> list[bool]:
        """Whether each decision is right."""
        return [OUTCOMES[o] in RIGHT for o in self.outcome.tolist()]

    @property
    def wrong(self) -> dict[int, str]:
        """Outcomes of the wrong decisions by observation."""
        return {i: OUTCOMES[o] for i, o in enumerate(self.outcome.tolist()) if OUTCOMES[o] not in RIGHT}

    @property
    def counts(self) -> dict[str, int]:
        """Observations by outcome, in the order of `OUTCOMES`."""
        found = Counter(self.outcome.tolist())
        return {name: found[i] for i, name in enumerate(OUTCOMES)}


def row_of(confusion: Confusion | None, rows: slice) -> TruthRow | None:
    """The part of a run's outcomes that belongs to some observations."""
    return None if confusion is None else TruthRow(confusion.ground_truth[rows], confusion.outcome[rows])


class FrameSoFar(NamedTuple):
    """A frame that is decided about: its rows of the log, and decisions and initialized landmarks (M,) so far."""

    log: Log
    task: str
    rows: slice
    decisions: IntArray
    created: IntArray
    removed: IntArray | None  # as in `Run`

    def judged(self, decided: IntArray | None = None) -> TruthRow | None:
        """The referee's judgement of its observations, or of other decisions `decided` (m,); None without true ids. It
        depends only on these and on the observations that initialized landmarks, so only these are judged.
        """
        true_id = self.log.truth.landmark_of
        if true_id is None or np.any(true_id == UNKNOWN_ID):
            return None
        first = np.flatnonzero(self.created[: self.rows.start] >= 0)
        those = np.concatenate([first, np.arange(self.rows.start, self.rows.stop)])
        known = self.log.recorded.map if self.task == "localization" else None
        made = self.decisions[those]
        if decided is not None:
            made[len(first) :] = decided
        frame = self.log.recorded.observations.frame[those]
        scored = confuse(frame, true_id[those], made, self.created[those], known, self.removed)
        return row_of(scored, slice(len(first), None))


@dataclass(frozen=True, eq=False)
class Matching:
    """A frame's problem and its solutions."""

    title: str  # of the figure
    expectation: Expectation  # given to every method
    sensor: Sensor
    gate: float | None  # probability of the individual test, None for none
    decisions: Mapping[str, IntArray | str]  # (m,) by method, in the order of the panels; a text is the reason for none
    chosen: str  # the method that updates
    truth: Mapping[str, TruthRow]  # judgements of the referee by method; empty without true ids
    right: IntArray | None  # (m,) number of the right landmark, negative for none; None without true ids
    first: int = 0  # what landmark and observation 0 are called


def removed_so_far(front: FrontEnd, created: IntArray) -> IntArray | None:
    """Frames after which landmarks left the map; None where all stay."""
    managed = front.map_management
    return None if managed is None else managed.removal_frames(int(created.max(initial=-1)) + 1)


def pose_problem(
    front: FrontEnd, e: Expectation, f: FrameSoFar, title: str, methods: Sequence[str] = COMPARED, first: int = 0
) -> Matching:
    """Decisions of `methods`, and of the one that updates, on an expectation; the latter's are in `f.decisions`."""
    made: dict[str, IntArray | str] = {}
    judged, right, true_id = {}, None, f.log.truth.landmark_of
    this = f.judged()
    if this is not None and true_id is not None:
        right = this.ground_truth
        stray = (true_id[f.rows] == CLUTTER) | (f.task == "localization")
        made["truth"] = np.where(right >= 0, right, np.where(stray, DISCARD, NEW))
    for name in dict.fromkeys((*methods, front.association)):
        try:
            decided = f.decisions[f.rows].copy() if name == front.association else front.decide(e, name).decisions
        except SingularInnovationError:
            made[name] = "singular innovation covariance"
            continue
        made[name] = decided
        if (row := f.judged(decided)) is not None:
            judged[name] = row
    return Matching(title, e, f.log.recorded.sensor, front.setup.gate, made, front.association, judged, right, first)


class _Collector(Observer):
    """Observer that keeps the problems of some frames."""

    def __init__(self, log: Log, task: str, frames: Sequence[int], title: str, methods: Sequence[str]) -> None:
        self.log, self.task, self.frames, self.title, self.methods = log, task, set(frames), title, methods
        m = len(log.recorded.observations.frame)
        self.decisions, self.created = np.full(m, DISCARD, np.int64), np.full(m, -1, np.int64)
        self.found: dict[int, Matching] = {}

    def decided(self, front: FrontEnd, frame: Frame, pairing: Pairing) -> None:
        rows = slice(frame.first, frame.first + len(pairing.decisions))
        self.decisions[rows] = pairing.decisions
        if frame.number in self.frames and pairing.expectation is not None and len(pairing.expectation.number):
            gone = removed_so_far(front, self.created)
            so_far = FrameSoFar(self.log, self.task, rows, self.decisions, self.created, gone)
            title = self.title.format(frame=frame.number)
            self.found[frame.number] = pose_problem(front, pairing.expectation, so_far, title, self.methods)

    def updated(self, front: FrontEnd, decisions: IntArray, created: IntArray) -> None:
        self.decisions, self.created = decisions.copy(), created.copy()


def problems_of(
    log: Log, task: str, estimator: str, association: str, setup: Setup, frames: Sequence[int],
    methods: Sequence[str] = COMPARED, title: str = "frame {frame}",
) -> dict[int, Matching]:  # fmt: skip
    """The problems of some frames of a run, replayed for this; frames without a map or an expectation are left out."""
    inputs = log.inputs(labels=association == "known")
    seen = _Collector(log, task, frames, title, methods)
    inputs = inputs.without_map() if task == "slam" else inputs
    step_by_step(estimator, inputs, task, association, setup, finish=False, observer=seen)
    return seen.found

"""The problem of one frame as every method gets it: what each makes of the same expectation, and what is right."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from association.expectation import Expectation, SingularInnovationError
from data.inputs import Frame, IntArray
from data.log import Log
from data.result import DISCARD, NEW
from data.truth import CLUTTER
from eval.replay.frontend import FrontEnd, Pairing
from eval.replay.run import step_by_step
from eval.replay.settings import Setup
from eval.stepping.plane import Matching
from eval.stepping.text import judge_frame

COMPARED = ("nn", "singles", "ml", "jcbb")
"""Methods shown side by side."""


class FrameSoFar(NamedTuple):
    """A frame that is decided about: its rows of the log, and decisions and initialized landmarks (M,) so far."""

    log: Log
    task: str
    rows: slice
    decisions: IntArray
    created: IntArray
    removed: IntArray | None


def removed_so_far(front: FrontEnd, created: IntArray) -> IntArray | None:
    """Frames after which landmarks left the map; None where none ever does."""
    managed = front.map_management
    return None if managed is None else managed.removal_frames(int(created.max(initial=-1)) + 1)


def pose_problem(
    front: FrontEnd, e: Expectation, f: FrameSoFar, title: str, methods: Sequence[str] = COMPARED
) -> Matching:
    """What `methods`, and the one that updates, make of an expectation; `f.decisions` holds what that one decided."""
    made: dict[str, IntArray | str] = {}
    judged, right, true_id = {}, None, f.log.truth.landmark_of
    this = judge_frame(f.log, f.task, f.rows, f.decisions, f.created, f.removed)
    if this is not None and true_id is not None:
        right = this.ground_truth
        stray = (true_id[f.rows] == CLUTTER) | (f.task == "localization")
        made["truth"] = np.where(right >= 0, right, np.where(stray, DISCARD, NEW))
    for name in dict.fromkeys((*methods, front.association)):
        try:
            own = name == front.association
            made[name] = f.decisions[f.rows].copy() if own else front.decide(e, name).decisions
        except SingularInnovationError:
            made[name] = "singular innovation covariance"
            continue
        every = f.decisions.copy()
        every[f.rows] = made[name]
        row = judge_frame(f.log, f.task, f.rows, every, f.created, f.removed)
        if row is not None:
            judged[name] = row
    return Matching(title, e, f.log.recorded.sensor, front.setup.gate, made, front.association, judged, right)


class _Onlooker:
    """Looks on while a log is replayed, and keeps the problem of the frames asked for."""

    def __init__(self, log: Log, task: str, frames: Sequence[int], title: str, methods: Sequence[str]) -> None:
        self.log, self.task, self.frames, self.title, self.methods = log, task, set(frames), title, methods
        m = len(log.recorded.observations.frame)
        self.decisions, self.created = np.full(m, DISCARD, np.int64), np.full(m, -1, np.int64)
        self.found: dict[int, Matching] = {}

    def moved(self, front: FrontEnd) -> None:
        """Nothing to keep yet."""

    def decided(self, front: FrontEnd, frame: Frame, pairing: Pairing) -> None:
        """Keep the problem, if this is one of the frames."""
        rows = slice(frame.first, frame.first + len(pairing.decisions))
        self.decisions[rows] = pairing.decisions
        if frame.number in self.frames and pairing.expectation is not None and len(pairing.expectation.number):
            so_far = FrameSoFar(
                self.log, self.task, rows, self.decisions, self.created, removed_so_far(front, self.created)
            )
            title = self.title.format(frame=frame.number)
            self.found[frame.number] = pose_problem(front, pairing.expectation, so_far, title, self.methods)

    def updated(self, front: FrontEnd, decisions: IntArray, created: IntArray) -> None:
        """Keep what was decided."""
        self.decisions, self.created = decisions.copy(), created.copy()


def problems_of(
    log: Log,
    task: str,
    estimator: str,
    association: str,
    setup: Setup,
    frames: Sequence[int],
    methods: Sequence[str] = COMPARED,
    title: str = "frame {frame}",
) -> dict[int, Matching]:
    """The problems of some frames of a run with this estimator and way of association, which is replayed for it.

    Frames without a map to match with, or without an expectation (`known`), are left out.
    """
    inputs = log.inputs(labels=association == "known")
    seen = _Onlooker(log, task, frames, title, methods)
    step_by_step(
        estimator, inputs.without_map() if task == "slam" else inputs, task, association, setup, finish=False,
        observer=seen,
    )  # fmt: skip
    return seen.found

"""A walk through a log: looks on while it is replayed, prints, paints, and waits for Enter at every stage."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from association.expectation import Expectation, SingularInnovationError
from data.inputs import Frame, IntArray
from data.log import Log
from data.result import DISCARD, NEW, Run
from data.truth import CLUTTER
from eval.figures import error_figure
from eval.figures.style import style_of
from eval.replay.frontend import FrontEnd, Pairing
from eval.walk.album import Album
from eval.walk.matching import Matching, paint_compatibility, paint_matching
from eval.walk.pictures import paint_ground_truth, paint_map, paint_observations
from eval.walk.text import closing, compatibility_text, judge_frame, pose_text, run_text, statistics, step_block

COMPARED = ("nn", "singles", "ml", "jcbb")
"""Methods shown side by side."""


class StoppedError(Exception):
    """The person wants no more."""


class Walk:
    """Looks on while a log is replayed: prints, paints and waits for Enter (see `eval.replay.observer.Observer`)."""

    def __init__(self, log: Log, task: str, estimator: str, album: Album, *, pausing: bool) -> None:
        """Before the first frame."""
        self.log, self.task, self.estimator, self.album, self.pausing = log, task, estimator, album, pausing
        m = len(log.recorded.observations.frame)
        self.decisions, self.created = np.full(m, -2, np.int64), np.full(m, -1, np.int64)
        self.path: list[Any] = []
        self.digits = max(3, len(str(len(log.recorded) - 1)))
        self.kind = f"{style_of(estimator).label} {'SLAM' if task == 'slam' else task}"
        self.printed = False

    def pause(self, stage: str) -> None:
        """Wait for Enter, if anybody is there."""
        if not self.pausing:
            return
        try:
            answer = input(f"  [{stage}; Enter] ").strip().lower()
        except EOFError:
            print()
            raise StoppedError from None
        if answer in ("q", "quit"):
            raise StoppedError
        if answer in ("r", "run"):
            self.pausing = False

    def say(self, stage: str, text: str) -> None:
        """A line about a stage, for those who wait at it."""
        if self.pausing:
            print(f"step {self.k}, {stage}: {text}", flush=True)

    @property
    def title(self) -> str:
        """Names the step in every figure."""
        return f"{self.log.name}, step {self.k}"

    def show(self, what: str, paint: Callable[[Figure], object], *, keep: bool = True) -> None:
        """A picture of this step; `keep`: as a file, too."""
        self.album.show(what, paint, f"step-{self.k:0{self.digits}d}-{what}" if keep else None)

    def moved(self, front: FrontEnd) -> None:
        """Move and observe."""
        self.k, self.printed = front.k, False
        r = self.log.recorded
        self.rows = slice(int(r.start[self.k]), int(r.start[self.k + 1]))
        if self.log.truth.known_poses:
            self.show("ground-truth", lambda fig: paint_ground_truth(fig, self.log, self.k, self.title))
        if self.k > 0:
            x, y, theta = r.increments.mean[self.k].tolist()
            odometry = f"odometry {x:.3f} m, {y:.3f} m, {math.degrees(theta):.2f} deg"
            self.say("move", f"{odometry}; {pose_text(*front.estimator.estimate())}")
            self._map(front, "prediction", keep=False)
            self.pause("move")
        seen = r.sightings(self.k)
        if len(seen.z):
            self.say("observe", f"{len(seen.z)} observation{'s' * (len(seen.z) != 1)}")
            self.show("observations", lambda fig: paint_observations(fig, r.sensor, *seen, self.title))
            self.pause("observe")

    def decided(self, front: FrontEnd, frame: Frame, pairing: Pairing) -> None:
        """Compatibility and matching, once there is a map."""
        decisions, expectation = pairing.decisions, pairing.expectation
        self.decisions[frame.first : frame.first + len(decisions)] = decisions
        wanted = self.album.wanted or self.pausing
        if expectation is None and wanted:
            expectation = front.expect(frame.sightings)
        if expectation is not None and len(expectation.number) and wanted:
            self.say("compatibility", compatibility_text(expectation, front.setup.gate))
            problem = self._problem(front, expectation, decisions) if self.album.wanted else None
            if problem is not None:
                self.show("compatibility", lambda fig: paint_compatibility(fig, problem))
            self.pause("compatibility")
            if problem is not None:
                self.show("matching", lambda fig: paint_matching(fig, problem))
            self._print_step(front)
            self.pause("matching")

    def _problem(self, front: FrontEnd, e: Expectation, decisions: IntArray) -> Matching:
        """What every method makes of the same expectation."""
        made: dict[str, IntArray | str] = {}
        judged, right = {}, None
        removed = self._removed(front)
        this = judge_frame(self.log, self.task, self.rows, self.decisions, self.created, removed)
        if this is not None and self.log.truth.landmark_of is not None:
            right = this.ground_truth
            stray = (self.log.truth.landmark_of[self.rows] == CLUTTER) | (self.task == "localization")
            made["truth"] = np.where(right >= 0, right, np.where(stray, DISCARD, NEW))
        for name in dict.fromkeys((*COMPARED, front.association)):
            try:
                made[name] = decisions if name == front.association else front.decide(e, name).decisions
            except SingularInnovationError:
                made[name] = "singular innovation covariance"
                continue
            every = self.decisions.copy()
            every[self.rows] = made[name]
            row = judge_frame(self.log, self.task, self.rows, every, self.created, removed)
            if row is not None:
                judged[name] = row
        title = f"{self.title} ({self.kind})"
        return Matching(title, e, self.log.recorded.sensor, front.setup.gate, made, front.association, judged, right)

    def _removed(self, front: FrontEnd) -> IntArray | None:
        """Frames after which landmarks left the map, so far."""
        managed = front.map_management
        return None if managed is None else managed.removal_frames(int(self.created.max(initial=-1)) + 1)

    def _print_step(self, front: FrontEnd) -> None:
        """The text of the step; new landmarks get the next numbers."""
        if self.printed:
            return
        self.printed = True
        decisions = self.decisions[self.rows]
        new = decisions == NEW
        created = np.where(new, self.created.max(initial=-1) + np.cumsum(new), -1)
        row = judge_frame(self.log, self.task, self.rows, self.decisions, self.created, self._removed(front))
        print(step_block(self.k, row, decisions, created), end="\n\n", flush=True)

    def updated(self, front: FrontEnd, decisions: IntArray, created: IntArray) -> None:
        """Update, and the end of the step."""
        if self.rows.stop > self.rows.start:
            self._print_step(front)
        self.decisions[self.rows], self.created[self.rows] = decisions[self.rows], created[self.rows]
        self.path.append(front.estimator.estimate().mean[:2])
        self._map(front, "estimate", keep=True)
        if self.rows.stop > self.rows.start:
            d = decisions[self.rows]
            used, new = int((d >= 0).sum()), int((created[self.rows] >= 0).sum())
            removed = {} if front.map_management is None else front.map_management.removed
            gone = sorted(n for n, k in removed.items() if k == self.k)
            lost = f"; removed from the map: {', '.join(map(str, gone))}" if gone else ""
            counts = f"{used} used, {new} new, {len(d) - used - new} left out"
            self.say("update", f"{counts}; {pose_text(*front.estimator.estimate())}{lost}")
            self.pause("update")

    def _map(self, front: FrontEnd, what: str, *, keep: bool) -> None:
        if self.album.windows is None and not (keep and self.album.folder is not None):
            return
        now, landmarks = front.estimator.estimate(), front.landmarks()
        path = np.array([*self.path, now.mean[:2]] if what == "prediction" else self.path)
        title = f"{self.title} ({self.kind}, {front.association})"
        self.show(
            "map",
            lambda fig: paint_map(fig, self.log, self.k, self.estimator, path, now, landmarks, title),
            keep=keep,
        )


def end(log: Log, run: Run, album: Album, walk: Walk) -> None:
    """Statistics and the figure of error."""
    numbers = statistics(log, run)
    print(f"{closing(log, run)}\n\n{numbers}", flush=True)
    if not album.wanted:
        return
    album.write("steps.txt", f"{run_text(log, run)}\n\n{numbers}\n".encode())
    album.show_made("error", error_figure(log, [run]))
    if album.windows is not None:
        walk.pause("end")

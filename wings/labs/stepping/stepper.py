"""A walk through a log: an observer that prints, paints, and waits for Enter at every stage."""

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from data.inputs import Frame, IntArray
from data.log import Log
from data.result import NEW, Run
from data.terminal import counted
from eval.figures.error import error_figure
from eval.figures.style import style_of
from eval.replay.frontend import FrontEnd, Pairing
from eval.replay.recorder import Observer
from wings.labs.stepping import pictures, text as texts
from wings.labs.stepping.problem import FrameSoFar, pose_problem, removed_so_far


class StoppedError(Exception):
    """The user stopped the walk."""


class Walk(Observer):
    """Observer of a replay that prints, paints and waits for Enter."""

    def __init__(
        self, log: Log, task: str, estimator: str, images: pictures.ImageWriter, *, pausing: bool,
        block: texts.Block = texts.step_block, first: int = 0,
    ) -> None:  # fmt: skip
        """`block` makes the text of a step; it calls step, landmark and observation 0 `first`, as figures then do."""
        self.block, self.first = block, first
        self.camera: Iterator[bytes] = iter(())  # an image for each frame, of a log made from images
        self.log, self.task, self.estimator, self.images, self.pausing = log, task, estimator, images, pausing
        m = len(log.recorded.observations.frame)
        self.decisions, self.created = np.full(m, -2, np.int64), np.full(m, -1, np.int64)
        self.path: list[Any] = []
        self.digits = max(3, len(str(len(log.recorded) - 1 + first)))
        self.kind = f"{style_of(estimator).label} {'SLAM' if task == 'slam' else task}"
        self.printed = self.tried = False

    def pause(self, stage: str) -> None:
        """Wait for Enter, if interactive."""
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
        """Print a line about a stage, if interactive."""
        if self.pausing:
            print(f"step {self.number}, {stage}: {text}", flush=True)

    @property
    def number(self) -> int:
        """What the step is called."""
        return self.k + self.first

    @property
    def title(self) -> str:
        """Title of every figure of the step."""
        return f"{self.log.name}, step {self.number}"

    def stem(self, what: str) -> str:
        """Name of a figure's file."""
        return f"step-{self.number:0{self.digits}d}-{what}"

    def show(self, what: str, paint: Callable[[Figure], object]) -> None:
        """Show a figure of this step."""
        self.images.show(what, paint, self.stem(what))

    def moved(self, front: FrontEnd) -> None:
        """Move and observe."""
        self.k, self.printed, self.tried = front.k, False, False
        r = self.log.recorded
        self.rows = slice(int(r.start[self.k]), int(r.start[self.k + 1]))
        if (image := next(self.camera, None)) is not None:
            self.images.show_image("camera", image, self.stem("camera"))
        if self.log.truth.known_poses:
            self.show("ground-truth", lambda fig: pictures.paint_ground_truth(fig, self.log, self.k, self.title))
        if self.k > 0:
            self.say("move", texts.moved_text(r.increments.mean[self.k], front.estimator.estimate()))
            self._map(front, "prediction")
            self.pause("move")
        seen = r.frame_observations(self.k)
        if len(seen.z):
            self.say("observe", counted(len(seen.z), "observation"))
            self.show("observations", lambda f: pictures.paint_observations(f, r.sensor, *seen, self.title, self.first))
            self.pause("observe")

    def decided(self, front: FrontEnd, frame: Frame, pairing: Pairing) -> None:
        """Compatibility and matching, once there is a map."""
        self._print_poses(front)
        decisions, expectation = pairing.decisions, pairing.expectation
        self.decisions[frame.first : frame.first + len(decisions)] = decisions
        wanted = self.images.wanted or self.pausing
        if expectation is None and wanted:
            expectation = front.expect(frame.observations, frame.appearance)
        if expectation is not None and len(expectation.number) and wanted:
            self.say("compatibility", texts.compatibility_text(expectation, front.setup.gate))
            problem = None
            if self.images.wanted:
                title = f"{self.title} ({self.kind})"
                problem = pose_problem(front, expectation, self._frame(front), title, first=self.first)
                self.show("compatibility", lambda fig: pictures.paint_compatibility(fig, problem))
            self.pause("compatibility")
            if problem is not None:
                self.show("matching", lambda fig: pictures.paint_matching(fig, problem))
            self._print_step(front)
            self.pause("matching")

    def _print_poses(self, front: FrontEnd) -> None:
        """The frame's fixes and closures, once they were tried."""
        if self.tried or self.block is not texts.step_block:
            return
        self.tried = True
        poses = front.poses
        columns = texts.pose_columns(self.log, self.k, poses.fixed, poses.closed, poses.gate)
        if text := texts.poses_block(self.k, columns):
            print(text, end="\n\n", flush=True)
            self.pause("fixes and closures")

    def _frame(self, front: FrontEnd) -> FrameSoFar:
        removed = removed_so_far(front, self.created)
        return FrameSoFar(self.log, self.task, self.rows, self.decisions, self.created, removed)

    def _print_step(self, front: FrontEnd) -> None:
        if self.printed:
            return
        self.printed = True
        decisions = self.decisions[self.rows]
        new = decisions == NEW
        created = np.where(new, self.created.max(initial=-1) + np.cumsum(new), -1)
        if text := self.block(texts.Step(self.k, self._frame(front).judged(), decisions, created)):
            print(text, end="\n\n", flush=True)

    def updated(self, front: FrontEnd, decisions: IntArray, created: IntArray) -> None:
        """Update, and the end of the step."""
        self._print_poses(front)
        if self.rows.stop > self.rows.start:
            self._print_step(front)
        self.decisions[self.rows], self.created[self.rows] = decisions[self.rows], created[self.rows]
        self.path.append(front.estimator.estimate().mean[:2])
        self._map(front, "map")
        if self.rows.stop > self.rows.start:
            d = decisions[self.rows]
            used, new = int((d >= 0).sum()), int((created[self.rows] >= 0).sum())
            removed = {} if front.map_management is None else front.map_management.removed
            leaving = sorted(n + self.first for n, k in removed.items() if k == self.k)
            self.say("update", texts.updated_text(used, new, len(d) - used - new, leaving, front.estimator.estimate()))
            self.pause("update")

    def _map(self, front: FrontEnd, what: str) -> None:
        """The map as predicted or updated: two files, one window."""
        if not self.images.wanted:
            return
        now, landmarks = front.estimator.estimate(), front.landmarks()
        path = np.array([*self.path, now.mean[:2]] if what == "prediction" else self.path)
        title = f"{self.title} ({self.kind}, {front.association})" + (", predicted" if what == "prediction" else "")
        seen = (self.log, self.k, self.estimator, path, now, landmarks, title, self.first)
        self.images.show("map", lambda fig: pictures.paint_map(fig, *seen), self.stem(what))


def end(log: Log, run: Run, images: pictures.ImageWriter, walk: Walk) -> None:
    """Statistics and the figure of error."""
    numbers = texts.statistics(log, run)
    print(f"{texts.closing(log, run)}\n\n{numbers}", flush=True)
    if not images.wanted:
        return
    images.write("steps.txt", f"{texts.run_text(log, run, block=walk.block)}\n\n{numbers}\n".encode())
    images.show_made("error", error_figure(log, [run]))
    if images.windows is not None:
        walk.pause("end")

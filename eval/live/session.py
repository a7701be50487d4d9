"""From packet to estimates: one frame through the front end of each estimator, one after the other, nothing kept.

The steps are those of a replay (`eval.replay.run.through`), so a recording replayed gives the same numbers. What an
estimator cannot go on from ends that one alone.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from data.errors import UsageError
from data.inputs import Frame, IntArray
from data.result import DISCARD, MapState, Updated
from data.robot.frames import SENSOR, USUAL, Framing, Noise, prior
from data.robot.traffic.motion import Packet
from data.se2 import Array
from ekf.slam import EkfSlam
from eval.player.watch import map_now
from eval.replay.foreign.guard import ForeignError
from eval.replay.foreign.make import CannotError, require
from eval.replay.foreign.spec import is_foreign, name_of
from eval.replay.given import Beginning
from eval.replay.run import DIVERGED, front_end, through
from eval.replay.settings import Setup
from graph.fixed_lag import FixedLagSmoother
from graph.incremental import Isam2Smoother

ROBOT = Beginning(prior(), SENSOR)
"""The prior is the origin, there is no map: SLAM."""


@dataclass(frozen=True, eq=False)
class Step:
    """An estimator after a frame.

    Attributes:
        mean: (3,) pose [m, m, rad], world frame.
        covariance: (3, 3) of it.
        decisions: (m,) about the frame's observations, as in `data.result.Run`.
        created: (m,) landmarks they initialized, -1 for none.
        nis: per degree of freedom; NaN where nothing was paired.
    """

    mean: Array
    covariance: Array
    decisions: IntArray
    created: IntArray
    nis: float


class Taken(NamedTuple):
    """A frame and what each estimator made of it; None of one that has ended."""

    frame: Frame
    steps: tuple[Step | None, ...]


class Estimating:
    """One estimator on line.

    Attributes:
        name: as it stands in tables.
        failure: why it ended; empty: it goes on.
    """

    def __init__(self, name: str, association: str, setup: Setup) -> None:
        """Before the first frame.

        Raises:
            UsageError: it is somebody else's, and cannot do what is asked, or failed at once.
        """
        self.name, self.failure = name_of(name), ""
        setup = setup.settled(sensed=False)
        try:
            if is_foreign(name):
                require(name, "slam", association, setup)
            self.front = front_end(name, association, ROBOT, setup)
        except (CannotError, ForeignError) as stop:
            raise UsageError(f"--estimator {self.name}: {stop}") from None
        if isinstance(self.front.estimator, FixedLagSmoother):
            self.front.estimator.keep_no_path()

    def take(self, frame: Frame) -> Step | None:
        """The next frame; None if it has ended, now or before."""
        if self.failure:
            return None
        nothing = len(frame.sightings.z)
        decided, created, nis = np.full(nothing, DISCARD, np.int64), np.full(nothing, -1, np.int64), np.nan

        def used(part: Frame, decisions: IntArray, done: Updated) -> None:
            nonlocal nis
            rows = slice(part.first - frame.first, part.first - frame.first + len(decisions))
            decided[rows] = np.where((decisions >= 0) & ~done.used, DISCARD, decisions)
            created[rows] = done.created
            nis = done.nis / done.dof if done.dof else np.nan

        try:
            through(self.front, frame, used)
            mean, covariance = self.front.estimator.estimate()
        except (*DIVERGED, ForeignError) as stop:
            self.failure = f"at frame {frame.number}: {stop}"
            return None
        return Step(mean, covariance, decided, created, nis)

    def map(self) -> MapState | None:
        """Its walls now, asked so that nothing changes; None of what cannot be asked, or has ended."""
        estimator = self.front.estimator
        return map_now(estimator) if isinstance(estimator, EkfSlam | Isam2Smoother) and not self.failure else None


class Session:
    """Frames of a drive, one by one.

    Attributes:
        estimating: the estimators, in the order in which they get each frame.
        frames, observations: so far.
    """

    def __init__(
        self,
        names: Sequence[str],
        association: str,
        setup: Setup,
        noise: Noise = USUAL,
        told: Callable[[Taken], None] = lambda taken: None,
    ) -> None:
        """Before the first packet; `told` gets every frame that was taken."""
        self.estimating = [Estimating(name, association, setup) for name in names]
        self.frames = self.observations = 0
        self._framing, self._told = Framing(noise), told

    def take(self, packet: Packet) -> Taken:
        """A packet to a frame, the frame to every estimator."""
        frame = self._framing.frame(packet)
        self.frames, self.observations = frame.number + 1, frame.first + len(frame.sightings.z)
        taken = Taken(frame, tuple(each.take(frame) for each in self.estimating))
        self._told(taken)
        return taken

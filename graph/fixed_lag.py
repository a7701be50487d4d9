"""Fixed-lag smoothing: iSAM2 over the newest poses and all landmarks; what is older is marginalized."""

from __future__ import annotations

from array import array
from bisect import bisect_left

import gtsam
import numpy as np
from gtsam.symbol_shorthand import L, X

from data.inputs import FrameObservations, Increment, IntArray, LandmarkMap, Prior, Systematic
from data.result import Finished, Trajectory
from data.sensors import Sensor
from graph.engine import Window
from graph.incremental import SKIP, THRESHOLD, Isam2Smoother
from graph.optimum import in_world

SLACK = 0.1
"""Of the lag: those older than the lag leave together, when the oldest is older by this much."""

JOINED = 1e-4
"""m; standard deviation of the difference of two landmarks that are one."""


class FixedLagSmoother(Isam2Smoother):
    """The verbs of `Isam2Smoother`, with a bounded number of poses in the graph.

    Poses older than the lag become a linear factor on the oldest pose that stays and on the landmarks. Landmarks stay:
    their numbers keep their meaning, and loops are closed over any time. The price is that of a filter: this factor
    ties all landmarks together, and those it touches are never linearized anew.

    Every frame is stamped with its time (`stamp`; a frame that is not comes 1 after the one before), `lag` is in the
    same unit.
    """

    def __init__(
        self,
        prior: Prior,
        sensor: Sensor,
        known: LandmarkMap | None = None,
        *,
        lag: float,
        slack: float = SLACK,
        threshold: float = THRESHOLD,
        skip: int = SKIP,
        systematic: Systematic | None = None,
    ) -> None:
        """Start at the prior; with a map localize in it, without do SLAM.

        A pose stays for at least `lag` >= 0 after its own time, and at most for (1 + `slack`) times that, at the next
        observation: a slack of 0 marginalizes frame by frame, which takes 1.5 times as long on Victoria Park with a lag
        of 30 frames, three times as long with 100.
        """
        if not lag >= 0.0 or not slack >= 0.0:
            raise ValueError(f"lag {lag} and slack {slack} must not be negative")
        super().__init__(prior, sensor, known, threshold=threshold, skip=skip, systematic=systematic)
        self.lag, self.slack = lag, slack
        self._time = [0.0]
        self._timed = 0
        """First frame whose time is still there."""
        engine = self._engine
        self._window = Window(threshold, skip, qr=engine.qr, name=engine.name, linear=engine.linear, walls=engine.walls)
        self._engine = self._window
        self._oldest = 0
        """First frame that is still in the window."""
        self._keeps = True
        self._left = array("d")
        """Of each frame that left: pose (3), covariance (3, 3), errors and their sigmas (2, p); 100 bytes or so."""

    def predict(self, increment: Increment) -> None:
        """Move by an increment; the graph grows only when something is seen."""
        super().predict(increment)
        self._time.append(self._time[-1] + 1.0)

    def stamp(self, time: float) -> None:
        """The present frame's time. Raises ValueError for one that is not after the frame before."""
        if len(self._time) > 1 and not time > self._time[-2]:
            raise ValueError(f"frame {self.frame} at {time} is not after the one before, at {self._time[-2]}")
        self._time[-1] = time

    def _extend(self, observations: FrameObservations, number: IntArray) -> None:
        """Add the motion since the anchor and these observations, then let go of what is too old."""
        super()._extend(observations, number)
        now = self._time[-1]
        if now - self._time[self._oldest - self._timed] > (1.0 + self.slack) * self.lag:
            self._forget(self._timed + bisect_left(self._time, now - self.lag))

    def _forget(self, oldest: int) -> None:
        """Marginalize the poses of all frames before `oldest`, with the copies of landmarks seen from them."""
        frames = range(self._oldest, oldest)
        if self._keeps:
            self._keep(frames)
        keys = [*(X(k) for k in frames), *self._end.forget(oldest)]
        keys += self._observed.alone(frames)
        self._window.marginalize(keys, self._end.keys)
        self._observed.forget(oldest, self._window.alive)
        del self._time[: oldest - self._timed]
        self._oldest = self._timed = oldest
        self._read()

    def amend(self, frames: IntArray, observations: FrameObservations, decisions: IntArray) -> None:
        """As `Isam2Smoother.amend`, for frames in the window; what older ones saw cannot be taken back any more.

        In SLAM nothing is: its path is kept as it was when it left the window.
        """
        if self.map is None:
            return
        keep = np.flatnonzero(frames >= self._oldest)
        if len(keep):
            super().amend(frames[keep], FrameObservations(observations.z[keep], observations.R[keep]), decisions[keep])

    def remove(self, numbers: IntArray) -> None:
        """Drop landmarks with their observations from poses in the window.

        What older observations said about everything else cannot be taken back any more, as in a filter.
        """
        gone = np.asarray(numbers).tolist()
        super().remove(numbers)
        held = [L(n) for n in gone if self._window.holds(L(n))]
        if held:
            self._window.marginalize(held, self._end.keys)
            self._read()

    def merge(self, merged: IntArray, kept: IntArray) -> None:
        """Landmarks `merged` (k,) are the same as `kept` (k,): an observation of no difference, as in a filter."""
        pairs = self._pairs_to_merge(merged, kept)
        self._window.add(self._window.same(pairs, JOINED), gtsam.Values())
        self.refine()
        gone = [L(n) for n in sorted(pairs)] + self._observed.alone(range(self._oldest, self.frame + 1), list(pairs))
        self._observed.take_back(list(pairs))
        self._window.marginalize(gone, self._end.keys)
        self._read()

    def keep_no_path(self) -> None:
        """Nobody will ask for `finish`: poses that leave the window are forgotten."""
        self._keeps = False

    def finish(self) -> Finished:
        """Every pose as it was when it left the window, those in it as they are now; there is no cost to sum up.

        Motion since the last observation joins the window; nothing is optimized that was not during the run.
        """
        self._complete()
        if not self._keeps:
            raise ValueError("its path was not kept")
        self._keep(range(self._oldest, self.frame + 1))
        kept = np.array(self._left).reshape(self.frame + 1, -1)
        self._oldest = self.frame + 1
        path, covariance = kept[:, :3].copy(), kept[:, 3:12].reshape(-1, 3, 3)
        found = None if self.map is not None else self.landmarks()
        errors = self._end.history(kept[:, 12:].reshape(len(kept), 2, -1))
        return Finished(Trajectory(path, in_world(path, covariance)), found, systematic=errors)

    def _keep(self, frames: range) -> None:
        """Poses as they are when they leave."""
        for frame in frames:
            left = self._end.leaving(self._window, frame)
            for part in (left.pose, left.covariance, *(left.errors or ())):
                self._left.extend(part.ravel().tolist())

"""Fixed-lag smoothing: iSAM2 over the newest poses and all landmarks; older poses are marginalized."""

from array import array
from bisect import bisect_left

import gtsam
import numpy as np
from gtsam.symbol_shorthand import L, X

from data.inputs import FrameObservations, Increment, IntArray, LandmarkMap, Prior, Systematic
from data.pose_measurements import Closures, Fixes, FixSource, PoseUpdated
from data.result import Finished, Trajectory
from data.sensors import Sensor
from graph.engine import Window
from graph.factors import Factor
from graph.incremental import SKIP, THRESHOLD, Isam2Smoother
from graph.optimum import in_world
from graph.pose_factors import PoseFactor
from graph.problem import is_uncertain

SLACK = 0.1  # share of the lag by which the oldest pose may exceed it, before all older ones are marginalized together

JOINED = 1e-4  # m; standard deviation of the difference of two merged landmarks


class FixedLagSmoother(Isam2Smoother):
    """`Isam2Smoother` with a bounded number of poses in the graph.

    Poses older than the lag become a linear factor on the oldest remaining pose and the landmarks. Landmarks remain, so
    loops are closed over any time. As in a filter, this factor connects all landmarks, and those are never
    relinearized.

    Every frame has a time (`stamp`; by default 1 after the previous one), in the unit of `lag`.
    """

    def __init__(
        self, prior: Prior, sensor: Sensor, known: LandmarkMap | None = None, *, lag: float, slack: float = SLACK,
        threshold: float = THRESHOLD, skip: int = SKIP, systematic: Systematic | None = None,
    ) -> None:  # fmt: skip
        """Start at the prior; with a map localize in it, without do SLAM. A pose stays for at least `lag` >= 0 after
        its own time, at most (1 + `slack`) times that; 0 marginalizes frame by frame, 1.5 to 3 times as slow.
        """
        if not lag >= 0.0 or not slack >= 0.0:
            raise ValueError(f"lag {lag} and slack {slack} must not be negative")
        super().__init__(prior, sensor, known, threshold=threshold, skip=skip, systematic=systematic)
        self.lag, self.slack = lag, slack
        self._time = [0.0]
        self._timed = 0  # first frame whose time is stored
        self._engine = self._window = Window(self._engine)
        self._oldest = 0  # first frame in the window
        self._keeps = True
        self._left = array("d")
        """Of each frame that left: pose (3), covariance (3, 3), errors and their sigmas (2, p); about 100 bytes."""

    def __deepcopy__(self, memo: dict[int, object]) -> "FixedLagSmoother":
        """See `Isam2Smoother`."""
        other = super().__deepcopy__(memo)
        assert isinstance(other, FixedLagSmoother)
        assert isinstance(other._engine, Window)
        other._window = other._engine
        return other

    def predict(self, increment: Increment) -> None:
        """Predict with an increment; the graph grows only with an observation."""
        super().predict(increment)
        self._time.append(self._time[-1] + 1.0)

    def stamp(self, time: float) -> None:
        """Set the present frame's time. Raises ValueError for one that is not after the frame before."""
        if len(self._time) > 1 and not time > self._time[-2]:
            raise ValueError(f"frame {self.frame} at {time} is not after the one before, at {self._time[-2]}")
        self._time[-1] = time

    def _extend(self, observations: FrameObservations, number: IntArray, *, again: bool = False) -> None:
        """As `Isam2Smoother._extend`, then marginalize what is too old."""
        super()._extend(observations, number, again=again)
        self._marginalize_old()

    def fix(self, fixes: Fixes, sources: tuple[FixSource, ...], gate: float | None) -> PoseUpdated:
        """As `Isam2Smoother.fix`, then marginalize what is too old."""
        done = super().fix(fixes, sources, gate)
        self._marginalize_old(but=1)
        return done

    def close_loops(self, closures: Closures, gate: float | None) -> PoseUpdated:
        """As `fix`, with closures of the newest pose to frames in the window; others are not used."""
        done = super().close_loops(closures, gate)
        self._marginalize_old(but=1)
        return done

    def _note(self, factors: list[PoseFactor], done: PoseUpdated) -> list[Factor]:
        """As `Isam2Smoother`; nothing is optimized in the end."""
        used = super()._note(factors, done)
        self._of_poses.clear()
        return used

    def _held(self, frames: IntArray) -> IntArray:
        """A closure to a frame that left the window is not used."""
        return frames[frames >= self._oldest]

    def _marginalize_old(self, but: int = 0) -> None:
        """Marginalize old poses, with landmarks' copies observed there, but for `but`: the motion may be inflated."""
        now = self._time[-1]
        if self._end.anchor < self.frame:
            return
        oldest = min(self._timed + bisect_left(self._time, now - self.lag), self.frame - but)
        due = now - self._time[self._oldest - self._timed] > (1.0 + self.slack) * self.lag
        if not due or oldest <= self._oldest:
            return
        frames = range(self._oldest, oldest)
        if self._keeps:
            self._keep(frames)
        keys = [*(X(k) for k in frames), *self._end.forget(oldest)]
        keys += self._observed.own_variables(frames)
        self._window.marginalize(keys, self._end.keys)
        self._observed.forget(oldest, self._window.alive)
        del self._time[: oldest - self._timed]
        self._oldest = self._timed = oldest
        self._read()

    def amend(self, frames: IntArray, observations: FrameObservations, decisions: IntArray) -> None:
        """As `Isam2Smoother.amend`, for frames in the window of a localization; older ones are marginalized."""
        if self.map is None:
            return
        keep = np.flatnonzero(frames >= self._oldest)
        if len(keep):
            super().amend(frames[keep], FrameObservations(observations.z[keep], observations.R[keep]), decisions[keep])

    def remove(self, numbers: IntArray) -> None:
        """Remove landmarks with their observations from poses in the window; older observations are marginalized."""
        removed = np.asarray(numbers).tolist()
        super().remove(numbers)
        held = [L(n) for n in removed if self._window.holds(L(n))]
        if held:
            self._window.marginalize(held, self._end.keys)
            self._read()

    def merge(self, merged: IntArray, kept: IntArray) -> None:
        """Merge landmarks `merged` (k,) into `kept` (k,) by an observation of no difference, as in a filter."""
        pairs = self._pairs_to_merge(merged, kept)
        self._window.add(self._window.same(pairs, JOINED), gtsam.Values())
        self.refine()
        held = range(self._oldest, self.frame + 1)
        removed = [L(n) for n in sorted(pairs)] + self._observed.own_variables(held, list(pairs))
        self._observed.withdraw(list(pairs))
        self._window.marginalize(removed, self._end.keys)
        self._read()

    def keep_no_path(self) -> None:
        """Discard marginalized poses; disables `finish`."""
        self._keeps = False

    def finish(self) -> Finished:
        """Every pose as it left the window, those in it as they are now; nothing is optimized, and there is no cost."""
        self._complete()
        if not self._keeps:
            raise ValueError("no path: `keep_no_path` was called")
        self._keep(range(self._oldest, self.frame + 1))
        kept = np.array(self._left).reshape(self.frame + 1, -1)
        self._oldest = self.frame + 1
        path, covariance = kept[:, :3].copy(), kept[:, 3:12].reshape(-1, 3, 3)
        found = self.landmarks() if self.map is None or is_uncertain(self.map) else None
        errors = self._end.history(kept[:, 12:].reshape(len(kept), 2, -1))
        return Finished(Trajectory(path, in_world(path, covariance)), found, systematic=errors)

    def _keep(self, frames: range) -> None:
        """Store poses as they leave."""
        for frame in frames:
            self._left.extend(self._end.leaving(self._window, frame))

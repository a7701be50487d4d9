"""Fixed-lag smoothing of key poses: iSAM2 over the newest ones; those that leave are marginalized, and are places then.

With landmarks (`graph.fixed_lag`) loops are closed through the landmarks, which stay. Here nothing stays but the key
poses of the window, so a loop closure to one that has left can only be taken as a fix: the newest pose is measured
from a place known with the pose and covariance that it left with. That the two errors have a past in common is ignored,
as in localization by a map that is not quite right: the path comes back to the place, the poses in between do not, and
the covariance comes out too small after many such fixes.
"""

from __future__ import annotations

from bisect import bisect_left

import gtsam
import numpy as np
from gtsam.symbol_shorthand import X

from data.inputs import IntArray, Prior
from data.se2 import Array, compose, world_from_body
from graph.factors import pose2, root_information, with_loss
from graph.optimum import in_world
from graph.poses.online import SKIP, THRESHOLD, PoseGraph, name_of_key
from graph.transport import transport
from graph.window import Window

LAG = 30.0
"""s."""
SLACK = 0.1
"""Of the lag: those older than the lag leave together, when the oldest is older by this much, as in
`graph.fixed_lag`."""


class FixedLagPoseGraph(PoseGraph):
    """The verbs of `PoseGraph` with a bounded number of key poses in the graph.

    Attributes:
        fixes: loop closures to a key pose that had left.
        lost: loop closures between two key poses that had both left: nothing can be done with them.
    """

    def __init__(self, prior: Prior, *, lag: float = LAG, loss: str = "gaussian") -> None:
        """As `PoseGraph`; a key pose stays for `lag` >= 0 [s] after its time, and up to a tenth longer."""
        if not lag >= 0.0:
            raise ValueError(f"lag {lag} must not be negative")
        super().__init__(prior, loss=loss)
        self.lag, self.fixes, self.lost = lag, 0, 0
        self._window = Window(THRESHOLD, SKIP, qr=self._engine.qr, name=name_of_key)
        self._engine = self._window
        self._time = [0.0]
        self._left: list[tuple[Array, Array]] = []

    def stamp(self, time: float) -> None:
        """The newest key pose's time [s]; without, it comes 1 s after the one before."""
        self._time[-1] = time

    def add_key(self, motion: Array, covariance: Array) -> None:
        """As `PoseGraph.add_key`."""
        super().add_key(motion, covariance)
        self._time.append(self._time[-1] + 1.0)

    def add_loops(self, key1: IntArray, key2: IntArray, relative: Array, covariance: Array) -> None:
        """As `PoseGraph.add_loops`, within the window; see above for what happens to the others."""
        first, second = np.minimum(key1, key2), np.maximum(key1, key2)
        inside = first >= self._oldest
        super().add_loops(key1[inside], key2[inside], relative[inside], covariance[inside])
        fix = ~inside & (second >= self._oldest)
        if (fix & (key1 > key2)).any():
            raise ValueError("a loop closure leads from the earlier key pose to the later one")
        self.fixes += int(fix.sum())
        self.lost += int((~inside & ~fix).sum())
        for i in np.flatnonzero(fix):
            place, P = self._left[key1[i]]
            there = compose(place, relative[i])
            F, B = transport(there - place), world_from_body(place[2])
            P = F @ P @ F.T + B @ covariance[i] @ B.T
            T = world_from_body(there[2])
            model = gtsam.noiseModel.Gaussian.SqrtInformation(root_information((T.T @ P @ T)[None])[0][0])
            self._factors.append(gtsam.PriorFactorPose2(X(int(key2[i])), pose2(there), with_loss(model, self.loss)))
            self._loops = True

    def update(self) -> None:
        """As `PoseGraph.update`; then what is too old leaves."""
        super().update()
        now = self._time[-1]
        if now - self._time[self._oldest] <= (1.0 + SLACK) * self.lag:
            return
        stay = bisect_left(self._time, now - self.lag)
        keys = range(self._oldest, stay)
        pose = np.array([self._window.pose(X(k)) for k in keys])
        self._left += list(zip(pose, self._world(pose, keys), strict=True))
        self._window.marginalize([X(k) for k in keys], [X(self.keys - 1)])
        self._oldest = stay

    def _world(self, pose: Array, keys: range) -> Array:
        """World-frame covariances of key poses in the window."""
        return in_world(pose, np.array([self._body_covariance(k) for k in keys]))

    def poses(self) -> Array:
        """Every key pose (K, 3) as it was when it left the window, those in it as they are now."""
        inside = self._present()
        return np.concatenate([[p for p, _ in self._left], inside]) if self._left else inside

    def covariances(self) -> Array:
        """Their covariances (K, 3, 3), of the same moments."""
        inside = super().covariances()
        return np.concatenate([[P for _, P in self._left], inside]) if self._left else inside

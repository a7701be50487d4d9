"""iSAM2 over key poses: a chain of relative poses with loop closures; of all key poses, or of the newest.

With a fixed lag, key poses are marginalized. A loop closure to one of them is a fix: the newest pose is measured from
that place, with the pose and covariance at its marginalization. The correlation of the two is ignored, so the path
returns to the place, the poses in between do not, and the covariance is too small after many such fixes. With landmarks
(`graph.fixed_lag`) loops are closed through the landmarks instead.
"""

from bisect import bisect_left

import gtsam
import numpy as np
from gtsam.symbol_shorthand import X

from data.inputs import IntArray, Prior
from data.se2 import Array, compose, world_from_body
from graph.engine import Engine, Window
from graph.factors import Factor, is_exact, noise, pose2, prior_factor, relative_factors, root_information
from graph.incremental import DELICATE
from graph.optimum import in_world

THRESHOLD = 0.05  # m, rad. Relinearize what moved further than this, ...
SKIP = 1  # ... anywhere in the graph, in every update


class PoseGraph:
    """Key poses in a chain, loop closures between them, estimated by iSAM2 (Kaess et al., IJRR 2012).

    Additions count from the next `update` on. Covariances in are of the additive error [m, m, rad] of the relative
    pose, in the body frame where it starts; covariances out are of poses, world frame, additive.
    """

    _engine: Engine

    def __init__(self, prior: Prior) -> None:
        self.prior, self.keys = prior, 1
        low = np.linalg.eigvalsh(prior.covariance)
        self._engine = Engine(
            THRESHOLD, SKIP, qr=bool(low[0] < DELICATE < low[-1]), name=lambda key: f"key pose {gtsam.symbolIndex(key)}"
        )
        self._tip = prior.mean.copy()
        self._factors: list[Factor] = [prior_factor(prior)]
        self._values = gtsam.Values()
        self._values.insert(X(0), pose2(prior.mean))
        self._loops = False
        self._oldest = 0  # first key pose in the graph

    def add_key(self, motion: Array, covariance: Array) -> None:
        """The next key pose, `motion` (3,) from the newest one; raises DataError for a singular covariance (3, 3)."""
        key, what = np.array([self.keys]), f"motion into key pose {self.keys}"
        factors, pivot, _ = relative_factors(key - 1, key, motion[None], covariance[None], lambda _: what)
        if pivot < DELICATE:
            self._engine.use_qr()
        self._tip = compose(self._tip, motion)
        self._factors += factors
        self._values.insert(X(self.keys), pose2(self._tip))
        self.keys += 1

    def add_loops(self, key1: IntArray, key2: IntArray, relative: Array, covariance: Array) -> None:
        """Poses (L, 3) of key2 (L,) in frames of key1 (L,), covariances (L, 3, 3). DataError for a singular one."""
        factors, _, _ = relative_factors(key1, key2, relative, covariance, lambda i: f"loop closure, number {i}")
        self._factors += factors
        self._loops |= bool(factors)

    def update(self) -> None:
        """One update of iSAM2; after loop closures more of them, until the newest pose stays."""
        if not self._factors:
            return
        self._engine.add(self._factors, self._values)
        self._factors, self._values = [], gtsam.Values()
        newest = int(X(self.keys - 1))
        if self._loops:
            self._engine.settle(newest, pose2(self._tip))
        self._tip, self._loops = self._engine.pose(newest), False

    @property
    def size(self) -> int:
        """Number of key poses in the graph."""
        return self.keys - self._oldest

    def newest(self) -> tuple[Array, Array]:
        """The newest key pose (3,) after the last update, and its covariance (3, 3)."""
        B = world_from_body(self._tip[2])
        P = B @ self._body_covariance(self.keys - 1) @ B.T
        return self._tip.copy(), 0.5 * (P + P.T)

    def poses(self) -> Array:
        """All key poses (K, 3) after the last update."""
        return np.asarray(gtsam.utilities.extractPose2(self._engine.values()), float)

    def covariances(self) -> Array:
        """Marginal covariances (K, 3, 3) of all key poses after the last update."""
        body = np.array([self._body_covariance(k) for k in range(self._oldest, self.keys)])
        return in_world(PoseGraph.poses(self), body)

    def _body_covariance(self, key: int) -> Array:
        """Covariance (3, 3) of a key pose in its own frame."""
        return np.zeros((3, 3)) if key == 0 and is_exact(self.prior) else self._engine.covariance([int(X(key))])


SLACK = 0.1  # share of the lag by which the oldest key pose may exceed it, as in `graph.fixed_lag`


class FixedLagPoseGraph(PoseGraph):
    """`PoseGraph` with a bounded number of key poses in the graph."""

    def __init__(self, prior: Prior, time: Array, *, lag: float) -> None:
        """As `PoseGraph`, but a key pose leaves `lag` [s] after its own of the times (K,) [s], or a tenth later."""
        if not lag >= 0.0:
            raise ValueError(f"lag {lag} must not be negative")
        super().__init__(prior)
        self.lag = lag
        self._engine = self._window = Window(self._engine)
        self._time = time
        self._left: list[tuple[Array, Array]] = []

    def add_loops(self, key1: IntArray, key2: IntArray, relative: Array, covariance: Array) -> None:
        """As `PoseGraph.add_loops`, to key poses within the window; see the module for those from ones that left it."""
        inside = key1 >= self._oldest
        super().add_loops(key1[inside], key2[inside], relative[inside], covariance[inside])
        for i in np.flatnonzero(~inside):
            place, P = self._left[key1[i]]
            there = compose(place, relative[i])
            F, B = np.eye(3), world_from_body(place[2])
            F[:2, 2] = place[1] - there[1], there[0] - place[0]
            P = F @ P @ F.T + B @ covariance[i] @ B.T
            T = world_from_body(there[2])
            model = noise.Gaussian.SqrtInformation(root_information((T.T @ P @ T)[None])[0][0])
            self._factors.append(gtsam.PriorFactorPose2(X(int(key2[i])), pose2(there), model))
            self._loops = True

    def update(self) -> None:
        """As `PoseGraph.update`; then old key poses are marginalized."""
        super().update()
        now = self._time[self.keys - 1]
        if now - self._time[self._oldest] <= (1.0 + SLACK) * self.lag:
            return
        stay = bisect_left(self._time, now - self.lag)
        keys = range(self._oldest, stay)
        pose = np.array([self._window.pose(X(k)) for k in keys])
        self._left += list(zip(pose, in_world(pose, np.array([self._body_covariance(k) for k in keys])), strict=True))
        self._window.marginalize([X(k) for k in keys], [X(self.keys - 1)])
        self._oldest = stay

    def poses(self) -> Array:
        """Every key pose (K, 3) as it left the window, those in it as they are now."""
        return np.array([*(p for p, _ in self._left), *super().poses()])

    def covariances(self) -> Array:
        """Their covariances (K, 3, 3), of the same moments."""
        return np.array([*(P for _, P in self._left), *super().covariances()])

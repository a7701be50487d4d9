"""iSAM2 over key poses, as they come: a chain of relative poses, and loop closures in it."""

from __future__ import annotations

import gtsam
import numpy as np
from gtsam.symbol_shorthand import X

from data.inputs import IntArray, Prior
from data.se2 import Array, compose, world_from_body
from graph.engine import Engine
from graph.factors import LOSSES, Factor, is_exact, pose2, prior_factor, with_loss
from graph.incremental import DELICATE, SETTLE
from graph.optimum import in_world
from graph.poses.factors import relative_noise

THRESHOLD = 0.05
"""m, rad. Relinearize what moved further than this, ..."""
SKIP = 1
"""... wherever in the graph it is, in every update."""


class PoseGraph:
    """Key poses in a chain, loop closures between them, and iSAM2 (Kaess et al., IJRR 2012) for their estimate.

    What is added counts from the next `update` on. Covariances that go in are of the additive error [m, m, rad] of the
    relative pose, in the body frame of the pose it starts at; those that come out are of poses, world frame, additive.
    """

    def __init__(self, prior: Prior, *, loss: str = "gaussian") -> None:
        """Key pose 0 is where the prior puts it. `loss` of loop closures; the chain is always believed."""
        if loss not in LOSSES:
            raise ValueError(f"loss {loss!r}; known: {', '.join(LOSSES)}")
        self.prior, self.loss, self.keys = prior, loss, 1
        low = np.linalg.eigvalsh(prior.covariance)
        self._engine = Engine(THRESHOLD, SKIP, qr=bool(low[0] < DELICATE < low[-1]), name=name_of_key)
        self._tip = prior.mean.copy()
        self._factors: list[Factor] = [prior_factor(prior)]
        self._values = gtsam.Values()
        self._values.insert(X(0), pose2(prior.mean))
        self._loops = False
        self._oldest = 0  # key pose that is still in the graph

    def add_key(self, motion: Array, covariance: Array) -> None:
        """The next key pose, `motion` (3,) with covariance (3, 3) from the newest one.

        Raises DataError for a covariance that is singular.
        """
        models, pivot = relative_noise(motion[None], covariance[None], f"motion into key pose {self.keys}")
        if pivot < DELICATE:
            self._engine.use_qr()
        self._tip = compose(self._tip, motion)
        self._factors.append(gtsam.BetweenFactorPose2(X(self.keys - 1), X(self.keys), pose2(motion), models[0]))
        self._values.insert(X(self.keys), pose2(self._tip))
        self.keys += 1

    def add_loops(self, key1: IntArray, key2: IntArray, relative: Array, covariance: Array) -> None:
        """Poses (L, 3) of key2 (L,) in the frames of key1 (L,), with covariances (L, 3, 3).

        Raises DataError for a covariance that is singular, ValueError for a key pose that is not there.
        """
        if len(key1) and not (min(key1.min(), key2.min()) >= 0 and max(key1.max(), key2.max()) < self.keys):
            raise ValueError(f"a loop closure is between key poses 0 ... {self.keys - 1}")
        models, _ = relative_noise(relative, covariance, "loop closure")
        for a, b, pose, model in zip(key1.tolist(), key2.tolist(), relative, models, strict=True):
            self._factors.append(gtsam.BetweenFactorPose2(X(a), X(b), pose2(pose), with_loss(model, self.loss)))
            self._loops = True

    def update(self) -> None:
        """One update of iSAM2 with what was added; after loop closures more of them, until the newest pose rests."""
        if not self._factors:
            return
        self._engine.add(self._factors, self._values)
        self._factors, self._values = [], gtsam.Values()
        newest = int(X(self.keys - 1))
        if self._loops:
            pose = self._engine.settle(newest, pose2(self._tip))
        else:
            pose = self._engine.isam.calculateEstimatePose2(newest)
        self._tip, self._loops = np.array([pose.x(), pose.y(), pose.theta()]), False

    def refine(self, updates: int = SETTLE) -> None:
        """More steps towards the optimum of what is known: an update without loop closures makes only one."""
        self._ready()
        for _ in range(updates):
            self._engine.update()
        pose = self._engine.isam.calculateEstimatePose2(X(self.keys - 1))
        self._tip = np.array([pose.x(), pose.y(), pose.theta()])

    @property
    def size(self) -> int:
        """How many key poses are in the graph."""
        return self.keys - self._oldest

    def newest(self) -> tuple[Array, Array]:
        """The newest key pose (3,) after the last update, and its covariance (3, 3)."""
        self._ready()
        B = world_from_body(self._tip[2])
        P = B @ self._body_covariance(self.keys - 1) @ B.T
        return self._tip.copy(), 0.5 * (P + P.T)

    def poses(self) -> Array:
        """All key poses (K, 3) after the last update."""
        return self._present()

    def covariances(self) -> Array:
        """Marginal covariances (K, 3, 3) of all key poses after the last update."""
        body = np.array([self._body_covariance(k) for k in range(self._oldest, self.keys)])
        return in_world(self._present(), body)

    def _present(self) -> Array:
        """Key poses that are in the graph."""
        self._ready()
        return np.asarray(gtsam.utilities.extractPose2(self._engine.values()), float)

    def _body_covariance(self, key: int) -> Array:
        """Covariance (3, 3) of a key pose in its own frame."""
        if key == 0 and is_exact(self.prior):
            return np.zeros((3, 3))
        return self._engine.covariance([int(X(key))])

    def _ready(self) -> None:
        """Raises ValueError where something was added that no update has seen."""
        if self._factors:
            raise ValueError("update the graph before asking it")


def name_of_key(key: int) -> str:
    """A variable in words."""
    return f"key pose {gtsam.symbolIndex(key)}"

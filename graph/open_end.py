"""The open end of the graph: the newest pose, composed from the motion since the newest pose that is in the graph."""

from __future__ import annotations

import gtsam
import numpy as np
from gtsam.symbol_shorthand import X

from data.inputs import Increment, Prior
from data.se2 import Array, world_from_body
from graph.factors import between_factors, pose2
from graph.transport import advance, transport


class OpenEnd:
    """The newest pose, and the increments that are not in the graph yet.

    Attributes:
        mean: (3,) of the newest pose.
        P: (3, 3), its covariance, world frame.
        anchor: frame of the newest pose in the graph, -1 before there is one.
    """

    def __init__(self, prior: Prior) -> None:
        """At the prior."""
        self.mean, self.P = prior.mean.copy(), prior.covariance.copy()
        self.anchor = -1
        self._anchor_pose = self.mean
        self._increments, self._path = list[Increment](), list[Array]()
        self._Q = np.zeros((3, 3))
        """Covariance gathered since the anchor."""

    @property
    def moved(self) -> bool:
        """Whether there was motion since the anchor."""
        return len(self._increments) > 0

    @property
    def since_anchor(self) -> tuple[Array, Array]:
        """Jacobian (3, 3) of the newest pose (world) to the anchor (its body frame), and covariance gathered since."""
        F = transport(self.mean - self._anchor_pose) @ world_from_body(self._anchor_pose[2])
        return F, self._Q

    def move(self, increment: Increment) -> None:
        """One increment further."""
        self._increments.append(increment)
        self._advance(increment)

    def _advance(self, increment: Increment) -> None:
        """The newest pose and its covariance by one increment (the same arithmetic as a filter's prediction)."""
        self.mean, self.P, self._Q = advance(self.mean, self.P, self._Q, increment.mean, increment.covariance)
        self._path.append(self.mean)

    def inflate(self, covariance: Array) -> None:
        """So much covariance (3, 3), alike in all directions, is added to the last increment's."""
        if not self._increments:
            raise ValueError("there was no motion since the last sighting")
        mean, stated = self._increments[-1]
        self._increments[-1] = Increment(mean, stated + covariance)
        self.P, self._Q = self.P + covariance, self._Q + covariance

    def place(self, pose: Array) -> None:
        """The newest pose starts at another place (3,), where there was motion that can have led there."""
        if self._increments:
            self.mean = self._path[-1] = pose.copy()

    def join_graph(self, values: gtsam.Values) -> tuple[list[gtsam.BetweenFactorPose2], float]:
        """Factors of the increments, start values added to `values`: the newest pose becomes the anchor.

        Also returned: the smallest pivot of their covariances (see `graph.factors.between_factors`).
        """
        if not self._increments:
            return [], np.inf
        mean, covariance = (np.array(rows) for rows in zip(*self._increments, strict=True))
        factors, pivot = between_factors(self.anchor + 1, mean, covariance)
        for k, pose in enumerate(self._path, self.anchor + 1):
            values.insert(X(k), pose2(pose))
        self.anchor += len(factors)
        self._increments, self._path = [], []
        return factors, pivot

    def renew(self, anchor_pose: Array, P: Array) -> None:
        """The graph has a new estimate of the anchor (3,), with covariance (3, 3): the newest pose follows from it."""
        self._anchor_pose = self.mean = anchor_pose
        self.P, self._Q, self._path = P, np.zeros((3, 3)), []
        for increment in self._increments:
            self._advance(increment)

"""The open end of the graph: the newest pose, composed from the motion since the newest pose that is in the graph.

A pose carried along by increments, with its covariance and what was gathered since another one.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import gtsam
import numba
import numpy as np
from gtsam.symbol_shorthand import X

from data.blocks import diagonal_blocks
from data.inputs import Increment, IntArray, Prior
from data.motion.velocity import carried
from data.result import MapState, PoseEstimate, Systematics
from data.se2 import Array, world_from_body
from data.sensors import wrap_angle_jit
from graph.engine import Engine, Window
from graph.factors import Factor, Sighted, between_factors, is_exact, pose2, prior_factor
from graph.problem import Problem


@numba.njit(cache=True)
def advance(mean, P, Q, motion, M):  # type: ignore[no-untyped-def]
    """Pose (3,), its covariance P and the covariance Q gathered since the anchor, one increment later."""
    wx, wy, F, B = carried(mean[2], motion)
    moved = np.array([mean[0] + wx, mean[1] + wy, wrap_angle_jit(mean[2] + motion[2])])
    G = B @ M @ B.T
    return moved, F @ P @ F.T + G, F @ Q @ F.T + G


def transport(displacement: Array) -> Array:
    """Jacobian of a pose to an earlier one, world frame, for the displacement (3,) between them."""
    F = np.eye(3)
    F[0, 2], F[1, 2] = -displacement[1], displacement[0]
    return F


class Left(NamedTuple):
    """A pose (3,) of the robot with covariance (3, 3), body frame; errors (p,) and sigmas (p,), as they were there."""

    pose: Array
    covariance: Array
    errors: tuple[Array, Array] | None = None


class OpenEnd:
    """The newest pose, and the increments that are not in the graph yet.

    Attributes:
        mean: (3,) of the newest pose.
        P: (3, 3), its covariance, world frame.
        anchor: frame of the newest pose in the graph, -1 before there is one.
    """

    def __init__(self, prior: Prior) -> None:
        """At the prior."""
        self.prior = prior
        self.mean, self.P = prior.mean.copy(), prior.covariance.copy()
        self.anchor = -1
        self._anchor_pose = self.mean
        self._increments, self._path = list[Increment](), list[Array]()
        self._Q = np.zeros((3, 3))
        """Covariance gathered since the anchor."""
        self._motion = list[gtsam.BetweenFactorPose2]()

    @property
    def moved(self) -> bool:
        """Whether there was motion since the anchor."""
        return len(self._increments) > 0

    @property
    def keys(self) -> list[int]:
        """Variables of the graph that the newest pose follows from."""
        return [int(X(self.anchor))]

    @property
    def errors(self) -> tuple[Array, Array] | None:
        """Systematic errors: none."""
        return None

    def estimate(self) -> PoseEstimate:
        """The newest pose of the robot (copies)."""
        return PoseEstimate(self.mean.copy(), self.P.copy())

    @property
    def since_anchor(self) -> tuple[Array, Array]:
        """Jacobian (3, 3) of the newest pose (world) to the anchor (its body frame), and covariance gathered since."""
        F = transport(self.mean - self._anchor_pose) @ world_from_body(self._anchor_pose[2])
        return F, self._Q

    def carried(self, J: Array) -> Array:
        """Joint covariance of the newest pose and landmarks (world) from that of the variables `keys` and landmarks."""
        if self.anchor == 0 and is_exact(self.prior):
            J[:3], J[:, :3] = 0.0, 0.0  # gtsam's joint marginal takes a hard constraint for a variance of about 1
        F, Q = self.since_anchor
        J[:3] = F @ J[:3]
        J[:, :3] = J[:, :3] @ F.T
        J[:3, :3] += Q
        return J

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

    def inside(self, pose: Array) -> Array:
        """A pose (3,) of the robot as it is in the graph."""
        return pose

    def place(self, pose: Array) -> None:
        """The newest pose starts at another place (3,) of the graph, where there was motion that can have led there."""
        if self._increments:
            self.mean = self._path[-1] = pose.copy()

    def join_graph(self, values: gtsam.Values) -> tuple[list[Factor], float]:
        """Factors of the increments (and the prior), start values added to `values`: the newest pose is the anchor.

        Also returned: the smallest pivot of their covariances (see `graph.factors.between_factors`).
        """
        first = list[Factor]()
        if self.anchor < 0:
            self.anchor = 0
            first.append(prior_factor(self.prior))
            values.insert(X(0), pose2(self.prior.mean))
        if not self._increments:
            return first, np.inf
        mean, covariance = (np.array(rows) for rows in zip(*self._increments, strict=True))
        factors, pivot = between_factors(self.anchor + 1, mean, covariance)
        for k, pose in enumerate(self._path, self.anchor + 1):
            values.insert(X(k), pose2(pose))
        self.anchor += len(factors)
        self._increments, self._path = [], []
        self._motion += factors
        return [*first, *factors], pivot

    def hold(self, handles: Sequence[int]) -> None:
        """The engine's handles on the factors of `join_graph`."""

    def read(self, engine: Engine) -> None:
        """The graph has a new estimate of the anchor: the newest pose follows from it."""
        pose = engine.settle(self.keys[0], pose2(self.mean))
        B = world_from_body(pose.theta())
        P = B @ engine.covariance(self.keys) @ B.T
        self._anchor_pose = self.mean = np.array([pose.x(), pose.y(), pose.theta()])
        self.P, self._Q, self._path = 0.5 * (P + P.T), np.zeros((3, 3)), []
        for increment in self._increments:
            self._advance(increment)

    def points(self, xy: Array) -> Array:
        """Points (n, 2) of the world from those of the graph."""
        return xy

    def reach(self, radius: float) -> tuple[Array, float]:
        """Where the newest pose (2,) is on a known map, and a radius [m] around it there."""
        return self.mean[:2], radius

    def known(self, xy: Array) -> tuple[Array, Array]:
        """Known landmarks (n, 2) as they are in the graph; covariance of the newest pose, and of them if not known."""
        return xy, self.P

    def map_of(self, number: IntArray, xy: Array, J: Array) -> MapState:
        """Landmarks (n,) of the graph, at xy (n, 2) there; J: joint covariance of the variables `keys` and them."""
        return MapState(number, xy, diagonal_blocks(J[3:, 3:]))

    def leaving(self, window: Window, frames: Iterable[int]) -> list[Left]:
        """Poses of frames in a window, which may leave it."""
        return [Left(window.pose(X(k)), window.covariance([X(k)])) for k in frames]

    def forget(self, oldest: int) -> list[int]:
        """Frame `oldest` becomes the first one in the graph: further variables that leave it."""
        self._motion.clear()
        return []

    def history(self, left: Array) -> Systematics | None:
        """Systematic errors of frames that left, from these and their sigmas (N, 2, p) then: none."""
        return None

    def problem(self, sighted: Sequence[Sighted], known_map: bool) -> Problem:
        """All of the run as a problem."""
        return Problem(self.prior, self._motion, sighted, known_map)

    def start(self, values: gtsam.Values, problem: Problem) -> gtsam.Values:
        """Where the search for the optimum starts: the present estimate."""
        return values

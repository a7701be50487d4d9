"""The open end of the graph: the newest pose, composed from the motion since the newest pose in the graph."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import gtsam
import numpy as np
from gtsam.symbol_shorthand import X

from data.blocks import diagonal_blocks
from data.compiled import njit
from data.inputs import Increment, IntArray, Prior
from data.motion.velocity import compose_in_place
from data.result import MapState, PoseEstimate, Systematics
from data.se2 import Array, world_from_body
from data.sensors import wrap_angle_jit
from graph.engine import Engine, Window
from graph.factors import Factor, ObservationFactors, between_factors, is_exact, pose2, pose_array, prior_factor
from graph.problem import Problem


@njit
def advance(mean: Array, P: Array, Q: Array, motion: Array, M: Array) -> tuple[Array, Array, Array]:
    """Pose (3,), its covariance P and the covariance Q gathered since the anchor, one increment later."""
    moved, new_P, new_Q = np.empty(3), np.empty((3, 3)), np.empty((3, 3))
    compose_in_place(mean, P, motion, M, moved, new_P)
    compose_in_place(mean, Q, motion, M, moved, new_Q)
    moved[2] = wrap_angle_jit(moved[2])
    return moved, new_P, new_Q


def transport(displacement: Array) -> Array:
    """Jacobian of a pose to an earlier one, world frame, for the displacement (3,) between them."""
    F = np.eye(3)
    F[0, 2], F[1, 2] = -displacement[1], displacement[0]
    return F


class MarginalizedPose(NamedTuple):
    """A marginalized pose (3,) with covariance (3, 3), body frame; errors (p,) and sigmas (p,) at that time."""

    pose: Array
    covariance: Array
    errors: tuple[Array, Array] | None = None


class OpenEnd:
    """The newest pose, and the increments that are not in the graph yet."""

    def __init__(self, prior: Prior) -> None:
        self.prior = prior
        self.mean, self.P = prior.mean.copy(), prior.covariance.copy()  # newest pose, world frame
        self.anchor = -1  # frame of the newest pose in the graph, -1 before there is one
        self._increments, self._path = list[Increment](), list[Array]()
        self._joined: Increment | None = None  # the motion into the newest pose in the graph
        self._known_exactly = is_exact(prior)
        self._motion = list[gtsam.BetweenFactorPose2]()
        self._anchor = self.mean, self.P
        self._Q = np.zeros((3, 3))  # covariance gathered since the anchor

    @property
    def keys(self) -> list[int]:
        """Variables of the graph that determine the newest pose."""
        return [int(X(self.anchor))]

    @property
    def errors(self) -> tuple[Array, Array] | None:
        """Systematic errors: none."""
        return None

    def estimate(self) -> PoseEstimate:
        """The newest pose of the robot (copies)."""
        return PoseEstimate(self.mean.copy(), self.P.copy())

    def _since_anchor(self) -> tuple[Array, Array]:
        """Jacobian (3, n) of the newest pose (world) to the variables `keys`, and covariance (3, 3) gathered since."""
        pose = self._anchor[0]
        return transport(self.mean - pose) @ world_from_body(pose[2]), self._Q

    def carried(self, J: Array) -> Array:
        """Joint covariance of the newest pose and landmarks from that of `keys` and landmarks, in graph coordinates."""
        T, Q = self._since_anchor()
        n, J = T.shape[1], self._fix_anchor(J)
        found = np.empty((len(J) - n + 3,) * 2)
        across = T @ J[:n]
        found[:3, :3] = across[:, :n] @ T.T + Q
        found[:3, 3:], found[3:, :3], found[3:, 3:] = across[:, n:], across[:, n:].T, J[n:, n:]
        return found

    def _fix_anchor(self, J: Array) -> Array:
        """Joint covariance of the anchor and others, corrected where a hard constraint holds the anchor."""
        if self.anchor == 0 and self._known_exactly:
            J[:3], J[:, :3] = 0.0, 0.0  # gtsam's joint marginal has a variance of about 1
        return J

    def move(self, increment: Increment) -> None:
        """Add an increment."""
        self._increments.append(increment)
        self._advance(increment)

    def _advance(self, increment: Increment) -> None:
        """Propagate the newest pose and its covariance by one increment (the arithmetic of a filter's prediction)."""
        moved = np.array(increment.mean), np.array(increment.covariance)  # read-only arrays would compile once more
        self.mean, self.P, self._Q = advance(self.mean, self.P, self._Q, *moved)
        self._path.append(self.mean)

    def inflate(self, covariance: Array) -> None:
        """Add an isotropic covariance (3, 3) to the last increment's."""
        if not self._increments:
            raise ValueError("there was no motion since the last observation")
        mean, stated = self._increments[-1]
        self._increments[-1] = Increment(mean, stated + covariance)
        self._propagate_again()

    def inflated(self, covariance: Array) -> Factor:
        """Factor of the motion into the newest pose in the graph, with that much covariance (3, 3) more."""
        assert self._joined is not None  # the newest pose joined with a motion
        mean, stated = self._joined
        self._joined = Increment(mean, stated + covariance)
        return self._motion_again(self._joined)

    def _motion_again(self, increment: Increment) -> Factor:
        """The newest motion's factor anew, with another covariance."""
        (factor,), _ = between_factors(self.anchor, increment.mean[None], increment.covariance[None])
        self._motion[-1:] = [factor]  # of a window, none are kept
        return factor

    def _propagate_again(self) -> None:
        """Propagate all increments since the anchor again."""
        self._reset()
        self._path = []
        for increment in self._increments:
            self._advance(increment)

    def _reset(self) -> None:
        """Reset the newest pose to the anchor."""
        (self.mean, self.P), self._Q = self._anchor, np.zeros((3, 3))

    def inside(self, pose: Array) -> Array:
        """A robot's pose (3,) in the frame of the graph."""
        return pose

    def place(self, pose: Array, *, joined: bool = False) -> None:
        """Start the newest pose at another pose (3,) of the graph, if there was motion or it is in the graph."""
        if self._increments:
            self.mean = self._path[-1] = pose.copy()
        elif joined:
            self.mean = pose.copy()

    def join_graph(self, values: gtsam.Values) -> tuple[list[Factor], float]:
        """Factors of the increments (and the prior), start values added to `values`: the newest pose is the anchor.
        Also returns the smallest pivot of their covariances (see `graph.factors.between_factors`).
        """
        first = list[Factor]()
        if self.anchor < 0:
            self.anchor = 0
            first = self._first_factors(values)
        if not self._increments:
            return first, np.inf
        for k, pose in enumerate(self._path, self.anchor + 1):
            values.insert(X(k), pose2(pose))
        factors, pivot = self._motion_factors(values)
        self._joined = self._increments[-1]
        self.anchor += len(self._increments)
        self._increments, self._path = [], []
        return first + factors, pivot

    def _first_factors(self, values: gtsam.Values) -> list[Factor]:
        """Prior factors, and their start values."""
        values.insert(X(0), pose2(self.prior.mean))
        return [prior_factor(self.prior)]

    def _motion_factors(self, values: gtsam.Values) -> tuple[list[Factor], float]:
        """Factors of the increments since the anchor, start values of variables of their own, smallest pivot."""
        mean, covariance = (np.array(rows) for rows in zip(*self._increments, strict=True))
        factors, pivot = between_factors(self.anchor + 1, mean, covariance)
        self._motion += factors
        return [*factors], pivot

    def read(self, engine: Engine) -> None:
        """Propagate the newest pose from the new estimate of the anchor."""
        self._settle(engine, pose2(self.mean))
        self._propagate_again()

    def _settle(self, engine: Engine, before: gtsam.Pose2) -> None:
        """Read the anchor from the graph, after more updates if it jumped away from `before`."""
        pose = engine.settle(self.keys[0], before)
        B = world_from_body(pose.theta())
        P = B @ engine.covariance(self.keys) @ B.T
        self._anchor = pose_array(pose), 0.5 * (P + P.T.copy())  # a sum with a view takes 80 us after gtsam's work

    def points(self, xy: Array) -> Array:
        """Points (n, 2) of the world from those of the graph."""
        return xy

    def reach(self, radius: float) -> tuple[Array, float]:
        """Position (2,) of the newest pose on a known map, and a radius [m] around it there."""
        return self.mean[:2], radius

    def known(self, xy: Array) -> tuple[Array, Array]:
        """Known landmarks (n, 2) in the graph's frame; covariance of the newest pose, and theirs if not exact."""
        return xy, self.P

    def map_of(self, number: IntArray, xy: Array, J: Array) -> MapState:
        """Map of landmarks (n,) at xy (n, 2) in the graph; J: joint covariance of the variables `keys` and them."""
        return MapState(number, xy, diagonal_blocks(J[3:, 3:]))

    def leaving(self, window: Window, frame: int) -> MarginalizedPose:
        """The pose of a frame in a window, before its marginalization."""
        return MarginalizedPose(window.pose(X(frame)), window.covariance([X(frame)]))

    def forget(self, oldest: int) -> list[int]:
        """Make frame `oldest` the first one in the graph; returns further variables that leave it."""
        self._motion.clear()
        return []

    def history(self, left: Array) -> Systematics | None:
        """Systematic errors (N, 2, p) with sigmas of frames that left: none."""
        return None

    def problem(self, observations: Sequence[ObservationFactors], known_map: bool) -> Problem:
        """The whole run as a problem."""
        return Problem(self.prior, self._motion, observations, known_map)

    def start(self, values: gtsam.Values, problem: Problem) -> gtsam.Values:
        """Start of the search for the optimum: the present estimate."""
        return values

"""The optimum of a smoothing problem with its exact covariances: gtsam's Levenberg-Marquardt, then Newton steps.

Levenberg-Marquardt stops on a small decrease of the error and never complains, not even about a variable that nothing
determines. So its result is checked, and polished, with the exact Newton step of `graph.marginals`, which measures the
distance to the optimum in sigmas and gives the covariances on the way.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import gtsam
import numpy as np
from gtsam.symbol_shorthand import L, X

from data.inputs import IntArray, Prior
from data.result import MapState, Trajectory
from data.se2 import Array, world_from_body
from graph.factors import Sighted, UnderConstrained, graph_of, pose2, prior_factor
from graph.marginals import Linearized, UndeterminedError, solve

STEP = 1e-6
"""sigma. A Newton step smaller than this in every variable ends the search."""
ROUNDING = 2e-5
"""sigma. So does one below this that hardly shrank: gtsam's logarithm of a pose is good to 1e-5 sigma or so."""
ERROR_ROUNDING = 1e-7
"""Of the cost: what a step towards the optimum may seem to lose (the ranges to beacons are rounded to nanometres)."""
POLISH = 6
"""Most Newton steps; one or two are usual, robust losses converge linearly and may use all."""
TINY = 1e-9
"""m, rad. Stands in for a sigma of zero when a step is measured in sigmas."""


@dataclass(frozen=True)
class Problem:
    """A log as factors.

    Attributes:
        prior: on the pose of frame 0.
        motion: [k - 1] leads into frame k.
        sighted: the observations in use, ascending by frame.
        known_map: the landmarks are known, so that none is estimated.
    """

    prior: Prior
    motion: Sequence[gtsam.NonlinearFactor]
    sighted: Sequence[Sighted]
    known_map: bool

    def graph(self) -> gtsam.NonlinearFactorGraph:
        """Everything, as gtsam takes it."""
        return graph_of([prior_factor(self.prior), *self.motion, *(f for s in self.sighted for f in s.factors)])

    @property
    def numbers(self) -> IntArray:
        """Landmarks that are estimated, ascending."""
        return np.unique([s.number for s in self.sighted if not self.known_map]).astype(np.int64)

    @property
    def dof(self) -> int:
        """Degrees of freedom of the chi-square: two for each observation, less two for each landmark."""
        return 2 * len(self.sighted) - 2 * len(self.numbers)

    def values(self, pose: Array, landmark: dict[int, Array]) -> gtsam.Values:
        """Start values from poses (N, 3) and landmark positions (2,) by number."""
        values = gtsam.Values()
        for k, row in enumerate(pose):
            values.insert(X(k), pose2(row))
        for n in self.numbers:
            values.insert(L(int(n)), landmark[int(n)])
        for s in self.sighted:
            if s.xy is not None and s.key is not None:
                values.insert(s.key, s.xy)
        return values


@dataclass(frozen=True)
class Optimum:
    """The minimum of a problem.

    Attributes:
        trajectory, map: with exact marginal covariances (map is None where it was known).
        error: half the cost; without a robust loss half the chi-square.
        iterations: of both optimizers.
        last_step: sigmas, the Newton step that was left.
    """

    trajectory: Trajectory
    map: MapState | None
    error: float
    iterations: int
    last_step: float


def optimize(problem: Problem, start: gtsam.Values) -> Optimum:
    """Minimize from `start`; raises `UnderConstrained` naming a variable that the data leave free."""
    graph = problem.graph()
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setRelativeErrorTol(1e-9)
    parameters.setAbsoluteErrorTol(1e-9)
    parameters.setMaxIterations(200)
    optimizer = gtsam.LevenbergMarquardtOptimizer(graph, start, parameters)
    values = optimizer.optimize()
    error, iterations = graph.error(values), optimizer.iterations()
    # what is left without the prior (the smoother takes it exact) and without the pins of known landmarks (not moving)
    inner = graph_of([*problem.motion, *(f for s in problem.sighted for f in s.measured)])
    numbers = problem.numbers
    last_step = np.inf
    for polished in range(POLISH + 1):
        try:
            solution = solve(linearize(problem, inner, values))
        except UndeterminedError as free:
            raise UnderConstrained(f"landmark {numbers[free.slot]} is not determined by the observations") from None
        _check_poses(solution.pose_covariance)
        before, last_step = (
            last_step,
            max(
                _in_sigmas(solution.pose, solution.pose_covariance),
                _in_sigmas(solution.landmark, solution.landmark_covariance),
            ),
        )
        if last_step < STEP or 0.5 * before < last_step < ROUNDING or polished == POLISH:
            break
        delta = gtsam.VectorValues()
        for k, row in enumerate(solution.pose):
            delta.insert(X(k), row)
        for n, row in zip(numbers, solution.landmark, strict=True):
            delta.insert(L(int(n)), row)
        moved = values.retract(delta)
        moved_error = graph.error(moved)
        if not moved_error <= error + ERROR_ROUNDING * (1.0 + error):
            break
        values, error, iterations = moved, moved_error, iterations + 1
    pose = poses_of(values, len(problem.motion) + 1)
    state = None
    if not problem.known_map:
        xy = np.array([values.atPoint2(L(int(n))) for n in numbers]).reshape(-1, 2)
        state = MapState(numbers, xy, solution.landmark_covariance)
    trajectory = Trajectory(pose, in_world(pose, solution.pose_covariance))
    return Optimum(trajectory, state, error, iterations, last_step)


def linearize(problem: Problem, inner: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> Linearized:
    """The problem around `values` as a chain; `inner` holds the motion factors, then the measurements."""
    n, m = len(problem.motion) + 1, len(problem.sighted)
    # rows: three for each motion, two for each observation; columns: landmarks by key, poses, right-hand side
    key_of = [s.key for s in problem.sighted if s.key is not None]
    keys = sorted(set(key_of))
    landmarks = len(keys)
    chain, readings = np.zeros((n, 3, 7)), np.zeros((m, 2, 6))
    if inner.size():
        triplets = inner.linearize(values).sparseJacobian_()
        row, column = triplets[:2].astype(np.int64) - 1
        value = triplets[2]
        place = column - 2 * landmarks
        frame, entry, right = place // 3, place % 3, place == 3 * n
        moving = row < 3 * (n - 1)
        k, r = row // 3 + 1, row % 3
        end = frame == k
        of = moving & ~right
        chain[k[of], r[of], entry[of] + 3 * end[of]] = value[of]
        of = moving & right
        chain[k[of], r[of], 6] = value[of]
        i, r = (row - 3 * (n - 1)) // 2, (row - 3 * (n - 1)) % 2
        of = ~moving & (place >= 0) & ~right
        readings[i[of], r[of], entry[of]] = value[of]
        of = ~moving & (place < 0)
        readings[i[of], r[of], 3 + column[of] % 2] = value[of]
        of = ~moving & right
        readings[i[of], r[of], 5] = value[of]
    F, step, Q = np.zeros((n, 3, 3)), np.zeros((n, 3)), np.zeros((n, 3, 3))
    end_block = chain[1:, :, 3:6]
    lost = np.flatnonzero(np.linalg.det(end_block) == 0.0)
    if len(lost):
        raise UnderConstrained(f"pose of frame {lost[0] + 1} is not determined: its increment carries no information")
    inverse = np.linalg.inv(end_block)
    F[1:] = -inverse @ chain[1:, :, :3]
    step[1:] = (inverse @ chain[1:, :, 6:])[:, :, 0]
    Q[1:] = inverse @ inverse.transpose(0, 2, 1)
    step[0], Q[0] = _prior_in_tangent(problem.prior, values)
    first = np.searchsorted([s.frame for s in problem.sighted], np.arange(n + 1)).astype(np.int64)
    if problem.known_map:
        slot, count = np.zeros(m, np.int64), 0
    else:
        slot, count = np.searchsorted(keys, key_of).astype(np.int64), landmarks
    Hx, Hl, y = (np.ascontiguousarray(readings[..., c]) for c in (slice(0, 3), slice(3, 5), 5))
    return Linearized(F, step, Q, first, Hx, Hl, y, slot, count)


def _prior_in_tangent(prior: Prior, values: gtsam.Values) -> tuple[Array, Array]:
    """Mean (3,) and covariance (3, 3) that the prior gives the first pose's tangent coordinates; never inverts P0."""
    unit = gtsam.PriorFactorPose2(X(0), pose2(prior.mean), gtsam.noiseModel.Unit.Create(3))
    A, b = unit.linearize(values).jacobian()
    inverse = np.linalg.inv(A) @ world_from_body(prior.mean[2]).T
    mean = np.asarray(np.linalg.solve(A, b), float)
    covariance: Array = inverse @ prior.covariance @ inverse.T
    return mean, covariance


def _check_poses(covariance: Array) -> None:
    """Raise `UnderConstrained` for the first pose without a finite covariance."""
    lost = np.flatnonzero(~np.isfinite(covariance).all((1, 2)))
    if len(lost):
        raise UnderConstrained(f"pose of frame {lost[0]} is not determined: its covariance is not finite")


def _in_sigmas(step: Array, covariance: Array) -> float:
    """Largest component of steps (n, d), each divided by its standard deviation."""
    sigma = np.sqrt(np.maximum(np.diagonal(covariance, axis1=1, axis2=2), TINY**2))
    return float(np.max(np.abs(step) / sigma, initial=0.0))


def poses_of(values: gtsam.Values, n: int) -> Array:
    """Poses (n, 3) of frames 0 ... n - 1."""
    poses = np.empty((n, 3))
    for k in range(n):
        p = values.atPose2(X(k))
        poses[k] = p.x(), p.y(), p.theta()
    return poses


def in_world(pose: Array, covariance: Array) -> Array:
    """Body-frame covariances (N, 3, 3) of poses (N, 3) turned into the world frame: B S B'."""
    B = np.zeros((len(pose), 3, 3))
    c, s = np.cos(pose[:, 2]), np.sin(pose[:, 2])
    B[:, 0, 0], B[:, 0, 1], B[:, 1, 0], B[:, 1, 1], B[:, 2, 2] = c, -s, s, c, 1.0
    world = B @ covariance @ B.transpose(0, 2, 1)
    return 0.5 * (world + world.transpose(0, 2, 1))

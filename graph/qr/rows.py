"""A smoothing problem as rows for `graph.qr.elimination`: increments and priors linearized here, all else by gtsam.

The drift of a knot is a variable like a pose. The few constant systematic errors affect all rows: they are further
right-hand sides (see `graph.qr.elimination`), the effect of a prior sigma of each on the residuals. All is in the
sensor's frame, except the first pose, which the prior knows in the world: its variable is the motion of the robot's own
pose, with a column for the errors.
"""

from collections.abc import Sequence
from typing import NamedTuple, Self

import gtsam
import numpy as np
from gtsam.symbol_shorthand import L, X

from data.inputs import IntArray, Prior
from data.se2 import Array, BoolArray, compose, world_from_body, wrap_angle
from graph.factors import Factor, ObservationFactors, graph_of, pose2, pose_array, prior_factor
from graph.problem import Problem
from graph.qr.elimination import NO_DRIFT, Rows, Solution, Structure, ordering, structure
from graph.systematic import CONSTANTS, drift_key

CHUNK = 10000  # observations that gtsam linearizes at once: its triplets take 24 bytes a number
EXACT = 1e-15  # share of the largest variance of the prior below which another one is zero, and rounding
INDEX = np.uint64(2**56 - 1)  # the index bits of a gtsam symbol, below its character


class Chunk(NamedTuple):
    """Consecutive factors: `row` (r, 2) block and row in it of each residual, `column` (q, 2) variable, component."""

    graph: gtsam.NonlinearFactorGraph
    row: IntArray
    column: IntArray

    @classmethod
    def of(cls, blocks: Sequence[Sequence[Factor]], block: int, size: IntArray, frames: int, numbers: IntArray) -> Self:
        """Factors that fill consecutive blocks of so many rows (`size`), from `block` on."""
        part = graph_of(f for factors in blocks for f in factors)
        row = np.stack([np.repeat(block + np.arange(len(blocks)), size), _within(size)], 1)
        variable, pose = variables_of(part.keyVector(), frames, numbers)  # gtsam sorts the keys
        dim = np.where(pose, 3, 2)
        return cls(part, row, np.stack([np.repeat(variable, dim), _within(dim)], 1))

    def put(self, values: gtsam.Values, variable: IntArray, A: Array, b: Array) -> None:
        """Linearize around `values`, into the blocks A and b with the variables of each, in place."""
        triplets = self.graph.linearize(values).sparseJacobian_()
        r, c = triplets[0].astype(np.int64) - 1, triplets[1].astype(np.int64) - 1
        block, value = self.row[r, 0], triplets[2]
        right = c == len(self.column)
        b[block[right], self.row[r[right], 1], 0] = value[right]
        left = np.flatnonzero(~right)
        one, component = self.column[c[left]].T
        left, one, component = (each[one >= 0] for each in (left, one, component))
        second = one != variable[block[left], 0]
        A[block[left], self.row[r[left], 1], 3 * second + component] = value[left]


def variables_of(keys: Sequence[int], frames: int, numbers: IntArray) -> tuple[IntArray, BoolArray]:
    """Variables (k,) of keys of poses and landmarks, -1: a known landmark; which are poses."""
    symbols = np.array(keys, np.uint64)
    index, pose = (symbols & INDEX).astype(np.int64), symbols >> np.uint64(56) == ord("x")
    return np.where(pose, index, frames + np.searchsorted(numbers, index) if len(numbers) else -1), pose


class Linearizer:
    """Linearizes a problem repeatedly; parts independent of the estimate are computed once.

    Variables: poses 0 ... N - 1, the landmarks to be estimated, the drift of each knot. Blocks: the prior, the
    increments, the observations, fixes and closures (`of_poses`; those not in use have no rows), the priors of
    landmarks, those of the drift. The prior of the pose is taken exactly, even if singular: variable 0 represents the
    motion of the first pose, see `first`. Each constant systematic error has a right-hand side.
    """

    def __init__(self, problem: Problem) -> None:
        motion, of_poses, priors = problem.motion, problem.pose_factors, problem.priors
        self._problem, self._motion, self.numbers = problem, motion, problem.numbers
        self.frames = n = len(motion.increments.mean)  # N
        m, q = len(problem.observations), n + len(problem.observations) + len(of_poses)
        variable = np.full((q + len(priors), 2), -1)
        variable[:n, 0] = np.arange(n)
        variable[1:n, 1] = np.arange(n - 1)
        variable[n : n + m, 0] = [s.frame for s in problem.observations]
        if not problem.known_map:
            variable[n : n + m, 1] = n + np.searchsorted(self.numbers, [s.number for s in problem.observations])
        for row, p in enumerate(of_poses, n + m):
            variable[row, : len(p.frames)] = p.frames
        variable[q:, 0] = n + np.searchsorted(self.numbers, [p.number for p in priors])
        height = [3] * n + [2] * m + [len(p.entries) if p.used else 0 for p in of_poses] + [2] * len(priors)
        blocks = variable, np.array(height, np.int64), np.repeat([3, 2], [n, len(self.numbers)])
        self._variable, self._height, self._dim = with_drift(*blocks, motion.of, motion.knots)
        self.of_poses = n + m + np.arange(len(of_poses))
        # whether steps are extrapolated, for large residuals and weights that vanish
        self.extrapolates = len(of_poses) > 0 and not motion.names
        further = [*(p.factor for p in of_poses), *(p.factor for p in priors)]
        self._further = self._chunked([[f] for f in further], n + m, [f.dim() for f in further])
        self._further_factors = [*problem.of_poses, *(p.factor for p in priors)]
        self._chunks, self._graph = self._observations([s.measured for s in problem.observations])
        self._prior = prior_factor(problem.prior)
        moves = problem.known_map and motion.frame.range_at >= 0  # known landmarks that the range error moves
        self._world = np.array([s.xy for s in problem.observations]).reshape(-1, 2) if moves else None
        self._last: tuple[gtsam.Values, Array, Array] | None = None
        self._first: tuple[gtsam.Values, tuple[Array, Array, Array]] | None = None
        # with closures no variable counts as a pose of a bare chain, whose order would fill in
        chain = 0 if any(p.closure for p in of_poses) else n
        order = ordering(self._variable, chain, len(self._dim), motion.first_of if motion.knots else NO_DRIFT)
        self.structure: Structure = structure(self._variable, self._dim, order)

    def _observations(self, measured: Sequence[Sequence[Factor]]) -> tuple[list[Chunk], gtsam.NonlinearFactorGraph]:
        """The factors of all observations and those after them, in chunks and together."""
        every = [f for factors in measured for f in factors]
        chunks = self._chunked(measured, self.frames, [2] * len(measured))
        return chunks + self._further, graph_of([*every, *self._further_factors])

    def _chunked(self, blocks: Sequence[Sequence[Factor]], block: int, dims: Sequence[int]) -> list[Chunk]:
        """Factors that fill consecutive blocks of so many rows (`dims`), from `block` on."""
        chunks = []
        for first in range(0, len(blocks), CHUNK):
            some, size = blocks[first : first + CHUNK], np.array(dims[first : first + CHUNK], np.int64)
            chunks.append(Chunk.of(some, block + first, size, self.frames, self.numbers))
        return chunks

    def __call__(self, values: gtsam.Values) -> Rows:
        """The rows around `values`, right-hand sides (B, 3, 1 + q) with q constant systematic errors."""
        B, motion, n = len(self._variable), self._motion, self.frames
        A = np.zeros((B, 3, 6 + self._variable.shape[1] - 2))
        b = np.zeros((B, 3, 1 + len(motion.constant)))
        self._renew(values)
        for chunk in self._chunks:
            chunk.put(values, self._variable, A, b)
        pose, errors = self._state(values)
        residual, before, after, by_errors = motion.linearized(pose, errors)
        by_errors *= motion.sigma
        A[1:n, :, :3], A[1:n, :, 3:6] = after, before
        b[1:n, :, 0], b[1:n, :, 1:] = -residual, by_errors[:, :, motion.constant]
        if motion.knots:
            A[1:n, :, 6] = by_errors[:, :, motion.drift]
            A[-motion.knots :, 0, 0], A[-motion.knots :, 0, 3] = motion.drift_rows
            b[-motion.knots :, 0, 0] = -motion.drift_steps(errors)
        if self._world is not None:
            # observations are relative: a shift of the landmark is the opposite shift of the pose
            seen, frame = np.array([s.frame for s in self._problem.observations], np.int64), motion.frame
            shift = (self._world - frame.origin) * motion.sigma[frame.range_at]
            cos, sin = np.cos(pose[seen, 2]), np.sin(pose[seen, 2])
            body = np.stack([cos * shift[:, 0] + sin * shift[:, 1], cos * shift[:, 1] - sin * shift[:, 0]], 1)
            rows, at = slice(n, n + len(seen)), 1 + int(np.searchsorted(motion.constant, frame.range_at))
            b[rows, :, at] -= np.einsum("mij,mj->mi", A[rows, :, :2], body)
        start, z, root = self.first(values)
        J, by_constants = self._first_by(errors[0], pose[0])
        put_prior(self._variable, A, b, J @ start, z, J @ root, by_constants)
        return Rows(self._variable, A, b, self._height, self._dim)

    def _state(self, values: gtsam.Values) -> tuple[Array, Array]:
        """Poses (N, 3), in the order of gtsam's keys, and errors (N, p); cached."""
        if self._last is None or self._last[0] is not values:
            self._last = values, np.ascontiguousarray(gtsam.utilities.extractPose2(values)), self._motion.errors(values)
        return self._last[1:]

    def _robot(self, values: gtsam.Values) -> gtsam.Pose2:
        pose, errors = self._state(values)
        return pose2(self._motion.frame.poses_out(pose[:1], errors[:1])[0][0])

    def first(self, values: gtsam.Values) -> tuple[Array, Array, Array]:
        """The first pose's tangent coordinates as start + U w, where z + w ~ N(0, I): start, z (3,), U (3, 3).

        The start is zero unless the present estimate contradicts an exact direction of the prior. The pose is that of
        the robot in the world.
        """
        if self._first is None or self._first[0] is not values:
            self._first = values, _prior_in_tangent(self._problem.prior, self._robot(values))
        return self._first[1]

    def _first_by(self, errors: Array, pose: Array) -> tuple[Array, Array]:
        """Jacobians (3, 3), (3, q) of the first pose's tangent to the robot's pose and to constant errors in sigmas."""
        of, sigma, frame = self._motion, self._motion.sigma, self._motion.frame
        by_constants, size, bearing = np.zeros((3, len(of.constant))), 1.0, 0.0
        if frame.same:
            return np.eye(3), by_constants
        if frame.bearing_at >= 0:
            bearing = errors[frame.bearing_at]
            by_constants[2, np.searchsorted(of.constant, frame.bearing_at)] = -sigma[frame.bearing_at]
        if frame.range_at >= 0:
            size += errors[frame.range_at]
            away = world_from_body(pose[2])[:2, :2].T @ (pose[:2] - frame.origin) / size
            by_constants[:2, np.searchsorted(of.constant, frame.range_at)] = sigma[frame.range_at] * away
        sensor = compose(frame.mount, np.array([0.0, 0.0, -bearing]))
        return np.diag([size, size, 1.0]) @ pose2(sensor).inverse().AdjointMap(), by_constants

    def constants(self, values: gtsam.Values) -> Array:
        """The constant systematic errors (q,) in sigmas."""
        return values.atVector(CONSTANTS) if len(self._motion.constant) else np.empty(0)

    def tangent(self, solution: Solution, values: gtsam.Values) -> Array:
        """Its step (V, 3) in tangent coordinates, also of the first pose."""
        delta = solution.step.copy()
        start, _, root = self.first(values)
        delta[0] = start + root @ delta[0]
        return delta

    def cost(self, values: gtsam.Values) -> float:
        """Half the sum of the squared whitened residuals, or of the losses."""
        self._renew(values)
        pose, errors = self._state(values)
        parts = self._motion.linearized(pose, errors)[0], self.constants(values), self._motion.drift_steps(errors)
        first = gtsam.Values()
        first.insert(X(0), self._robot(values))
        own = 0.5 * sum(float(np.sum(part**2)) for part in parts) + float(self._prior.error(first))
        return float(self._graph.error(values)) + own

    def step(self, delta: Array, constants: Array) -> gtsam.VectorValues:
        """A step delta (V, 3) in tangent coordinates, and `constants` (q,) in units of their sigmas, as gtsam's."""
        vector, n, m = gtsam.VectorValues(), self.frames, len(self.numbers)
        for k, row in enumerate(delta[:n]):
            vector.insert(X(k), row)
        for number, row in zip(self.numbers.tolist(), delta[n : n + m, :2], strict=True):
            vector.insert(L(number), row)
        for j, drift in enumerate(delta[n + m :, :1]):
            vector.insert(drift_key(j), drift)
        if len(constants):
            vector.insert(CONSTANTS, constants)
        return vector

    def moved(self, values: gtsam.Values, step: gtsam.VectorValues) -> gtsam.Values:
        """Values after a step."""
        moved, frame = values.retract(step), self._motion.frame
        errors = self._motion.errors(moved)
        first = pose_array(self._robot(values).retract(step.at(X(0))))
        moved.update(X(0), pose2(frame.poses_in(first[None], errors[:1])[0]))
        if self._world is not None:
            for s, at in zip(self._problem.observations, frame.points_in(self._world, errors[-1])[0], strict=True):
                if s.key is not None:
                    moved.update(s.key, at)
        return moved

    def flat(self, values: gtsam.Values, moved: gtsam.Values) -> tuple[Array, Array]:
        """Poses and landmarks (3 N + 2 L,) of an estimate, headings not wrapped, and the way to a moved one."""
        at, there = (np.concatenate(self._arrays(each), axis=None) for each in (values, moved))
        way = there - at
        way[2 : 3 * self.frames : 3] = wrap_angle(way[2 : 3 * self.frames : 3])
        return at, way

    def _arrays(self, values: gtsam.Values) -> tuple[Array, Array]:
        pose = np.array([pose_array(values.atPose2(X(k))) for k in range(self.frames)])
        return pose, np.array([values.atPoint2(L(n)) for n in self.numbers.tolist()]).reshape(-1, 2)

    def unflat(self, at: Array, like: gtsam.Values) -> gtsam.Values:
        """The estimate with poses and landmarks (3 N + 2 L,), all else as in another one."""
        values, n = gtsam.Values(like), 3 * self.frames
        for k, pose in enumerate(at[:n].reshape(-1, 3)):
            values.update(X(k), pose2(pose))
        for number, xy in zip(self.numbers.tolist(), at[n:].reshape(-1, 2), strict=True):
            values.update(L(number), xy)
        return values

    def name(self, variable: int) -> str:
        """Name of a variable."""
        n, m = self.frames, len(self.numbers)
        if variable < n:
            return f"pose of frame {variable}"
        if variable < n + m:
            return f"landmark {self.numbers[variable - n]}"
        return f"the drift from frame {self._motion.first_of[variable - n - m]} on"

    def _renew(self, values: gtsam.Values) -> None:
        """Move known landmarks in the factors according to the errors of `values`."""
        seen = self._problem.observations
        if self._world is not None and any(s.key is None for s in seen):
            xy = self._motion.frame.points_in(self._world, self._state(values)[1][-1])[0]
            measured = [s.measured if s.key is not None else [_moved(s, at)] for s, at in zip(seen, xy, strict=True)]
            self._chunks, self._graph = self._observations(measured)


def _within(size: IntArray) -> IntArray:
    """Number of each row in its block, for blocks of these sizes one after the other."""
    return np.asarray(np.arange(size.sum()) - np.repeat(np.cumsum(size) - size, size))


def _moved(observation: ObservationFactors, xy: Array) -> Factor:
    """The factor of a known landmark without a variable, moved to xy (2,)."""
    (factor,) = observation.measured
    assert isinstance(factor, gtsam.KnownLandmarkFactorPose2)
    assert observation.xy is not None
    point = observation.xy - factor.evaluateError(gtsam.Pose2())
    return gtsam.KnownLandmarkFactorPose2(X(observation.frame), xy, point, factor.noiseModel())


def with_drift(
    variable: IntArray, height: IntArray, dim: IntArray, of: IntArray, knots: int
) -> tuple[IntArray, IntArray, IntArray]:
    """Variables (B, 3), heights (B,) and dimensions (V,) of `Rows` with a drift of `knots` knots as last variables. It
    enters the blocks of the increments, 1 to N - 1; those of its prior come last. The same without a knot.
    """
    if not knots:
        return variable, height, dim
    drift, enters, chain = len(dim) + np.arange(knots), np.full(len(variable), -1), np.full((knots, 3), -1)
    enters[1 : len(of)] = drift[of[1:]]
    chain[:, 0], chain[1:, 1] = drift, drift[:-1]
    one = np.ones(knots, np.int64)
    blocks = np.concatenate([np.column_stack([variable, enters]), chain])
    return blocks, np.concatenate([height, one]), np.concatenate([dim, one])


def put_prior(
    variable: IntArray, A: Array, b: Array, start: Array, z: Array, root: Array, by_errors: Array | None = None
) -> None:
    """Substitute w for variable 0, the first pose: start + U w with z + w ~ N(0, I), in place.

    `variable` (B, 2), A (B, 3, 6), b (B, 3, c) as of `Rows`; block 0 is that of the prior. U: `root` (3, 3).
    `by_errors` (3, c - 1): effect on the first pose of a unit of each further right-hand side.
    """
    for k in np.flatnonzero((variable == 0).any(axis=1)):
        q = 3 * int(variable[k, 0] != 0)
        b[k, :, 0] -= A[k, :, q : q + 3] @ start
        if by_errors is not None:
            b[k, :, 1:] += A[k, :, q : q + 3] @ by_errors
        A[k, :, q : q + 3] = A[k, :, q : q + 3] @ root
    A[0, :, :3], b[0, :, 0] = np.eye(3), -z


def _prior_in_tangent(prior: Prior, pose: gtsam.Pose2) -> tuple[Array, Array, Array]:
    unit = gtsam.PriorFactorPose2(X(0), pose2(prior.mean), gtsam.noiseModel.Unit.Create(3))
    values = gtsam.Values()
    values.insert(X(0), pose)
    A, b = unit.linearize(values).jacobian()
    turned = world_from_body(prior.mean[2])
    variance, axes = np.linalg.eigh(prior.covariance)
    sigma = np.sqrt(np.where(variance > EXACT * variance[-1], variance, 0.0))
    along = axes.T @ turned @ -b  # offset of the estimate from the prior's mean, along the axes
    z = np.divide(along, sigma, out=np.zeros(3), where=sigma > 0.0)
    start = np.linalg.solve(A, b + turned.T @ axes @ (sigma * z))
    root: Array = np.linalg.solve(A, turned.T @ (axes * sigma))
    return start, z, root

"""A smoothing problem linearized by gtsam, as rows for `graph.qr.elimination`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import gtsam
import numpy as np
from gtsam.symbol_shorthand import L, X

from data.inputs import IntArray, Prior
from data.se2 import Array, world_from_body, wrap_angle
from graph.factors import graph_of, pose2, pose_array
from graph.pose_factors import PoseFactor
from graph.problem import Problem
from graph.qr.calibrated import CalibratedRows, with_drift
from graph.qr.elimination import NO_DRIFT, Rows, Structure, ordering, structure
from graph.qr.solution import Solution
from graph.systematic import CONSTANTS

CHUNK = 20000  # factors that gtsam linearizes at once: its triplets take 24 bytes a number
EXACT = 1e-15  # share of the largest variance of the prior below which another one is zero, and rounding
INDEX = np.uint64(2**56 - 1)  # the index bits of a gtsam symbol, below its character


class _Chunk(NamedTuple):
    """Consecutive factors: `row` (r, 2) block and row in it of each residual, `column` (q, 2) variable, component."""

    graph: gtsam.NonlinearFactorGraph
    row: IntArray
    column: IntArray


class Linearizer:
    """Linearizes a problem repeatedly; parts independent of the estimate are computed once.

    Variables: poses 0 ... N - 1, then the landmarks to be estimated. Blocks: the prior, the increments, the
    observations, fixes and closures (`of_poses`; those not in use have no rows), the priors of landmarks. The prior of
    the pose is taken exactly, even if
    singular: variable 0 represents the motion of the first pose, see `first`. Systematic errors: their drifts are
    variables behind the landmarks, with blocks behind all others; each constant one has a right-hand side, the effect
    of a unit of it on the residuals.
    """

    def __init__(self, problem: Problem) -> None:
        self.prior = problem.prior
        self.frames, self.numbers = len(problem.motion) + 1, problem.numbers  # N, landmarks to be estimated
        self.calibrated = None if problem.calibrated is None else CalibratedRows(problem)
        n, m, of_poses, priors = self.frames, len(problem.observations), problem.pose_factors, problem.priors
        q = n + m + len(of_poses)
        frame = np.array([s.frame for s in problem.observations], np.int64)
        variable = np.full((q + len(priors), 2), -1)
        variable[:n, 0] = np.arange(n)
        variable[1:n, 1] = np.arange(n - 1)
        variable[n : n + m, 0] = frame
        if not problem.known_map:
            number = np.array([s.number for s in problem.observations], np.int64)
            variable[n : n + m, 1] = n + np.searchsorted(self.numbers, number)
        for row, p in enumerate(of_poses, n + m):
            variable[row, : len(p.frames)] = p.frames
        self._variable = variable
        variable[q:, 0] = n + np.searchsorted(self.numbers, np.array([p.number for p in priors], np.int64))
        height = [len(p.entries) if p.used else 0 for p in of_poses] + [2] * len(priors)
        self._height = np.concatenate([np.repeat(np.array([3, 2], np.int64), [n, m]), np.array(height, np.int64)])
        self.of_poses = n + m + np.arange(len(of_poses))
        # whether steps are extrapolated, for large residuals and weights that vanish
        self.extrapolates = len(of_poses) > 0 and problem.calibrated is None
        of_map = [p.factor for p in priors]
        self._further = [*self._whole(of_poses, n + m), *self._chunked(of_map, q, 2)]
        self._further_factors = [*problem.of_poses, *of_map]
        self._dim = np.repeat(np.array([3, 2], np.int64), [n, len(self.numbers)])
        if problem.calibrated is not None and self.calibrated is not None:
            drifts = problem.calibrated.of, problem.calibrated.knots
            self._variable, self._height, self._dim = with_drift(variable, self._height, self._dim, *drifts)
            self._chunks, self._graph = self._observations([s.measured for s in problem.observations])
        else:
            observations, _ = self._observations([s.measured for s in problem.observations])
            self._chunks, self._graph = [*self._chunked(problem.motion, 1, 3), *observations], problem.graph()
        drift = NO_DRIFT if self.calibrated is None else self.calibrated.first_of
        # with closures no variable counts as a pose of a bare chain, whose order would fill in
        chain = 0 if any(p.closure for p in of_poses) else n
        self.structure: Structure = structure(
            self._variable, self._dim, ordering(self._variable, chain, len(self._dim), drift)
        )

    def _observations(
        self, measured: Sequence[Sequence[gtsam.NonlinearFactor]]
    ) -> tuple[list[_Chunk], gtsam.NonlinearFactorGraph]:
        """The factors of all observations, in chunks and together."""
        chunks, step = list[_Chunk](), CHUNK // 2
        for first in range(0, len(measured), step):
            part = [f for factors in measured[first : first + step] for f in factors]
            chunks += self._chunked(part, self.frames + first, 2)
        every = [f for factors in measured for f in factors]
        return chunks + self._further, graph_of([*every, *self._further_factors])

    def _chunked(self, factors: Sequence[gtsam.NonlinearFactor], block: int, height: int) -> list[_Chunk]:
        """Factors whose residuals fill blocks of `height` rows, from `block` on."""
        chunks = []
        step = CHUNK - CHUNK % 2  # an observation may be two factors of one residual each
        for first in range(0, len(factors), step):
            part = gtsam.NonlinearFactorGraph()
            for f in factors[first : first + step]:
                part.add(f)
            size = sum(f.dim() for f in factors[first : first + step])
            row = np.stack([block + np.arange(size) // height, np.arange(size) % height], 1)
            block += size // height
            chunks.append(_Chunk(part, row, self._columns(part)))
        return chunks

    def _whole(self, factors: Sequence[PoseFactor], block: int) -> list[_Chunk]:
        """Fixes and closures, each of which fills a block of its own, from `block` on."""
        chunks = []
        for first in range(0, len(factors), CHUNK):
            some = factors[first : first + CHUNK]
            size = np.array([len(p.entries) for p in some])
            within = np.arange(size.sum()) - np.repeat(np.cumsum(size) - size, size)
            row = np.stack([np.repeat(block + first + np.arange(len(some)), size), within], 1)
            part = graph_of(p.factor for p in some)
            chunks.append(_Chunk(part, row, self._columns(part)))
        return chunks

    def _columns(self, part: gtsam.NonlinearFactorGraph) -> IntArray:
        """Variable and component (q, 2) of the columns of a part: gtsam sorts the keys; -1: a known landmark."""
        keys = np.array(part.keyVector(), np.uint64)
        index, pose = (keys & INDEX).astype(np.int64), keys >> np.uint64(56) == ord("x")
        landmark = self.frames + np.searchsorted(self.numbers, index) if len(self.numbers) else np.full(len(keys), -1)
        variable, dim = np.where(pose, index, landmark), np.where(pose, 3, 2)
        column = np.repeat(variable, dim)
        component = np.arange(len(column)) - np.repeat(np.cumsum(dim) - dim, dim)
        return np.stack([column, component], 1)

    def __call__(self, values: gtsam.Values) -> Rows:
        """The rows around `values`, right-hand sides (B, 3, 1 + q) with q constant systematic errors."""
        B, q = len(self._variable), 0 if self.calibrated is None else self.calibrated.constants
        A, b = np.zeros((B, 3, 6 + self._variable.shape[1] - 2)), np.zeros((B, 3, 1 + q))
        self._renew(values)
        for part, row, column in self._chunks:
            triplets = part.linearize(values).sparseJacobian_()
            r, c = triplets[0].astype(np.int64) - 1, triplets[1].astype(np.int64) - 1
            block, value = row[r, 0], triplets[2]
            right = c == len(column)
            b[block[right], row[r[right], 1], 0] = value[right]
            left = np.flatnonzero(~right)
            variable, component = column[c[left]].T
            left, variable, component = (each[variable >= 0] for each in (left, variable, component))
            second = variable != self._variable[block[left], 0]
            A[block[left], row[r[left], 1], 3 * second + component] = value[left]
        start, z, root = self.first(values)
        by_errors = None
        if self.calibrated is not None:
            J, by_errors = self.calibrated.fill(A, b, values)
            start, root = J @ start, J @ root
        put_prior(self._variable, A, b, start, z, root, by_errors)
        return Rows(self._variable, A, b, self._height, self._dim)

    def first(self, values: gtsam.Values) -> tuple[Array, Array, Array]:
        """The first pose's tangent coordinates as start + U w, where z + w ~ N(0, I): start, z (3,) and U (3, 3).

        The start is zero unless the present estimate contradicts an exact direction of the prior. With systematic
        errors it is the robot's pose in the world.
        """
        return _prior_in_tangent(self.prior, values if self.calibrated is None else self.calibrated.robot(values))

    def constants(self, values: gtsam.Values) -> Array:
        """The constant systematic errors (q,) in sigmas."""
        none = self.calibrated is None or not self.calibrated.constants
        return np.empty(0) if none else values.atVector(CONSTANTS)

    def tangent(self, solution: Solution, values: gtsam.Values) -> Array:
        """Its step (V, 3) in tangent coordinates, also of the first pose."""
        delta = solution.step.copy()
        start, _, root = self.first(values)
        delta[0] = start + root @ delta[0]
        return delta

    def cost(self, values: gtsam.Values) -> float:
        """Half the sum of the squared whitened residuals, or of the losses."""
        self._renew(values)
        error = float(self._graph.error(values))
        return error if self.calibrated is None else error + self.calibrated.cost(values)

    def moved(self, values: gtsam.Values, delta: Array, constants: Array) -> gtsam.Values:
        """Values after a step: delta (V, 3) in tangent coordinates, `constants` (q,) in units of their sigmas."""
        vector = gtsam.VectorValues()
        for k, row in enumerate(delta[: self.frames]):
            vector.insert(X(k), row)
        landmarks = delta[self.frames : self.frames + len(self.numbers), :2]
        for number, row in zip(self.numbers.tolist(), landmarks, strict=True):
            vector.insert(L(number), row)
        if self.calibrated is None:
            return values.retract(vector)
        return self.calibrated.moved(values, vector, delta[0], delta[self.frames + len(self.numbers) :, 0], constants)

    def flat(self, values: gtsam.Values, moved: gtsam.Values) -> tuple[Array, Array]:
        """Poses and landmarks (3 N + 2 L,) of an estimate, headings not wrapped, and the way to a moved one."""
        at, there = (np.concatenate(self._arrays(each), axis=None) for each in (values, moved))
        way = there - at
        heading = way[2 : 3 * self.frames : 3]
        way[2 : 3 * self.frames : 3] = wrap_angle(heading)
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
        assert self.calibrated is not None
        return f"the drift from frame {self.calibrated.first_of[variable - n - m]} on"

    def _renew(self, values: gtsam.Values) -> None:
        """Move known landmarks in the factors according to the errors of `values`."""
        measured = None if self.calibrated is None else self.calibrated.measured(values)
        if measured is not None:
            self._chunks, self._graph = self._observations(measured)


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


def _prior_in_tangent(prior: Prior, values: gtsam.Values) -> tuple[Array, Array, Array]:
    unit = gtsam.PriorFactorPose2(X(0), pose2(prior.mean), gtsam.noiseModel.Unit.Create(3))
    A, b = unit.linearize(values).jacobian()
    turned = world_from_body(prior.mean[2])
    variance, axes = np.linalg.eigh(prior.covariance)
    sigma = np.sqrt(np.where(variance > EXACT * variance[-1], variance, 0.0))
    along = axes.T @ turned @ -b  # offset of the estimate from the prior's mean, along the axes
    z = np.divide(along, sigma, out=np.zeros(3), where=sigma > 0.0)
    start = np.linalg.solve(A, b + turned.T @ axes @ (sigma * z))
    root: Array = np.linalg.solve(A, turned.T @ (axes * sigma))
    return start, z, root

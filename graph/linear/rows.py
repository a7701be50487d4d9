"""A smoothing problem linearized by gtsam, as the rows that `graph.linear.elimination` takes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import gtsam
import numpy as np
from gtsam.symbol_shorthand import X

from data.inputs import IntArray, Prior
from data.se2 import Array, world_from_body
from graph.factors import pose2
from graph.linear.elimination import Rows
from graph.linear.ordering import ordering
from graph.linear.symbolic import Structure, structure
from graph.problem import Problem

CHUNK = 20000
"""Factors that gtsam linearizes at once: its triplets take 24 bytes a number."""
EXACT = 1e-15
"""Share of the largest variance of the prior below which another one is zero, and rounding."""
INDEX = np.uint64(2**56 - 1)
"""The bits of a gtsam symbol that are its index; its character stands above."""


class _Chunk(NamedTuple):
    """Factors in a row: `row` (r, 2) block and row in it of each residual, `column` (q, 2) variable and component."""

    graph: gtsam.NonlinearFactorGraph
    row: IntArray
    column: IntArray


class Linearizer:
    """Linearizes a problem again and again; what does not change with the estimate is done once.

    Variables: poses 0 ... N - 1, then the landmarks to be estimated. Blocks: the prior, the increments, the
    observations. The prior is taken exactly, however singular: variable 0 stands for what moves the first pose, see
    `first`.
    """

    def __init__(self, problem: Problem) -> None:
        """Ready to linearize."""
        self.prior = problem.prior
        self.frames, self.numbers = len(problem.motion) + 1, problem.numbers
        n, m = self.frames, len(problem.sighted)
        frame = np.array([s.frame for s in problem.sighted], np.int64)
        variable = np.full((n + m, 2), -1)
        variable[:n, 0] = np.arange(n)
        variable[1:n, 1] = np.arange(n - 1)
        variable[n:, 0] = frame
        if not problem.known_map:
            number = np.array([s.number for s in problem.sighted], np.int64)
            variable[n:, 1] = n + np.searchsorted(self.numbers, number)
        self._variable = variable
        self._height = np.repeat(np.array([3, 2], np.int64), [n, m])
        self._dim = np.repeat(np.array([3, 2], np.int64), [n, len(self.numbers)])
        self._chunks = [*self._chunked(problem.motion, 1, 3)]
        step = CHUNK // 2
        for first in range(0, m, step):
            part = problem.sighted[first : first + step]
            self._chunks += self._chunked([f for s in part for f in s.measured], n + first, 2)
        self.structure: Structure = structure(variable, ordering(variable, n, len(self._dim)))

    def _chunked(self, factors: Sequence[gtsam.NonlinearFactor], block: int, height: int) -> list[_Chunk]:
        """Factors whose residuals fill blocks of so many rows, from `block` on."""
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

    def _columns(self, part: gtsam.NonlinearFactorGraph) -> IntArray:
        """Variable and component (q, 2) of the columns of a part: gtsam sorts the keys; -1: a known landmark."""
        variable, dim = self._variables(np.array(part.keyVector(), np.uint64))
        column = np.repeat(variable, dim)
        component = np.arange(len(column)) - np.repeat(np.cumsum(dim) - dim, dim)
        return np.stack([column, component], 1)

    def _variables(self, keys: IntArray) -> tuple[IntArray, IntArray]:
        """Variable (-1: a known landmark) and dimension of keys (q,)."""
        index, pose = (keys & INDEX).astype(np.int64), keys >> np.uint64(56) == ord("x")
        landmark = self.frames + np.searchsorted(self.numbers, index) if len(self.numbers) else np.full(len(keys), -1)
        return np.where(pose, index, landmark), np.where(pose, 3, 2)

    def __call__(self, values: gtsam.Values) -> Rows:
        """The rows around `values`, right-hand sides (B, 3, 1)."""
        A, b = np.zeros((len(self._variable), 3, 6)), np.zeros((len(self._variable), 3, 1))
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
        put_prior(self._variable, A, b, start, z, root)
        return Rows(self._variable, A, b, self._height, self._dim)

    def first(self, values: gtsam.Values) -> tuple[Array, Array, Array]:
        """The first pose's tangent coordinates as start + U w, where z + w ~ N(0, I): start, z (3,) and U (3, 3).

        The start is zero unless the present estimate contradicts what the prior knows exactly.
        """
        return _prior_in_tangent(self.prior, values)


def put_prior(variable: IntArray, A: Array, b: Array, start: Array, z: Array, root: Array) -> None:
    """Variable 0, the first pose, becomes w where the pose is start + U w and z + w ~ N(0, I), in place.

    `variable` (B, 2), A (B, 3, 6), b (B, 3, c) as of `Rows`; block 0 is that of the prior. U: `root` (3, 3).
    """
    for k in np.flatnonzero((variable == 0).any(axis=1)):
        q = 3 * int(variable[k, 0] != 0)
        b[k, :, 0] -= A[k, :, q : q + 3] @ start
        A[k, :, q : q + 3] = A[k, :, q : q + 3] @ root
    A[0, :, :3], b[0, :, 0] = np.eye(3), -z


def _prior_in_tangent(prior: Prior, values: gtsam.Values) -> tuple[Array, Array, Array]:
    unit = gtsam.PriorFactorPose2(X(0), pose2(prior.mean), gtsam.noiseModel.Unit.Create(3))
    A, b = unit.linearize(values).jacobian()
    turned = world_from_body(prior.mean[2])
    variance, axes = np.linalg.eigh(prior.covariance)
    sigma = np.sqrt(np.where(variance > EXACT * variance[-1], variance, 0.0))
    along = axes.T @ turned @ -b  # how far the estimate is from the prior's mean, along the axes
    z = np.divide(along, sigma, out=np.zeros(3), where=sigma > 0.0)
    start = np.linalg.solve(A, b + turned.T @ axes @ (sigma * z))
    root: Array = np.linalg.solve(A, turned.T @ (axes * sigma))
    return start, z, root

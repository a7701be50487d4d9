"""A linearized graph made triangular by sparse QR, with solutions and joint marginal covariances of its factors.

A column that depends on those before it, gauge freedom or a variable that nothing ties, is left out: its variable keeps
its value in that direction. All that residuals depend on is invariant to this choice (Rao and Mitra, "Generalized
inverse of matrices", 1971, section 2.5).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from data.inputs import IntArray
from data.se2 import Array
from graph.qr import solution
from graph.qr.elimination import Blocks, Structure, Triangle, colamd, structure, triangular
from wings.audit.linear import Group, System

DEPENDENT = 1e-9  # share of a column's norm below which its remainder is rounding: 1e-10 was seen on 20 000 poses
PART = 128  # right-hand sides solved at once: they stay in the cache


@dataclass(frozen=True, eq=False)
class Factored:
    """A system made triangular.

    Attributes:
        at: (V,) first column of each variable in the order of elimination.
        home: per group, (n,) the position at which each factor is eliminated.
    """

    system: System
    structure: Structure
    triangle: Triangle
    at: IntArray
    home: Sequence[IntArray]

    @property
    def columns(self) -> int:
        """Their number."""
        return len(self.triangle.diagonal)

    @property
    def dropped(self) -> IntArray:
        """Columns that the others determine."""
        return np.flatnonzero(self.triangle.diagonal == 0.0)

    @property
    def rank(self) -> int:
        """Number of determined columns."""
        return self.columns - len(self.dropped)

    @property
    def square(self) -> float:
        """Least sum of squares of the weighted linear system."""
        return float(self.triangle.left[0, 0])

    def index(self, group: Group) -> IntArray:
        """Columns (n, c) of the variables of each factor."""
        return index_of(group, self.at, self.system.dim)

    def at_of(self, group: Group, n: int) -> IntArray:
        """Columns (c,) of the variables of one factor of a group."""
        return np.concatenate([self.at[v] + np.arange(self.system.dim[v]) for v in group.variables[n].tolist()])


def index_of(group: Group, at: IntArray, dim: IntArray) -> IntArray:
    """Columns (n, c) of the variables of each factor, the first of each variable at `at` (V,)."""
    sizes = dim[group.variables[0]]
    within = np.concatenate([np.arange(size) for size in sizes]) if len(sizes) else np.zeros(0, np.int64)
    out: IntArray = np.repeat(at[group.variables], sizes, axis=1) + within
    return out


def ordering(system: System, last: Sequence[int] = ()) -> IntArray:
    """Order (V,) of elimination with little fill-in; the variables `last` at the end."""
    return colamd(unique_variables(system), last)


def unique_variables(system: System) -> Iterator[list[int]]:
    """Sets of variables that share a factor; gtsam's symbolic factors have at most four, larger sets are chained."""
    for group in system.groups:
        if group.variables.shape[1]:
            for variables in np.unique(np.sort(group.variables, axis=1), axis=0).tolist():
                if len(variables) <= 4:
                    yield variables
                else:
                    yield from ([a, b] for k, a in enumerate(variables) for b in variables[k + 1 :])


def factorize(system: System, order: IntArray, scale: Sequence[Array] | None = None) -> Factored:
    """Make the system triangular.

    Args:
        system: the linearized graph.
        order: (V,) of elimination.
        scale: factor (n, d) of each row of each group, besides the root of its weight.
    """
    groups = system.groups
    widest = max(g.variables.shape[1] for g in groups)
    padded = np.concatenate(
        [np.pad(g.variables, ((0, 0), (0, widest - g.variables.shape[1])), constant_values=-1) for g in groups]
    )
    s = structure(padded, system.dim, order)
    at, square = s.at, np.zeros(s.column[-1])
    A, b, columns = [], [], []
    for k, g in enumerate(groups):
        factor = np.sqrt(g.weight)[:, None] * (np.ones_like(g.r) if scale is None else scale[k])
        A.append(g.A * factor[:, :, None])
        b.append(-g.r * factor)
        columns.append(index_of(g, at, system.dim))
        square += np.bincount(columns[-1].ravel(), np.sum(A[-1] ** 2, axis=1).ravel(), len(square))
    count, height, width = (np.array([each.shape[i] for each in A]) for i in range(3))
    height, width = np.repeat(height, count), np.repeat(width, count)
    at_A, at_b, at_column = (np.append(0, np.cumsum(size)) for size in (height * width, height, width))
    flat, right, column = (np.concatenate([each.ravel() for each in some]) for some in (A, b, columns))
    blocks = Blocks(flat, at_A[:-1], column, at_column, right[:, None], at_b[:-1], height)
    home = np.empty_like(s.block)
    home[s.block] = np.repeat(np.arange(len(s.parent)), np.diff(s.first))
    ends = np.append(0, np.cumsum(count)).tolist()
    t = triangular(blocks, s, 0.0, DEPENDENT * np.sqrt(square))
    return Factored(system, s, t, at, [home[i:j] for i, j in pairwise(ends)])


def step(f: Factored) -> Array:
    """Columns (N,) of the least-squares step."""
    return solution.backward(f.structure, f.triangle, f.triangle.d)[:, 0]


def forward(f: Factored, right: Array, homes: IntArray | None = None) -> Array:
    """R^-T right (N, c), which is overwritten; products of columns are those of `right` with the covariance between.

    `homes`: positions at which alone `right` is not zero, or all.
    """
    some = np.full(len(f.structure.parent), homes is None)
    if homes is not None:
        some[homes] = True
    return solution.forward(f.structure, f.triangle, right, some)


def solved(f: Factored, right: Array, homes: IntArray | None = None) -> Array:
    """Solution (N, c) of the normal equations  A' W A x = right (N, c); arguments as of `forward`."""
    return solution.backward(f.structure, f.triangle, forward(f, right, homes))


def joint_covariances(f: Factored) -> list[Array]:
    """Joint marginal covariance (n, c, c) of the variables of each factor, per group."""
    return solution.joint_covariances(f.structure, f.triangle, [f.index(g) for g in f.system.groups])

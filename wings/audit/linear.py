"""Any gtsam graph, linearized: whitened residuals and Jacobians of each factor, in groups of equal shape.

A factor with a robust noise is linearized with the noise beneath, and has a weight: the estimate depends on the
weighted residual, the test of the factor on its stated noise.

The system is made triangular by sparse QR, which gives solutions and joint marginal covariances of its factors. A
column that depends on those before it, gauge freedom or a variable that nothing ties, is left out: its variable keeps
its value in that direction. All that residuals depend on is invariant to this choice (Rao and Mitra, "Generalized
inverse of matrices", 1971, section 2.5).
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import combinations, pairwise
from typing import Any

import gtsam
import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from data.errors import DataError
from data.inputs import IntArray
from data.se2 import Array
from graph.qr import elimination
from graph.qr.elimination import Blocks, Structure, Triangle, colamd, structure, triangular

DEPENDENT = 1e-9  # share of a column's norm below which its remainder is rounding: 1e-10 was seen on 20 000 poses
PART = 128  # right-hand sides solved at once: they stay in the cache


@dataclass(frozen=True, eq=False)
class Factored:
    """A system made triangular."""

    system: System
    structure: Structure
    triangle: Triangle
    at: IntArray  # (V,) first column of each variable in the order of elimination
    home: Sequence[IntArray]  # per group, (n,) the position at which each factor is eliminated

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
        return index_of(group.variables, self.at, self.system.dim)


def index_of(variables: IntArray, at: IntArray, dim: IntArray) -> IntArray:
    """Columns (n, c) of the variables (n, k) of each factor, the first of each variable at `at` (V,)."""
    sizes = dim[variables[0]]
    within = np.concatenate([np.arange(size) for size in sizes]) if len(sizes) else np.zeros(0, np.int64)
    return np.asarray(np.repeat(at[variables], sizes, axis=1) + within)


def ordering(system: System) -> IntArray:
    """Order (V,) of elimination with little fill-in, the first variable of each connected part at the end."""
    shared = []  # sets of variables that share a factor; gtsam's symbolic factors have at most four, the others pairs
    for group in system.groups:
        if group.variables.shape[1]:
            for variables in np.unique(np.sort(group.variables, axis=1), axis=0).tolist():
                shared += [variables] if len(variables) <= 4 else [list(pair) for pair in combinations(variables, 2)]
    return colamd(shared, np.unique(parts(system), return_index=True)[1].tolist())


def parts(system: System) -> IntArray:
    """A number (V,) of the connected part of each variable."""
    pairs = [g.variables[:, [0, j]] for g in system.groups for j in range(1, g.variables.shape[1])]
    a, b = np.concatenate([np.zeros((0, 2), np.int64), *pairs]).T
    size = len(system.keys)
    label = connected_components(coo_matrix((np.ones(len(a)), (a, b)), (size, size)), directed=False)[1]
    return np.asarray(label, np.int64)


def factorize(system: System, order: IntArray, scale: Sequence[Array] | None = None) -> Factored:
    """Make the system triangular, in an order (V,); `scale`: more factors (n, d) of each row of each group."""
    groups = system.groups
    widest = max(g.variables.shape[1] for g in groups)
    all_variables = [g.variables for g in groups]
    padded = np.concatenate([np.pad(v, ((0, 0), (0, widest - v.shape[1])), constant_values=-1) for v in all_variables])
    s = structure(padded, system.dim, order)
    at, square = s.at, np.zeros(s.column[-1])
    A, b, columns = [], [], []
    for k, g in enumerate(groups):
        factor = np.sqrt(g.weight)[:, None] * (np.ones_like(g.r) if scale is None else scale[k])
        A.append(g.A * factor[:, :, None])
        b.append(-g.r * factor)
        columns.append(index_of(g.variables, at, system.dim))
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
    return elimination.backward(f.structure, f.triangle, f.triangle.d)[:, 0]


def forward(f: Factored, right: Array, homes: IntArray | None = None) -> Array:
    """R^-T right (N, c), which is overwritten; products of columns are those of `right` with the covariance between.
    `homes`: positions at which alone `right` is not zero, or all.
    """
    some = np.full(len(f.structure.parent), homes is None)
    if homes is not None:
        some[homes] = True
    return elimination.forward(f.structure, f.triangle, right, some)


def solved(f: Factored, right: Array, homes: IntArray | None = None) -> Array:
    """Solution (N, c) of the normal equations  A' W A x = right (N, c); arguments as of `forward`."""
    return elimination.backward(f.structure, f.triangle, forward(f, right, homes))


def joint_covariances(f: Factored) -> list[Array]:
    """Joint marginal covariance (n, c, c) of the variables of each factor, per group."""
    return elimination.joint_covariances(f.structure, f.triangle, [f.index(g) for g in f.system.groups])


Graph = gtsam.NonlinearFactorGraph
Values = gtsam.Values
EXACT = 1e5  # weight of a constraint, a noise of zero, over the largest coefficient of all other rows
IGNORED = 1e-9  # weight of a factor that its robust noise ignores: what it alone determines stays determined


@dataclass(frozen=True, eq=False)
class Group:
    """Factors with equally many residuals and the same dimensions of their variables."""

    factor: IntArray  # (n,) numbers in the graph
    variables: IntArray  # (n, k) positions in the keys of the system
    A: Array  # (n, d, c) whitened Jacobians, the columns of the variables side by side
    r: Array  # (n, d) whitened residuals, prediction minus measurement
    weight: Array  # (n,) of a robust noise, else 1


@dataclass(frozen=True, eq=False)
class System:
    """A graph around its values: keys (V,) and dimensions (V,) of the variables, groups of factors, number of slots."""

    keys: Sequence[int]
    dim: IntArray
    groups: Sequence[Group]
    size: int

    @property
    def rows(self) -> int:
        """Number of residuals."""
        return sum(group.r.size for group in self.groups)


def linearize(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> System:
    """The graph around the values; empty slots have no group, variables without a factor no column. DataError: an
    unknown variable, or what gtsam cannot evaluate, is not finite, or has another shape than noise and variables.
    """
    dims = values.dims()
    used = sorted(graph.keyVector())
    if (absent := next((key for key in used if key not in dims), None)) is not None:
        number = next(i for i in range(graph.size()) if graph.exists(i) and absent in set(graph.at(i).keys()))
        raise DataError(f"factor {number}: {name(absent)} has no value; a value for each variable is needed")
    place = {key: k for k, key in enumerate(used)}
    linear = _linear(graph, values)
    dim = np.array([dims[key] for key in used], np.int64)
    shaped: dict[tuple[int, ...], list[tuple[int, list[int], Array, Array, float]]] = defaultdict(list)
    exact: dict[int, Array] = {}  # rows that are constraints, by factor
    for i in range(graph.size()):
        if not graph.exists(i):
            continue
        factor = graph.at(i)
        keys = factor.keys()
        A, r, weight, constrained = _whitened(factor, linear, i, keys, values)
        if len(set(keys)) < len(keys):
            A, keys = _once(A, keys, dims)
        if constrained is not None:
            exact[i] = constrained
        shaped[len(r), *(dims[key] for key in keys)].append((i, [place[key] for key in keys], A, r, weight))
    groups = [
        Group(np.array(i), np.array(k, np.int64).reshape(len(i), -1), np.array(A), np.array(r), np.array(w))
        for i, k, A, r, w in (zip(*each, strict=True) for each in shaped.values())
    ]
    wrong = [i for g in groups for i in g.factor[~np.isfinite(g.A.sum((1, 2)) + g.r.sum(1))].tolist()]
    if wrong:
        at = ", ".join(map(name, graph.at(min(wrong)).keys()))
        raise DataError(f"factor {min(wrong)}: its residual at {at} is not finite; check their values and its noise")
    largest = max((float(np.abs(g.A).max(initial=0.0)) for g in groups), default=0.0)
    for g in groups if exact else []:
        for n, i in enumerate(g.factor.tolist()):
            if i in exact:
                scale = np.where(exact[i], EXACT * max(largest, 1.0), 1.0)
                g.A[n] *= scale[:, None]
                g.r[n] *= scale
    return System(used, dim, groups, graph.size())


def _linear(graph: Graph, values: Values) -> gtsam.GaussianFactorGraph:
    """All factors linearized, but callbacks: gtsam does not check their Jacobians, and ends the process over some."""
    plain = gtsam.NonlinearFactorGraph(graph)
    for i in range(graph.size()):
        if graph.exists(i) and isinstance(graph.at(i), gtsam.CustomFactor):
            plain.remove(i)
    try:
        return plain.linearize(values)
    except RuntimeError:
        for i in range(plain.size()):
            try:
                if plain.exists(i):
                    plain.at(i).linearize(values)
            except RuntimeError as error:
                why = next(iter(str(error).strip().splitlines()), "gtsam cannot linearize it at these values")
                raise DataError(f"factor {i}: {why}") from None
        raise


def _once(A: Array, keys: list[int], dims: dict[int, int]) -> tuple[Array, list[int]]:
    """Jacobian and keys, each variable once: a factor may have one several times."""
    unique = list(dict.fromkeys(keys))
    if A.shape[1] == sum(dims[key] for key in unique):
        return A, unique
    parts = np.split(A, np.cumsum([dims[key] for key in keys])[:-1], axis=1)
    return np.hstack([sum(part for part, k in zip(parts, keys, strict=True) if k == key) for key in unique]), unique


def _callback(factor: gtsam.NoiseModelFactor, i: int, keys: list[int], values: Values) -> tuple[Array, Array]:
    """Residual and Jacobian of a factor before its noise. Raises DataError for other shapes than it states."""
    own = {key: value_of(values, key) for key in keys}
    if all(value is not None for value in own.values()):
        values = gtsam.Values()  # gtsam copies all values for each callback
        for key, value in own.items():
            values.insert(key, value)
    blocks = gtsam.JacobianVector([np.empty((0, 0))] * len(keys))
    error, dims = np.asarray(factor.unwhitenedError(values, blocks)), values.dims()
    if len(error) != factor.dim():
        raise DataError(f"factor {i}: {len(error)} residuals; its noise has {factor.dim()} dimensions")
    for key, block in zip(keys, blocks, strict=True):
        if np.shape(block) != (len(error), dims[key]):
            wrong, right = np.shape(block), (len(error), dims[key])
            raise DataError(f"factor {i}: its Jacobian of {name(key)} has the shape {wrong}; {right} is needed")
    return error, np.hstack(list(blocks))


def _whitened(
    factor: gtsam.NonlinearFactor, linear: gtsam.GaussianFactorGraph, i: int, keys: list[int], values: gtsam.Values
) -> tuple[Array, Array, float, Array | None]:
    """Jacobian, residual, weight, and which rows are constraints (None: none)."""
    model = factor.noiseModel() if isinstance(factor, gtsam.NoiseModelFactor) else None
    exact = None
    if isinstance(model, gtsam.noiseModel.Constrained) and not all(model.sigmas()):
        exact = np.asarray(model.sigmas()) == 0.0
    if isinstance(factor, gtsam.NoiseModelFactor) and isinstance(model, gtsam.noiseModel.Robust):
        (error, A), beneath = _callback(factor, i, keys, values), model.noise()
        loss: Any = model.robust()  # the stubs do not know the weight
        r = beneath.whiten(error)
        return beneath.Whiten(A), r, max(float(loss.weight(float(np.linalg.norm(r)))), IGNORED), None
    if isinstance(factor, gtsam.CustomFactor):
        error, A = _callback(factor, i, keys, values)
        if model is not None and exact is not None:
            scale = 1.0 / np.where(exact, 1.0, model.sigmas())
            return scale[:, None] * A, scale * error, 1.0, exact
        return (A, error, 1.0, None) if model is None else (model.Whiten(A), model.whiten(error), 1.0, None)
    if not linear.exists(i):  # a factor that is switched off at these values
        return np.zeros((0, sum(values.dims()[key] for key in keys))), np.zeros(0), 1.0, None
    plain = linear.at(i)
    A, b = plain.jacobian()
    if isinstance(plain, gtsam.HessianFactor):  # as many rows as its rank: the others are what was eliminated
        size, V = np.linalg.eigh(A.T @ A)
        told = size > DEPENDENT * size.max(initial=0.0)
        root = np.sqrt(size[told])
        A, b = root[:, None] * V[:, told].T, V[:, told].T @ (A.T @ b) / root
    return A, -b, 1.0, exact


def value_of(values: Values, key: int) -> Any:
    """A pose, or a point (2,) or (3,); None of any other variable."""
    for at in (values.atPose2, values.atPose3, values.atPoint2, values.atPoint3):
        with suppress(RuntimeError):  # of another type
            return at(key)
    return None


def name(key: int) -> str:
    """A key as gtsam prints it; its number, where its character cannot be printed."""
    return str(gtsam.DefaultKeyFormatter(key)) if key < 1 << 56 or 32 < key >> 56 < 127 else str(key)

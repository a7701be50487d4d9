"""The audit of a graph around its values: factors, kinds, and what the linearization says about the values."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import gtsam
import numpy as np

from data.errors import DataError
from data.inputs import IntArray
from data.se2 import Array
from graph.audit.components import Components, Estimator
from graph.audit.draws import family, smallest_p
from graph.audit.factors import Tested, directions, examine, holm
from graph.audit.fronts import Factored, factorize, ordering
from graph.audit.kinds import Grouping, Kinds, kinds, positions_of
from graph.audit.linear import System, linearize

DRAWS = 200


@dataclass(frozen=True, eq=False)
class Audit:
    """Numbers of an audit.

    Attributes:
        keys: (F,) of each factor; empty in an empty slot.
        kinds: of the factors.
        factors: statistics of each factor.
        p_family: (F,) Holm's, over all factors and components.
        p_drawn: (F,) from the smallest p value of draws; NaN without draws.
        by_kind, by_axis: components of the kinds, and of the axes of each; `axis` (K, 2) kind and axis, -1: whole.
        p_kind, p_axis: Holm's, in the same family as the factors.
        decrement: length of the step to the minimum of the linearized problem, in sigmas.
        gained: decrease of the sum of squares that this step promises.
        freedom: degrees of freedom.
        f: the factored system.
    """

    keys: Sequence[tuple[int, ...]]
    kinds: Kinds
    factors: Tested
    p_family: Array
    p_drawn: Array
    by_kind: Components
    by_axis: Components
    axis: IntArray
    p_kind: Array
    p_axis: Array
    decrement: float
    gained: float
    freedom: int
    f: Factored


def audit(
    graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, by: Grouping = None, draws: int = DRAWS, seed: int = 0
) -> Audit:
    """Examine a graph around its values. Raises DataError as `linearize`, and for a graph without factors."""
    system = linearize(graph, values)
    if not system.rows or not len(system.keys):
        raise DataError("the graph has no factor of a variable; at least one is needed")
    order = ordering(system, firsts(system))
    f = factorize(system, order)
    seen = directions(f)
    t = examine(f, seen, positions_of(values, system.keys))
    rng = np.random.default_rng(seed)
    of = kinds(graph, by)
    axis, rows = axes_of(of, system)
    estimator = Estimator(f, order, rows, axis[:, 0], rng)
    by_kind, by_axis = estimator.by_kind(), estimator.by_axis()
    family_of = np.concatenate([t.p, by_kind.p, np.where(axis[:, 1] >= 0, by_axis.p, np.nan)])
    adjusted = holm(family_of)
    n, k = len(t.p), len(of.names)
    p_drawn = family(t.p, smallest_p(f, seen, draws, rng)) if draws else np.full(n, np.nan)
    keys = [tuple(graph.at(i).keys()) if graph.exists(i) else () for i in range(graph.size())]
    whole = sum(float(np.sum(g.weight[:, None] * g.r**2)) for g in system.groups)
    gained = max(whole - f.square, 0.0)
    return Audit(
        keys, of, t, adjusted[:n], p_drawn, by_kind, by_axis, axis, adjusted[n : n + k], adjusted[n + k :],
        float(np.sqrt(gained)), gained, system.rows - f.rank, f,
    )  # fmt: skip


def firsts(system: System) -> list[int]:
    """The first variable of each connected part: eliminated last, it keeps its value if nothing ties the part."""
    root = parts(system)
    return [int(np.flatnonzero(root == r)[0]) for r in np.unique(root)]


def parts(system: System) -> IntArray:
    """A number (V,) of the connected part of each variable."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    pairs = [g.variables[:, [0, j]] for g in system.groups for j in range(1, g.variables.shape[1])]
    a, b = np.concatenate([np.zeros((0, 2), np.int64), *pairs]).T
    size = len(system.keys)
    label = connected_components(coo_matrix((np.ones(len(a)), (a, b)), (size, size)), directed=False)[1]
    return np.asarray(label, np.int64)


def axes_of(of: Kinds, system: System) -> tuple[IntArray, list[IntArray]]:
    """Kind and axis (K, 2) of each component, axis -1 for a whole kind, and per group the component (n, d) of a row."""
    axis: list[tuple[int, int]] = []
    start = []
    for k, names in enumerate(of.axes):
        start.append(len(axis))
        axis += [(k, a) for a in range(len(names))] or [(k, -1)]
    begin = np.array(start)
    split = np.array([len(names) > 0 for names in of.axes])
    rows = []
    for g in system.groups:
        kind = of.of[g.factor]
        rows.append(begin[kind][:, None] + split[kind][:, None] * np.arange(g.r.shape[1]))
    return np.array(axis), rows

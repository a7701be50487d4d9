"""The factors that contradict all others: the fewest errors that explain every rejection.

Data snooping (Baarda 1968): leave out the factor of least p value, optimize the rest again, and repeat until nothing is
rejected. The graph is optimized, not only its linearization, since a gross error bends the optimum. A factor that the
rest predicts is taken back. Loops that support each other alone are left out together.

Many gross errors hide each other (masking), or make right factors look wrong (swamping). A second search then starts
without the loops that graduated non-convexity rejects (Yang et al., RA-L 2020). The search with fewer errors counts.
Wrong loops between the same two places are one error.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtri

from data.inputs import IntArray
from data.se2 import Array, BoolArray
from wings.audit.factors import (
    BRIEF,
    NEAR,
    SIGNIFICANCE,
    Cluster,
    cluster_level,
    clusters,
    directions,
    log_p_of,
    tests,
)
from wings.audit.files import callbacks, moved, optimized
from wings.audit.linear import IGNORED, Factored, Graph, System, Values, factorize, linearize, step

TURNS, FEW = 30, 3  # steps of one search; more factors than these may mask each other
GROSS = 0.01
"""Least share of the excess sum of squares that a factor explains, once a few are left out; else the noise is wrong."""
BAD = 100.0  # sum of squares per degree of freedom that no misstated noise explains: residuals of 10 sigma
GRADES, GROWTH, LEAST = 60, 2.0, 1e-12
"""Of graduated non-convexity: steps at most, growth of mu in each, least squared residual over an inlier's largest."""
TIED = 10.0
"""If two T differ by less, a loop is left out rather than odometry: the likelihood ratio is below e^5 = 150."""


@dataclass(frozen=True, eq=False)
class Contradicting:
    """Factors that contradict the rest, and the rest.

    Attributes:
        left: their numbers.
        f: the system without them, around its own minimum.
        T, rank: (F,) of each factor beside the rest; rank 0 where nothing sees it.
        excess: sum of squares of the rest minus its degrees of freedom.
        errors: number of errors; loops between the same two places are one.
    """

    left: IntArray
    f: Factored
    T: Array
    rank: IntArray
    excess: float
    errors: int


def optimum_without(graph: Graph, values: Values, left: Iterable[int]) -> Values:
    """The optimum of a graph without some factors, near the values."""
    rest = Graph(graph)
    for i in left:
        rest.remove(int(i))
    return optimized(rest, values)


def without(system: System, left: IntArray, order: IntArray) -> Factored:
    """The system without some factors, all others at full weight."""
    groups = [replace(g, weight=np.where(np.isin(g.factor, left), IGNORED, 1.0)) for g in system.groups]
    return factorize(replace(system, groups=groups), order)


def contradicting(
    f: Factored,
    left: IntArray,
    order: IntArray,
    level: float,
    loops: BoolArray,
    metres: Sequence[IntArray],
    again: tuple[Graph, Values] | None = None,
) -> Contradicting | None:
    """One search; None where many factors are rejected and none of them explains much: the noise is wrong then.

    Args:
        f: the system without `left`.
        left: numbers of factors to begin without.
        order: (V,) of elimination.
        level: logarithm of the p value below which a factor is rejected.
        loops: (F,) relations of variables that are no neighbours.
        metres: as of `clusters`.
        again: graph that is optimized again, from values; without, the linearized problem is solved again.
    """
    taken = Counter[int]()
    for turn in range(TURNS):
        seen = directions(f, BRIEF)
        T, rank = tests(f, seen)
        log_p = log_p_of(T, rank)
        outside = np.isin(np.arange(len(T)), left)
        inside = np.where(outside, 0.0, log_p)
        kept = [(s, ~outside[g.factor]) for g, s in zip(f.system.groups, seen, strict=True)]
        excess = sum(float(np.sum(s.r[k] ** 2)) - s.r[k].size for s, k in kept) + f.rank
        back = [i for i in left.tolist() if log_p[i] > level and taken[i] < 2]
        together, count = clusters(f, seen, T, rank, np.flatnonzero(loops & ~outside).tolist(), metres)
        best = min(together, key=lambda c: c.log_p, default=None)
        alone = inside.min(initial=0.0) < level
        if alone or (best is not None and best.log_p < cluster_level(count)):
            worst, explained = _worst(T, inside, loops, best) if alone or best is None else (best.factors, best.T)
            theta = 1.0 + excess / max(f.system.rows - f.rank, 1)  # a cluster explains much by its size alone
            large = best is not None and worst is best.factors and log_p_of(best.T / theta, best.rank) > level
            if turn >= FEW and (explained < GROSS * excess or large):
                return None
            left = np.union1d(left, worst)
        elif back:
            taken.update(back)
            left = np.setdiff1d(left, back)
        else:
            return Contradicting(left, f, T, rank, excess, _errors(f, left, loops))
        system = f.system
        if again is not None:
            again = again[0], optimum_without(*again, left)
            system = linearize(*again)
        f = without(system, left, order)
    return None


def _errors(f: Factored, left: IntArray, loops: BoolArray) -> int:
    some = left[loops[left]]
    if not len(some):
        return len(left)
    ends = np.array([np.sort(v)[[0, -1]] for g in f.system.groups for v in g.variables[np.isin(g.factor, some)]])
    count, ends = len(left) - len(some), ends[np.lexsort(ends.T[::-1])]
    while len(ends):  # those within a place of the first, at both ends
        count, ends = count + 1, ends[np.abs(ends - ends[0]).max(1) > 2 * NEAR]
    return count


def _worst(T: Array, log_p: Array, loops: BoolArray, best: Cluster | None) -> tuple[Sequence[int], float]:
    """The factors to leave out next, one or the `best` cluster, and their T."""
    worst = int(np.argmin(log_p))
    tied = np.flatnonzero(loops & (log_p < log_p[worst] + 0.5 * TIED))
    worst = int(tied[np.argmin(log_p[tied])]) if len(tied) else worst
    if best is not None and best.log_p < log_p[worst] - 0.5 * TIED:
        return best.factors, best.T
    return (worst,), float(T[worst])


def searched(
    graph: Graph, values: Values, f: Factored, left: IntArray, order: IntArray, level: float, loops: BoolArray,
    metres: Sequence[IntArray],
) -> Contradicting | None:  # fmt: skip
    """As `contradicting`, with the graph optimized again; a second search where many are left out, or odometry is.

    Of searches that explain as much with as many errors, that counts which leaves odometry in.
    """
    found = contradicting(f, left, order, level, loops, metres, (graph, values))
    noise = found is None and f.square < BAD * (f.system.rows - f.rank)
    few = found is not None and len(found.left) <= FEW and loops[found.left].all()
    if noise or few or not loops.any() or callbacks(graph):
        return found
    other = None
    with suppress(RuntimeError):  # gtsam refuses graphs that it cannot weight
        start, near = _graduated(graph, values, order, loops)
        again = graph, optimum_without(graph, near, start)
        other = contradicting(without(linearize(*again), start, order), start, order, level, loops, metres, again)
    both = [c for c in (found, other) if c is not None]
    least = min((c.excess for c in both), default=0.0) + TIED
    return min(both, default=None,
               key=lambda c: (c.errors, c.excess > least, np.count_nonzero(~loops[c.left]), len(c.left)))  # fmt: skip


def _graduated(graph: Graph, values: Values, order: IntArray, loops: BoolArray) -> tuple[IntArray, Values]:
    """The loops that graduated non-convexity rejects, and its optimum; it starts from the path without loops.

    Truncated least squares (Yang et al. 2020, equations 12 to 14), with one step of Gauss and Newton for each `mu`.
    """
    now = optimum_without(graph, values, np.flatnonzero(loops))
    system, mu, weight = linearize(graph, now), 0.0, np.ones(len(loops))
    for _ in range(GRADES):
        square = np.zeros(len(loops))  # over the largest of an inlier
        for g in system.groups:
            square[g.factor] = np.sum(g.r**2, 1) / chdtri(max(g.r.shape[1], 1), SIGNIFICANCE)
        square[~loops] = 0.0
        mu = GROWTH * mu if mu else 1.0 / max(2.0 * square.max(initial=0.0) - 1.0, 1e-3)
        between = np.sqrt(mu * (mu + 1.0) / np.maximum(square, LEAST)) - mu
        weight = np.where(square >= (mu + 1.0) / mu, IGNORED, np.where(square <= mu / (mu + 1.0), 1.0, between))
        groups = [replace(g, weight=np.where(loops[g.factor], weight[g.factor], g.weight)) for g in system.groups]
        f = factorize(replace(system, groups=groups), order)
        now = moved(system, f.at, step(f), now)
        if np.all((weight == 1.0) | (weight == IGNORED)):
            break
        system = linearize(graph, now)
    return np.flatnonzero(loops & (weight < 0.5)), now

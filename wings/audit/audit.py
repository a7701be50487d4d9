"""The audit of a graph around its values: factors, kinds, what it does not determine and what it says twice.

The factors that contradict all others: the fewest errors that explain every rejection.

Data snooping (Baarda 1968) leaves out the factor of least p value and optimizes again; where many errors hide each
other, a second search starts without the loops that graduated non-convexity rejects (Yang et al., RA-L 2020). Variance
components (Förstner 1979, Fisher's scoring, probes of random signs by Hutchinson 1989): by which factor the stated
variances of each kind of factor are wrong. docs/notes/audit.md has the formulas.
"""

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import gtsam
import numpy as np
from scipy.sparse import csr_matrix
from scipy.special import chdtri

from data.errors import DataError
from data.inputs import IntArray
from data.se2 import Array, BoolArray
from data.tails import log_below, log_tail
from wings.audit import factors, linear
from wings.audit.factors import Cluster, Directions, Tested
from wings.audit.files import moved, optimized
from wings.audit.kinds import Grouping, Kinds, kinds, plain_noise, positions_of
from wings.audit.linear import PART, Factored, factorize, solved, step

ROWS = 6000  # probed rows of an axis: 2 % of the entries of S
ITERATIONS, POOLED = 12, 2  # iterations; those where axes share a component: if they differ there is no fixed point
CLOSE = 0.3  # change in standard errors that ends them
LEAST_SCORE = 0.02  # least step of scoring
SMALLEST, NONE = 1e-8, 0.5  # least component; redundancy below which there is no estimate
ZERO = 1e-8  # sum of squares over redundancy below which residuals are zero: nothing was drawn, or it is stated twice
VAGUE, PRIOR = 1e-4, 6  # leverage of a row below which a sigma that is too large spoils nothing; rows of one prior


@dataclass(frozen=True, eq=False)
class Components:
    """Variance components (K,); NaN where nothing is redundant."""

    component: Array
    error: Array  # standard error of the component
    redundancy: Array  # at the stated weights
    ratio: Array  # sum of squares over the redundancy, both at the stated weights
    freedom: Array  # of the chi-square of the ratio
    vague: BoolArray  # sigmas that may be wide, as those of a gauge alone: their rows move nothing, or are few

    @property
    def zero(self) -> BoolArray:
        """Whether all residuals are zero, though others check them."""
        return (self.redundancy > NONE) & (self.ratio < ZERO)

    @property
    def log_p(self) -> Array:
        """Logarithms of p values of the component 1: the larger of two two-sided tests by a chi-square (Satterthwaite).

        The sum of squares at the stated weights has the right size, but answers to the noise of other kinds; the
        estimate does not, but is no chi-square where it has few degrees of freedom. The larger p has both virtues.
        """
        with np.errstate(invalid="ignore", divide="ignore"):
            own = _two_sided(self.component, 2.0 * (self.component / self.error) ** 2)
            tested = np.isfinite(self.component) & ~(self.vague & (self.component < 1.0))
            return np.where(tested, np.fmax(own, _two_sided(self.ratio, self.freedom)), np.nan)


def _two_sided(ratio: Array, freedom: Array) -> Array:
    x = ratio * freedom
    return np.asarray(np.minimum(np.log(2.0) + np.minimum(log_tail(x, freedom), log_below(x, freedom)), 0.0))


def weighted_rows(f: Factored, scale: Sequence[Array] | None = None) -> csr_matrix:
    """Coefficients (rows, N) of the system as it is solved: with roots of weights, and scales."""
    values, columns, counts = [], [], []
    for k, g in enumerate(f.system.groups):
        n, d, c = g.A.shape
        factor = np.sqrt(g.weight)[:, None] * (np.ones((n, d)) if scale is None else scale[k])
        values.append((g.A * factor[:, :, None]).ravel())
        columns.append(np.repeat(f.index(g), d, axis=0).ravel())
        counts.append(np.full(n * d, c))
    start = np.concatenate([[0], np.cumsum(np.concatenate(counts))])
    return csr_matrix((np.concatenate(values), np.concatenate(columns), start), (len(start) - 1, f.columns))


def residuals(f: Factored, A: csr_matrix, e: Array) -> Array:
    """Residuals (I - H) e of errors e (rows, c) of the rows as they are solved."""
    out = np.empty_like(e)
    for first in range(0, e.shape[1], PART):
        part = slice(first, first + PART)
        out[:, part] = e[:, part] - A @ solved(f, np.asarray(A.T @ e[:, part]))
    return out


def components(
    f: linear.Factored, left: IntArray, order: IntArray, of: Kinds, rng: np.random.Generator
) -> tuple[Components, Components]:
    """Components of the rows of a system without the factors `left`, by kind and by axis of a kind."""
    (axis, rows), system = axes_of(of, f.system), f.system
    rows = [np.where(np.isin(g.factor, left)[:, None], -1, r) for g, r in zip(system.groups, rows, strict=True)]
    row, count = np.concatenate([each.ravel() for each in rows]), len(axis)
    used = row >= 0
    size = np.bincount(row[used], minlength=count)
    probes = np.clip(np.ceil(ROWS / np.maximum(size, 1)), 2, 400).astype(int)
    # probes of random signs, or all unit vectors where these are fewer: exact
    sizes = zip(size.tolist(), probes.tolist(), strict=True)
    signs = [np.sqrt(n) * np.eye(n) if n <= m else rng.choice([-1.0, 1.0], (n, m)) for n, m in sizes]

    def equations(theta: Array, f: Factored | None = None) -> tuple[Array, Array]:
        """S (K, K) and q (K,) of rows whose variances are multiplied by `theta` (K,)."""
        scale = [np.where(each < 0, 1.0, 1.0 / np.sqrt(theta)[each]) for each in rows]
        f = factorize(system, order, scale) if f is None else f
        A, x = weighted_rows(f, scale), step(f)
        pairs = zip(system.groups, scale, strict=True)
        b = np.concatenate([(np.sqrt(g.weight)[:, None] * s * g.r).ravel() for g, s in pairs])
        q = np.bincount(row[used], ((b + A @ x) ** 2)[used], count).astype(float)
        S = np.zeros((count, count))
        for k, of_axis in enumerate(signs):
            if len(of_axis):
                e = np.zeros((len(row), of_axis.shape[1]))
                e[row == k] = of_axis
                S[:, k] = np.bincount(row[used], np.sum(residuals(f, A, e) ** 2, 1)[used], count) / of_axis.shape[1]
        return 0.5 * (S + S.T), q

    stated, kind = equations(np.ones(count), f), axis[:, 0]
    by_axis = _estimate(np.eye(count), size, stated, equations)
    if count == kind.max() + 1:
        return by_axis, by_axis
    return _estimate((kind[:, None] == np.arange(kind.max() + 1)).astype(float), size, stated, equations), by_axis


def _estimate(
    share: Array, size: IntArray, stated: tuple[Array, Array], equations: Callable[[Array], tuple[Array, Array]]
) -> Components:
    """Components of unions of axes, `share` (K, C), of `size` (K,) rows, from the equations at the stated weights."""
    theta, (S, q) = np.ones(share.shape[1]), stated
    S, q = share.T @ S @ share, share.T @ q
    redundancy = S.sum(1)
    live = (redundancy > NONE) & (q > ZERO * redundancy)
    vague = (redundancy > (1.0 - VAGUE) * (size @ share)) | (size @ share <= PRIOR)
    ratio, freedom = q / np.maximum(redundancy, NONE), redundancy**2 / np.maximum(np.diagonal(S), NONE**2)
    error = np.full(len(theta), np.nan)
    if not live.any():
        return Components(error, error, redundancy, ratio, freedom, vague)
    for turn in range(most := ITERATIONS if len(theta) == len(share) else POOLED):
        part = np.ix_(live, live)  # Fisher's scoring; where that leads too far, the almost-unbiased estimate
        scored, unbiased = np.ones(len(theta)), np.ones(len(theta))
        scored[live] = np.linalg.lstsq(S[part], (q - S[:, ~live].sum(1))[live], rcond=None)[0]
        unbiased[live] = q[live] / S.sum(1)[live]
        before, theta = theta, np.maximum(theta * np.where(scored > LEAST_SCORE, scored, unbiased), SMALLEST)
        root = np.sqrt(np.maximum(np.diagonal(S), np.finfo(float).tiny))[live]  # a vanishing component has little
        inverse = np.linalg.pinv(S[part] / root[:, None] / root, rcond=1e-6, hermitian=True)
        error[live] = theta[live] * np.sqrt(2.0 * np.maximum(np.diagonal(inverse), 0.0)) / root
        r = theta / before / np.exp(np.mean(np.log((theta / before)[live])))  # a common factor changes no estimate
        if turn + 1 == most or np.all(np.abs(r - 1.0)[live] * theta[live] < CLOSE * error[live]):
            break
        S, q = equations(share @ theta)
        S, q = share.T @ S @ share, share.T @ q
    return Components(np.where(live, theta, np.nan), error, redundancy, ratio, freedom, vague)


TURNS, FEW = 30, 3
"""Steps of one search, which ends where as many as are left, of the same effect, do not explain the excess: the noise
is wrong; more factors than these may mask each other."""
BAD = 100.0  # sum of squares per degree of freedom that no misstated noise explains: residuals of 10 sigma
GRADES, GROWTH, LEAST = 60, 2.0, 1e-12
"""Of graduated non-convexity: steps at most, growth of mu in each, least squared residual over an inlier's largest."""
TIED = 10.0  # If two T differ by less, a loop is left out rather than odometry: the likelihood ratio is below e^5 = 150


Told = Callable[..., None]
"""Is told the stages of an audit, with their numbers as keywords: `opened`, `optimized`, `tested`, `searched`."""


def unheard(_: str, **numbers: float) -> None:
    """Nobody listens."""


@dataclass(frozen=True, eq=False)
class Contradicting:
    """Factors that contradict the rest, and the rest."""

    left: IntArray  # their numbers
    f: linear.Factored  # the system without them, around its own minimum
    T: Array  # (F,) of each factor beside the rest
    rank: IntArray  # (F,) of T; 0 where nothing sees the factor
    excess: float  # sum of squares of the rest minus its degrees of freedom
    errors: int  # number of errors; loops between the same two places are one


def optimum_without(graph: linear.Graph, values: linear.Values, left: Iterable[int]) -> linear.Values:
    """The optimum of a graph without some factors, near the values."""
    rest = linear.Graph(graph)
    for i in left:
        rest.remove(int(i))
    return optimized(rest, values)


def without(system: linear.System, left: IntArray, order: IntArray) -> linear.Factored:
    """The system without some factors, all others at full weight."""
    groups = [replace(g, weight=np.where(np.isin(g.factor, left), linear.IGNORED, 1.0)) for g in system.groups]
    return linear.factorize(replace(system, groups=groups), order)


def contradicting(
    f: linear.Factored, left: IntArray, order: IntArray, level: float, loops: BoolArray, metres: Sequence[IntArray],
    again: tuple[linear.Graph, linear.Values] | None = None, *, steps: int = TURNS, told: Told = unheard,
) -> Contradicting | None:  # fmt: skip
    """One search, of `left` factors to begin without; None where many are rejected (below the logarithm `level` of p)
    and none explains much: the noise is wrong; or after so many `steps`. order (V,): of elimination; loops (F,):
    relations of variables that are no neighbours; metres: as of `clusters`. Solved again is graph `again`, or the
    linearized one.
    """
    taken, agreeing = Counter[int](), set[int]()
    for turn in range(steps):
        told("searched", step=turn + 1, steps=steps, left=len(left))
        seen = factors.directions(f, factors.BRIEF)
        T, rank = factors.tests(f, seen)
        log_p = factors.log_p_of(T, rank)
        outside = np.isin(np.arange(len(T)), left)
        inside = np.where(outside, 0.0, log_p)
        kept = [(s, ~outside[g.factor]) for g, s in zip(f.system.groups, seen, strict=True)]
        excess = sum(float(np.sum(s.r[k] ** 2)) - s.r[k].size for s, k in kept) + f.rank
        known = np.log(factors.FAMILY / max(len(agreeing), 1))  # of a cluster, what the rest predicts comes back
        back = [i for i in left.tolist() if log_p[i] > (known if i in agreeing else level) and taken[i] < 2]
        together, count = factors.clusters(f, seen, T, rank, np.flatnonzero(loops & ~outside).tolist(), metres)
        best = min(together, key=lambda c: c.log_p, default=None)
        alone = inside.min(initial=0.0) < level
        if alone or (best is not None and best.log_p < factors.cluster_level(count)):
            one = int(np.argmin(inside - 0.5 * TIED * loops))
            worst: tuple[int, ...] = (one,)
            explained = float(T[one])
            if best is not None and (not alone or best.log_p < inside[one] + (0.5 - loops[one]) * TIED):
                worst, explained = best.factors, best.T
            theta = 1.0 + excess / max(f.system.rows - f.rank, 1)  # what a wider noise explains
            large = best is not None and worst is best.factors and factors.log_p_of(best.T / theta, best.rank) > level
            if turn >= FEW and ((steps - turn) * explained < excess or large):
                return None
            left = np.union1d(left, worst)
            agreeing.update(worst if len(worst) > 1 else [])
        elif back:
            taken.update(back)
            left = np.setdiff1d(left, back)
        else:
            return Contradicting(left, f, T, rank, excess, _errors(f, left, loops))
        system = f.system
        if again is not None:
            again = again[0], optimum_without(*again, left)
            system = linear.linearize(*again)
        f = without(system, left, order)
    return None


def _errors(f: linear.Factored, left: IntArray, loops: BoolArray) -> int:
    some = left[loops[left]]
    if not len(some):
        return len(left)
    ends = np.array([np.sort(v)[[0, -1]] for g in f.system.groups for v in g.variables[np.isin(g.factor, some)]])
    count, ends = len(left) - len(some), ends[np.lexsort(ends.T[::-1])]
    while len(ends):  # those within a place of the first, at both ends
        count, ends = count + 1, ends[np.abs(ends - ends[0]).max(1) > 2 * factors.NEAR]
    return count


def searched(
    graph: linear.Graph, values: linear.Values, f: linear.Factored, left: IntArray, order: IntArray, level: float,
    loops: BoolArray, metres: Sequence[IntArray], *, steps: int = TURNS, told: Told = unheard,
) -> Contradicting | None:  # fmt: skip
    """As `contradicting`, with the graph optimized again; a second search where many are left out, or odometry is. Of
    searches that explain as much with as many errors, that counts which leaves odometry in.
    """
    search = partial(contradicting, order=order, level=level, loops=loops, metres=metres, steps=steps, told=told)
    found = search(f, left, again=(graph, values))
    noise = found is None and f.square < BAD * (f.system.rows - f.rank)
    few = found is not None and len(found.left) <= FEW and loops[found.left].all()
    if noise or few or not loops.any():
        return found
    start, near = _graduated(graph, values, order, loops)
    again = graph, optimum_without(graph, near, start)
    other = search(without(linear.linearize(*again), start, order), start, again=again)
    both = [c for c in (found, other) if c is not None]
    best = min(both, default=None, key=lambda c: c.excess)

    def place(c: Contradicting) -> tuple[int, bool, int, int]:
        more = max(int(best.rank[best.left].sum() - c.rank[c.left].sum()) if best else 0, 1)  # that the best leaves out
        worse = best is not None and c.excess - best.excess > float(chdtri(more, factors.SIGNIFICANCE)) - more
        return c.errors, worse, int((~loops[c.left]).sum()), len(c.left)

    return min(both, default=None, key=place)


def _graduated(
    graph: linear.Graph, values: linear.Values, order: IntArray, loops: BoolArray
) -> tuple[IntArray, linear.Values]:
    """Loops that graduated non-convexity rejects (Yang et al. 2020, eq. 12 to 14), and its optimum."""
    now = optimum_without(graph, values, np.flatnonzero(loops))
    system, mu, weight = linear.linearize(graph, now), 0.0, np.ones(len(loops))
    for _ in range(GRADES):
        square = np.zeros(len(loops))  # over the largest of an inlier
        for g in system.groups:
            square[g.factor] = np.sum(g.r**2, 1) / chdtri(max(g.r.shape[1], 1), factors.SIGNIFICANCE)
        square[~loops] = 0.0
        mu = GROWTH * mu if mu else 1.0 / max(2.0 * square.max(initial=0.0) - 1.0, 1e-3)
        between = np.sqrt(mu * (mu + 1.0) / np.maximum(square, LEAST)) - mu
        weight = np.where(square >= (mu + 1.0) / mu, linear.IGNORED, np.where(square <= mu / (mu + 1.0), 1.0, between))
        groups = [replace(g, weight=np.where(loops[g.factor], weight[g.factor], g.weight)) for g in system.groups]
        f = linear.factorize(replace(system, groups=groups), order)
        now = moved(system, f.at, linear.step(f), now)
        if np.all((weight == 1.0) | (weight == linear.IGNORED)):
            break
        system = linear.linearize(graph, now)
    return np.flatnonzero(loops & (weight < 0.5)), now


DRAWS = 200
LOG_FAMILY = float(np.log(factors.FAMILY))


class Loose(NamedTuple):
    """A variable that nothing ties: its position in the keys, in how many directions, and whether it moves, turns."""

    variable: int
    directions: int
    moves: bool
    turns: bool


@dataclass(frozen=True)
class Condition:
    """Findings about the structure of a graph."""

    parts: tuple[int, ...]  # numbers of variables of the connected parts, largest first
    gauge: int  # directions in which whole parts can move
    scale: int  # how many of them are scales
    loose: tuple[Loose, ...]  # variables that nothing ties in some directions
    duplicates: tuple[tuple[int, int], ...]  # pairs of factors with equal variables, residuals and Jacobians


@dataclass(frozen=True, eq=False)
class Statistics:
    """Statistics of a linearized graph."""

    keys: Sequence[tuple[int, ...]]  # (F,) of each factor; empty in an empty slot
    kinds: Kinds  # of the factors
    factors: Tested  # statistics of each factor
    log_p_family: Array  # (F,) natural, Holm's over all factors, components and clusters; of the tests that draws show
    p_drawn: Array  # (F,) from the smallest p value of draws; NaN without draws
    by_kind: Components  # of the kinds
    by_axis: Components  # of the axes of each kind
    axis: IntArray  # (K, 2) kind and axis, -1: whole
    log_p_kind: Array  # Holm's, in the same family as the factors
    log_p_axis: Array  # the same
    clusters: Sequence[Cluster]  # loops that agree with each other, tested together
    log_p_cluster: Array  # Holm's, in the same family
    freedom: int  # degrees of freedom
    f: linear.Factored  # the factored system
    wrong: IntArray  # factors without which no other is rejected, if they are few; else all that are rejected
    beside: Array  # (F,) T of the wrong ones beside all that are not, where that rejects more; else NaN
    searched: bool  # whether they are those of the search

    @property
    def rejected(self) -> bool:
        """Whether anything is rejected at a family-wise 5 %."""
        log_p = np.concatenate([self.log_p_family, self.log_p_kind, self.log_p_axis, self.log_p_cluster])
        return bool(np.any(log_p < LOG_FAMILY))


@dataclass(frozen=True, eq=False)
class Audit(Statistics):
    """Numbers of an audit."""

    decrement: float  # length of the step to the minimum of the linearized problem, in sigmas
    gained: float  # decrease of the sum of squares that this step promises
    condition: Condition  # what the graph does not determine
    place: Array  # (V, 3) position of each variable of the system, NaN where it has none
    unused: tuple[int, ...]  # keys that have a value and no factor


def examined(
    graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, by: Grouping = None, draws: int = DRAWS, seed: int = 0,
    *, steps: int = TURNS, told: Told = unheard,
) -> Audit:  # fmt: skip
    """Examine a graph around its values, with at most `steps` of a search. DataError as `linearize`, or if empty."""
    system = linear.linearize(graph, values)
    if not system.rows or not len(system.keys):
        raise DataError("the graph has no factor of a variable; at least one is needed")
    for i in range(graph.size()):
        model = plain_noise(graph.at(i))[0] if graph.exists(i) else None
        if type(model) is gtsam.noiseModel.Gaussian and not (np.diagonal(model.R()) > 0.0).all():
            raise DataError(f"factor {i}: its noise is not positive definite; check its covariance or information")
    of, rng = kinds(graph, by), np.random.default_rng(seed)
    keys = [tuple(graph.at(i).keys()) if graph.exists(i) else () for i in range(graph.size())]
    metres = positions_of(values, system.keys)
    s = statistics(system, keys, of, metres, rng, draws, partial(searched, graph, values, steps=steps, told=told), told)
    gained = max(sum(float(np.sum(g.weight[:, None] * g.r**2)) for g in system.groups) - s.f.square, 0.0)
    found = condition(s.f, linear.parts(system), metres, growth(values, system, s.f.at))
    return Audit(**vars(s), decrement=float(np.sqrt(gained)), gained=gained, condition=found,
                 place=places(values, system.keys),
                 unused=tuple(sorted(set(values.dims()) - set(system.keys))))  # fmt: skip


def statistics(
    system: linear.System, keys: Sequence[tuple[int, ...]], of: Kinds, metres: Sequence[IntArray],
    rng: np.random.Generator, draws: int, search: Callable[..., Contradicting | None], told: Told = unheard,
) -> Statistics:  # fmt: skip
    """Statistics of a graph linearized around its values; metres: per variable, the components that are a position in
    m; draws: of the graph's own noise; search: as `contradicting`, of the linear problem.
    """
    order = linear.ordering(system)
    f = linear.factorize(system, order)
    seen = factors.directions(f, factors.INEXACT)
    t = factors.examine(f, seen, metres)
    axis, rows = axes_of(of, system)
    drawn = smallest_p(f, seen, draws, rng)
    tested = int(np.isfinite(t.log_p).sum())
    alone = min(independent(drawn), tested) if len(drawn) and tested else tested
    together, all_ = factors.clusters(f, seen, t.deleted, t.rank, np.flatnonzero(of.loops).tolist(), metres)
    level, robust = np.log(factors.PARTS[0] * factors.FAMILY / max(alone, 1)), t.weight < 1.0
    told("tested", rejected=int((t.log_p < level).sum()), factors=tested, freedom=system.rows - f.rank)
    left = np.flatnonzero(robust & (t.log_p < level))
    rest, wrong = without(system, left, order) if robust.any() else f, None
    agreeing = min((c.log_p for c in together), default=0.0) < factors.cluster_level(all_)
    if np.any(np.delete(t.log_p, left) < level) or agreeing:
        wrong = search(rest, left, order, level, of.loops, metres)
        rest, left = (wrong.f, wrong.left) if wrong is not None else (rest, left)
    by_kind, by_axis = components(rest, left, order, of, rng)
    if wrong is not None:  # those that are not wrong with the noise that the residuals ask for belong to it
        theta = np.nan_to_num(by_kind.component, nan=1.0)[of.of[left]]
        gross = left[factors.log_p_of(wrong.T[left] / np.maximum(theta, 1.0), wrong.rank[left]) < level]
        if len(gross) < len(left):
            by_kind, by_axis = components(without(rest.system, gross, order), gross, order, of, rng)
    whole_rows = np.concatenate([each.ravel() for each in rows])
    every = [(1.0 - s.weight[:, None] * np.einsum("nij,nj->ni", s.V**2, s.h)).ravel() for s in seen]
    by_axis = replace(by_axis, redundancy=np.bincount(whole_rows, np.concatenate(every), len(axis)).astype(float))
    log_p = [c.log_p for c in together]
    if wrong is not None:
        log_p = factors.beside(rest, factors.directions(rest, factors.BRIEF), together, left)
    known = ~np.isin(of.names, of.assumed)  # a noise that nobody stated cannot be wrong
    divided = (axis[:, 1] >= 0) & known[axis[:, 0]]
    of_components = np.where(np.append(known, divided), np.append(by_kind.log_p, by_axis.log_p), np.nan)
    classes = (t.log_p, of_components, np.concatenate([log_p, np.zeros(all_ - len(together))]))
    weight = [np.full(len(p), w / max((~np.isnan(p)).sum(), 1)) for p, w in zip(classes, factors.PARTS, strict=True)]
    n, k = len(t.log_p), len(of.names)
    share = np.ones(sum(map(len, classes)))
    share[:n] = alone / max(tested, 1)
    adjusted = factors.holm(np.concatenate(classes), np.concatenate(weight), share)
    alone_wrong = np.full(n, np.nan)
    if wrong is not None:  # others are rejected beside these
        log_p_beside = factors.log_p_of(wrong.T[left], wrong.rank[left]) + np.log(alone / factors.PARTS[0])
        alone_wrong[left] = np.where(log_p_beside < adjusted[left], wrong.T[left], np.nan)
        adjusted[left] = np.fmin(adjusted[left], log_p_beside)
    p_drawn = family(t.log_p, drawn) if len(drawn) else np.full(n, np.nan)
    return Statistics(
        keys, of, t, adjusted[:n], p_drawn, by_kind, by_axis, axis, adjusted[n : n + k],
        adjusted[n + k : n + k + len(axis)], together, adjusted[n + k + len(axis) :][: len(together)],
        system.rows - f.rank, f, np.flatnonzero(adjusted[:n] < LOG_FAMILY) if wrong is None else left,
        alone_wrong, wrong is not None,
    )  # fmt: skip


def smallest_p(f: linear.Factored, seen: Sequence[Directions], count: int, rng: np.random.Generator) -> Array:
    """Logarithm of the smallest p value of all factors in each of `count` draws on the linear model. The rows of a
    robust noise are drawn as stated, and weighted as at the values.
    """
    A = weighted_rows(f)
    root = np.concatenate([np.repeat(np.sqrt(g.weight), g.r.shape[1]) for g in f.system.groups])[:, None]
    out = np.zeros(count)
    for first in range(0, count, linear.PART):
        part = slice(first, min(count, first + linear.PART))
        r = residuals(f, A, root * rng.standard_normal((A.shape[0], part.stop - part.start))) / root
        at = 0
        for g, s in zip(f.system.groups, seen, strict=True):
            n, d = g.r.shape
            T = s.tested(r[at : at + n * d].reshape(n, d, -1))
            rank = np.sum(s.R > 0.0, 1)
            for k in np.unique(rank[rank > 0]).tolist():
                out[part] = np.minimum(out[part], log_tail(T[rank == k].max(0), k))
            at += n * d
    return out


def independent(smallest: Array) -> float:
    """Number of independent tests whose least p value is distributed as those drawn (logarithms), where it is small. It
    is exponential in -log(1 - p); the maximum-likelihood rate from the lower half, the rest is censored.
    """
    y = -np.log1p(-np.exp(np.sort(smallest)))
    k = (len(y) + 1) // 2
    return float(k / max(y[:k].sum() + (len(y) - k) * y[k - 1], 1e-300))


def family(log_p: Array, smallest: Array) -> Array:
    """Family-wise p values (F,) of logarithms of p values, from the smallest of each draw; NaN stays."""
    below = np.searchsorted(np.sort(smallest), log_p, side="right")
    return np.where(np.isfinite(log_p), (1.0 + below) / (1.0 + len(smallest)), np.nan)


def places(values: gtsam.Values, keys: Sequence[int]) -> Array:
    """Positions (V, 3), NaN of variables without one; in the plane z is 0."""
    out = np.full((len(keys), 3), np.nan)
    for v, key in enumerate(keys):
        value = linear.value_of(values, key)
        if value is not None:
            place = value if isinstance(value, np.ndarray) else value.translation()
            out[v, : len(place)], out[v, len(place) :] = place, 0.0
    return out


def axes_of(of: Kinds, system: linear.System) -> tuple[IntArray, list[IntArray]]:
    """Kind and axis (K, 2) of each component, axis -1 for a whole kind, and per group the component (n, d) of a row."""
    axis = np.array([(k, a) for k, names in enumerate(of.axes) for a in (range(len(names)) or (-1,))])
    begin: IntArray = np.searchsorted(axis[:, 0], np.arange(len(of.axes)))
    split = np.array([len(names) > 0 for names in of.axes])
    of_group = [(of.of[g.factor], np.arange(g.r.shape[1])) for g in system.groups]
    return axis, [begin[kind][:, None] + np.where(split[kind][:, None], row, 0) for kind, row in of_group]


def left_out(
    graph: linear.Graph, values: linear.Values, a: Audit, sets: Sequence[Sequence[int]]
) -> list[tuple[float, float]]:
    """Of each set of factors without it: motion of the worst point in m, and decrease of the sum of squares. `values`
    are the optimum of the graph, `a` is the audit of both, `sets` numbers of factors left out together.
    """
    begin, out = 2.0 * graph.error(values), []
    for some in sets:
        end = optimum_without(graph, values, some)
        apart = np.linalg.norm(places(end, a.f.system.keys) - a.place, axis=1)
        lost = 2.0 * sum(graph.at(int(i)).error(end) for i in some)
        out.append((float(np.nanmax(apart, initial=0.0)), begin - 2.0 * graph.error(end) + lost))
    return out


MOVES = 1e-6  # share of a null vector's largest entry that counts as motion
WHOLE = 0.9  # share of the poses that move with the whole graph
MOST = 512  # directions without information that are looked at


def condition(f: linear.Factored, part: IntArray, metres: Sequence[IntArray], shape: Array) -> Condition:
    """The findings. part (V,): connected part of each variable; metres: of its tangent, the components of a position;
    shape (N, 4): motion if the graph grows, and three shifts of its centre, as of `growth`.
    """
    sizes = tuple(sorted(np.bincount(part).tolist(), reverse=True))
    gauge, scale, loose = 0, 0, list[Loose]()
    A = weighted_rows(f)
    norm = np.sqrt(np.asarray(A.multiply(A).sum(0)).ravel())
    unit = np.where(norm > 0.0, norm, 1.0)[:, None]
    dropped = f.dropped[-MOST:]
    N = linear.solved(f, np.asarray(-(A.T @ A[:, dropped]).toarray()))  # motions that cost nothing, in sigmas `unit`
    N[dropped, np.arange(len(dropped))] += 1.0
    N = N * unit / np.maximum(np.abs(N * unit).max(0, initial=0.0), np.finfo(float).tiny)
    placed = np.array([len(each) > 0 for each in metres])
    for p in np.unique(part).tolist() if N.shape[1] else []:
        members = np.flatnonzero(part == p)
        rows = np.concatenate([_columns(f, u) for u in members.tolist()])
        poses = members[placed[members]] if placed[members].any() else members
        mine = N[:, (np.abs(N[rows]) > MOVES).any(0)]
        grown, mine = _without_growth(mine, np.where(np.isin(np.arange(len(unit)), rows)[:, None], shape * unit, 0.0))
        found, rest = _gauge(f, mine, members, poses)
        gauge, scale = gauge + found + grown, scale + grown
        for v, n in zip(members.tolist(), _ranks(f, rest, members).tolist(), strict=True):
            if n:
                moves = np.abs(rest[_columns(f, v)]).max(1) > MOVES
                place = shape[_columns(f, v), 1:].any(1)
                loose.append(Loose(v, n, bool(moves[place].any()), bool(moves[~place].any())))
    alike, pairs = dict[bytes, int](), list[tuple[int, int]]()
    for g in f.system.groups:
        for i, variables, J, e in zip(g.factor.tolist(), g.variables, g.A, g.r, strict=True):
            if (first := alike.setdefault(variables.tobytes() + J.tobytes() + e.tobytes(), i)) != i:
                pairs.append((first, i))
    return Condition(sizes, gauge, scale, tuple(sorted(loose)), tuple(pairs))


def growth(values: linear.Values, system: linear.System, at: IntArray) -> Array:
    """Motion (N, 4) of poses and points if all grows about the origin, and shifts of that centre."""
    out, place = np.zeros((int(system.dim.sum()), 4)), places(values, system.keys)
    for v, key in enumerate(system.keys):
        if np.isfinite(place[v]).all():
            value = linear.value_of(values, key)
            R = np.eye(len(value)) if isinstance(value, np.ndarray) else value.rotation().matrix().T
            first, d = int(at[v]) + 3 * isinstance(value, gtsam.Pose3), len(R)  # gtsam has the rotation first
            out[first : first + d] = R @ np.column_stack([place[v], -np.eye(3)])[:d]
    return out


def _without_growth(N: Array, D: Array) -> tuple[int, Array]:
    """Whether a part's scale is free, 1 or 0, and the motions besides; D (N, 4): its growth and shifts, in sigmas."""
    if not N.shape[1] or not D[:, 0].any():
        return 0, N
    x = np.linalg.lstsq(np.column_stack([N, D[:, 1:]]), D[:, 0], rcond=None)[0]
    apart = D[:, 0] - np.column_stack([N, D[:, 1:]]) @ x
    c = x[: N.shape[1]]
    if np.abs(apart).max() > MOVES * np.abs(D[:, 0]).max() or np.abs(N @ c).max() < MOVES * np.abs(D[:, 0]).max():
        return 0, N
    return 1, N @ np.linalg.svd(c[None])[2][1:].T


def _gauge(f: linear.Factored, N: Array, members: IntArray, poses: IntArray) -> tuple[int, Array]:
    """Number of directions that move nearly all poses, and what still moves while one well-tied pose stays."""
    rank = _ranks(f, N, poses)
    if np.count_nonzero(rank) < max(WHOLE * len(poses), 1):
        return 0, N
    typical = poses[rank == np.bincount(rank[rank > 0]).argmax()]
    tries = [_held(f, N, int(v)) for v in typical[[0, len(typical) // 2, -1]]]
    return min(tries, key=lambda found: np.count_nonzero(_ranks(f, found[1], members)))


def _held(f: linear.Factored, N: Array, v: int) -> tuple[int, Array]:
    """Number of directions in which a variable moves, and the motions in which it stays."""
    _, s, Vt = np.linalg.svd(N[_columns(f, v)])
    rank = int((s > MOVES).sum())
    return rank, N @ Vt[rank:].T


def _ranks(f: linear.Factored, N: Array, some: IntArray) -> IntArray:
    """Number of directions in which each of some variables moves."""
    out = np.zeros(len(some), np.int64)
    for d in np.unique(f.system.dim[some]).tolist() if N.shape[1] else []:
        mine = np.flatnonzero(f.system.dim[some] == d)
        out[mine] = (np.linalg.svd(N[f.at[some[mine]][:, None] + np.arange(d)], compute_uv=False) > MOVES).sum(1)
    return out


def _columns(f: linear.Factored, v: int) -> IntArray:
    return np.arange(f.at[v], f.at[v] + f.system.dim[v])


def warm() -> None:
    """Compile the kernels of an audit, by that of four poses in a loop."""
    graph, values, unit = gtsam.NonlinearFactorGraph(), gtsam.Values(), gtsam.noiseModel.Unit.Create(3)
    for i in range(4):
        values.insert(i, gtsam.Pose2())
        graph.add(gtsam.BetweenFactorPose2(i, (i + 1) % 4, gtsam.Pose2(), unit))
    graph.add(gtsam.PriorFactorPose2(0, gtsam.Pose2(), unit))
    examined(graph, values, draws=1)
